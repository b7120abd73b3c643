"""Tank: what it refuses, its state, muscles, batches and lanes; records are checked before kernels read them."""

import copy
import pickle
from dataclasses import replace
from decimal import Decimal
from fractions import Fraction

import naive
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from moving import each_method, tiered

from fish_env import INTEGRATORS, Tank, World, make_fish
from fish_env.control.gait import best_gait
from fish_env.envs import FishVectorEnv
from fish_env.physics.engine import DEEPEST
from fish_env.physics.failures import FAILURES
from fish_env.physics.linearise import linearise
from fish_env.physics.tank_options import own_step, whole_steps

FISH = make_fish()
BODY, WATER, PAUSE = FISH.body, FISH.water, FISH.control_interval
MANY = 33  # enough for two threads
plain = pytest.mark.usefixtures("kernels")
in_lanes = pytest.mark.parametrize("name", tiered(INTEGRATORS, ("leapfrog_chebyshev",)))
"""Methods in kernels of eight lanes."""
two_methods = pytest.mark.parametrize("name", tiered(INTEGRATORS, ("leapfrog_chebyshev", "dop853")))
"""For what does not depend on the method: the default one, and one without an engine."""


def assert_same(state, other, which=slice(None)):
    """Assert that all parts of two states (those of the fish `which`) are the same bits."""
    for part in state:
        np.testing.assert_array_equal(state[part][which], other[part][which], err_msg=part)


def tank_of(name, num_fish, **keywords):
    """A tank of the default fish in water, at a stable step of the method."""
    return Tank(FISH, num_fish, name, own_step(FISH, INTEGRATORS[name]), WATER, **keywords)


def pause(name):
    """A control interval, or for the slow adaptive methods a sixteenth of one."""
    return PAUSE if INTEGRATORS[name].kind != "adaptive" else own_step(FISH, INTEGRATORS[name])


def actions(seed, *shape):
    """Random actions (...,12)."""
    return np.random.default_rng(seed).uniform(-1, 1, (*shape, 12))


# Input validation


@pytest.mark.parametrize("name", ["explicit_euler", "midpoint"])
def test_no_stable_step(name):
    """A method without a stable step on undamped springs raises an error with those that have one; a dt is used."""
    springs = BODY.springs._replace(damping=np.zeros_like(BODY.springs.damping))
    undamped = replace(FISH, body=FISH.body._replace(springs=springs, max_damping_eigenvalue=0.0))
    with pytest.raises(ValueError, match=f"{name!r} has no known stable step on 'mass_spring': not all .*'semi_impl"):
        Tank(undamped, 1, name)
    assert Tank(undamped, 1, name, 1e-5).dt == 1e-5
    assert Tank(undamped, 1, "rk4").dt < 1.7 / np.sqrt(undamped.body.max_stiffness_eigenvalue)


@pytest.mark.soft
def test_default_method_and_step():
    """A fish has its own method and step; another method gets a step that divides its control interval."""
    tank = Tank(FISH)
    assert (tank.integrator.name, tank.dt) == (FISH.integrator, FISH.time_step)
    for name, record in INTEGRATORS.items():
        dt = Tank(FISH, 1, name).dt
        assert PAUSE / dt == pytest.approx(round(PAUSE / dt), rel=1e-12)
        assert name == FISH.integrator or 0.4 * record.base(FISH.body) <= dt <= 0.5 * record.base(FISH.body)


ZERO, NAN = np.zeros(12), float("nan")
TANKS = [
    ({"integrator": "euler"}, "unknown integrator 'euler'; choose from 'semi_implicit'"),
    ({"integrator": 4}, "unknown integrator 4; choose from"),
    *(({"dt": dt}, "dt is .*; give a positive number of seconds") for dt in (0, -0.01, NAN, np.inf, [0.01], "fast")),
    ({"dt": 5e-324}, "dt is 5e-324; give a positive number of seconds, at least 1e-12"),
    *(({"num_fish": count}, f"num_fish is {count}; give a whole number, at least 1") for count in (0, True, 2.0)),
    ({"num_fish": 10**12}, r"num_fish is 1000000000000, which takes .* GiB; this machine has .* give at most"),
    *(({"threads": count}, f"threads is {count}; give a whole number") for count in (0, False)),
    ({"water": 1000.0}, "water is 1000.0; give keywords of fish_env.make_water"),
    ({"water": (0.0, 750.0, np.zeros(3))}, "water is \\(0.0, 750.0, .*; give keywords of fish_env.make_water"),
    ({"water": WATER._replace(friction=-1.0)}, "friction of the water"),
    ({"fish": "trout"}, "fish is a str; give a Fish"),
    ({"fish": BODY}, "fish is a Body; give a Fish"),
    ({"lanes": 5}, "lanes is 5; choose from 'xyz', 1, 2, 4, 8, 16, 32"),
    ({"lanes": "dual"}, "lanes is 'dual', which moves nothing; choose from 'xyz', 1, 2, 4, 8, 16, 32"),
    ({"dtype": "float16"}, "dtype is 'float16'; choose 'float64' or 'float32'"),
    *(({"refine": part}, f"refine is {part}; give a positive number") for part in (0.0, NAN)),
    ({"integrator": "rk4", "refine": 0.1}, "'rk4' cannot refine its steps; give refine=inf"),
]


@pytest.mark.parametrize(("arguments", "text"), TANKS, ids=str)
def test_tank_refuses(arguments, text):
    """A tank of wrong parts raises an error with the given and the valid values; so does an environment."""
    with pytest.raises(ValueError, match=text):
        Tank(**({"fish": FISH, "num_fish": 1} | arguments))
    if set(arguments) <= {"lanes", "dtype", "refine", "integrator"}:
        with pytest.raises(ValueError, match=text):
            FishVectorEnv(1, **arguments)


CALLS = [
    *(("swim", (action, PAUSE), r"action has shape \(.*; give shape \(2, 12\)")
      for action in (np.zeros(11), np.zeros((3, 12)), np.zeros((2, 12, 1)), 0.5)),
    ("swim", (np.full(12, np.nan), PAUSE), r"action is nan at \(0, 0\); give finite numbers"),
    ("swim", (np.where(np.arange(12) == 7, -1.01, 0), PAUSE), r"action reaches 1.01; give values in \[-1, 1\]"),
    ("swim", ("left", PAUSE), "left"),
    *(("swim", (ZERO, duration), "duration is .*; give a positive number of seconds")
      for duration in (0.0, -PAUSE, NAN, np.inf, None, "long")),
    *(("swim", (ZERO, part * FISH.time_step), "give a whole multiple of dt") for part in (1.5, 0.2, 6 + 6e-7)),
    *((name, (np.zeros(shape), each), r"has shape \(.*; give shape \(2, 12\)")
      for name, each in (("command", PAUSE), ("drive", 6)) for shape in ((5, 12), (2, 3), (12,))),
    *((name, (np.full((2, 12), value), each), text) for name, each in (("command", PAUSE), ("drive", 6))
      for value, text in ((NAN, "contraction is nan"), (1.0 + 2**-52, "contraction is from 1.0.*2 to 1.0.*; give"))),
    *(("command", (np.zeros((2, 12)), duration), "duration is .*; give a positive") for duration in (-1.0, NAN)),
    *((name, (*others, steps), "steps is .*; give a whole number from 0") for steps in (-1, 1.5, 2**64, "3", None)
      for name, others in (("advance", ()), ("drive", (np.zeros((2, 12)),)))),
    ("nearest", (np.zeros(3), [99], 0), "contains 99"), ("nearest", (np.zeros(3), [-1], 0), "contains -1"),
    ("nearest", (np.zeros(3), [], 0), "empty"), ("nearest", (np.zeros(3), None, 2), "i contains 2"),
]  # fmt: skip


@pytest.mark.parametrize(("name", "arguments", "text"), CALLS, ids=range(len(CALLS)))
def test_calls_refuse(name, arguments, text):
    """A method given what is misshapen, not finite or out of range raises an error, and changes nothing."""
    tank = Tank(FISH, 2, water=WATER)
    before = tank.get_state()
    with pytest.raises(ValueError, match=text):
        getattr(tank, name)(*arguments)
    assert_same(tank.get_state(), before)
    assert not tank.control.rate.any()


@given(st.integers(1, 10_000), st.floats(1e-6, 1e3))
@settings(max_examples=200)
def test_whole_multiples_are_accepted(steps, dt):
    """Every n dt computed in floating point counts as n steps, whatever its rounding."""
    assert whole_steps(steps * dt, dt, "duration") == steps
    assert whole_steps(sum([dt] * 7), dt, "duration") == 7


def wrong_states():
    """Changes that make a valid state of two fish invalid, and the messages about them."""
    nan = np.zeros((2, 23, 3))
    nan[1, 4, 2] = np.nan
    return {
        "missing": (lambda s: s.pop("v"), "state holds .*; give .*'v'"),
        "unknown": (lambda s: s.update(colour=np.zeros(2)), "state holds .*'colour'"),
        "shape": (lambda s: s.update(x=s["x"][:1]), r"x has shape \(1, 23, 3\); give shape \(2, 23, 3\)"),
        "nan": (lambda s: s.update(v=nan), r"v is nan at \(1, 4, 2\); give finite"),
        "text": (lambda s: s.update(rest_length="short"), "rest_length is 'short'"),
        "no reason": (lambda s: s.update(failure=np.array([0, 99])), "failure"),
        "counters": (
            lambda s: s.update(counters=-1 - s["counters"]),
            "(?s)counters are .*; give whole numbers, zero or",
        ),
        "half a count": (lambda s: s.update(counters=s["counters"] + 0.5), "counters are"),
        "rest length": (lambda s: s.update(rest_length=-s["rest_length"]), "rest_length"),
    }


@pytest.mark.parametrize("kind", wrong_states())
def test_set_state_refuses(kind):
    """A state with a missing, unknown, misshapen or invalid part raises an error, and changes nothing."""
    tank = Tank(FISH, 2, water=WATER)
    tank.swim(actions(0, 2), PAUSE)
    state, before = tank.get_state(), tank.get_state()
    state["x"] += 1.0  # a valid part must not be taken either
    spoil, text = wrong_states()[kind]
    spoil(state)
    with pytest.raises(ValueError, match=text):
        tank.set_state(state)
    assert_same(tank.get_state(), before)


# Live state


def test_views_are_live():
    """Positions, velocities and rest lengths are the same arrays before and after a call, which moves them."""
    tank = Tank(FISH, 2, water=WATER)
    x, v, rest = tank.position, tank.velocity, tank.rest_length
    assert (x.shape, v.shape, rest.shape) == ((2, 23, 3), (2, 23, 3), (2, 91))
    v[1] = 0.1
    tank.advance(3)
    assert tank.position is x is tank.state.x and tank.velocity is v and tank.rest_length is rest
    np.testing.assert_allclose(x[0], BODY.position, rtol=0, atol=1e-5)
    assert np.abs(x[1] - BODY.position).min() > 1e-4


@plain
def test_default_is_vacuum():
    """Without water a fish keeps its momentum; in water it loses it."""
    for water, kept in ((None, True), (WATER, False)):
        tank = Tank(FISH, water=water)
        tank.velocity[:, :, 0] = FISH.length
        tank.advance(4)
        momentum = naive.momentum(BODY.mass, tank.velocity[0])[0]
        assert (momentum == pytest.approx(BODY.mass.sum() * FISH.length, rel=1e-12)) == kept


# Muscles


@each_method
def test_rest_lengths_move_linearly(name):
    """During a swim the muscles' rest lengths run straight to the command: the motion is the reference's."""
    fish, world, command, steps = FISH, World(*naive.dense_water(FISH)), actions(4), 8
    tank = Tank(fish, 1, name, own_step(fish, INTEGRATORS[name]), world)
    natural, duration, rate = fish.body.springs.rest_length, steps * tank.dt, np.zeros(91)
    contracted = np.minimum(0.5 * (command + 1.0), min(1.0, duration / fish.contraction_time))
    shortened = contracted - fish.lengthening * contracted[fish.mirrored_muscles]
    rate[fish.muscles] = -shortened * (1 - fish.contracted) * natural[fish.muscles] / duration
    wanted = naive.advance(name, fish.body, world, natural, rate, fish.body.position, np.zeros((23, 3)), tank.dt, steps)
    tank.swim(command, duration)
    exact = 1.0 if INTEGRATORS[name].kind != "adaptive" else 2e5
    np.testing.assert_allclose(tank.position[0], wanted[0], rtol=0, atol=exact * 1e-12 * fish.length)
    round_off = 1e-14 * fish.length  # of the shortest steps' slow motions
    np.testing.assert_allclose(
        tank.velocity[0], wanted[1], rtol=0, atol=exact * 1e-11 * np.abs(wanted[1]).max() + round_off
    )
    np.testing.assert_allclose(tank.contraction[0], contracted, rtol=0, atol=1e-14)


@pytest.mark.parametrize("body", tiered(naive.TU, ("mass_spring",)))
def test_rest_lengths_are_rate_limited(body):
    """Rest lengths approach a command as fast as the contraction time allows, reach it, and stay; no other moves."""
    fish = make_fish(body)
    tank = Tank(fish, 2, water=fish.water)
    pause = 4 * tank.dt
    limit = pause / fish.contraction_time
    for command in np.random.default_rng(5).uniform(-1, 1, (3, 2, 12)):
        target = 0.5 * (command + 1.0)
        for _ in range(int(np.ceil(1 / limit)) + 1):
            before = tank.contraction.copy()
            tank.swim(command, pause)
            wanted = before + np.clip(target - before, -limit, limit)
            np.testing.assert_allclose(tank.contraction, wanted, rtol=0, atol=1e-14)
        np.testing.assert_allclose(tank.contraction, target, rtol=0, atol=1e-14)
        others = np.delete(tank.rest_length, fish.muscles, axis=1)
        np.testing.assert_array_equal(others, np.tile(np.delete(fish.body.springs.rest_length, fish.muscles), (2, 1)))
    assert tank.alive.all()


@pytest.mark.parametrize("body", tiered(["mass_spring", "planar", "tetrahedral"], ("mass_spring", "planar")))
def test_antagonists_lengthen(body):
    """Rest lengths are natural less the span times (own contraction - lengthening x the mirrored muscle's)."""
    part, fish = 0.6, make_fish(body, lengthening=0.6)
    tank, generator = Tank(fish, 3, water=fish.water), np.random.default_rng(7)
    other, reached = fish.mirrored_muscles, np.zeros((3, 12))
    for _ in range(6):
        goal = generator.uniform(0, 1, (3, 12))
        if fish.flat:  # one fibre for the upper and the lower muscle of a side
            goal = goal[:, fish.grouping("pairs")]
        tank.drive(goal, round(fish.control_interval / tank.dt))
        most = fish.control_interval / fish.contraction_time
        effort = np.clip(goal - reached, -most, most) / most
        reached += np.clip(goal - reached, -most, most)
        np.testing.assert_allclose(tank.contraction, reached, rtol=0, atol=1e-13)
        np.testing.assert_allclose(tank.effort, (effort**2).mean(axis=1), rtol=1e-11)
        rest = tank.natural - tank.span * (reached - part * reached[:, other])
        np.testing.assert_allclose(tank.rest_length[:, fish.muscles], rest, rtol=1e-14)
    assert tank.alive.all()


def test_range_and_effort():
    """-1 is the natural length, 1 full contraction, if one side contracts; effort, the mean square of speeds."""
    left = FISH.sides > 0
    tank, command = Tank(FISH, 2, water=WATER), np.array([np.full(12, -1.0), np.where(left, 1.0, -1.0)])
    tank.swim(command, int(np.ceil(FISH.contraction_time / tank.dt)) * tank.dt)
    natural = BODY.springs.rest_length[FISH.muscles]
    np.testing.assert_array_equal(tank.rest_length[0, FISH.muscles], natural)
    reached = tank.rest_length[1, FISH.muscles]
    np.testing.assert_allclose(reached[left], (FISH.contracted * natural)[left], rtol=1e-14)
    tank, contraction = Tank(FISH, 4, water=WATER), np.zeros((4, 12))
    duration = 8 * tank.dt
    assert duration < FISH.contraction_time
    contraction[0], contraction[1, 5], contraction[2] = 1.0, 1.0, 0.5 * duration / FISH.contraction_time
    for action, wanted in ((2 * contraction - 1, [1.0, 1 / 12, 0.25, 0.0]), (-1.0, [1.0, 1 / 12, 0.25, 0.0]),
                           (-1.0, [0.0] * 4)):  # fmt: skip
        tank.swim(np.broadcast_to(action, (4, 12)), duration)
        np.testing.assert_allclose(tank.effort, wanted, rtol=1e-12, atol=1e-24)


# Batches

VARIED = [(0.5, 2.0, 0.7, (0.0, 0.1, 0.0)), (2.0, 0.5, 1.5, (0.0, 0.0, 0.0)), (1.0, 1.0, 1.0, (0.2, 0.0, 0.0))]


def vary(tank, i, number):
    """Vary fish i of a tank as the one of this number: three of four fish are."""
    if number % 4 < 3:
        tank.vary(i, *VARIED[number % 4])


@in_lanes
def test_batch_equals_one_by_one(name):
    """Each of 33 fish, varied, with commands of its own is bit for bit the single fish, on one thread and on two."""
    commands = actions(7, 4 if INTEGRATORS[name].kind != "adaptive" else 1, MANY)
    batches = [tank_of(name, MANY, threads=threads) for threads in (1, 2)]
    start = np.random.default_rng(8).normal(0, 0.1 * FISH.length, (MANY, 23, 3))
    for tank in batches:
        tank.velocity[:] = start
        for b in range(MANY):
            vary(tank, b, b)
        for command in commands:
            tank.swim(command, pause(name))
        assert tank.alive.all()
    one, two = (tank.get_state() for tank in batches)
    assert_same(one, two)
    for b in (0, 1, 15, 16, 17, 32):
        single = tank_of(name, 1)
        single.velocity[:] = start[b]
        vary(single, 0, b)
        for command in commands:
            single.swim(command[b], pause(name))
        assert single.effort[0] == batches[0].effort[b] == batches[1].effort[b]
        assert_same(single.get_state(), {part: value[b : b + 1] for part, value in one.items()})
    for tank in batches:
        tank.close()
        tank.swim(commands[0, 0], pause(name))  # one command for all; the threads start again
        tank.set_state(one)
        tank.swim(np.tile(commands[0, 0], (MANY, 1)), pause(name))
    assert_same(batches[0].get_state(), batches[1].get_state())
    batches[1].close()


@in_lanes
def test_a_failing_fish_harms_no_other(name, monkeypatch):
    """A fish that diverges fails with a reason and stops; its neighbours are the same bits as without it."""
    if INTEGRATORS[name].kind == "adaptive":  # they give up in good time
        monkeypatch.setattr("fish_env.soft.adaptive.MOST_EVALUATIONS", 2000)
    commands, victims = actions(9, 3, MANY), [4, 16, 32]
    healthy, hit = (tank_of(name, MANY, threads=2) for _ in range(2))
    for tank in (healthy, hit):
        tank.swim(commands[0], pause(name))
    hit.velocity[4, 7] = [1e9, -1e9, 1e9]
    hit.velocity[16, 2, 1] = np.nan
    hit.position[32, 0, 0] = np.inf
    stopped = hit.time[victims].copy()
    for command in commands[1:]:
        healthy.swim(command, pause(name))
        hit.swim(command, pause(name))
    np.testing.assert_array_equal(np.flatnonzero(~hit.alive), victims)
    assert all(hit.failure[victims]) and not any(np.delete(hit.failure, victims))
    for reason in hit.failure[victims]:
        assert reason.startswith(("non-finite", "torn", "untrusted solve", "no convergence"))
    np.testing.assert_array_equal(hit.time[victims], stopped)
    assert np.isfinite(hit.position).all() and np.isfinite(hit.velocity).all()
    assert_same(hit.get_state(), healthy.get_state(), np.delete(np.arange(MANY), victims))
    hit.reset(~hit.alive)
    hit.swim(commands[0], pause(name))
    assert hit.alive.all()
    for tank in (healthy, hit):
        tank.close()


# Saved states and copies


@two_methods
def test_states_and_copies_replay(name):
    """A saved state, a pickle and a deep copy continue with the same bits, apart from the original."""
    tank, other, commands = tank_of(name, MANY, threads=2), tank_of(name, MANY, threads=2), actions(11, 3, MANY)
    tank.swim(commands[0], pause(name))
    saved = tank.get_state()
    kept, copies = copy.deepcopy(saved), [pickle.loads(pickle.dumps(tank)), copy.deepcopy(tank)]
    for command in commands[1:]:
        tank.swim(command, pause(name))
    end, effort = tank.get_state(), tank.effort.copy()
    assert_same(saved, kept)  # the saved state is a copy
    for replay in (tank, other):
        replay.set_state(saved)
    for replay in (tank, other, *copies):
        assert replay.integrator is INTEGRATORS[name]
        assert_same(replay.get_state(), saved)
        for command in commands[1:]:
            replay.swim(command, pause(name))
        assert_same(replay.get_state(), end)
        np.testing.assert_array_equal(replay.effort, effort)
        replay.close()


def test_reset_and_clock():
    """Reset puts the fish of a mask, failed ones too, to rest at time zero, and leaves the others as they are."""
    tank = Tank(FISH, 4, water=WATER)
    fresh = tank.get_state()
    tank.velocity[1] = 1e200
    for command in actions(12, 3, 4):
        tank.swim(command, PAUSE)
    tank.advance(5)
    tank.advance(0)
    np.testing.assert_allclose(tank.time[[0, 2, 3]], 3 * PAUSE + 5 * tank.dt, rtol=1e-14)
    tank.state.counters[:] = 3
    before, effort = tank.get_state(), tank.effort.copy()
    other = Tank(FISH, 4, water=WATER)
    other.set_state(before)
    assert other.failure.tolist() == tank.failure.tolist() and tank.alive.tolist() == [True, False, True, True]
    tank.reset(np.array([True, True, False, False]))
    assert_same(tank.get_state(), fresh, [0, 1])
    assert_same(tank.get_state(), before, [2, 3])
    np.testing.assert_array_equal(tank.effort, [0, 0, *effort[2:]])
    tank.reset()
    assert_same(tank.get_state(), fresh)
    other.reset()
    for each in (tank, other):
        each.swim(actions(13), PAUSE)
    assert_same(tank.get_state(), other.get_state())


@pytest.mark.parametrize("how", ["reset", "reset of a failed fish", "set_state", "linearise"])
def test_a_command_that_has_not_ended(how):
    """It ends with the motion that it was part of; only what does not move the fish leaves it."""
    tank, still = Tank(FISH, 2, water=WATER), Tank(FISH, 2, water=WATER)
    state = tank.get_state()
    if "failed" in how:
        tank.position[0] = np.nan
        tank.advance(1)
    for each in (tank, still) if how == "linearise" else (tank,):
        each.command(np.ones((2, 12)), PAUSE)
    if how == "set_state":
        tank.set_state(state)
    elif how == "linearise":
        linearise(tank, np.zeros((2, 12)), 2)
    else:
        tank.reset()
    for each in (tank, still):
        each.advance(20)
    assert_same(tank.get_state(), still.get_state())


# Lanes, precision and refinement


def same_bits(one: Tank, other: Tank, rows=slice(None), others=slice(None)) -> bool:
    """Whether two tanks' fish have the same state, bit for bit, and cost the same."""
    return all(a[rows].tobytes() == b[others].tobytes() for a, b in zip(one.state, other.state, strict=True))


@pytest.mark.parametrize("alone", tiered([False, True], (False,)))
def test_single_precision_is_near(alone):
    """float32 is within 5e-6 body lengths of float64 over a second of the best gait, in lanes and alone the same."""
    options = {"double": {}, "single": {"dtype": "float32"}}
    if alone:
        options["alone"] = {"dtype": "float32", "lanes": "xyz"}
    paths = {}
    for name, each in options.items():
        tank, path = Tank(FISH, 4, water=WATER, threads=1, **each), []
        for k in range(50):
            tank.drive(np.tile(best_gait().contraction(FISH, (k + 1) * PAUSE), (4, 1)), round(PAUSE / tank.dt))
            path.append(tank.position.copy())
        paths[name] = np.array(path)
    assert not alone or paths["single"].tobytes() == paths["alone"].tobytes()
    apart = np.linalg.norm(paths["single"] - paths["double"], axis=-1).max() / FISH.length
    assert 1e-9 < apart < 5e-6


@pytest.mark.parametrize("far", [1e5, -1e6])
def test_single_precision_far_away(far):
    """float32 moves fish far from the origin as beside it."""
    near, there = (Tank(FISH, 3, water=WATER, threads=1, dtype="float32") for _ in range(2))
    there.position[...] += far
    for tank in (near, there):
        for k in range(20):
            tank.swim(np.full(12, (-1.0) ** (k // 4)), PAUSE)
    assert there.alive.all()
    allowed = 1e-5 + 4 * np.spacing(abs(far)) / FISH.length
    assert np.abs(there.position - far - near.position).max() / FISH.length < allowed


@plain
@pytest.mark.soft
@pytest.mark.parametrize("far", [1e5, -1e6])
def test_single_precision_far_away_beside_walls(far):
    """Where walls tell places apart, the episode of a fish in float32 ends there."""
    walled = WATER._replace(added_mass=None, planes=np.array([[0.0, 0.0, 1.0, -1e9, 0.5]]))
    with_walls = Tank(FISH, 2, water=walled, threads=1, dtype="float32", refine=np.inf)
    with_walls.position[1] += far
    with_walls.advance(2)
    assert with_walls.alive.tolist() == [True, False] and with_walls.failure[1].startswith("out of range")
    assert Tank(FISH, 1, water=walled, threads=1)._engine.blocks[0].reach == np.inf  # float64 goes anywhere


def harsh(tank, intervals=40):
    """Fling fish 0 about, and let the others be; counts of refinements."""
    generator = np.random.default_rng(1)
    for _ in range(intervals):
        command = np.full((tank.num_fish, FISH.num_muscles), -1.0)
        command[0] = generator.choice([-1.0, 1.0], FISH.num_muscles)
        tank.swim(command, PAUSE)
    return tank.counters["refinements"].copy()


def test_steps_are_shortened_where_needed():
    """Only the fish whose springs change fast takes an interval again; its company makes no difference to anybody."""
    tank = Tank(FISH, 11, water=WATER, refine=0.01)
    counts = harsh(tank)
    assert counts[0] > 5 and not counts[1:].any()
    alone = Tank(FISH, 1, water=WATER, refine=0.01)
    assert (harsh(alone) == counts[:1]).all() and same_bits(alone, tank, others=[0])
    calm = Tank(FISH, 11, water=WATER, refine=np.inf)
    harsh(calm)
    assert same_bits(calm, tank, slice(1, None), slice(1, None)) and not same_bits(calm, tank, [0], [0])
    assert not calm.counters["refinements"].any()


def test_refined_steps_are_the_half_ones():
    """An interval that is refined as often as it can be is the interval with the shortest steps, bit for bit."""
    position, command = BODY.position * (1.0, 1.2, 1.0), np.ones(FISH.num_muscles)
    tanks = [Tank(FISH, 1, dt=FISH.time_step / part, refine=refine, water=WATER)
             for part, refine in ((1, 1e-9), (2**DEEPEST, np.inf))]  # fmt: skip
    for tank in tanks:
        tank.position[0] = position
        tank.swim(command, PAUSE)
    np.testing.assert_array_equal(tanks[0].position, tanks[1].position)
    assert tanks[0].counters["refinements"][0] == DEEPEST  # 1/2, 1/4, ...


def test_refining_rescues_a_fish():
    """A base step far too long for a stiff fish, four times the default, is survived by refining, and not without."""
    commands = np.random.default_rng(0).choice([-1.0, 1.0], (60, 9, FISH.num_muscles))

    def survivors(refine):
        tank = Tank(FISH, 9, refine=refine, dt=PAUSE / 2, water=WATER)
        for i in range(9):
            tank.vary(i, stiffness=2.0)
        for command in commands:
            tank.swim(command, PAUSE)
        return int(tank.alive.sum())

    assert survivors(FISH.refine) == 9 and survivors(np.inf) == 0


def test_defaults():
    """The fish's own step comes with its refinement; a step that is given comes without; few fish are taken alone."""
    assert Tank(FISH).refine == FISH.refine < np.inf
    assert Tank(FISH, dt=0.5 * FISH.time_step).refine == FISH.refine
    assert [Tank(FISH, count).kind.lanes for count in (1, 2, 3, 256)] == ["xyz", "xyz", 8, 8]
    assert Tank(FISH, 256, dtype="float32").kind.lanes == 16


# Records are checked before kernels read them


def with_part(fish, part, **changes):
    """A fish with other fields of a part of its body."""
    return replace(fish, body=fish.body._replace(**{part: getattr(fish.body, part)._replace(**changes)}))


def raised(array, by=1000):
    """A copy of whole numbers, its last element larger."""
    array = np.array(array)
    array.reshape(-1)[-1] += by
    return array


CHANGED = [
    ("springs", {"nodes": raised(BODY.springs.nodes)}, "springs.nodes contains 10"),
    ("springs", {"nodes": raised(BODY.springs.nodes, -99)}, "springs.nodes contains -"),
    ("springs", {"nodes": BODY.springs.nodes[::-1].copy()}, "springs.entry does not name"),
    ("springs", {"stiffness": np.ones(3)}, "springs.stiffness has shape"),
    ("faces", {"nodes": raised(BODY.faces.nodes)}, "faces.nodes contains"),
    ("profile", {"first": np.zeros(23, int)}, "profile of the body is not that"),
    ("body", {"mass": np.ones(22)}, "position has shape .23, 3.; give shape .22, 3."),
    ("body", {"position": BODY.position * np.nan}, "position is nan"),
    ("fish", {"muscles": raised(FISH.muscles)}, "muscles contains"),
    ("fish", {"contracted": FISH.contracted[:3]}, "contracted has shape"),
    ("fish", {"fibres": raised(FISH.fibres)}, "fibres contains"),
    ("fish", {"drives": raised(FISH.drives)}, "drives contains"),
    ("fish", {"right": FISH.right[:-1]}, "right has shape"),
    ("fish", {"nose": 23}, "nose contains 23"),
    ("fish", {"landmarks": FISH.landmarks._replace(node=raised(FISH.landmarks.node))}, "landmarks.node contains"),
]


@pytest.mark.parametrize(("part", "changes", "text"), CHANGED, ids=range(len(CHANGED)))
def test_inconsistent_parts(part, changes, text):
    """A fish with an inconsistent part raises an error that names the part when a tank is made."""
    if part == "fish":
        fish = replace(FISH, **changes)
    elif part == "body":
        fish = replace(FISH, body=BODY._replace(**changes))
    else:
        fish = with_part(FISH, part, **changes)
    with pytest.raises(ValueError, match=text):
        Tank(fish, 2)


@pytest.mark.soft
@pytest.mark.parametrize(("name", "part", "fields", "text"), [
    ("tetrahedral", "tets", {"nodes": raised}, "tets.nodes contains"),
    ("two_layer", "compartments", {"faces": raised}, "compartments.faces"),
    ("two_layer", "compartments", {"first": lambda first: np.append(first[:-1], first[-1] + 2)}, "compartments.first"),
    ("two_layer", "barriers", {"nodes": raised}, "barriers.nodes contains"),
])  # fmt: skip
def test_inconsistent_soft_parts(name, part, fields, text):
    """So do the parts of a soft body."""
    fish = make_fish(name)
    changes = {field: change(getattr(getattr(fish.body, part), field)) for field, change in fields.items()}
    with pytest.raises(ValueError, match=text):
        Tank(with_part(fish, part, **changes), 2)


@pytest.mark.soft
@pytest.mark.parametrize("change", [{"node": np.array([-1])}, {"node": np.array([23])}, {"stiffness": np.ones(2)},
                                    {"point": np.array([[np.inf, 0.0, 0.0]])}])  # fmt: skip
def test_inconsistent_anchors(change):
    """Anchors of missing nodes, or with inconsistent arrays, raise an error."""
    from fish_env.soft.conditions import make_anchors

    anchors = make_anchors([0], [(0.0, 0.0, 0.0)], 1.0)._replace(**change)
    with pytest.raises(ValueError, match="anchors"):
        Tank(FISH, 1, water=WATER._replace(anchors=anchors))


@pytest.mark.parametrize("length", ["0.3", 0.3 + 0j, None])
def test_invalid_numbers(length):
    """Texts and complex numbers are no numbers."""
    with pytest.raises(ValueError, match="length is"):
        make_fish(length=length)


def test_valid_numbers():
    """Fractions and decimals are numbers; `nearest` finds the nearest node."""
    for length in (Fraction(1, 5), Decimal("0.2")):
        assert make_fish(length=length).body.position.tobytes() == make_fish(length=0.2).body.position.tobytes()
    assert Tank(FISH, 2).nearest(BODY.position[4], [3, 4, 5], 1) == 4


# What belongs to a tank


@plain
@pytest.mark.soft
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


@plain
@pytest.mark.parametrize("integrator", tiered(["leapfrog_chebyshev", "rk4", "dop853"], "all"))
def test_non_finite_clock(integrator):
    """A nan on the clock of a fish ends its motion with the reason; the other one swims on as before."""
    tank, same = (Tank(FISH, 2, integrator, refine=np.inf) for _ in range(2))
    tank.time[1] = np.nan
    for each in (tank, same):
        each.swim(np.full(12, 0.5), each.dt)
    assert tank.alive.tolist() == [True, False] and tank.time.tolist() == [same.time[0], 0.0]
    assert tank.failure[1].startswith("non-finite: a position, a velocity or the clock")
    np.testing.assert_array_equal(tank.position[0], same.position[0])
    np.testing.assert_array_equal(tank.position[1], BODY.position)
    tank.set_state(tank.get_state())


@pytest.mark.parametrize("integrator", tiered(["leapfrog_chebyshev", "dop853"], ("leapfrog_chebyshev",)))
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
