"""What the tests of methods share: their lists, fish, and tanks of any body in any state, all springs driven."""

from dataclasses import replace
from functools import cache

import naive
import numpy as np
import pytest
from scipy.integrate import solve_ivp

from fish_env import INTEGRATORS, Tank, make_fish
from fish_env.physics.fish import ElasticObject
from fish_env.physics.forces.evaluate import Evaluator
from fish_env.physics.records import Body, World
from fish_env.physics.world import VACUUM

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
FINER = {
    "explicit_euler": 16,
    "linearly_implicit": 16,
    "linearly_implicit_projected": 16,
    "linearly_implicit_water": 16,
    "leapfrog_chebyshev": 4,
}
"""By how much steps are shortened for a method, so that its error is in the straight part of its slope."""
REPRESENTATIVE = ("leapfrog_chebyshev", "semi_implicit", "rk4", "rosenbrock", "dop853")
"""One method of each family of kernels. The others differ from one of them by numbers of a table, take as long to
compile again, and are tried by `pytest -m slow`; every run tries what tells them apart (`test_integrators.py`)."""


def tiered(names, quick=REPRESENTATIVE):
    """Parameters of a test, methods for example, those that are not among the quick ones marked as slow."""
    return [pytest.param(name, marks=() if name in quick else pytest.mark.slow) for name in names]


each_body = pytest.mark.parametrize("body", naive.TU)
each_method = pytest.mark.parametrize("name", tiered(INTEGRATORS))
each_fixed = pytest.mark.parametrize("name", tiered(FIXED_STEP))
each_adaptive = pytest.mark.parametrize("name", tiered(ADAPTIVE))
two_methods = pytest.mark.parametrize("name", tiered(INTEGRATORS, ("leapfrog_chebyshev", "dop853")))
"""For what does not depend on the method: the default one, and one without an engine."""
all_fixed = pytest.mark.parametrize("name", FIXED_STEP)


THIN = VACUUM._replace(quadratic=1e-300)
"""Water that moves no bit: tests in it share the kernels of tests in water. Methods differ in a real vacuum only where
`vacuum_for` gives it."""


def vacuum_for(name):
    """Vacuum for a method that leaves something out where no force decays velocities, `THIN` for the others."""
    return VACUUM if name in STABILISED else THIN


def without_walls(name, world):
    """The same world, without walls for a method that cannot serve them."""
    return world._replace(planes=None) if name in ADAPTIVE else world


def driven(thing, h):
    """The object, or the body, with a muscle for every spring and steps of h s."""
    if isinstance(thing, Body):
        thing = ElasticObject(name="body", body=thing, length=1.0, time_step=h, control_interval=h)
    springs = np.arange(thing.body.springs.stiffness.size)
    halves = np.full(springs.size, 0.5)
    return replace(thing, time_step=h, muscles=springs, contracted=halves, fibres=None, drives=None)


def tank_of(name, thing, world, x, v, h, rest=None, rate=None, **options):
    """A tank of bodies at x with velocities v, (N,3) or (B,N,3), that the method of this name moves by steps of h s.

    Args:
        name: a key of INTEGRATORS.
        thing: a `Body`, or an elastic object that has one.
        world: what surrounds it.
        x: positions, m.
        v: velocities, m/s.
        h: step, s.
        rest: rest lengths (E,) or (B,E), m; None leaves the natural ones.
        rate: how fast they move in the first call, m/s; None holds them.
        options: of `Tank`.
    """
    x, v = np.array(x, ndmin=3), np.array(v, ndmin=3)
    tank = Tank(driven(thing, h), len(x), name, h, water=world, **{"threads": 1, "refine": np.inf, **options})
    tank.position[:], tank.velocity[:] = x, v
    if rest is not None:
        tank.rest_length[:] = rest
    if rate is not None:
        tank.control.rate[:] = rate
    return tank


def advance(name, thing, world, x, v, rest, rate, h, n):
    """Where one body is after n steps in a call, which it must survive: (x, v)."""
    tank = tank_of(name, thing, world, x, v, h, rest, rate)
    tank.advance(n)
    assert tank.alive[0], tank.failure[0]
    return tank.position[0], tank.velocity[0]


def assert_moved(start, moved, wanted, of_way, of_velocity):
    """Check the ends (x, v) of a motion from `start`: displacements and velocities, each to an absolute error."""
    np.testing.assert_allclose(moved[0] - start, wanted[0] - start, rtol=0, atol=of_way)
    np.testing.assert_allclose(moved[1], wanted[1], rtol=0, atol=of_velocity)


def run_into_failure(tank, n, calls=200):
    """Advance one body until it fails: it must be left, with its clock, as it was before the last call."""
    for _ in range(calls):
        before = [array.copy() for array in tank.state[:3]]
        tank.advance(n)
        if not tank.alive[0]:
            for now, then in zip(tank.state[:3], before, strict=True):
                np.testing.assert_array_equal(now, then)
            assert np.isfinite(tank.position).all() and np.isfinite(tank.velocity).all()
            tank.advance(n)  # a failed body stays where it is
            np.testing.assert_array_equal(tank.position, before[0])
            assert tank.time[0] == before[2][0]
            return tank.state.failure[0]
    raise AssertionError(f"still valid after {calls} calls")


def world_of(fish, current=(0.3, -0.2, 0.1)):
    """The water of `naive.dense_water` as the kernels take it."""
    return World(*naive.dense_water(fish, current=current))


def random_motion(fish, rng):
    """A random state, with muscles and, a little, all other rest lengths on the move: x, v, rest lengths, rates."""
    x, v = naive.random_state(fish, rng, speed=0.2)
    natural = fish.body.springs.rest_length
    rest = natural * rng.uniform(0.9, 1.1, natural.size)
    rate = natural * rng.uniform(-0.3, 0.3, natural.size) / fish.contraction_time
    return x, v, rest, rate


def slope_of(errors, steps):
    """Measured order: slope of log error over log step."""
    return np.polyfit(np.log(steps), np.log(errors), 1)[0]


def exact(body, world, x, v, rest, rate, duration):
    """The reference solution (x, v) by an eighth-order method with its own error control, on the kernels' forces.

    Also returns which faces moved outward: one row for every pattern met on the way.
    """
    evaluator, size, outward = Evaluator(body, world), x.size, set()

    def slope(t, y):
        positions, velocities = y[:size].reshape(-1, 3), y[size:].reshape(-1, 3)
        p, q, r, s = np.moveaxis(positions[body.faces.nodes], 1, 0)
        through = np.einsum("fc,fck->fk", body.faces.share, velocities[body.faces.nodes]) - world.current
        outward.add(tuple(np.einsum("fk,fk->f", np.cross(r - p, s - q), through) > 0))
        f = evaluator.force(rest + t * rate, positions, velocities, t)
        return np.concatenate([y[size:], (f / body.mass[:, None]).ravel()])

    y0 = np.concatenate([x.ravel(), v.ravel()])
    y = solve_ivp(slope, (0.0, duration), y0, method="DOP853", rtol=1e-13, atol=1e-15 * np.abs(y0).max()).y[:, -1]
    return (y[:size].reshape(-1, 3), y[size:].reshape(-1, 3)), outward


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
        world = VACUUM._replace(linear=linear, quadratic=0.01 * quadratic, current=current)
        rate *= 0.2
        v = 0.02 * fish.length / fish.contraction_time * rng.uniform(-1, 1, (23, 3))
    elif medium == "stiff":
        duration *= 2
    start_of_it = (fish.body, world, x, v, rest, rate, duration)
    end, outward = exact(*start_of_it)
    if medium == "water":
        assert len(outward) == 1, "a face turned between outward and inward: the scene is not smooth"
    return start_of_it[1:], end
