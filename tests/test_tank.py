"""Tank: input validation, live state, muscles, and that a fish in a batch is the same as a single fish."""

import copy
import pickle
from dataclasses import replace

import naive
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from moving import each_method, two_methods

from fish_env import INTEGRATORS, Tank, World, make_fish, make_water
from fish_env.physics.tank_options import own_step, whole_steps
from fish_env.soft import adaptive

FISH = make_fish()
WATER = make_water()
PAUSE = FISH.control_interval
MANY = 33  # enough for two threads


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
    springs = FISH.body.springs._replace(damping=np.zeros_like(FISH.body.springs.damping))
    undamped = replace(FISH, body=FISH.body._replace(springs=springs, max_damping_eigenvalue=0.0))
    with pytest.raises(ValueError, match=f"{name!r} has no stable step on 'mass_spring', .* from 'semi_implicit'"):
        Tank(undamped, 1, name)
    assert Tank(undamped, 1, name, 1e-5).dt == 1e-5
    assert Tank(undamped, 1, "rk4").dt < 1 / np.sqrt(undamped.body.max_stiffness_eigenvalue)


def test_default_method_and_step():
    """A fish has its own method and step; another method gets a step that divides its control interval."""
    tank = Tank(FISH)
    assert (tank.integrator.name, tank.dt) == (FISH.integrator, FISH.time_step)
    for name, record in INTEGRATORS.items():
        dt = Tank(FISH, 1, name).dt
        assert FISH.control_interval / dt == pytest.approx(round(FISH.control_interval / dt), rel=1e-12)
        assert name == FISH.integrator or dt <= 0.5 * record.base(FISH.body)


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        ({"integrator": "euler"}, "unknown integrator 'euler'; choose from 'semi_implicit'"),
        ({"integrator": 4}, "unknown integrator 4; choose from"),
        *(({"dt": dt}, f"dt is {text}; give a positive") for dt, text in (
            (0, "0"), (-0.01, "-0.01"), (float("nan"), "nan"), (float("inf"), "inf"), ([0.01], ".*"), ("fast", "'fast'")
        )),
        ({"num_fish": 0}, "num_fish is 0; give a whole number, at least 1"),
        ({"num_fish": True}, "num_fish is True; give a whole number"),
        ({"num_fish": 2.0}, "num_fish is 2.0; give a whole number"),
        ({"threads": 0}, "threads is 0; give a whole number"),
        ({"threads": False}, "threads is False; give a whole number"),
        ({"water": 1000.0}, "water is 1000.0; give keywords of fish_env.make_water"),
        ({"water": (0.0, 750.0, np.zeros(3))}, "water is \\(0.0, 750.0, .*; give keywords of fish_env.make_water"),
        ({"fish": "trout"}, "fish is a str; give a Fish"),
        ({"fish": FISH.body}, "fish is a Body; give a Fish"),
    ],
    ids=str,
)  # fmt: skip
def test_tank_refuses(arguments, text):
    """A tank of wrong parts raises an error with the given and the valid values."""
    with pytest.raises(ValueError, match=text):
        Tank(**({"fish": FISH} | arguments))


ZERO = np.zeros(12)


@pytest.mark.parametrize(
    ("action", "duration", "text"),
    [
        (np.zeros(11), PAUSE, r"action has shape \(11,\); give shape \(3, 12\)"),
        (np.zeros((2, 12)), PAUSE, r"action has shape \(2, 12\); give shape \(3, 12\)"),
        (np.zeros((3, 12, 1)), PAUSE, r"action has shape \(3, 12, 1\)"),
        (0.5, PAUSE, r"action has shape \(\)"),
        (np.full(12, np.nan), PAUSE, r"action is nan at \(0, 0\); give finite numbers"),
        (np.full((3, 12), np.inf), PAUSE, r"action is inf at \(0, 0\)"),
        (np.where(np.arange(12) == 7, -1.01, 0), PAUSE, r"action reaches 1.01; give values in \[-1, 1\]"),
        ("left", PAUSE, "left"),
        (ZERO, 0.0, "duration is 0.0; give a positive number of seconds"),
        (ZERO, -PAUSE, "duration is .*; give a positive"),
        (ZERO, float("nan"), "duration is nan; give a positive"),
        (ZERO, float("inf"), "duration is inf; give a positive"),
        (ZERO, None, "duration is None; give a positive"),
        (ZERO, "long", "duration is 'long'; give a positive"),
        (ZERO, 1.5 * FISH.time_step, "give a whole multiple of dt"),
        (ZERO, 0.2 * FISH.time_step, "give a whole multiple of dt"),
        (ZERO, PAUSE * (1 + 1e-7), "give a whole multiple of dt"),
    ],
    ids=range(17),
)
def test_swim_refuses(action, duration, text):
    """An invalid action, or a duration that is not a positive whole multiple of dt, raises an error; nothing moves."""
    tank = Tank(FISH, 3, water=WATER)
    before = tank.get_state()
    with pytest.raises(ValueError, match=text):
        tank.swim(action, duration)
    assert_same(tank.get_state(), before)


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
        "infinite": (lambda s: s.update(t=np.array([0.0, np.inf])), r"t is inf at \(1,\)"),
        "text": (lambda s: s.update(rest_length="short"), "rest_length is 'short'"),
        "no reason": (lambda s: s.update(failure=np.array([0, 99])), "failure"),
        "negative reason": (lambda s: s.update(failure=np.array([-1, 0])), "failure"),
        "counters": (
            lambda s: s["counters"].__setitem__((1, 2), -1),
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


@two_methods
def test_views_are_live(name):
    """Values written to position, velocity and rest_length count in the next call, and the same arrays show its end."""
    fish = make_fish("published")
    world = World(*naive.dense_water(fish))
    tank = Tank(fish, 2, name, own_step(fish, INTEGRATORS[name]), world)
    x, v, rest, natural = tank.position, tank.velocity, tank.rest_length, fish.body.springs.rest_length
    assert (x.shape, v.shape, rest.shape) == ((2, 23, 3), (2, 23, 3), (2, 91))
    start_x, start_v = naive.random_state(fish, np.random.default_rng(1), speed=0.2)
    start_rest = natural * np.random.default_rng(2).uniform(0.9, 1.1, 91)
    x[1], v[1], rest[1] = start_x, start_v, start_rest
    tank.advance(3)
    assert tank.alive.all()
    wanted, still = (naive.advance(name, fish.body, world, *start, tank.dt, 3) for start in (
        (start_rest, np.zeros(91), start_x, start_v), (natural, np.zeros(91), fish.body.position, 0 * start_v)
    ))  # fmt: skip
    allowed = 1e-11 if INTEGRATORS[name].kind != "adaptive" else 1e-7
    np.testing.assert_allclose(x[1], wanted[0], rtol=0, atol=allowed * fish.length)
    np.testing.assert_allclose(v[1], wanted[1], rtol=0, atol=allowed * np.abs(wanted[1]).max())
    np.testing.assert_allclose(x[0], still[0], rtol=0, atol=allowed * fish.length)
    assert tank.position is tank.state.x and np.shares_memory(tank.position, x)
    np.testing.assert_array_equal(rest[1], start_rest)


def test_default_is_vacuum():
    """Without water a fish keeps its momentum; in water it loses it."""
    for water, kept in ((None, True), (WATER, False)):
        tank = Tank(FISH, water=water)
        tank.velocity[:, :, 0] = FISH.length
        tank.advance(16)
        momentum = naive.momentum(FISH.body.mass, tank.velocity[0])[0]
        assert (momentum == pytest.approx(FISH.body.mass.sum() * FISH.length, rel=1e-12)) == kept


# Muscles


@each_method
def test_rest_lengths_move_linearly(name):
    """During a swim the muscles' rest lengths run straight to the command: the motion is the reference's."""
    fish, world, command, steps = FISH, World(*naive.dense_water(FISH)), actions(4), 8
    tank = Tank(fish, 1, name, own_step(fish, INTEGRATORS[name]), world)
    natural, duration, rate = fish.body.springs.rest_length, steps * tank.dt, np.zeros(91)
    contracted = np.minimum(0.5 * (command + 1.0), min(1.0, duration / fish.contraction_time))
    rate[fish.muscles] = -contracted * (1 - fish.contracted) * natural[fish.muscles] / duration
    wanted = naive.advance(name, fish.body, world, natural, rate, fish.body.position, np.zeros((23, 3)), tank.dt, steps)
    tank.swim(command, duration)
    exact = 1.0 if INTEGRATORS[name].kind != "adaptive" else 2e5
    np.testing.assert_allclose(tank.position[0], wanted[0], rtol=0, atol=exact * 1e-12 * fish.length)
    round_off = 1e-14 * fish.length  # of the shortest steps' slow motions
    np.testing.assert_allclose(
        tank.velocity[0], wanted[1], rtol=0, atol=exact * 1e-11 * np.abs(wanted[1]).max() + round_off
    )
    np.testing.assert_allclose(tank.contraction[0], contracted, rtol=0, atol=1e-14)


@pytest.mark.parametrize("body", naive.TU)
def test_rest_lengths_are_rate_limited(body):
    """Rest lengths approach a command as fast as the contraction time allows, reach it, and stay; no other moves."""
    fish = make_fish(body)
    tank = Tank(fish, 2)
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


def test_activation_is_first_order():
    """The contraction is the solution of da/dt = (u - a) / T, T one time for rising and one for falling."""
    rise, fall = 0.015, 0.05
    fish = make_fish(activation_time=(rise, fall))
    tank, contraction, steps = Tank(fish, 2, water=WATER), np.zeros((2, 12)), 4000
    h = fish.control_interval / steps
    for command in np.random.default_rng(7).uniform(0, 1, (4, 2, 12)):
        tank.drive(command, round(fish.control_interval / tank.dt))
        before = contraction.copy()
        for _ in range(steps):  # of Heun's method
            slope = (command - contraction) / np.where(command > contraction, rise, fall)
            ahead = contraction + h * slope
            contraction = contraction + 0.5 * h * (slope + (command - ahead) / np.where(command > ahead, rise, fall))
        np.testing.assert_allclose(tank.contraction, contraction, rtol=0, atol=2e-8)
        most = 1.0 - np.exp(-fish.control_interval / rise)
        np.testing.assert_allclose(tank.effort, ((contraction - before) ** 2).mean(axis=1) / most**2, rtol=2e-6)
    assert tank.alive.all()


def test_range_and_effort():
    """-1 is the natural length, 1 full contraction; effort is the mean square of speeds over the fastest."""
    tank, command = Tank(FISH, 2), np.array([np.full(12, -1.0), np.full(12, 1.0)])
    tank.swim(command, int(np.ceil(FISH.contraction_time / tank.dt)) * tank.dt)
    natural = FISH.body.springs.rest_length[FISH.muscles]
    np.testing.assert_array_equal(tank.rest_length[0, FISH.muscles], natural)
    np.testing.assert_allclose(tank.rest_length[1, FISH.muscles], FISH.contracted * natural, rtol=1e-14)
    tank, contraction = Tank(FISH, 4), np.zeros((4, 12))
    duration = 8 * tank.dt
    assert duration < FISH.contraction_time
    contraction[0], contraction[1, 5], contraction[2] = 1.0, 1.0, 0.5 * duration / FISH.contraction_time
    for action, wanted in ((2 * contraction - 1, [1.0, 1 / 12, 0.25, 0.0]), (-1.0, [1.0, 1 / 12, 0.25, 0.0]),
                           (-1.0, [0.0] * 4)):  # fmt: skip
        tank.swim(np.broadcast_to(action, (4, 12)), duration)
        np.testing.assert_allclose(tank.effort, wanted, rtol=1e-12, atol=1e-24)


# Batches


@each_method
def test_batch_equals_one_by_one(name):
    """Each of 33 fish with commands of its own is bit for bit the single fish, on one thread and on two."""
    commands = actions(7, 4 if INTEGRATORS[name].kind != "adaptive" else 1, MANY)
    batches = [tank_of(name, MANY, threads=threads) for threads in (1, 2)]
    start = np.random.default_rng(8).normal(0, 0.1 * FISH.length, (MANY, 23, 3))
    for tank in batches:
        tank.velocity[:] = start
        for command in commands:
            tank.swim(command, pause(name))
        assert tank.alive.all()
    one, two = (tank.get_state() for tank in batches)
    assert_same(one, two)
    for b in (0, 1, 15, 16, 17, 32):
        single = tank_of(name, 1)
        single.velocity[:] = start[b]
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


@each_method
def test_a_failing_fish_harms_no_other(name, monkeypatch):
    """A fish that diverges fails with a reason and stops; its neighbours are the same bits as without it."""
    monkeypatch.setattr(adaptive, "MOST_EVALUATIONS", 2000)  # the adaptive methods give up in good time
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


def test_state_keeps_failures():
    """A saved failure is restored: the fish stays failed, with its reason and its counters."""
    tank, other = (Tank(FISH, 2, water=WATER) for _ in range(2))
    tank.velocity[0] = 1e200
    tank.swim(np.zeros(12), PAUSE)
    assert tank.alive.tolist() == [False, True]
    other.set_state(tank.get_state())
    assert other.failure.tolist() == tank.failure.tolist()
    assert_same(other.get_state(), tank.get_state())


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
    assert not tank.alive[1]
    tank.reset(np.array([True, True, False, False]))
    assert_same(tank.get_state(), fresh, [0, 1])
    assert_same(tank.get_state(), before, [2, 3])
    np.testing.assert_array_equal(tank.effort, [0, 0, *effort[2:]])
    tank.reset()
    assert_same(tank.get_state(), fresh)
    other = Tank(FISH, 4, water=WATER)
    for each in (tank, other):
        each.swim(actions(13), PAUSE)
    assert_same(tank.get_state(), other.get_state())
