"""Every method of the INTEGRATORS table: against its slow twin, its order, what it conserves, and how it fails."""

from functools import cache
from types import SimpleNamespace

import naive
import numpy as np
import pytest
import scipy.integrate
from hypothesis import example, given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

from fish_env import INTEGRATORS, Tank, forces, make_fish
from fish_env.body import (
    COUNTERS,
    FAILURES,
    FORCES,
    NO_CONVERGENCE,
    NON_FINITE,
    PIVOTS,
    TORN,
    UNTRUSTED_SOLVE,
    Control,
    State,
    make_body,
)
from fish_env.integrators import adaptive, leapfrog_chebyshev, limits, rosenbrock
from fish_env.tank import own_step
from fish_env.world import VACUUM, World

FISH = {name: make_fish(name) for name in naive.TU}
KINDS = ("explicit", "semi-implicit", "linearly implicit", "stabilised", "adaptive")
EXPLICIT, SEMI_IMPLICIT, LINEARLY_IMPLICIT, STABILISED, ADAPTIVE = (
    [name for name, record in INTEGRATORS.items() if record.kind == kind] for kind in KINDS
)
SOLVING = SEMI_IMPLICIT + LINEARLY_IMPLICIT
FIXED_STEP = EXPLICIT + SOLVING + STABILISED
MATRIX = {
    "linearly_implicit": {},
    "linearly_implicit_projected": {"projected": True},
    "linearly_implicit_water": {"wet": True},
    "rosenbrock": {},
}
"""What `naive.implicit_matrices` is told for each linearly implicit method."""
KEEPS_ANGULAR_MOMENTUM = {"symplectic_euler"}
each_body = pytest.mark.parametrize("body", naive.TU)
each_method = pytest.mark.parametrize("name", INTEGRATORS)
each_fixed = pytest.mark.parametrize("name", FIXED_STEP)
each_adaptive = pytest.mark.parametrize("name", ADAPTIVE)


def world_of(fish, current=(0.3, -0.2, 0.1)):
    """The water of `naive.dense_water` as the kernels take it."""
    return World(*naive.dense_water(fish, current=current))


def start(x, v):
    """The state of one body at time zero."""
    return State(x[None].copy(), v[None].copy(), np.zeros(1), np.zeros(1, dtype=int), np.zeros((1, 4), dtype=int))


def held(rest, rate=None):
    """Control of one body."""
    return Control(rest[None].copy(), np.zeros((1, rest.size)) if rate is None else rate[None].copy())


def step_of(name, fish, reach):
    """A step of `reach` over the highest frequency, or the part of it that the method bears."""
    return naive.SHORTER.get(name, 1) * reach / naive.highest_frequency(fish.body)


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
        assert record.order >= 1 and record.source and record.kind in KINDS
        assert (record.forces >= 1) == (name in EXPLICIT + SOLVING)
        assert (record.factorisations >= 1) == (record.solves >= 1) == (name in SOLVING)
    assert set(MATRIX) == set(LINEARLY_IMPLICIT)


@each_method
@pytest.mark.parametrize("medium", ["vacuum", "water"])
@settings(max_examples=8)
@given(seed=st.integers(0, 2**32 - 1), body=st.sampled_from(list(naive.TU)))
@example(seed=19573, body="published")  # two faces of the tail turn within the step
def test_step_equals_its_twin(name, medium, seed, body):
    """One step from a random state with moving rest lengths equals the textbook step.

    An adaptive method's is as accurate as its tolerance, which is of the fish's size, and of that times a frequency.
    """
    fish = FISH[body]
    world = VACUUM if medium == "vacuum" else world_of(fish)
    x, v, rest, rate = driven(fish, np.random.default_rng(seed))
    h = 0.5 / naive.highest_frequency(fish.body)
    moved = advance(name, fish.body, world, x, v, rest, rate, h, 1)
    wanted = naive.advance(name, fish.body, world, rest, rate, x, v, h, 1)
    allowed = 1e-12 * np.abs(wanted[0] - x).max(), 1e-12 * np.abs(wanted[1]).max()
    if name in ADAPTIVE:
        slack = 10 if medium == "vacuum" else 400  # the error estimate sees little of a face that turns within a step
        allowed = slack * adaptive.TOLERANCE * fish.length * np.array([1.0, 0.5 / h])
    np.testing.assert_allclose(moved[0] - x, wanted[0] - x, rtol=0, atol=allowed[0])
    np.testing.assert_allclose(moved[1], wanted[1], rtol=0, atol=allowed[1])


@each_fixed
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


@each_fixed
def test_calls_add_up(name):
    """With the controls held, n steps in one call and n calls of one step are the same bits; the clock reads n h."""
    fish = FISH["mass_spring"]
    x, v, rest, _ = driven(fish, np.random.default_rng(8))
    method = INTEGRATORS[name]
    world, h = world_of(fish), own_step(fish, method)
    once, often = start(x, v), start(x, v)
    method.advance(fish.body, world, once, held(rest), h, 10)
    for _ in range(10):
        method.advance(fish.body, world, often, held(rest), h, 1)
    np.testing.assert_array_equal(once.x, often.x)
    np.testing.assert_array_equal(once.v, often.v)
    assert once.t[0] == pytest.approx(10 * h, rel=1e-15) and often.t[0] == pytest.approx(10 * h, rel=1e-14)


# Accuracy


METHOD = {"dop853": "DOP853", "radau": "Radau"}
FINER = {
    "explicit_euler": 16,
    "linearly_implicit": 16,
    "linearly_implicit_projected": 16,
    "linearly_implicit_water": 16,
    "leapfrog_chebyshev": 4,
}
"""How many times the steps of `test_order` a method takes."""


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


@each_fixed
@pytest.mark.parametrize(
    ("body", "medium", "steps"),
    [
        (body, medium, steps)
        for body in naive.TU
        for medium, steps in (("vacuum", (32, 64, 128)), ("water", (32, 64, 128)), ("stiff", (16, 24, 32)))
    ],
)
def test_order(name, body, medium, steps):
    """The error falls with the method's order: in vacuum, in water, and at steps as large as the stiffest unit bears.

    The step times the highest frequency is 1/4 to 1/16, and in the stiff scene 1 to 1/2, where explicit methods end at
    2: its fast vibrations are not resolved, but hardly excited either. The first-order methods whose error is in the
    damping take steps a fraction of that (`FINER`): the amplitude's error grows as exp(h), so that it is straight in h
    only where the step is short against each vibration's own relaxation. So does the leapfrog, whose filter holds back
    the damping differently above a step of six relaxation times: its error has two slopes of second order and a bend.
    """
    steps = FINER.get(name, 1) * np.array(steps)
    (fish_body, world, x, v, rest, rate, duration), (true_x, true_v) = scene(body, medium)
    errors = []
    for n in steps:
        near_x, near_v = advance(name, fish_body, world, x, v, rest, rate, duration / n, n)
        errors.append(np.linalg.norm(near_x - true_x) + duration * np.linalg.norm(near_v - true_v))
    order = slope_of(errors, duration / np.array(steps))
    assert abs(order - INTEGRATORS[name].order) <= 0.15, f"measured order {order:.3f}, errors {errors}"


@each_adaptive
@each_body
@pytest.mark.parametrize("medium", ["vacuum", "water", "stiff"])
def test_adaptive_is_exact(name, body, medium):
    """An adaptive method ends where the true motion ends, to its tolerance; a wider one is less exact and cheaper."""
    (fish_body, world, x, v, rest, rate, duration), (true_x, true_v) = scene(body, medium)
    errors, costs = [], []
    for tolerance in (1e-10, 1e-4):
        state = start(x, v)
        adaptive.solve(fish_body, world, state, held(rest, rate), duration, METHOD[name], tolerance)
        assert state.failure[0] == 0 and state.t[0] == duration
        error = np.linalg.norm(state.x[0] - true_x) + duration * np.linalg.norm(state.v[0] - true_v)
        errors.append(error / (np.linalg.norm(true_x - x) + duration * np.linalg.norm(true_v)))
        costs.append(state.counters[0, FORCES])
    assert errors[0] <= 2e-7 and 1e-7 <= errors[1] <= 0.2
    assert costs[1] < costs[0]


# What is conserved


@each_method
@each_body
def test_linear_momentum(name, body):
    """In vacuum, linear momentum stays for 10,000 steps; the centre of mass moves straight."""
    fish, n = FISH[body], 10_000 if name in FIXED_STEP else 30
    x, v = naive.random_state(fish, np.random.default_rng(4), displacement=0.005, speed=0.3)
    mass, rest, h = fish.body.mass, fish.body.springs.rest_length, step_of(name, fish, 0.3)
    moved_x, moved_v = advance(name, fish.body, VACUUM, x, v, rest, np.zeros_like(rest), h, n)
    size = mass @ np.linalg.norm(v, axis=1)
    assert np.abs(naive.momentum(mass, moved_v) - naive.momentum(mass, v)).max() <= 1e-13 * size
    travelled = naive.momentum(mass, moved_x - x)
    np.testing.assert_allclose(travelled, n * h * naive.momentum(mass, v), rtol=0, atol=1e-12 * size * n * h)


def spinning(fish):
    """A deformed fish with much angular momentum."""
    x, v = naive.random_state(fish, np.random.default_rng(5), displacement=0.005, speed=0.1)
    return x, v + np.cross([0.2, -0.3, 0.25], x) / fish.contraction_time


@each_method
@each_body
def test_angular_momentum(name, body):
    """In vacuum, angular momentum is kept to rounding by symplectic Euler, and to the method's order by the others.

    Tu's method pulls along the line between the nodes' new places while the momentum arm is the old one: a drift
    that halves with the step. Runge-Kutta's falls with the fourth power. An adaptive one's is its tolerance.
    """
    fish = FISH[body]
    x, v = spinning(fish)
    mass, rest = fish.body.mass, fish.body.springs.rest_length
    before, size = naive.angular_momentum(mass, x, v), mass @ np.linalg.norm(np.cross(x, v), axis=1)

    def drift(h, n):
        moved = advance(name, fish.body, VACUUM, x, v, rest, np.zeros_like(rest), h, n)
        return np.linalg.norm(naive.angular_momentum(mass, *moved) - before) / size

    h = 0.4 / naive.highest_frequency(fish.body) / FINER.get(name, 1)
    if name in ADAPTIVE:
        assert drift(h, 20) <= 1e-9
        return
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
    allowed = (1e-9 if name in FIXED_STEP else 1e-7) * fish.length  # where a face turns, tolerances are all there is
    dt = own_step(fish, INTEGRATORS[name])
    tanks = [Tank(fish, 1, name, dt, water=world_of(fish, (0, 0, 0))) for _ in range(2)]
    for action in rng.uniform(-1, 1, (decisions, 12)):
        tanks[0].swim(action, fish.control_interval)
        tanks[1].swim(action[naive.mirrored_muscles(fish)], fish.control_interval)
        assert all(tank.alive[0] for tank in tanks)
        image = tanks[0].position[0, fish.mirror] * [1, -1, 1]
        assert np.abs(tanks[1].position[0] - image).max() <= allowed
    assert np.abs(tanks[0].position[0] - image).max() > 1e-2 * fish.length, "it swam straight: nothing was tested"


@each_method
@each_body
def test_energy_never_grows_in_water(name, body):
    """Left alone in still water, a shaken fish only loses energy, of motion and elastic together."""
    fish = FISH[body]
    x, v = naive.random_state(fish, np.random.default_rng(9), displacement=0.01, speed=0.5)
    rest, h, world = fish.body.springs.rest_length, 0.05 / naive.highest_frequency(fish.body), world_of(fish, (0, 0, 0))
    state, control, energy = start(x, v), held(rest), []
    calls = 100 if name in FIXED_STEP else 25
    for _ in range(calls):
        motion = naive.kinetic_energy(fish.body.mass, state.v[0])
        energy.append(motion + naive.spring_energy(fish.body.springs, rest, state.x[0]))
        INTEGRATORS[name].advance(fish.body, world, state, control, h, 4000 // calls)
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
    if name in ADAPTIVE:
        assert failure == NO_CONVERGENCE and FAILURES[failure].startswith("no convergence")
    elif name == "linearly_implicit_water":  # the infinite damping stands in its matrix
        assert failure == UNTRUSTED_SOLVE
    else:
        assert failure == NON_FINITE and FAILURES[failure].startswith("non-finite")
    np.testing.assert_array_equal(state.v[0], v)


@pytest.mark.parametrize("name", EXPLICIT + SEMI_IMPLICIT)
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


@pytest.mark.parametrize("name", [name for name in LINEARLY_IMPLICIT if INTEGRATORS[name].order == 1])
@each_body
@pytest.mark.parametrize("seed", range(3))
def test_any_step(name, body, seed):
    """At a hundred times the step symplectic Euler bears, linearly implicit Euler shakes no fish apart.

    It ends somewhere folded, no longer than it was and slower. Explicit methods and Tu's fail from the same state. In
    water only the method that has the water in its matrix holds. The Rosenbrock method is left out: stable for linear
    motion, it may tear a fish that is far from it.
    """
    fish = FISH[body]
    omega, theta = naive.highest_frequency(fish.body), np.max(fish.body.springs.damping / fish.body.springs.stiffness)
    h = 100 * (np.sqrt((omega * theta) ** 2 + 4) - omega * theta) / omega
    x, v = naive.random_state(fish, np.random.default_rng(seed), displacement=0.005, speed=0.3)
    rest = fish.body.springs.rest_length
    for other in EXPLICIT + SEMI_IMPLICIT:
        state = start(x, v)
        INTEGRATORS[other].advance(fish.body, VACUUM, state, held(rest), h, 300)
        assert state.failure[0]
    world = world_of(fish, (0, 0, 0)) if MATRIX[name].get("wet") else VACUUM
    moved_x, moved_v = advance(name, fish.body, world, x, v, rest, np.zeros_like(rest), h, 300)
    assert np.ptp(moved_x, axis=0).max() < 1.5 * fish.length and np.abs(moved_v).max() < np.abs(v).max()


@pytest.mark.parametrize("name", STABILISED)
@each_body
def test_stages_grow_with_the_step(name, body):
    """A stabilised method takes more stages at longer steps and holds where symplectic Euler has long failed.

    At 2 and 3 times the step that symplectic Euler bears: the fish, shaken in vacuum, loses its energy.
    """
    fish = FISH[body]
    x, v = naive.random_state(fish, np.random.default_rng(3), displacement=0.002, speed=0.1)
    rest, limit, stages = fish.body.springs.rest_length, limits.leapfrog(fish.body), []
    for factor in (0.1, 2.0, 3.0):
        state, n = start(x, v), 400
        INTEGRATORS[name].advance(fish.body, VACUUM, state, held(rest), factor * limit, n)
        stages.append(state.counters[0, FORCES] / n)
        assert state.failure[0] == 0
        motion = naive.kinetic_energy(fish.body.mass, state.v[0] - fish.body.mass @ v / fish.body.mass.sum())
        assert motion < naive.kinetic_energy(fish.body.mass, v)
    assert stages[0] == 2 and stages[0] < stages[1] < stages[2]
    state = start(x, v)
    INTEGRATORS["symplectic_euler"].advance(fish.body, VACUUM, state, held(rest), 2.0 * limit, 400)
    assert state.failure[0]


def test_most_stages():
    """A step too long for any number of stages allowed is taken with the most, not looked for without end."""
    t, body = np.zeros(leapfrog_chebyshev.MOST_STAGES + 1), FISH["mass_spring"].body
    assert leapfrog_chebyshev.plan(body.elastic_rate, body.viscous_rate, 1e6, t) == leapfrog_chebyshev.MOST_STAGES


@pytest.mark.parametrize("stages", [2, 3, 5, 12, 60])
def test_filter(stages):
    """The filter is 1 at rest; kicks of all vibrations within its reach are positive and at most what is stable, 4."""
    t = np.zeros(leapfrog_chebyshev.MOST_STAGES + 1)
    midpoint, first, factor, reach = leapfrog_chebyshev.polynomial(stages, t)
    z = np.linspace(1e-6, reach, 2000)
    a, before = first / midpoint * np.ones_like(z), np.zeros_like(z)
    for s in range(1, stages):  # (37)
        pull = 2.0 * (first + midpoint * a) - factor * z * a
        a, before = (t[s] * pull - t[s - 1] * before) / t[s + 1], a
    assert abs(a[0] - 1.0) < 1e-5
    assert (z * a).min() > 0.0 and 3.9 < (z * a).max() <= 4.0 + 1e-9


@pytest.mark.parametrize("name", ["symplectic_euler", "semi_implicit", "explicit_euler", "midpoint", "rk4"])
@each_body
def test_limit_is_safe(name, body):
    """A gently shaken fish holds at 0.98 of the step its record calls safe; the first three fail at twice that."""
    fish = FISH[body]
    x, v = naive.random_state(fish, np.random.default_rng(3), displacement=1e-4, speed=1e-3)
    rest, limit = fish.body.springs.rest_length, INTEGRATORS[name].limit(fish.body)
    for factor, n in ((0.98, 2000), (2.0, 4000)):
        state = start(x, v)
        INTEGRATORS[name].advance(fish.body, VACUUM, state, held(rest), factor * limit, n)
        if factor < 1.0:
            assert state.failure[0] == 0 and np.abs(state.v[0]).max() < 2 * np.abs(v).max()
        elif name in ("symplectic_euler", "semi_implicit", "explicit_euler"):
            assert state.failure[0] or np.abs(state.v[0]).max() > 100 * np.abs(v).max()


@each_method
def test_nodes_in_one_place(name):
    """Two joined nodes in one place have no direction to push in: non-finite, or an untrusted solve, never a guess."""
    fish = FISH["mass_spring"]
    x = fish.body.position.copy()
    x[2] = x[1]
    state = start(x, np.zeros_like(x))
    control = held(fish.body.springs.rest_length)
    failure = run_into_failure(INTEGRATORS[name], fish, VACUUM, state, control, fish.time_step, 1)
    assert failure == UNTRUSTED_SOLVE if name in SOLVING else NO_CONVERGENCE if name in ADAPTIVE else NON_FINITE
    np.testing.assert_array_equal(state.x[0], x)


@pytest.mark.parametrize("name", [name for name in SOLVING if name != "linearly_implicit_projected"])
def test_untrusted_solve(name):
    """Two masses on a spring compressed so that m + 2 h2 eta is zero: the singular system is reported, not solved.

    The projected method has no negative eta.
    """
    h = 1.0 / rosenbrock.GAMMA if name == "rosenbrock" else 1.0
    body = make_body([[0, 0, 0], [1, 0, 0]], [1, 1], [(0, 1)], [1], [0], [1.5], [])
    state = start(body.position, np.zeros((2, 3)))
    INTEGRATORS[name].advance(body, VACUUM, state, held(body.springs.rest_length), h, 5)
    assert FAILURES[state.failure[0]].startswith("untrusted solve")
    record = INTEGRATORS[name]  # all but the one step it took went uncounted
    assert state.counters[0, :PIVOTS].tolist() == [record.forces, record.factorisations, record.solves]
    np.testing.assert_array_equal(state.x[0], body.position)
    assert state.t[0] == 0 and not state.v.any()


@pytest.mark.parametrize("name", SOLVING)
@each_body
def test_non_positive_pivots_are_counted(name, body):
    """A strongly compressed fish and a large step make the matrix indefinite: one pivot a negative eigenvalue.

    A fish that fails on the way keeps its count. The projected matrix is never indefinite.
    """
    fish = FISH[body]
    rest, x, v = fish.body.springs.rest_length, 0.6 * fish.body.position, np.zeros((23, 3))
    for reach in (1.5, 3.0, 10.0):
        h = inner = reach / naive.highest_frequency(fish.body)
        if name == "rosenbrock":
            h = inner / rosenbrock.GAMMA
        if name in SEMI_IMPLICIT:
            matrix, _ = naive.tu_system(fish.body, VACUUM, rest, h, x, v)
        else:
            stiffness, damping = naive.implicit_matrices(fish.body, VACUUM, rest, x, v, **MATRIX[name])
            matrix = np.diag(np.repeat(fish.body.mass, 3)) + inner * damping + inner**2 * stiffness
        wanted = np.count_nonzero(np.linalg.eigvalsh(matrix) < 0)
        state = start(x, v)
        state.counters[0, PIVOTS] = 5
        INTEGRATORS[name].advance(fish.body, VACUUM, state, held(rest), h, 1)
        assert state.counters[0, PIVOTS] - 5 == wanted
        assert (wanted > 0) == (name != "linearly_implicit_projected")


@each_method
def test_sound_fish_meets_no_bad_pivot(name):
    """At its own step a swimming fish meets no non-positive pivot, and explicit methods have none to count."""
    fish = FISH["mass_spring"]
    dt = own_step(fish, INTEGRATORS[name])
    tank = Tank(fish, 2, name, dt, water=world_of(fish, (0, 0, 0)))
    for action in np.random.default_rng(11).uniform(-1, 1, (20 if name in FIXED_STEP else 4, 2, 12)):
        tank.swim(action, fish.control_interval)
    assert tank.alive.all() and not tank.counters["non_positive_pivots"].any()


@pytest.mark.parametrize("name", EXPLICIT + SOLVING)
def test_counters(name):
    """Every fish's counters grow by the record's numbers a step, call after call; a failed fish's stand still."""
    fish, record = FISH["mass_spring"], INTEGRATORS[name]
    tank = Tank(fish, 3, name, dt=0.1 * fish.time_step)
    tank.state.failure[1] = TORN
    for calls in (1, 2):
        tank.advance(7)
        for part in ("force_evaluations", "factorisations", "solves"):
            each = getattr(record, {"force_evaluations": "forces"}.get(part, part))
            if name in STABILISED and part == "force_evaluations":
                t = np.zeros(leapfrog_chebyshev.MOST_STAGES + 1)
                each = leapfrog_chebyshev.plan(fish.body.elastic_rate, fish.body.viscous_rate, tank.dt, t)
            wanted = 7 * calls * each
            assert tank.counters[part].tolist() == [wanted, 0, wanted]
    assert list(tank.counters) == list(COUNTERS)


@each_adaptive
def test_adaptive_counters(name, monkeypatch):
    """An adaptive method counts every evaluation of the forces, and the factorisations that scipy tells of."""
    evaluations, found = [], []

    def total(*arguments):
        evaluations.append(arguments)
        forces.total(*arguments)

    def remember(*arguments, **options):
        found.append(solve_ivp(*arguments, **options))
        return found[-1]

    monkeypatch.setattr(adaptive, "forces", SimpleNamespace(total=total, jacobian=forces.jacobian))
    monkeypatch.setattr(scipy.integrate, "solve_ivp", remember)
    fish = FISH["mass_spring"]
    tank = Tank(fish, 1, name, water=world_of(fish))
    tank.advance(2)
    tank.advance(1)
    assert len(found) == 2 and found[0].nfev + found[1].nfev == len(evaluations) == tank.counters["force_evaluations"]
    assert tank.counters["factorisations"] == found[0].nlu + found[1].nlu
    assert (tank.counters["factorisations"] > 0) == (name == "radau")
    assert tank.counters["solves"] == 0


@each_adaptive
def test_adaptive_gives_up(name, monkeypatch):
    """A motion that takes more evaluations than are allowed fails as not converged, and is put back; counters stay."""
    monkeypatch.setattr(adaptive, "MOST_EVALUATIONS", 100)
    fish = FISH["mass_spring"]
    x, v = naive.random_state(fish, np.random.default_rng(13))
    state = start(x, v)
    failure = run_into_failure(INTEGRATORS[name], fish, VACUUM, state, held(fish.body.springs.rest_length), 1.0, 1)
    assert failure == NO_CONVERGENCE
    np.testing.assert_array_equal(state.x[0], x)
    assert state.counters[0, FORCES] == 101


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        ({"method": "RK45"}, "unknown method 'RK45'; choose from 'DOP853', 'Radau'"),
        ({"tolerance": 1e-14}, "tolerance is 1e-14; give a number from 1e-13 to 0.01"),
        ({"tolerance": 0.1}, "tolerance is 0.1; give a number"),
        ({"tolerance": float("nan")}, "tolerance is nan; give a number"),
        ({"tolerance": "fine"}, "tolerance is 'fine'; give a number"),
        ({"duration": -1.0}, "duration is -1.0; give a finite number of seconds, zero or more"),
        ({"duration": float("inf")}, "duration is inf; give a finite number"),
    ],
    ids=str,
)
def test_adaptive_refuses(arguments, text):
    """A method, tolerance or duration that is not allowed is refused before anything moves."""
    fish = FISH["mass_spring"]
    x, v = naive.random_state(fish, np.random.default_rng(14))
    state = start(x, v)
    with pytest.raises(ValueError, match=text):
        adaptive.solve(fish.body, VACUUM, state, held(fish.body.springs.rest_length), **{"duration": 0.1, **arguments})
    np.testing.assert_array_equal(state.x[0], x)


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
