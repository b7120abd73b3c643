"""ROS2: a Rosenbrock method of two stages, second order for any approximate Jacobian, L-stable (Verwer et al. 1999).

The Jacobian is the units', less its part that is not symmetric; the water is explicit. The two stages share one matrix.

Legend: x, v positions and velocities of one body; h step; a the system matrix in its skyline of 3 x 3 blocks, then L;
p, q the accelerations of the first and second stage; sx, sv the state at which the second stage is taken.
"""

import math

import numpy as np

from fish_env import forces
from fish_env._jit import njit
from fish_env.body import PIVOTS, UNTRUSTED_SOLVE
from fish_env.forces import contact
from fish_env.integrators._common import count, eliminate, rest_lengths, settle
from fish_env.linalg import ldlt

GAMMA = 1.0 - math.sqrt(0.5)  # the smaller of the two values that make the method L-stable, and the more accurate


@njit
def second_stage(body, world, rest, sx, sv, x, v, h, p, rate, load):
    """Right-hand side `load` (N,3) N of the second stage, and `rate` (N,3) m/s, what its positions would move at."""
    nodes, inner = body.mass.size, GAMMA * h
    for i in range(nodes):
        for k in range(3):
            rate[i, k] = v[i, k] + inner * p[i, k]  # of the first stage
            sx[i, k] = x[i, k] + h * rate[i, k]
            sv[i, k] = v[i, k] + h * p[i, k]
            rate[i, k] = sv[i, k] - 2.0 * rate[i, k]
    forces.total(body, world, rest, sx, sv, load)
    for i in range(nodes):
        for k in range(3):
            load[i, k] -= 2.0 * body.mass[i] * p[i, k]


@njit
def bear(planes, x, v, h, p, q):
    """Change the second stage q (N,3) so that the step's acceleration presses no node further behind a wall."""
    if planes is None:
        return
    change = 1.5 * p + 0.5 * q
    contact.bear(planes, x, v, h, change)
    q[:] = 2.0 * change - 3.0 * p


@njit
def step(body, world, control, b, elapsed, h, x, v, rest, late, a, p, q, sx, sv, rate, inverse_pivot, row):
    """One step of body b, `elapsed` s into the call, in place. Returns (non-positive pivots, trusted)."""
    inner = GAMMA * h
    rest_lengths(control, b, elapsed, rest)
    forces.total(body, world, rest, x, v, p)
    forces.add_stiffness_force(body, world, rest, x, v, v, inner, -math.inf, p)
    forces.system(body, world, rest, x, v, inner, -math.inf, False, a)
    eliminate(body, a, p)
    negative, trusted = ldlt.factor(body.profile, a, inverse_pivot, row)
    ldlt.solve(body.profile, a, inverse_pivot, p)  # (33)
    contact.bear(world.planes, x, v, h, p)
    rest_lengths(control, b, elapsed + h, late)
    second_stage(body, world, late, sx, sv, x, v, h, p, rate, q)
    forces.add_stiffness_force(body, world, rest, x, v, rate, inner, -math.inf, q)
    for m in range(body.held.shape[0]):
        q[body.held[m, 0], body.held[m, 1]] = 0.0
    ldlt.solve(body.profile, a, inverse_pivot, q)  # (34)
    bear(world.planes, x, v, h, p, q)
    for i in range(body.mass.size):
        for k in range(3):
            first, second = v[i, k] + inner * p[i, k], rate[i, k] + inner * q[i, k]
            x[i, k] += h * (1.5 * first + 0.5 * second)  # (32)
            v[i, k] += h * (1.5 * p[i, k] + 0.5 * q[i, k])
    return negative, trusted


@njit
def advance(body, world, state, control, h, n):
    """Move every sound body n steps of h seconds; state is changed in place."""
    nodes = body.mass.size
    a, p, q = np.empty((body.profile.start[nodes], 3, 3)), np.empty((nodes, 3)), np.empty((nodes, 3))
    sx, sv, rate = np.empty((nodes, 3)), np.empty((nodes, 3)), np.empty((nodes, 3))
    inverse_pivot, row = np.empty((nodes, 3)), np.empty((nodes, 3, 3))
    rest, late = np.empty(body.springs.stiffness.size), np.empty(body.springs.stiffness.size)
    before_x, before_v = np.empty((nodes, 3)), np.empty((nodes, 3))
    for b in range(state.t.size):
        if state.failure[b]:
            continue
        x, v = state.x[b], state.v[b]
        before_x[:] = x
        before_v[:] = v
        failure = taken = 0
        for s in range(n):
            negative, trusted = step(
                body, world, control, b, s * h, h, x, v, rest, late, a, p, q, sx, sv, rate, inverse_pivot, row
            )
            contact.bounce(world.planes, body.inverse_mass, world.gravity, h, x, v)
            taken += 1
            state.counters[b, PIVOTS] += negative
            if not trusted:
                failure = UNTRUSTED_SOLVE
                break
        count(state, b, 2 * taken, taken, 2 * taken)
        settle(body, state, control, b, before_x, before_v, failure, n * h)
