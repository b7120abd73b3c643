"""How every method fails, at which steps, and what it counts: forces, factorisations, solves, non-positive pivots."""

import math
import warnings
from functools import partial

import gymnasium as gym
import moving
import naive
import numpy as np
import pytest
from moving import (
    ADAPTIVE,
    EXPLICIT,
    FISH,
    FIXED_STEP,
    SOLVING,
    STABILISED,
    THIN,
    each_body,
    each_method,
    every_fixed,
    every_method,
    run_into_failure,
    tank_of,
    tiered,
)  # fmt: skip

import fish_env
from benchmarks.stability import linear
from fish_env import INTEGRATORS, Tank, make_fish
from fish_env.physics.body import make_body, scale_body
from fish_env.physics.failures import FAILURES, NO_CONVERGENCE, NON_FINITE, TORN, UNTRUSTED_SOLVE
from fish_env.physics.integrators import get_integrator, limits
from fish_env.physics.records import COUNTERS, PIVOTS
from fish_env.physics.tank_options import TESTED, longest_step, own_step
from fish_env.physics.world import VACUUM

DEFAULT, STILL = FISH["mass_spring"], np.zeros((23, 3))
GAMMA = 1.0 - np.sqrt(0.5)  # of the method of Rosenbrock
plain = pytest.mark.usefixtures("kernels")

# Failures


@each_method
@pytest.mark.parametrize("body", tiered(naive.TU, ("mass_spring",)))
def test_torn(name, body):
    """A fish whose springs are driven to four times their length is torn after some calls, and left as it was."""
    fish = FISH[body]
    h, rest = 0.1 / naive.highest_frequency(fish.body), 4 * fish.body.springs.rest_length
    tank = tank_of(name, fish, THIN, fish.body.position, STILL, h, rest)
    failure = run_into_failure(tank, 4)
    assert failure == TORN and FAILURES[failure].startswith("torn")
    assert tank.time[0] > 0 and tank.velocity.any()


@pytest.mark.parametrize("name", tiered(INTEGRATORS, set(moving.REPRESENTATIVE) - set(ADAPTIVE)))
def test_non_finite(name):
    """A speed whose fourth power overflows makes the water's force infinite: the fish fails as non-finite, and stays.

    In the method that has the water in its matrix, that has nothing left of the masses: its pivots are not to be
    trusted.
    """
    v = np.full((23, 3), 1e150)
    tank = tank_of(name, DEFAULT, moving.world_of(DEFAULT), DEFAULT.body.position, v, DEFAULT.time_step)
    failure = run_into_failure(tank, 1)
    if name in ADAPTIVE:
        assert failure == NO_CONVERGENCE and FAILURES[failure].startswith("no convergence")
    elif name == "linearly_implicit_water":
        assert failure == UNTRUSTED_SOLVE
    else:
        assert failure == NON_FINITE and FAILURES[failure].startswith("non-finite")
    np.testing.assert_array_equal(tank.velocity[0], v)


@pytest.mark.parametrize("name", tiered(EXPLICIT + moving.SEMI_IMPLICIT))
@pytest.mark.parametrize("body", tiered(naive.TU, ("mass_spring",)))
def test_too_large_a_step(name, body):
    """Many steps far above the stable one blow the fish up: it fails with a reason, explicit methods as non-finite."""
    fish = FISH[body]
    x, v = naive.random_state(fish, np.random.default_rng(10), speed=0.1)
    failure = run_into_failure(tank_of(name, fish, THIN, x, v, 40 / naive.highest_frequency(fish.body)), 3000)
    assert failure == NON_FINITE if name in EXPLICIT else FAILURES[failure]


@each_method
def test_nodes_in_one_place(name):
    """Two joined nodes in one place have no direction to push in: non-finite, or an untrusted solve, never a guess."""
    x = DEFAULT.body.position.copy()
    x[2] = x[1]
    tank = tank_of(name, DEFAULT, THIN, x, STILL, DEFAULT.time_step)
    failure = run_into_failure(tank, 1)
    assert failure == UNTRUSTED_SOLVE if name in SOLVING else NO_CONVERGENCE if name in ADAPTIVE else NON_FINITE
    np.testing.assert_array_equal(tank.position[0], x)


@pytest.mark.parametrize(
    "name", tiered((n for n in SOLVING if n != "linearly_implicit_projected"), moving.SEMI_IMPLICIT)
)
def test_untrusted_solve(name):
    """Two masses on a spring compressed so that m + 2 h2 eta is zero: the singular system is reported, not solved.

    The projected method has no negative eta. What follows in the call is counted as work, but no pivots of it.
    """
    h = 1.0 / GAMMA if name == "rosenbrock" else 1.0
    body = make_body([[0, 0, 0], [1, 0, 0]], [1, 1], [(0, 1)], [1], [0], [1.5], [])
    once, often = (tank_of(name, body, VACUUM, body.position, np.zeros((2, 3)), h) for _ in range(2))
    once.advance(1)
    often.advance(5)
    for tank in (once, often):
        assert tank.failure[0].startswith("untrusted solve")
        np.testing.assert_array_equal(tank.position[0], body.position)
        assert tank.time[0] == 0 and not tank.velocity.any()
    record = INTEGRATORS[name]
    cost = np.array([record.forces, record.factorisations, record.solves])
    np.testing.assert_array_equal(once.state.counters[0, :PIVOTS], cost)
    np.testing.assert_array_equal(often.state.counters[0, :PIVOTS], 5 * cost)
    assert once.state.counters[0, PIVOTS] == often.state.counters[0, PIVOTS]


@plain
@every_method
def test_no_steps(name):
    """Zero steps change nothing, but a state that is not valid is found out, and the body at rest put in its place."""
    x, v = naive.random_state(DEFAULT, np.random.default_rng(12))
    tank = tank_of(name, DEFAULT, THIN, x, v, DEFAULT.time_step)
    tank.advance(0)
    np.testing.assert_array_equal(tank.position[0], x)
    assert tank.time[0] == 0 and tank.alive[0]
    tank.velocity[0, 3, 1] = np.nan
    tank.time[0] = 7.0
    tank.advance(0)
    assert tank.state.failure[0] == NON_FINITE
    np.testing.assert_array_equal(tank.position[0], DEFAULT.body.position)  # handed over invalid: nothing to keep
    assert not tank.velocity.any() and tank.time[0] == 7.0


# Steps


SOME_TEAR = {(100, "linearly_implicit", "mass_spring"), (100, "linearly_implicit_water", "published")}
"""Factor on the step, method and body where a start tears or not by rounding; their matrices may be indefinite."""
FIRST = ("linearly_implicit",)


def stable_step(fish) -> float:
    """Of symplectic Euler: by the formula with the longest relaxation time; by the body's bound if some are far longer.

    The default fish is damped by section: its highest vibrations relax far sooner than its slowest springs.
    """
    omega, times = naive.highest_frequency(fish.body), fish.body.springs.damping / fish.body.springs.stiffness
    if times.max() > 2.0 * times.min():
        return limits.leapfrog(fish.body)
    return (np.sqrt((omega * times.max()) ** 2 + 4) - omega * times.max()) / omega


def shaken_hard(fish, factor):
    """A step of `factor` times the stable one, s, and three starts: positions and velocities (3,N,3)."""
    starts = [naive.random_state(fish, np.random.default_rng(k), displacement=0.005, speed=0.3) for k in range(3)]
    return factor * stable_step(fish), *map(np.array, zip(*starts, strict=True))


@pytest.mark.parametrize("name", tiered((n for n in moving.LINEARLY_IMPLICIT if INTEGRATORS[n].order == 1), FIRST))
@pytest.mark.parametrize("body", tiered(naive.TU, ("mass_spring",)))
@pytest.mark.parametrize("factor", [10, 100])
def test_large_steps(name, body, factor):
    """At ten and a hundred times the stable step of symplectic Euler, linearly implicit Euler shakes no fish apart.

    The exceptions are SOME_TEAR, where at least 70 % survive: three starts are repeated with changes by rounding. Those
    that survive end somewhere folded, no longer than they were and slower, but for some in SOME_TEAR that tear next.
    In water only the method that has the water in its matrix
    holds. The Rosenbrock method is left out: stable for linear motion, it may tear a fish that is far from it.
    """
    fish = FISH[body]
    h, x, v = shaken_hard(fish, factor)
    x = np.array([position * (1 + 1e-13 * k) for position in x for k in range(16)])
    v = np.repeat(v, 16, axis=0)
    world = moving.world_of(fish, (0, 0, 0)) if moving.MATRIX[name].get("wet") else THIN
    tank = tank_of(name, fish, world, x, v, h, lanes="xyz")
    tank.advance(300)
    some_tear = (factor, name, body) in SOME_TEAR
    assert tank.alive.mean() >= 0.7 if some_tear else tank.alive.all()
    moved_x, moved_v = tank.position[tank.alive], tank.velocity[tank.alive]
    assert np.ptp(moved_x, axis=1).max() < 1.5 * fish.length
    slower = np.abs(moved_v).max(axis=(1, 2)) < np.abs(v[tank.alive]).max(axis=(1, 2))
    assert slower.mean() >= 0.9 if some_tear else slower.all()


LIMITED = [*EXPLICIT, *moving.SEMI_IMPLICIT]


@plain
@pytest.mark.filterwarnings("ignore:.*will fail")
@pytest.mark.parametrize("name", LIMITED)
def test_limit_of_one_vibration(name):
    """A small vibration of two masses on a damped spring fades at 0.98 of the largest stable step, and grows at 1.02.

    Its rates are those of an oscillator: c / m' and k / m', with half the mass.
    """
    body = make_body([[0, 0, 0], [1, 0, 0]], [2.0, 2.0], [(0, 1)], [9.0], [1.5], [1.0], [])
    assert (body.max_stiffness_eigenvalue, body.max_damping_eigenvalue) == pytest.approx((9.0, 1.5))
    limit, v = INTEGRATORS[name].limit(body, VACUUM), 1e-6 * np.array([[-1.0, 0.0, 0.0], [1.0, 0.0, 0.0]])
    for part, fades in ((0.98, True), (1.02, False)):
        tank = tank_of(name, body, VACUUM, body.position, v, part * limit)
        tank.advance(300)
        assert tank.alive[0] and (np.abs(tank.velocity).max() < 1e-6) == fades


@pytest.mark.parametrize("water", ["reactive", "drag"])
@each_body
def test_default_steps_are_below_the_limit(body, water):
    """Every method's own step on every body in every water, and the body's own, is one that does not warn."""
    fish = make_fish(body, water=water) if body != "published" else FISH[body]
    for record in INTEGRATORS.values():
        assert own_step(fish, record) <= record.limit(fish.body, fish.water)


def make_tank(**options):
    """A tank, by keywords of an environment."""
    return Tank(DEFAULT, water=DEFAULT.water, **options)


@pytest.mark.parametrize("make", [
    make_tank, partial(gym.make, "FishEnv/Swim-v0"), partial(gym.make_vec, "FishEnv/Swim-v0", num_envs=2),
    partial(fish_env.make_sb3_vec_env, "FishEnv/Swim-v0", num_envs=2),
], ids=["tank", "single", "batch", "sb3"])  # fmt: skip
def test_a_step_above_the_limit_warns(make):
    """Wherever it is given, with the largest stable one; a step below it is taken silently."""
    for name, verb in (("rk4", "will"), ("leapfrog_chebyshev", "may")):  # the default method refines its steps
        limit = longest_step(DEFAULT, DEFAULT.water, INTEGRATORS[name])
        fewest = math.ceil(DEFAULT.control_interval / limit - 1e-9)
        below, above = (DEFAULT.control_interval / steps for steps in (fewest, fewest - 1))
        with pytest.warns(
            UserWarning,
            match=f"'{name}' {verb} fail .*: its stable steps are at most {limit:.3g} s, and dt is {above:.3g} s",
        ):
            make(integrator=name, dt=above)
        with warnings.catch_warnings():
            warnings.simplefilter("error", UserWarning)
            make(integrator=name, dt=below)


SCANS = [(body, "reactive", factor, (4, 5, 6, 7)) for body in ("mass_spring", "planar")
         for factor in (0.4, 0.6, 0.68, 0.76, 0.9, 1.0, 1.4)]  # fmt: skip
SCANS += [(body, "drag", 1.0, (4, 5, 6, 7)) for body in ("mass_spring", "planar")]


@pytest.mark.parametrize(("body", "water", "stiffness", "periods"), SCANS)
def test_no_step_between_is_unstable(body, water, stiffness, periods):
    """The default method, never refined, loses no fish at the longest step that does not warn, nor at shorter ones.

    Half of the fish contract one side and then the other every 0.08 to 0.14 s, half draw full contractions at random.
    The fewest steps grow with the root of the stiffness; in drag they are seven.
    """
    fish, count = make_fish(body, water=water), 16
    fewest = 7 if water == "drag" else fish.control_interval / (TESTED * fish.time_step) - 1e-9
    first = math.ceil(fewest * math.sqrt(max(1.0, stiffness)))
    for steps in range(first, max(first + 8, 17)):
        tank = Tank(fish, count, dt=fish.control_interval / steps, water=fish.water, refine=np.inf, threads=1)
        for i in range(count):
            tank.vary(i, stiffness=stiffness)
        command_violently(tank, 100, fish.control_interval, steps, periods)
        assert tank.alive.all(), steps


def command_violently(tank, intervals, duration, seed, periods=(4, 5, 6, 7)):
    """Half of the fish contract one side, then the other, every so many intervals; half draw full contractions."""
    fish, generator = tank.fish, np.random.default_rng(seed)
    for k in range(intervals):
        if k % 5 == 0:
            action = generator.choice([-1.0, 1.0], (tank.num_fish, fish.num_muscles))
        for i in range(0, tank.num_fish, 2):
            action[i] = np.where(fish.sides == (-1) ** (k // periods[i // 2 % len(periods)]), 1.0, -1.0)
        tank.swim(action, duration)


@pytest.mark.parametrize("water", ["reactive", "drag"])
@pytest.mark.parametrize(("stiffness", "mass"), [(1.0, 1.0), (0.7, 1.5), (0.4, 1.5)])
def test_tu_survives_at_its_own_step(stiffness, mass, water):
    """Tu's method at its own step loses no fish under violent commands, nor a softer and heavier one."""
    fish = make_fish(water=water)
    tank = Tank(fish, 32, "semi_implicit", water=fish.water, threads=1)
    for i in range(32):
        tank.vary(i, stiffness=stiffness, mass=mass)
    command_violently(tank, 200, fish.control_interval, 0)
    assert tank.alive.all()


# Linear theory

ALIKE = make_fish("mass_spring", relaxation_time=0.0003, damping_taper=[1.0] * 6).body
"""All springs relax alike, so that every vibration is damped on its own, and there are formulas."""
OMEGA = np.sqrt(ALIKE.max_stiffness_eigenvalue)
THETA = ALIKE.springs.damping[0] / ALIKE.springs.stiffness[0]
LONGEST = 5 * DEFAULT.control_interval


def test_modes_are_those_of_the_body():
    """As many vibrations as coordinates less six; the highest is the body's, all relax in the units' time."""
    squares, damping = linear.modes(ALIKE)
    assert squares.size == 3 * ALIKE.mass.size - 6
    assert np.isclose(squares.max(), ALIKE.max_stiffness_eigenvalue, rtol=1e-12)
    assert np.allclose(damping, THETA * squares, rtol=1e-9, atol=0)


FORMULAS = {
    "symplectic_euler": (lambda w, s: (np.sqrt((w * s) ** 2 + 4.0) - w * s) / w, 1e-5),
    "semi_implicit": (lambda w, s: (np.sqrt((w * s) ** 2 + 4.0) - w * s) / w, 1e-5),
    "explicit_euler": (lambda w, s: s, 1e-3),  # where every mode is lightly damped
}
"""Limit of a method by the highest frequency and the relaxation time, and the relative error that is allowed."""


@pytest.mark.parametrize("factor", [1.0, 100.0])
@pytest.mark.parametrize("name", tiered(FORMULAS, ("symplectic_euler",)))
def test_linear_limits(name, factor):
    """The limit of a body whose stiffness is multiplied by a factor is that of the formula."""
    body, (formula, error) = scale_body(ALIKE, factor, 1.0), FORMULAS[name]
    expected = formula(OMEGA * np.sqrt(factor), THETA / factor)
    assert np.isclose(linear.linear_limit(name, body, LONGEST), expected, rtol=error)


@pytest.mark.parametrize("name", tiered((n for n in FIXED_STEP if INTEGRATORS[n].kind != "explicit"), STABILISED))
def test_no_linear_limit(name):
    """A method that solves for, or filters, all stiffness is stable at long steps on a hundredfold stiff body at rest.

    Up to 30 ms the leapfrog's 1000 stages do.
    """
    body, longest = scale_body(DEFAULT.body, 100.0, 1.0), 1.5 * DEFAULT.control_interval
    assert np.isinf(linear.linear_limit(name, body, longest)) == (name != "semi_implicit")


# Counters


@plain
@pytest.mark.parametrize("name", tiered(SOLVING, "all"))
@each_body
def test_non_positive_pivots_are_counted(name, body):
    """A strongly compressed fish and a large step make the matrix indefinite: one pivot a negative eigenvalue.

    A fish that fails on the way keeps its count. The projected matrix is never indefinite.
    """
    fish = FISH[body]
    rest, x = fish.body.springs.rest_length, 0.6 * fish.body.position
    for reach in (1.5, 3.0, 10.0):
        h = inner = reach / naive.highest_frequency(fish.body)
        if name == "rosenbrock":
            h = inner / GAMMA
        if name in moving.SEMI_IMPLICIT:
            matrix, _ = naive.tu_system(fish.body, VACUUM, rest, h, x, STILL)
        else:
            stiffness, damping = naive.implicit_matrices(fish.body, VACUUM, rest, x, STILL, **moving.MATRIX[name])
            matrix = np.diag(np.repeat(fish.body.mass, 3)) + inner * damping + inner**2 * stiffness
        wanted = np.count_nonzero(np.linalg.eigvalsh(matrix) < 0)
        tank = tank_of(name, fish, THIN, x, STILL, h)
        tank.state.counters[0, PIVOTS] = 5
        tank.advance(1)
        assert tank.state.counters[0, PIVOTS] - 5 == wanted
        assert (wanted > 0) == (name != "linearly_implicit_projected")


@each_method
def test_a_swimming_fish_meets_no_bad_pivot(name):
    """At its own step a swimming fish meets no non-positive pivot, and explicit methods have none to count."""
    dt, still = own_step(DEFAULT, INTEGRATORS[name]), moving.world_of(DEFAULT, (0, 0, 0))
    tank = Tank(DEFAULT, 2, name, dt, water=still, lanes="xyz")
    for action in np.random.default_rng(11).uniform(-1, 1, (20 if name in moving.FIXED_STEP else 4, 2, 12)):
        tank.swim(action, DEFAULT.control_interval)
    assert tank.alive.all() and not tank.counters["non_positive_pivots"].any()


@plain
@every_fixed
def test_counters(name):
    """Every fish's counters grow by the record's numbers a step, call after call; a failed fish's stand still."""
    record = get_integrator(name)
    tank = Tank(DEFAULT, 3, name, dt=0.1 * DEFAULT.time_step, water=THIN, lanes="xyz")
    tank.state.failure[1] = TORN
    evaluations = record.forces
    if name in moving.STABILISED:
        body = DEFAULT.body
        row = record.method.plan(body.max_stiffness_eigenvalue, body.max_damping_eigenvalue, tank.dt)
        evaluations = record.method.costs(row)[0]
    assert {"explicit_euler": 1, "midpoint": 2, "rk4": 4}.get(name, evaluations) == evaluations
    each = {"force_evaluations": evaluations, "factorisations": record.factorisations, "solves": record.solves}
    for calls in (1, 2):
        tank.advance(2)
        for part, number in each.items():
            assert tank.counters[part].tolist() == [2 * calls * number, 0, 2 * calls * number]
    assert list(tank.counters) == list(COUNTERS)
