"""The classical Runge-Kutta method: four force evaluations a step, fourth order, explicit (Song 2009, ch. 5).

Legend: x, v positions and velocities of one body; f forces; h step; sx, sv the stage; kx, kv the weighted sums.
"""

import numpy as np

from fish_env import forces
from fish_env._jit import njit
from fish_env.forces import contact
from fish_env.integrators._common import count, rest_lengths, settle

TIME = (0.0, 0.5, 0.5, 1.0)  # when each stage is taken, in steps
WEIGHT = (1 / 6, 1 / 3, 1 / 3, 1 / 6)


@njit
def step(body, world, control, b, elapsed, h, x, v, rest, f, sx, sv, kx, kv):
    """One step of body b, `elapsed` seconds into the call; x and v are changed in place, the rest is scratch."""
    nodes = body.mass.size
    sx[:] = x
    sv[:] = v
    kx[:] = 0.0
    kv[:] = 0.0
    for stage in range(4):
        rest_lengths(control, b, elapsed + TIME[stage] * h, rest)
        forces.total(body, world, rest, sx, sv, f)
        ahead = h * TIME[min(stage + 1, 3)]
        for i in range(nodes):
            for k in range(3):
                velocity, acceleration = sv[i, k], body.inverse_mass[i, k] * f[i, k]
                kx[i, k] += WEIGHT[stage] * velocity
                kv[i, k] += WEIGHT[stage] * acceleration
                sx[i, k] = x[i, k] + ahead * velocity
                sv[i, k] = v[i, k] + ahead * acceleration
    for i in range(nodes):
        for k in range(3):
            x[i, k] += h * kx[i, k]  # (16)
            v[i, k] += h * kv[i, k]


@njit
def advance(body, world, state, control, h, n):
    """Move every sound body n steps of h seconds; state is changed in place."""
    nodes = body.mass.size
    rest = np.empty(body.springs.stiffness.size)
    f, sx, sv = np.empty((nodes, 3)), np.empty((nodes, 3)), np.empty((nodes, 3))
    kx, kv = np.empty((nodes, 3)), np.empty((nodes, 3))
    before_x, before_v = np.empty((nodes, 3)), np.empty((nodes, 3))
    for b in range(state.t.size):
        if state.failure[b]:
            continue
        x, v = state.x[b], state.v[b]
        before_x[:] = x
        before_v[:] = v
        for s in range(n):
            step(body, world, control, b, s * h, h, x, v, rest, f, sx, sv, kx, kv)
            contact.bounce(world.planes, body.inverse_mass, world.gravity, h, x, v)
        count(state, b, 4 * n, 0, 0)
        settle(body, state, control, b, before_x, before_v, state.failure[b], n * h)
