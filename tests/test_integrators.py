"""Every method of the INTEGRATORS table: against its slow twin, its order, what it conserves, and how it fails."""

from functools import cache

import naive
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

from fish_env import BODIES, INTEGRATORS, Tank, forces, make_fish
from fish_env.body import (
    FAILURES,
    NON_FINITE,
    TORN,
    UNTRUSTED_SOLVE,
    VACUUM,
    Control,
    State,
    World,
    make_body,
)

FISH = {name: make_fish(name) for name in BODIES}
SEMI_IMPLICIT = [name for name, record in INTEGRATORS.items() if record.kind == "semi-implicit"]
EXPLICIT = [name for name, record in INTEGRATORS.items() if record.kind == "explicit"]
KEEPS_ANGULAR_MOMENTUM = {"symplectic_euler"}
each_body = pytest.mark.parametrize("body", BODIES)
each_method = pytest.mark.parametrize("name", INTEGRATORS)


def world_of(fish, current=(0.3, -0.2, 0.1)):
    """The water of `naive.dense_water` as the kernels take it."""
    return World(*naive.dense_water(fish, current=current))


def start(x, v):
    """The state of one body at time zero."""
    return State(x[None].copy(), v[None].copy(), np.zeros(1), np.zeros(1, dtype=int), np.zeros(1, dtype=int))


def held(rest, rate=None):
    """Control of one body."""
    return Control(rest[None].copy(), np.zeros((1, rest.size)) if rate is None else rate[None].copy())


def advance(name, body, world, x, v, rest, rate, h, n):
    """Motion of one sound body after n steps, (x, v)."""
    state = start(x, v)
    INTEGRATORS[name].advance(body, world, state, held(rest, rate), h, n)
    assert state.failure[0] == 0
    return state.x[0], state.v[0]


def driven(fish, rng):
    """A random state, with muscles and, a little, all other rest lengths on the move."""
    x, v = naive.random_state(fish, rng, speed=0.2)
    natural = fish.body.springs.rest_length
    rest = natural * rng.uniform(0.9, 1.1, natural.size)
    rate = natural * rng.uniform(-0.3, 0.3, natural.size) / fish.contraction_time
    return x, v, rest, rate


def exact(body, world, x, v, rest, rate, duration):
    """The true motion (x, v) by an eighth-order method with its own error control, on the kernels' forces.

    Also returns which faces moved outward: one row for every pattern met on the way.
    """
    f, size, outward = np.empty_like(x), x.size, set()

    def slope(t, y):
        positions, velocities = y[:size].reshape(-1, 3), y[size:].reshape(-1, 3)
        p, q, r, s = np.moveaxis(positions[body.faces.nodes], 1, 0)
        through = np.einsum("fc,fck->fk", body.faces.share, velocities[body.faces.nodes]) - world.current
        outward.add(tuple(np.einsum("fk,fk->f", np.cross(r - p, s - q), through) > 0))
        forces.total(body, world, rest + t * rate, positions, velocities, f)
        return np.concatenate([y[size:], (f / body.mass[:, None]).ravel()])

    y0 = np.concatenate([x.ravel(), v.ravel()])
    y = solve_ivp(slope, (0.0, duration), y0, method="DOP853", rtol=1e-13, atol=1e-15 * np.abs(y0).max()).y[:, -1]
    return (y[:size].reshape(-1, 3), y[size:].reshape(-1, 3)), outward


def slope_of(errors, steps):
    """Measured order: slope of log error over log step."""
    return np.polyfit(np.log(steps), np.log(errors), 1)[0]


# Against the twins


def test_every_method_has_a_twin():
    """A new entry of the table comes with a slow twin, and its record names itself and its cost."""
    assert set(naive.STEPS) == set(INTEGRATORS)
    for name, record in INTEGRATORS.items():
        assert record.name == name
        assert record.order >= 1 and record.forces >= 1 and record.source
    assert set(SEMI_IMPLICIT) | set(EXPLICIT) == set(INTEGRATORS)


@each_method
@pytest.mark.parametrize("medium", ["vacuum", "water"])
@settings(max_examples=8)
@given(seed=st.integers(0, 2**32 - 1), body=st.sampled_from(list(BODIES)))
def test_step_equals_its_twin(name, medium, seed, body):
    """One step from a random state with moving rest lengths equals the textbook step."""
    fish = FISH[body]
    world = VACUUM if medium == "vacuum" else world_of(fish)
    x, v, rest, rate = driven(fish, np.random.default_rng(seed))
    h = 0.5 / naive.highest_frequency(fish.body)
    moved = advance(name, fish.body, world, x, v, rest, rate, h, 1)
    wanted = naive.advance(name, fish.body, world, rest, rate, x, v, h, 1)
    np.testing.assert_allclose(moved[0] - x, wanted[0] - x, rtol=0, atol=1e-12 * np.abs(wanted[0] - x).max())
    np.testing.assert_allclose(moved[1], wanted[1], rtol=0, atol=1e-12 * np.abs(wanted[1]).max())


@each_method
@each_body
def test_steps_equal_their_twin(name, body):
    """Eight steps in one call equal eight textbook steps: each takes the rest lengths of its own time."""
    fish = FISH[body]
    x, v, rest, rate = driven(fish, np.random.default_rng(7))
    h = 0.3 / naive.highest_frequency(fish.body)
    moved = advance(name, fish.body, world_of(fish), x, v, rest, 20 * rate, h, 8)
    wanted = naive.advance(name, fish.body, world_of(fish), rest, 20 * rate, x, v, h, 8)
    np.testing.assert_allclose(moved[0] - x, wanted[0] - x, rtol=0, atol=1e-11 * np.abs(wanted[0] - x).max())
    np.testing.assert_allclose(moved[1], wanted[1], rtol=0, atol=1e-11 * np.abs(wanted[1]).max())


@each_method
def test_calls_add_up(name):
    """With the controls held, n steps in one call and n calls of one step are the same bits; the clock reads n h."""
    fish = FISH["mass_spring"]
    x, v, rest, _ = driven(fish, np.random.default_rng(8))
    world, h, method = world_of(fish), fish.time_step, INTEGRATORS[name]
    once, often = start(x, v), start(x, v)
    method.advance(fish.body, world, once, held(rest), h, 10)
    for _ in range(10):
        method.advance(fish.body, world, often, held(rest), h, 1)
    np.testing.assert_array_equal(once.x, often.x)
    np.testing.assert_array_equal(once.v, often.v)
    assert once.t[0] == pytest.approx(10 * h, rel=1e-15) and often.t[0] == pytest.approx(10 * h, rel=1e-14)


# Accuracy


@cache
def scene(body, medium):
    """A smooth motion to measure orders on (body, world, x, v, rest lengths, rates, duration), and where it ends.

    In vacuum: a shaken, turned fish, all of whose vibrations matter. In water: a nearly straight one in a slanting
    current that no face overtakes, for the one-sided law is smooth only where no face turns. Stiff: driven from rest.
    """
    fish = FISH[body]
    rng = np.random.default_rng(1)
    x, v, rest, world = fish.body.position, np.zeros((23, 3)), fish.body.springs.rest_length, VACUUM
    rate, duration = np.zeros_like(rest), 8.0 / naive.highest_frequency(fish.body)
    rate[fish.muscles] = rest[fish.muscles] * (1 - fish.contracted) * rng.uniform(-1, 0, 12) / fish.contraction_time
    if medium == "vacuum":
        x, v = naive.random_state(fish, rng, displacement=0.005, speed=0.3)
    elif medium == "water":
        linear, quadratic, current = naive.dense_water(fish, current=(0.7, 1.0, 1.0))
        world = World(linear, 0.01 * quadratic, current)
        rate *= 0.2
        v = 0.02 * fish.length / fish.contraction_time * rng.uniform(-1, 1, (23, 3))
    elif medium == "stiff":
        duration *= 2
    start_of_it = (fish.body, world, x, v, rest, rate, duration)
    end, outward = exact(*start_of_it)
    if medium == "water":
        assert len(outward) == 1, "a face turned between outward and inward: the scene is not smooth"
    return start_of_it, end


@each_method
@pytest.mark.parametrize(
    ("body", "medium", "steps"),
    [
        (body, medium, steps)
        for body in BODIES
        for medium, steps in (("vacuum", (32, 64, 128)), ("water", (32, 64, 128)), ("stiff", (16, 24, 32)))
    ],
)
def test_order(name, body, medium, steps):
    """The error falls with the method's order: in vacuum, in water, and at steps as large as the stiffest unit bears.

    The step times the highest frequency is 1/4 to 1/16, and in the stiff scene 1 to 1/2, where explicit methods end at
    2: its fast vibrations are not resolved, but hardly excited either.
    """
    (fish_body, world, x, v, rest, rate, duration), (true_x, true_v) = scene(body, medium)
    errors = []
    for n in steps:
        near_x, near_v = advance(name, fish_body, world, x, v, rest, rate, duration / n, n)
        errors.append(np.linalg.norm(near_x - true_x) + duration * np.linalg.norm(near_v - true_v))
    order = slope_of(errors, duration / np.array(steps))
    assert abs(order - INTEGRATORS[name].order) <= 0.15, f"measured order {order:.3f}, errors {errors}"


# What is conserved


@each_method
@each_body
def test_linear_momentum(name, body):
    """In vacuum, linear momentum stays for 10,000 steps; the centre of mass moves straight."""
    fish = FISH[body]
    x, v = naive.random_state(fish, np.random.default_rng(4), displacement=0.005, speed=0.3)
    mass, rest, h = fish.body.mass, fish.body.springs.rest_length, 0.3 / naive.highest_frequency(fish.body)
    moved_x, moved_v = advance(name, fish.body, VACUUM, x, v, rest, np.zeros_like(rest), h, 10_000)
    size = mass @ np.linalg.norm(v, axis=1)
    assert np.abs(naive.momentum(mass, moved_v) - naive.momentum(mass, v)).max() <= 1e-13 * size
    travelled = naive.momentum(mass, moved_x - x)
    np.testing.assert_allclose(travelled, 10_000 * h * naive.momentum(mass, v), rtol=0, atol=1e-12 * size * 10_000 * h)


def spinning(fish):
    """A deformed fish with much angular momentum."""
    x, v = naive.random_state(fish, np.random.default_rng(5), displacement=0.005, speed=0.1)
    return x, v + np.cross([0.2, -0.3, 0.25], x) / fish.contraction_time


@each_method
@each_body
def test_angular_momentum(name, body):
    """In vacuum, angular momentum is kept to rounding by symplectic Euler, and to the method's order by the others.

    Tu's method pulls along the line between the nodes' new places while the momentum arm is the old one: a drift
    that halves with the step. Runge-Kutta's falls with the fourth power.
    """
    fish = FISH[body]
    x, v = spinning(fish)
    mass, rest = fish.body.mass, fish.body.springs.rest_length
    before, size = naive.angular_momentum(mass, x, v), mass @ np.linalg.norm(np.cross(x, v), axis=1)

    def drift(h, n):
        moved = advance(name, fish.body, VACUUM, x, v, rest, np.zeros_like(rest), h, n)
        return np.linalg.norm(naive.angular_momentum(mass, *moved) - before) / size

    h = 0.4 / naive.highest_frequency(fish.body)
    if name in KEEPS_ANGULAR_MOMENTUM:
        assert drift(h, 10_000) <= 1e-12
        return
    drifts = [drift(h / k, 100 * k) for k in (1, 2, 4)]
    order = slope_of(drifts, h / np.array([1, 2, 4]))
    assert order >= INTEGRATORS[name].order - 0.2, f"drift falls with order {order:.3f}: {drifts}"


@each_method
@each_body
def test_mirrored_commands_mirror_the_path(name, body):
    """Two beats of random commands, left and right exchanged, take the fish along the mirror image of its path."""
    fish = FISH[body]
    rng = np.random.default_rng(6)
    decisions = round(4 * fish.contraction_time / fish.control_interval)
    tanks = [Tank(fish, 1, name, water=world_of(fish, (0, 0, 0))) for _ in range(2)]
    for action in rng.uniform(-1, 1, (decisions, 12)):
        tanks[0].swim(action, fish.control_interval)
        tanks[1].swim(action[naive.mirrored_muscles(fish)], fish.control_interval)
        assert all(tank.alive[0] for tank in tanks)
        image = tanks[0].position[0, fish.mirror] * [1, -1, 1]
        assert np.abs(tanks[1].position[0] - image).max() <= 1e-9 * fish.length
    assert np.abs(tanks[0].position[0] - image).max() > 1e-2 * fish.length, "it swam straight: nothing was tested"


@each_method
@each_body
def test_energy_never_grows_in_water(name, body):
    """Left alone in still water, a shaken fish only loses energy, of motion and elastic together."""
    fish = FISH[body]
    x, v = naive.random_state(fish, np.random.default_rng(9), displacement=0.01, speed=0.5)
    rest, h, world = fish.body.springs.rest_length, 0.05 / naive.highest_frequency(fish.body), world_of(fish, (0, 0, 0))
    state, control, energy = start(x, v), held(rest), []
    for _ in range(100):
        motion = naive.kinetic_energy(fish.body.mass, state.v[0])
        energy.append(motion + naive.spring_energy(fish.body.springs, rest, state.x[0]))
        INTEGRATORS[name].advance(fish.body, world, state, control, h, 40)
    assert state.failure[0] == 0
    assert np.all(np.diff(energy) < 0)
    assert energy[-1] < 0.5 * energy[0]


# Failures


def run_into_failure(method, fish, world, state, control, h, n, calls=200):
    """Advance until the fish fails; it must be left, with its clock, as it was before the last call."""
    for _ in range(calls):
        before = [array.copy() for array in (state.x, state.v, state.t)]
        method.advance(fish.body, world, state, control, h, n)
        if state.failure[0]:
            for now, then in zip((state.x, state.v, state.t), before, strict=True):
                np.testing.assert_array_equal(now, then)
            assert np.isfinite(state.x).all() and np.isfinite(state.v).all()
            method.advance(fish.body, world, state, control, h, n)  # a failed fish stays where it is
            np.testing.assert_array_equal(state.x, before[0])
            assert state.t[0] == before[2][0]
            return state.failure[0]
    raise AssertionError(f"still sound after {calls} calls")


@each_method
@each_body
def test_torn(name, body):
    """A fish whose units are driven to four times their length is torn after some sound calls, and left as it was."""
    fish = FISH[body]
    natural = fish.body.springs.rest_length
    rate = np.zeros(91)
    state, h = start(fish.body.position, np.zeros((23, 3))), 0.1 / naive.highest_frequency(fish.body)
    failure = run_into_failure(INTEGRATORS[name], fish, VACUUM, state, held(4 * natural, rate), h, 4)
    assert failure == TORN and FAILURES[failure].startswith("torn")
    assert state.t[0] > 0 and state.v.any()


@each_method
@each_body
def test_non_finite(name, body):
    """A speed whose square overflows makes the water's force infinite: the fish fails as non-finite, and stays."""
    fish = FISH[body]
    v = np.full((23, 3), 1e200)
    state = start(fish.body.position, v)
    world, control = world_of(fish), held(fish.body.springs.rest_length)
    failure = run_into_failure(INTEGRATORS[name], fish, world, state, control, fish.time_step, 1)
    assert failure == NON_FINITE and FAILURES[failure].startswith("non-finite")
    np.testing.assert_array_equal(state.v[0], v)


@each_method
@each_body
def test_too_large_a_step(name, body):
    """Many steps far above the stable one blow the fish up: it fails with a reason, explicit methods as non-finite."""
    fish = FISH[body]
    x, v = naive.random_state(fish, np.random.default_rng(10), speed=0.1)
    h = 40 / naive.highest_frequency(fish.body)
    control = held(fish.body.springs.rest_length)
    failure = run_into_failure(INTEGRATORS[name], fish, VACUUM, start(x, v), control, h, 3000)
    assert FAILURES[failure]
    if name in EXPLICIT:
        assert failure == NON_FINITE


@each_method
def test_nodes_in_one_place(name):
    """Two joined nodes in one place have no direction to push in: non-finite, or an untrusted solve, never a guess."""
    fish = FISH["mass_spring"]
    x = fish.body.position.copy()
    x[2] = x[1]
    state = start(x, np.zeros_like(x))
    control = held(fish.body.springs.rest_length)
    failure = run_into_failure(INTEGRATORS[name], fish, VACUUM, state, control, fish.time_step, 1)
    assert failure == (UNTRUSTED_SOLVE if name in SEMI_IMPLICIT else NON_FINITE)
    np.testing.assert_array_equal(state.x[0], x)


@pytest.mark.parametrize("name", SEMI_IMPLICIT)
def test_untrusted_solve(name):
    """Two masses on a spring compressed so that m + 2 h2 eta is zero: the singular system is reported, not solved."""
    body = make_body([[0, 0, 0], [1, 0, 0]], [1, 1], [(0, 1)], [1], [0], [1.5], [])
    state = start(body.position, np.zeros((2, 3)))
    INTEGRATORS[name].advance(body, VACUUM, state, held(body.springs.rest_length), 1.0, 1)
    assert FAILURES[state.failure[0]].startswith("untrusted solve")
    np.testing.assert_array_equal(state.x[0], body.position)
    assert state.t[0] == 0 and not state.v.any()


@pytest.mark.parametrize("name", SEMI_IMPLICIT)
@each_body
def test_non_positive_pivots_are_counted(name, body):
    """A strongly compressed fish and a large step make the matrix indefinite: one pivot a negative eigenvalue.

    A fish that fails on the way keeps its count.
    """
    fish = FISH[body]
    rest, x, v = fish.body.springs.rest_length, 0.6 * fish.body.position, np.zeros((23, 3))
    for reach in (1.5, 3.0, 10.0):
        h = reach / naive.highest_frequency(fish.body)
        matrix, _ = naive.tu_system(fish.body, VACUUM, rest, h, x, v)
        wanted = np.count_nonzero(np.linalg.eigvalsh(matrix) < 0)
        state = start(x, v)
        state.pivots[0] = 5
        INTEGRATORS[name].advance(fish.body, VACUUM, state, held(rest), h, 1)
        assert state.pivots[0] - 5 == wanted > 0


@each_method
def test_sound_fish_meets_no_bad_pivot(name):
    """At its own step a swimming fish meets no non-positive pivot, and explicit methods have none to count."""
    fish = FISH["mass_spring"]
    tank = Tank(fish, 4, name, water=world_of(fish, (0, 0, 0)))
    for action in np.random.default_rng(11).uniform(-1, 1, (20, 4, 12)):
        tank.swim(action, fish.control_interval)
    assert tank.alive.all() and not tank.state.pivots.any()


@each_method
def test_no_steps(name):
    """Zero steps change nothing, but a state that is not sound is found out, and the body at rest put in its place."""
    fish = FISH["mass_spring"]
    x, v = naive.random_state(fish, np.random.default_rng(12))
    state = start(x, v)
    control = held(fish.body.springs.rest_length)
    INTEGRATORS[name].advance(fish.body, VACUUM, state, control, fish.time_step, 0)
    np.testing.assert_array_equal(state.x[0], x)
    assert state.t[0] == 0 and state.failure[0] == 0
    state.v[0, 3, 1] = np.nan
    state.t[0] = 7.0
    INTEGRATORS[name].advance(fish.body, VACUUM, state, control, fish.time_step, 0)
    assert state.failure[0] == NON_FINITE
    np.testing.assert_array_equal(state.x[0], fish.body.position)  # it was handed over broken: no sound state to keep
    assert not state.v.any() and state.t[0] == 7.0
