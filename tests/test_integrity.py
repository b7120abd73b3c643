"""What kernels are given is checked first: node numbers that do not exist never reach them, and memory stays whole."""

import pickle
from dataclasses import replace

import numpy as np
import pytest

from fish_env import BODIES, Tank, make_fish
from fish_env.bodies.objects import make_ring
from fish_env.control import load_policy, shipped_policy
from fish_env.envs import FishVectorEnv
from fish_env.physics import statics
from fish_env.physics.body import make_body
from fish_env.physics.failures import FAILURES
from fish_env.physics.forces.evaluate import Evaluator
from fish_env.physics.statics import equilibrium, reactions
from fish_env.physics.world import make_anchors, make_world

FISH = make_fish()
SOLID = make_fish("tetrahedral")
RING = make_ring()


def with_part(fish, part, **changes):
    """A fish with fields of a part of its body changed by hand."""
    return replace(fish, body=fish.body._replace(**{part: getattr(fish.body, part)._replace(**changes)}))


def raised(array, by=1000):
    """A copy of whole numbers, its last element larger."""
    array = np.array(array)
    array.reshape(-1)[-1] += by
    return array


CHANGED = {
    "springs": (lambda: with_part(FISH, "springs", nodes=raised(FISH.body.springs.nodes)), "springs.nodes contains 10"),
    "negative": (
        lambda: with_part(FISH, "springs", nodes=raised(FISH.body.springs.nodes, -99)),
        "springs.nodes contains -",
    ),
    "another spring": (
        lambda: with_part(FISH, "springs", nodes=FISH.body.springs.nodes[::-1].copy()),
        "springs.entry does not name",
    ),
    "stiffness": (lambda: with_part(FISH, "springs", stiffness=np.ones(3)), "stiffness of springs has shape"),
    "entry": (lambda: with_part(FISH, "springs", entry=raised(FISH.body.springs.entry)), "springs.entry does not"),
    "faces": (lambda: with_part(FISH, "faces", nodes=raised(FISH.body.faces.nodes)), "faces.nodes contains"),
    "tetrahedra": (lambda: with_part(SOLID, "tets", nodes=raised(SOLID.body.tets.nodes)), "tets.nodes contains"),
    "gas": (lambda: with_part(RING, "compartments", faces=raised(RING.body.compartments.faces)), "compartments.faces"),
    "first": (lambda: with_part(RING, "compartments", first=np.array([0, 5, 7])), "compartments.first is"),
    "barriers": (
        lambda: with_part(RING, "barriers", nodes=raised(RING.body.barriers.nodes)),
        "barriers.nodes contains",
    ),
    "profile": (
        lambda: replace(FISH, body=FISH.body._replace(profile=FISH.body.profile._replace(first=np.zeros(23, int)))),
        "profile of the body is not that",
    ),
    "mass": (lambda: replace(FISH, body=FISH.body._replace(mass=np.ones(22))), "position of body has shape"),
    "position": (
        lambda: replace(FISH, body=FISH.body._replace(position=FISH.body.position * np.nan)),
        "position of body",
    ),
    "muscles": (lambda: replace(FISH, muscles=raised(FISH.muscles)), "muscles contains"),
    "contracted": (lambda: replace(FISH, contracted=FISH.contracted[:3]), "contracted has shape"),
    "fibres": (lambda: replace(FISH, fibres=raised(FISH.fibres), drives=FISH.drives), "fibres contains"),
    "drives": (lambda: replace(FISH, fibres=FISH.fibres, drives=raised(FISH.drives)), "drives contains"),
    "right": (lambda: replace(FISH, right=FISH.right[:-1]), "right has shape"),
    "nose": (lambda: replace(FISH, nose=23), "nose contains 23"),
    "landmarks": (
        lambda: replace(FISH, landmarks=FISH.landmarks._replace(node=raised(FISH.landmarks.node))),
        "landmarks.node contains",
    ),
}


@pytest.mark.parametrize("name", CHANGED)
def test_parts_that_do_not_fit_are_refused(name):
    """A fish that was changed by hand is refused when a tank is made, with the part that is wrong."""
    make, message = CHANGED[name]
    with pytest.raises(ValueError, match=message):
        Tank(make(), 2)


def test_a_body_changed_in_place_is_refused_or_harmless():
    """Changed before a tank is made, a body is refused; after it, the tank does not notice."""
    fish = make_fish()
    tank, same = Tank(fish, 2, water=fish.water), Tank(make_fish(), 2, water=fish.water)
    fish.body.springs.nodes[:] = 10**9
    fish.landmarks.node[:] = 10**9
    fish.muscles[:] = 10**9
    action = np.random.default_rng(0).uniform(-1.0, 1.0, (2, 12))
    for each in (tank, same):
        each.swim(action, fish.control_interval)
    np.testing.assert_array_equal(tank.position, same.position)
    with pytest.raises(ValueError, match=r"springs.nodes contains 10+; valid numbers are 0 to 22"):
        Tank(fish, 1)
    with pytest.raises(ValueError, match=r"springs.nodes contains"):
        equilibrium(fish.body)


@pytest.mark.parametrize("change", [{"node": np.array([-1])}, {"node": np.array([23])}, {"stiffness": np.ones(2)},
                                    {"point": np.array([[np.inf, 0.0, 0.0]])}])  # fmt: skip
def test_anchors_that_do_not_fit_are_refused(change):
    """Anchors that were changed by hand hold no node that is missing."""
    anchors = make_anchors([0], [(0.0, 0.0, 0.0)], 1.0)._replace(**change)
    with pytest.raises(ValueError, match="anchors"):
        Tank(FISH, 1, water=FISH.water._replace(anchors=anchors))


@pytest.mark.parametrize(
    ("contraction", "duration", "message"),
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
def test_commands_that_do_not_fit_are_refused(contraction, duration, message):
    """Commands of another shape, that are not finite or out of range change nothing."""
    tank = Tank(FISH, 2)
    before = tank.get_state()
    with pytest.raises(ValueError, match=message):
        tank.command(contraction, duration)
    if duration > 0:
        with pytest.raises(ValueError, match=message):
            tank.drive(contraction, 6)
    for name, array in tank.get_state().items():
        np.testing.assert_array_equal(array, before[name])
    assert not tank.control.rate.any()


@pytest.mark.parametrize("steps", [-1, 1.5, 2**64, "3", None])
def test_steps_that_are_none_are_refused(steps):
    """A number of steps is a whole one that fits the clock."""
    for call in (lambda tank: tank.advance(steps), lambda tank: tank.drive(np.zeros((1, 12)), steps)):
        with pytest.raises(ValueError, match=r"steps is .*; give a whole number from 0"):
            call(Tank(FISH, 1))


def test_nearest_takes_nodes_that_there_are():
    """`nearest` names the node that is missing."""
    tank = Tank(FISH, 2)
    assert tank.nearest(FISH.body.position[4], [3, 4, 5], 1) == 4
    for nodes, i, message in (
        ([99], 0, "contains 99"),
        ([-1], 0, "contains -1"),
        ([], 0, "empty"),
        (None, 2, "i contains 2"),
    ):
        with pytest.raises(ValueError, match=message):
            tank.nearest((0.0, 0.0, 0.0), nodes, i)


def test_odd_numbers_are_numbers_or_refused():
    """Fractions and decimals are numbers; text, complex numbers and steps below the clock's rounding are not."""
    from decimal import Decimal
    from fractions import Fraction

    for length in (Fraction(1, 5), Decimal("0.2")):
        assert make_fish(length=length).body.position.tobytes() == make_fish(length=0.2).body.position.tobytes()
    for bad in ("0.3", 0.3 + 0j, None):
        with pytest.raises(ValueError, match="length is"):
            make_fish(length=bad)
    with pytest.raises(ValueError, match="dt is 5e-324; give a positive number of seconds, at least 1e-12"):
        Tank(FISH, 1, dt=5e-324)
    with pytest.raises(ValueError, match="planes is 3"):
        make_world(planes=3)
    b = FISH.body
    with pytest.raises(ValueError, match="tets is a int; give what make_tets returns"):
        make_body(b.position, b.mass, b.springs.nodes, b.springs.stiffness, b.springs.damping, b.springs.rest_length,
                  b.faces.nodes, tets=3)  # fmt: skip


@pytest.mark.parametrize(
    ("part", "value", "message"),
    [
        ("about", np.array("null"), "'about' is a NoneType"),
        ("about", np.array("[]"), "not a dictionary"),
        ("about", np.array(3.0), "'about' is an array"),
        ("weight0", np.array([["a"]]), "give floating-point numbers"),
        ("weight0", np.zeros((156, 64), complex), "give floating-point numbers"),
        ("weight0", np.zeros((156, 64), int), "give floating-point numbers"),
        ("bias1", np.zeros((3, 3), np.float32), "do not fit together"),
    ],
)
def test_odd_policy_files_are_refused(tmp_path, part, value, message):
    """A policy file with parts of another type is an error that names the file."""
    with np.load(shipped_policy("swim")) as file:
        held = dict(file) | {part: value}
    np.savez(tmp_path / "policy.npz", **held)
    with pytest.raises(ValueError, match=rf"policy.npz.*{message}"):
        load_policy(tmp_path / "policy.npz")


def test_an_array_is_no_policy(tmp_path):
    """A renamed array, and a file whose header promises more memory than there is, are errors that name the file."""
    np.save(tmp_path / "array.npy", np.zeros(3))
    (tmp_path / "array.npy").rename(tmp_path / "policy.npz")
    with pytest.raises(ValueError, match="is not a policy file"):
        load_policy(tmp_path / "policy.npz")
    with np.load(shipped_policy("swim")) as file:
        np.savez(tmp_path / "huge.npz", **dict(file))
    data = (tmp_path / "huge.npz").read_bytes()
    shape = b"(156, 32)" if b"(156, 32)" in data else data[data.index(b"'shape': (") + 9 :].split(b")")[0] + b")"
    (tmp_path / "huge.npz").write_bytes(data.replace(shape, b"(" + b"9" * (len(shape) - 3) + b",)", 1))
    with pytest.raises(ValueError, match="is not a policy file"):
        load_policy(tmp_path / "huge.npz")


ODD_ANCHOR = make_anchors([0], [(0.0, 0.0, 0.0)], 1.0)._replace(node=np.array([10**7]))


@pytest.mark.parametrize("integrator", ["leapfrog_chebyshev", "dop853", "radau"])
def test_a_tank_has_a_body_of_its_own(integrator):
    """A fish changed after a tank of it was made changes nothing, also in a copy by pickle and when a node is fixed."""
    fish = make_fish()
    tank, same = Tank(fish, integrator=integrator), Tank(make_fish(), integrator=integrator)
    fish.body.springs.nodes[:] = 10**7
    fish.fibres[:] = fish.muscles[:] = 10**7
    for each in (tank, same):
        each.advance(1)
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


@pytest.mark.parametrize("pose", [statics.equilibrium, lambda body, world: statics.modes(body, 3, world),
                                  lambda body, world: statics.linear_deflection(body, 0.0 * body.position, world),
                                  lambda body, world: reactions(body, body.position, world), Evaluator])  # fmt: skip
def test_problems_whose_parts_do_not_fit_are_refused(pose):
    """Statics and forces are worked out for nodes that there are: of the anchors, and of a body changed in place."""
    with pytest.raises(ValueError, match="anchors contains 10000000; valid numbers are 0 to 22"):
        pose(FISH.body, FISH.water._replace(anchors=ODD_ANCHOR))
    body = make_fish().body
    body.faces.nodes[:] = 10**7
    with pytest.raises(ValueError, match=r"faces.nodes contains 10000000"):
        pose(body, FISH.water)


@pytest.mark.parametrize(
    ("name", "value"),
    [("num_fish", 10**6), ("dt", -1.0), ("state", None), ("control", None), ("fish", FISH), ("threads", 10**6)],
)
def test_what_a_tank_is_made_with_stays(name, value):
    """What kernels count on cannot be set anew, and says so."""
    tank = Tank(make_fish(), 2)
    if name == "state":
        value = tank.state._replace(x=tank.state.x.astype(np.float32))
    before = getattr(tank, name)
    with pytest.raises(AttributeError, match=f"Tank.{name} is read-only; create a new Tank"):
        setattr(tank, name, value)
    assert getattr(tank, name) is before
    tank.advance(1)


@pytest.mark.parametrize("name", ["num_envs", "tank", "control_interval"])
def test_what_a_batch_is_made_with_stays(name):
    """The same of a batch of environments."""
    env = FishVectorEnv(2)
    with pytest.raises(AttributeError, match=f"FishVectorEnv.{name} is read-only"):
        setattr(env, name, 10**6)
    env.close()


@pytest.mark.parametrize("integrator", ["leapfrog_chebyshev", "rk4", "dop853"])
def test_a_clock_that_is_not_finite_ends_a_fish(integrator):
    """A user's nan on the clock ends that fish with the reason, where it is; the other one swims on as before."""
    tank, same = Tank(make_fish(), 2, integrator=integrator), Tank(make_fish(), 2, integrator=integrator)
    tank.time[1] = np.nan
    for each in (tank, same):
        each.swim(np.full(12, 0.5), 0.02)
    assert tank.alive.tolist() == [True, False] and tank.time.tolist() == [same.time[0], 0.0]
    assert tank.failure[1].startswith("non-finite: a position, a velocity or the clock")
    np.testing.assert_array_equal(tank.position[0], same.position[0])
    np.testing.assert_array_equal(tank.position[1], tank.fish.body.position)
    tank.set_state(tank.get_state())


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf, 1e300])
@pytest.mark.parametrize("where", ["muscle", "spring", "all"])
@pytest.mark.parametrize("integrator", ["leapfrog_chebyshev", "dop853"])
def test_rest_lengths_that_are_none(integrator, where, value):
    """Such a rest length ends the episode of its fish with a reason; what is seen and rewarded is finite."""
    options = {"task": "swim", "integrator": integrator, "autoreset_mode": "Disabled"}
    env, other = FishVectorEnv(2, **options), FishVectorEnv(2, **options)
    fish, action = env.tank.fish, np.full((2, 12), 0.3)
    other_spring = next(e for e in range(len(fish.body.mass)) if e not in fish.fibres)
    places = {"muscle": fish.muscles[3], "spring": other_spring, "all": slice(None)}
    for each in (env, other):
        each.reset(seed=0)
    env.tank.rest_length[1, places[where]] = value
    obs, reward, terminated, _, infos = env.step(action)
    expected = other.step(action)
    assert np.isfinite(obs).all() and np.isfinite(reward).all() and terminated.tolist() == [False, True]
    assert infos["failure"][1] and all(np.isfinite(array).all() for array in env.tank.state)
    assert np.isfinite(env.tank.rest_length).all() and np.isfinite(env.tank.effort).all()
    assert obs[0].tobytes() == expected[0][0].tobytes() and reward[0] == expected[1][0]


def test_a_failure_that_means_nothing_is_refused():
    """A number that stands for no failure is an error that names it; the fish does not move."""
    tank = Tank(make_fish(), 2)
    tank.state.failure[1] = 99
    tank.advance(1)
    with pytest.raises(ValueError, match=f"state.failure contains 99; valid numbers are 0 to {len(FAILURES) - 1}"):
        _ = tank.failure


@pytest.mark.parametrize("body", BODIES)
def test_fish_share_no_memory(body):
    """What is written into the arrays of one fish reaches no other: `left` and `right` were those of the module."""
    one, other = make_fish(body), make_fish(body)
    for name in ("left", "right", "muscles", "mirror"):
        assert not np.shares_memory(getattr(one, name), getattr(other, name))
