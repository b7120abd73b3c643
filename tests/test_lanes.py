"""Fish side by side in lanes: the same bits in any company, varied or not; shorter steps for those that need them."""

import numpy as np
import pytest

import fish_env
from benchmarks.common.problems import left_after_right, steps_of
from fish_env.envs import FishVectorEnv
from fish_env.physics.engine import DEEPEST
from fish_env.physics.tank import Tank

FISH = fish_env.make_fish()
SLOW = [pytest.param({"lanes": lanes}, marks=pytest.mark.slow) for lanes in (1, 4, 16)]
OPTIONS = [{"lanes": "xyz"}, {"threads": 2}, *SLOW]
VARIED = [(0.5, 2.0, 0.7, (0.0, 0.1, 0.0)), (2.0, 0.5, 1.5, (0.0, 0.0, 0.0)), (1.0, 1.0, 1.0, (0.2, 0.0, 0.0))]


def swum(which=range(37), intervals=6, **options) -> Tank:
    """A tank of some fish after random commands; each fish's are its own, and three of four fish are varied."""
    numbers = list(which)
    tank = Tank(FISH, len(numbers), water=FISH.water, **({"threads": 1} | options))
    commands = np.random.default_rng(0).uniform(-1.0, 1.0, (intervals, 64, FISH.num_muscles))
    for row, i in enumerate(numbers):
        if i % 4 < 3:
            tank.vary(row, *VARIED[i % 4])
    for command in commands:
        tank.swim(command[numbers], FISH.control_interval)
    return tank


def same(one: Tank, other: Tank, rows=slice(None), others=slice(None)) -> bool:
    """Whether two tanks' fish have the same state, bit for bit, and cost the same."""
    return all(a[rows].tobytes() == b[others].tobytes() for a, b in zip(one.state, other.state, strict=True))


@pytest.mark.parametrize("options", OPTIONS, ids=str)
def test_same_bits_in_any_company(options):
    """37 fish in lanes of 8, varied or not, are the same bit for bit in other lanes and over two threads."""
    assert same(swum(), swum(**options))


@pytest.mark.parametrize("chosen", [[5], [7], [36, 2, 17, 9, 1]])
def test_alone_and_in_other_places(chosen):
    """A fish alone, and among others in other places, is what it is in the whole batch."""
    assert same(swum(chosen), swum(), others=chosen)


def test_single_precision_is_near():
    """float32 is within 5e-6 body lengths of float64 over the abrupt manoeuvre, in lanes and alone the same."""
    goals = left_after_right(FISH)
    paths = {}
    for name, options in {
        "double": {}, "single": {"dtype": "float32"}, "alone": {"dtype": "float32", "lanes": "xyz"},
    }.items():  # fmt: skip
        tank, path = Tank(FISH, 4, water=FISH.water, threads=1, **options), []
        for goal in goals:
            tank.drive(np.tile(goal, (4, 1)), steps_of(FISH))
            path.append(tank.position.copy())
        paths[name] = np.array(path)
    assert paths["single"].tobytes() == paths["alone"].tobytes()
    apart = np.linalg.norm(paths["single"] - paths["double"], axis=-1).max() / FISH.length
    assert 1e-9 < apart < 5e-6


@pytest.mark.parametrize("far", [1e5, -1e6])
def test_single_precision_far_away(far):
    """float32 moves fish far from the origin as beside it; where walls tell places apart, their episode ends there."""
    near, there = (Tank(FISH, 3, water=FISH.water, threads=1, dtype="float32") for _ in range(2))
    there.position[...] += far
    for tank in (near, there):
        for k in range(20):
            tank.swim(np.full(12, (-1.0) ** (k // 4)), FISH.control_interval)
    assert there.alive.all()
    allowed = 1e-5 + 4 * np.spacing(abs(far)) / FISH.length
    assert np.abs(there.position - far - near.position).max() / FISH.length < allowed
    walled = FISH.water._replace(added_mass=None, planes=np.array([[0.0, 0.0, 1.0, -1e9, 0.5]]))
    with_walls = Tank(FISH, 2, water=walled, threads=1, dtype="float32")
    with_walls.position[1] += far
    with_walls.advance(6)
    assert with_walls.alive.tolist() == [True, False] and with_walls.failure[1].startswith("out of range")
    assert Tank(FISH, 1, water=walled, threads=1)._engine.blocks[0].reach == np.inf  # float64 goes anywhere


def harsh(tank, intervals=40):
    """Fling fish 0 about, and let the others be; counts of refinements."""
    generator = np.random.default_rng(1)
    for _ in range(intervals):
        command = np.full((tank.num_fish, FISH.num_muscles), -1.0)
        command[0] = generator.choice([-1.0, 1.0], FISH.num_muscles)
        tank.swim(command, FISH.control_interval)
    return tank.counters["refinements"].copy()


def test_steps_are_shortened_where_needed():
    """Only the fish whose springs change fast takes an interval again; its company makes no difference to anybody."""
    tank = Tank(FISH, 11, water=FISH.water, refine=0.01)
    counts = harsh(tank)
    assert counts[0] > 5 and not counts[1:].any()
    alone = Tank(FISH, 1, water=FISH.water, refine=0.01)
    assert (harsh(alone) == counts[:1]).all() and same(alone, tank, others=[0])
    calm = Tank(FISH, 11, water=FISH.water, refine=np.inf)
    harsh(calm)
    assert same(calm, tank, slice(1, None), slice(1, None)) and not same(calm, tank, [0], [0])
    assert not calm.counters["refinements"].any()


def test_refined_steps_are_the_half_ones():
    """An interval that is refined as often as it can be is the interval with the shortest steps, bit for bit."""
    position, command = FISH.body.position * (1.0, 1.2, 1.0), np.ones(FISH.num_muscles)
    tanks = [Tank(FISH, 1, dt=FISH.time_step / part, refine=refine, water=FISH.water)
             for part, refine in ((1, 1e-9), (2**DEEPEST, np.inf))]  # fmt: skip
    for tank in tanks:
        tank.position[0] = position
        tank.swim(command, FISH.control_interval)
    np.testing.assert_array_equal(tanks[0].position, tanks[1].position)
    assert tanks[0].counters["refinements"][0] == DEEPEST  # 1/2, 1/4, ...


def test_refining_rescues_a_fish():
    """A base step far too long for a stiff fish, four times the default, is survived by refining, and not without."""
    commands = np.random.default_rng(0).choice([-1.0, 1.0], (60, 9, FISH.num_muscles))

    def survivors(refine):
        tank = Tank(FISH, 9, refine=refine, dt=FISH.control_interval / 2, water=FISH.water)
        for i in range(9):
            tank.vary(i, stiffness=2.0)
        for command in commands:
            tank.swim(command, FISH.control_interval)
        return int(tank.alive.sum())

    assert survivors(FISH.refine) == 9 and survivors(np.inf) == 0


def test_defaults():
    """The fish's own step comes with its refinement; a step that is given comes without; few fish are taken alone."""
    assert Tank(FISH).refine == FISH.refine < np.inf
    assert Tank(FISH, dt=0.5 * FISH.time_step).refine == FISH.refine
    assert [Tank(FISH, count).kind.lanes for count in (1, 2, 3, 256)] == ["xyz", "xyz", 8, 8]
    assert Tank(FISH, 256, dtype="float32").kind.lanes == 16


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"lanes": 5}, "lanes is 5; choose from 'xyz', 1, 2, 4, 8, 16, 32"),
        ({"lanes": "dual"}, "lanes is 'dual', which moves nothing; choose from 'xyz', 1, 2, 4, 8, 16, 32"),
        ({"dtype": "float16"}, "dtype is 'float16'; choose 'float64' or 'float32'"),
        ({"refine": 0.0}, "refine is 0.0; give a positive number"),
        ({"refine": float("nan")}, "refine is nan; give a positive number"),
        ({"integrator": "rk4", "refine": 0.1}, "'rk4' cannot refine its steps; give refine=inf"),
        ({"num_fish": 10**12}, r"num_fish is 1000000000000, which takes .* GiB; this machine has .* give at most"),
    ],
)
def test_bad_keywords(options, message):
    """A kind, a refinement or a number of fish that is not offered is refused before anything is allocated."""
    with pytest.raises(ValueError, match=message):
        Tank(FISH, **options)
    if "num_fish" not in options:
        with pytest.raises(ValueError, match=message):
            FishVectorEnv(1, **options)


def test_environment_in_single_precision():
    """A vector environment takes dtype and lanes; observations stay close to those of float64 for a second."""
    envs = [FishVectorEnv(16, dtype=dtype) for dtype in ("float64", "float32")]
    seen = [env.reset(seed=0)[0] for env in envs]
    np.testing.assert_array_equal(*seen)
    actions = np.random.default_rng(0).uniform(-1, 1, (20, *envs[0].action_space.shape)).astype(np.float32)
    for action in actions:
        seen = [env.step(action)[0] for env in envs]
    assert seen[0].dtype == seen[1].dtype == np.float32
    np.testing.assert_allclose(*seen, atol=5e-2)
    assert np.abs(seen[0] - seen[1]).max() > 0
