"""Symplectic Euler: velocity first, then position with the new velocity. First order, explicit.

Newton and Warp call this method semi-implicit; here that word is Tu's (see `semi_implicit.py`).

Legend: x, v positions and velocities of one body; f forces; h step.
"""

import numpy as np

from fish_env import forces
from fish_env._jit import njit
from fish_env.forces import contact
from fish_env.integrators._common import count, rest_lengths, settle


@njit
def advance(body, world, state, control, h, n):
    """Move every sound body n steps of h seconds; state is changed in place."""
    nodes = body.mass.size
    f = np.empty((nodes, 3))
    rest = np.empty(body.springs.stiffness.size)
    before_x, before_v = np.empty((nodes, 3)), np.empty((nodes, 3))
    for b in range(state.t.size):
        if state.failure[b]:
            continue
        x, v = state.x[b], state.v[b]
        before_x[:] = x
        before_v[:] = v
        for s in range(n):
            rest_lengths(control, b, s * h, rest)
            forces.total(body, world, rest, x, v, f)
            for i in range(nodes):
                for k in range(3):
                    v[i, k] += h * body.inverse_mass[i, k] * f[i, k]  # (15)
                    x[i, k] += h * v[i, k]
            contact.bounce(world.planes, body.inverse_mass, world.gravity, h, x, v)
        count(state, b, n, 0, 0)
        settle(body, state, control, b, before_x, before_v, state.failure[b], n * h)
