"""What every method counts: evaluations of the forces, factorisations, solves and non-positive pivots."""

import naive
import numpy as np
import pytest
from moving import (
    FISH,
    FIXED_STEP,
    MATRIX,
    SEMI_IMPLICIT,
    SOLVING,
    STABILISED,
    each_body,
    each_method,
    tank_of,
    tiered,
    world_of,
)

from fish_env import INTEGRATORS, Tank
from fish_env.physics.failures import TORN
from fish_env.physics.integrators import rosenbrock
from fish_env.physics.records import COUNTERS, PIVOTS
from fish_env.physics.tank_options import own_step
from fish_env.physics.world import VACUUM

STILL = np.zeros((23, 3))


@pytest.mark.parametrize("name", tiered(SOLVING))
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
            h = inner / rosenbrock.GAMMA
        if name in SEMI_IMPLICIT:
            matrix, _ = naive.tu_system(fish.body, VACUUM, rest, h, x, STILL)
        else:
            stiffness, damping = naive.implicit_matrices(fish.body, VACUUM, rest, x, STILL, **MATRIX[name])
            matrix = np.diag(np.repeat(fish.body.mass, 3)) + inner * damping + inner**2 * stiffness
        wanted = np.count_nonzero(np.linalg.eigvalsh(matrix) < 0)
        tank = tank_of(name, fish, VACUUM, x, STILL, h)
        tank.state.counters[0, PIVOTS] = 5
        tank.advance(1)
        assert tank.state.counters[0, PIVOTS] - 5 == wanted
        assert (wanted > 0) == (name != "linearly_implicit_projected")


@each_method
def test_a_swimming_fish_meets_no_bad_pivot(name):
    """At its own step a swimming fish meets no non-positive pivot, and explicit methods have none to count."""
    fish = FISH["mass_spring"]
    dt = own_step(fish, INTEGRATORS[name])
    tank = Tank(fish, 2, name, dt, water=world_of(fish, (0, 0, 0)))
    for action in np.random.default_rng(11).uniform(-1, 1, (20 if name in FIXED_STEP else 4, 2, 12)):
        tank.swim(action, fish.control_interval)
    assert tank.alive.all() and not tank.counters["non_positive_pivots"].any()


@pytest.mark.parametrize("name", tiered(FIXED_STEP, ("leapfrog_chebyshev", "rosenbrock")))
def test_counters(name):
    """Every fish's counters grow by the record's numbers a step, call after call; a failed fish's stand still."""
    fish, record = FISH["mass_spring"], INTEGRATORS[name]
    tank = Tank(fish, 3, name, dt=0.1 * fish.time_step)
    tank.state.failure[1] = TORN
    evaluations = record.forces
    if name in STABILISED:
        evaluations = record.method.costs(
            record.method.plan(fish.body.max_stiffness_eigenvalue, fish.body.max_damping_eigenvalue, tank.dt)
        )[0]
    each = {"force_evaluations": evaluations, "factorisations": record.factorisations, "solves": record.solves}
    for calls in (1, 2):
        tank.advance(7)
        for part, number in each.items():
            assert tank.counters[part].tolist() == [7 * calls * number, 0, 7 * calls * number]
    assert list(tank.counters) == list(COUNTERS)
