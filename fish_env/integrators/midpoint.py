"""The midpoint method: half an explicit Euler step, then a step with what is found there (Song 2009, ch. 5).

Second order, explicit.

Legend: x, v positions and velocities of one body; f forces; h step; mx, mv the state at the half step.
"""

import numpy as np

from fish_env import forces
from fish_env._jit import njit
from fish_env.forces import contact
from fish_env.integrators._common import count, rest_lengths, settle


@njit
def step(body, world, control, b, elapsed, h, x, v, rest, f, mx, mv):
    """One step of body b, `elapsed` seconds into the call; x and v are changed in place, the rest is scratch."""
    nodes = body.mass.size
    rest_lengths(control, b, elapsed, rest)
    forces.total(body, world, rest, x, v, f)
    for i in range(nodes):
        for k in range(3):
            mx[i, k] = x[i, k] + 0.5 * h * v[i, k]
            mv[i, k] = v[i, k] + 0.5 * h * body.inverse_mass[i, k] * f[i, k]
    rest_lengths(control, b, elapsed + 0.5 * h, rest)
    forces.total(body, world, rest, mx, mv, f)
    for i in range(nodes):
        for k in range(3):
            x[i, k] += h * mv[i, k]  # (29)
            v[i, k] += h * body.inverse_mass[i, k] * f[i, k]


@njit
def advance(body, world, state, control, h, n):
    """Move every sound body n steps of h seconds; state is changed in place."""
    nodes = body.mass.size
    rest = np.empty(body.springs.stiffness.size)
    f, mx, mv = np.empty((nodes, 3)), np.empty((nodes, 3)), np.empty((nodes, 3))
    before_x, before_v = np.empty((nodes, 3)), np.empty((nodes, 3))
    for b in range(state.t.size):
        if state.failure[b]:
            continue
        x, v = state.x[b], state.v[b]
        before_x[:] = x
        before_v[:] = v
        for s in range(n):
            step(body, world, control, b, s * h, h, x, v, rest, f, mx, mv)
            contact.bounce(world.planes, body.inverse_mass, world.gravity, h, x, v)
        count(state, b, 2 * n, 0, 0)
        settle(body, state, control, b, before_x, before_v, state.failure[b], n * h)
