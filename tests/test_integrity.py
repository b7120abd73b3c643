"""Records are checked before kernels read them: missing node numbers raise errors, and memory stays whole."""

import pickle
from dataclasses import replace
from decimal import Decimal
from fractions import Fraction

import numpy as np
import pytest

from fish_env import BODIES, Tank, make_fish
from fish_env.control import load_policy, shipped_policy
from fish_env.envs import FishVectorEnv
from fish_env.physics.body import make_body
from fish_env.physics.failures import FAILURES
from fish_env.physics.forces.evaluate import Evaluator
from fish_env.soft import statics
from fish_env.soft.conditions import make_anchors
from fish_env.soft.objects import make_ring
from fish_env.soft.room import make_world

FISH = make_fish()
SOLID = make_fish("tetrahedral")
RING = make_ring()
BODY = FISH.body


def with_part(fish, part, **changes):
    """A fish with other fields of a part of its body."""
    return replace(fish, body=fish.body._replace(**{part: getattr(fish.body, part)._replace(**changes)}))


def raised(array, by=1000):
    """A copy of whole numbers, its last element larger."""
    array = np.array(array)
    array.reshape(-1)[-1] += by
    return array


CHANGED = {
    "springs": (with_part(FISH, "springs", nodes=raised(BODY.springs.nodes)), "springs.nodes contains 10"),
    "negative": (with_part(FISH, "springs", nodes=raised(BODY.springs.nodes, -99)), "springs.nodes contains -"),
    "order": (with_part(FISH, "springs", nodes=BODY.springs.nodes[::-1].copy()), "springs.entry does not name"),
    "stiffness": (with_part(FISH, "springs", stiffness=np.ones(3)), "stiffness of springs has shape"),
    "entry": (with_part(FISH, "springs", entry=raised(BODY.springs.entry)), "springs.entry does not"),
    "faces": (with_part(FISH, "faces", nodes=raised(BODY.faces.nodes)), "faces.nodes contains"),
    "tetrahedra": (with_part(SOLID, "tets", nodes=raised(SOLID.body.tets.nodes)), "tets.nodes contains"),
    "gas": (with_part(RING, "compartments", faces=raised(RING.body.compartments.faces)), "compartments.faces"),
    "first": (with_part(RING, "compartments", first=np.array([0, 5, 7])), "compartments.first is"),
    "barriers": (with_part(RING, "barriers", nodes=raised(RING.body.barriers.nodes)), "barriers.nodes contains"),
    "profile": (with_part(FISH, "profile", first=np.zeros(23, int)), "profile of the body is not that"),
    "mass": (replace(FISH, body=BODY._replace(mass=np.ones(22))), "position of body has shape"),
    "position": (replace(FISH, body=BODY._replace(position=BODY.position * np.nan)), "position of body"),
    "muscles": (replace(FISH, muscles=raised(FISH.muscles)), "muscles contains"),
    "contracted": (replace(FISH, contracted=FISH.contracted[:3]), "contracted has shape"),
    "fibres": (replace(FISH, fibres=raised(FISH.fibres), drives=FISH.drives), "fibres contains"),
    "drives": (replace(FISH, fibres=FISH.fibres, drives=raised(FISH.drives)), "drives contains"),
    "right": (replace(FISH, right=FISH.right[:-1]), "right has shape"),
    "nose": (replace(FISH, nose=23), "nose contains 23"),
    "landmarks": (
        replace(FISH, landmarks=FISH.landmarks._replace(node=raised(FISH.landmarks.node))), "landmarks.node contains"
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", CHANGED)
def test_inconsistent_parts(name):
    """A fish with an inconsistent part raises an error that names the part when a tank is made."""
    fish, text = CHANGED[name]
    with pytest.raises(ValueError, match=text):
        Tank(fish, 2)


@pytest.mark.parametrize("change", [{"node": np.array([-1])}, {"node": np.array([23])}, {"stiffness": np.ones(2)},
                                    {"point": np.array([[np.inf, 0.0, 0.0]])}])  # fmt: skip
def test_inconsistent_anchors(change):
    """Anchors of missing nodes, or with inconsistent arrays, raise an error; so does friction that drives."""
    anchors = make_anchors([0], [(0.0, 0.0, 0.0)], 1.0)._replace(**change)
    with pytest.raises(ValueError, match="anchors"):
        Tank(FISH, 1, water=FISH.water._replace(anchors=anchors))
    with pytest.raises(ValueError, match="friction of the water"):
        Tank(FISH, 1, water=FISH.water._replace(friction=-1.0))


@pytest.mark.parametrize(
    "call",
    [
        statics.equilibrium,
        lambda body, world: statics.modes(body, 3, world),
        lambda body, world: statics.linear_deflection(body, 0.0 * body.position, world),
        lambda body, world: statics.reactions(body, body.position, world),
        Evaluator,
    ],
)
def test_inconsistent_problems(call):
    """Statics and forces check the nodes of the anchors, and of a body changed in place."""
    anchors = make_anchors([0], [(0.0, 0.0, 0.0)], 1.0)._replace(node=np.array([10**7]))
    with pytest.raises(ValueError, match="anchors contains 10000000; valid numbers are 0 to 22"):
        call(BODY, FISH.water._replace(anchors=anchors))
    body = make_fish().body
    body.faces.nodes[:] = 10**7
    with pytest.raises(ValueError, match=r"faces.nodes contains 10000000"):
        call(body, FISH.water)


@pytest.mark.parametrize(
    ("contraction", "duration", "text"),
    [
        (np.zeros((5, 12)), 0.02, r"has shape \(5, 12\); give shape \(2, 12\)"),
        (np.zeros((2, 3)), 0.02, r"has shape \(2, 3\)"),
        (np.zeros(12), 0.02, r"has shape \(12,\)"),
        (np.full((2, 12), np.nan), 0.02, "contraction is nan"),
        (np.full((2, 12), 1.5), 0.02, "contraction is from 1.5 to 1.5; give numbers from 0 to 1"),
        (np.full((2, 12), 1.0 + 2**-52), 0.02, "contraction is from 1.0000000000000002 to 1.0000000000000002; give"),
        (np.zeros((2, 12)), -1.0, "duration is -1.0; give a positive"),
        (np.zeros((2, 12)), np.nan, "duration is nan; give a positive"),
    ],
)
def test_invalid_commands(contraction, duration, text):
    """Commands of another shape, that are not finite or out of range raise an error and change nothing."""
    tank = Tank(FISH, 2)
    before = tank.get_state()
    with pytest.raises(ValueError, match=text):
        tank.command(contraction, duration)
    if duration > 0:
        with pytest.raises(ValueError, match=text):
            tank.drive(contraction, 6)
    for name, array in tank.get_state().items():
        np.testing.assert_array_equal(array, before[name])
    assert not tank.control.rate.any()


ONE = Tank(FISH, 1)
TWO = Tank(FISH, 2)


@pytest.mark.parametrize(
    ("call", "text"),
    [
        *((lambda steps=steps: ONE.advance(steps), r"steps is .*; give a whole number from 0") for steps in
          (-1, 1.0, 1.5, 2**64, "3", None)),
        *((lambda steps=steps: ONE.drive(np.zeros((1, 12)), steps), r"steps is .*; give a whole number from 0")
          for steps in (-1, 1.5, 2**64, "3", None)),
        (lambda: TWO.nearest((0.0, 0.0, 0.0), [99], 0), "contains 99"),
        (lambda: TWO.nearest((0.0, 0.0, 0.0), [-1], 0), "contains -1"),
        (lambda: TWO.nearest((0.0, 0.0, 0.0), [], 0), "empty"),
        (lambda: TWO.nearest((0.0, 0.0, 0.0), None, 2), "i contains 2"),
        (lambda: make_fish(length="0.3"), "length is"),
        (lambda: make_fish(length=0.3 + 0j), "length is"),
        (lambda: make_fish(length=None), "length is"),
        (lambda: Tank(FISH, 1, dt=5e-324), "dt is 5e-324; give a positive number of seconds, at least 1e-12"),
        (lambda: make_world(planes=3), "planes is 3"),
        (lambda: make_body(BODY.position, BODY.mass, *BODY.springs[:4], BODY.faces.nodes, tets=3),
         "tets is a int; give what make_tets returns"),
    ],
)  # fmt: skip
def test_invalid_numbers(call, text):
    """Numbers of another type or out of range raise errors that name them."""
    with pytest.raises(ValueError, match=text):
        call()


def test_valid_numbers():
    """Fractions and decimals are numbers; `nearest` finds the nearest node."""
    for length in (Fraction(1, 5), Decimal("0.2")):
        assert make_fish(length=length).body.position.tobytes() == make_fish(length=0.2).body.position.tobytes()
    assert TWO.nearest(BODY.position[4], [3, 4, 5], 1) == 4


@pytest.mark.parametrize(
    ("part", "value", "text"),
    [
        ("about", np.array("null"), "'about' is a NoneType"),
        ("about", np.array("[]"), "not a dictionary"),
        ("about", np.array(3.0), "'about' is a float, not a dictionary"),
        ("weight0", np.array([["a"]]), "<U1; it should be floating"),
        ("weight0", np.zeros((156, 64), complex), "complex128; it should be floating"),
        ("weight0", np.zeros((156, 64), int), "int64; it should be floating"),
        ("bias1", np.zeros((3, 3), np.float32), r"\(3, 3\) of float32; it should be floating of shape"),
    ],
)
def test_invalid_policy_files(tmp_path, part, value, text):
    """A policy file with parts of another type raises an error that names the file."""
    with np.load(shipped_policy("swim")) as file:
        held = dict(file) | {part: value}
    np.savez(tmp_path / "policy.npz", **held)
    with pytest.raises(ValueError, match=rf"policy.npz.*{text}"):
        load_policy(tmp_path / "policy.npz")


def test_no_policy_files(tmp_path):
    """A renamed array, and a file whose header promises more memory than there is, are errors that name the file."""
    np.save(tmp_path / "array.npy", np.zeros(3))
    (tmp_path / "array.npy").rename(tmp_path / "policy.npz")
    with np.load(shipped_policy("swim")) as file:
        np.savez(tmp_path / "huge.npz", **dict(file))
    data = (tmp_path / "huge.npz").read_bytes()
    shape = b"(156, 32)" if b"(156, 32)" in data else data[data.index(b"'shape': (") + 9 :].split(b")")[0] + b")"
    (tmp_path / "huge.npz").write_bytes(data.replace(shape, b"(" + b"9" * (len(shape) - 3) + b",)", 1))
    for name in ("policy", "huge"):
        with pytest.raises(ValueError, match="is not a policy file"):
            load_policy(tmp_path / f"{name}.npz")


# What belongs to a tank


@pytest.mark.parametrize("integrator", ["leapfrog_chebyshev", "dop853"])
def test_a_tank_has_a_body_of_its_own(integrator):
    """A fish changed after a tank of it was made changes nothing, also in a copy by pickle and when a node is fixed."""
    fish = make_fish()
    tank, same = Tank(fish, integrator=integrator), Tank(make_fish(), integrator=integrator)
    fish.body.springs.nodes[:] = 10**7
    fish.fibres[:] = fish.muscles[:] = fish.landmarks.node[:] = 10**7
    for each in (tank, same):
        each.swim(np.linspace(-1.0, 1.0, 12), each.dt)
    copy = pickle.loads(pickle.dumps(tank))
    for each in (tank, copy, same):
        each.fix([0])
        each.advance(1)
        each.reactions()
    for each in (tank, copy):
        np.testing.assert_array_equal(each.position, same.position)
        for array in (each.fish.body.springs.nodes, each.fish.body.inverse_mass, each.world.current):
            with pytest.raises(ValueError, match="read-only"):
                array[:] = 0
    with pytest.raises(ValueError, match=r"springs.nodes contains 10+; valid numbers are 0 to 22"):
        Tank(fish, 1)


@pytest.mark.parametrize(
    ("name", "value"),
    [("num_fish", 10**6), ("dt", -1.0), ("state", None), ("control", None), ("fish", FISH), ("threads", 10**6)],
)
def test_read_only_attributes(name, value):
    """The attributes that kernels depend on are read-only."""
    tank = Tank(FISH, 2)
    before = getattr(tank, name)
    with pytest.raises(AttributeError, match=f"Tank.{name} is read-only; create a new Tank"):
        setattr(tank, name, value if name != "state" else tank.state._replace(x=tank.state.x.astype(np.float32)))
    assert getattr(tank, name) is before


def test_read_only_attributes_of_an_environment():
    """So are those of a batch of environments."""
    env = FishVectorEnv(2)
    for name, text in (("num_envs", "make a new"), ("tank", "FishVectorEnv.tank is read-only"), ("groups", "read-")):
        with pytest.raises(AttributeError, match=text):
            setattr(env, name, 10**6)
    env.close()


@pytest.mark.parametrize("integrator", ["leapfrog_chebyshev", "rk4", "dop853"])
def test_non_finite_clock(integrator):
    """A nan on the clock of a fish ends its motion with the reason; the other one swims on as before."""
    tank, same = (Tank(FISH, 2, integrator=integrator) for _ in range(2))
    tank.time[1] = np.nan
    for each in (tank, same):
        each.swim(np.full(12, 0.5), 0.02)
    assert tank.alive.tolist() == [True, False] and tank.time.tolist() == [same.time[0], 0.0]
    assert tank.failure[1].startswith("non-finite: a position, a velocity or the clock")
    np.testing.assert_array_equal(tank.position[0], same.position[0])
    np.testing.assert_array_equal(tank.position[1], BODY.position)
    tank.set_state(tank.get_state())


@pytest.mark.parametrize("integrator", ["leapfrog_chebyshev", "dop853"])
def test_invalid_rest_lengths(integrator):
    """Such a rest length ends the episode of its fish with a reason; observations and rewards are finite."""
    options = {"task": "swim", "integrator": integrator, "autoreset_mode": "Disabled"}
    fish, action = FISH, np.full((2, 12), 0.3)
    passive = next(e for e in range(len(fish.body.mass)) if e not in fish.fibres)
    env, other = FishVectorEnv(2, **options), FishVectorEnv(2, **options)
    for value in (np.nan, np.inf, -np.inf, 1e300):
        for where in (fish.muscles[3], passive, slice(None)):
            for each in (env, other):
                each.reset(seed=0)
            env.tank.rest_length[1, where] = value
            obs, reward, terminated, _, infos = env.step(action)
            expected = other.step(action)
            assert np.isfinite(obs).all() and np.isfinite(reward).all() and terminated.tolist() == [False, True]
            assert infos["failure"][1] and all(np.isfinite(array).all() for array in env.tank.state)
            assert np.isfinite(env.tank.rest_length).all() and np.isfinite(env.tank.effort).all()
            assert obs[0].tobytes() == expected[0][0].tobytes() and reward[0] == expected[1][0]


def test_invalid_failure():
    """A number that stands for no failure is an error that names it; the fish does not move."""
    tank = Tank(FISH, 2)
    tank.state.failure[1] = 99
    tank.advance(1)
    with pytest.raises(ValueError, match=f"state.failure contains 99; valid numbers are 0 to {len(FAILURES) - 1}"):
        _ = tank.failure


@pytest.mark.parametrize("body", BODIES)
def test_fish_share_no_memory(body):
    """Writing to the arrays of one fish changes no other."""
    one, other = make_fish(body), make_fish(body)
    for name in ("left", "right", "muscles", "mirror"):
        assert not np.shares_memory(getattr(one, name), getattr(other, name))
