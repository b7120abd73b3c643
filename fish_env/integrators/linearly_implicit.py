"""Linearly implicit Euler: the units' whole stiffness and damping implicit, one Newton step (Baraff & Witkin 1998).

The rest lengths are those of the step's end, as an implicit method of first order wants them. The water is explicit,
but for its damping in `advance_water`.

Legend: x, v positions and velocities of one body; h step; a the system matrix in its skyline of 3 x 3 blocks, then L;
g the load, then the acceleration; lowest the least effective stiffness a unit enters the matrix with.
"""

import math

import numpy as np

from fish_env import forces
from fish_env._jit import njit
from fish_env.body import PIVOTS, UNTRUSTED_SOLVE
from fish_env.forces import contact
from fish_env.integrators._common import count, eliminate, rest_lengths, settle
from fish_env.linalg import ldlt


def method(lowest, wet):
    """The compiled `advance` of one method; `lowest` and `wet` as in `forces.system`.

    They are constants of the kernel, and all of a step stands in it: numba compiles every kernel that another one calls
    once for itself and once more as part of the other.
    """

    @njit
    def advance(body, world, state, control, h, n):
        """Move every sound body n steps of h seconds; state is changed in place."""
        nodes = body.mass.size
        a, g = np.empty((body.profile.start[nodes], 3, 3)), np.empty((nodes, 3))
        inverse_pivot, row = np.empty((nodes, 3)), np.empty((nodes, 3, 3))
        rest = np.empty(body.springs.stiffness.size)
        before_x, before_v = np.empty((nodes, 3)), np.empty((nodes, 3))
        for b in range(state.t.size):
            if state.failure[b]:
                continue
            x, v = state.x[b], state.v[b]
            before_x[:] = x
            before_v[:] = v
            failure = taken = 0
            for s in range(n):
                rest_lengths(control, b, (s + 1) * h, rest)
                forces.total(body, world, rest, x, v, g)
                forces.add_stiffness_force(body, world, rest, x, v, v, h, lowest, g)
                forces.system(body, world, rest, x, v, h, lowest, wet, a)  # (30)
                eliminate(body, a, g)
                negative, trusted = ldlt.factor(body.profile, a, inverse_pivot, row)
                ldlt.solve(body.profile, a, inverse_pivot, g)  # (31)
                contact.bear(world.planes, x, v, h, g)
                for i in range(nodes):
                    for k in range(3):
                        v[i, k] += h * g[i, k]
                        x[i, k] += h * v[i, k]
                contact.bounce(world.planes, body.inverse_mass, world.gravity, h, x, v)
                taken += 1
                state.counters[b, PIVOTS] += negative
                if not trusted:
                    failure = UNTRUSTED_SOLVE
                    break
            count(state, b, taken, taken, taken)
            settle(body, state, control, b, before_x, before_v, failure, n * h)

    return advance


advance = method(-math.inf, False)
advance_projected = method(0.0, False)
"""A compressed unit enters the matrix without its negative stiffness across: none is indefinite."""
advance_water = method(-math.inf, True)
"""The water's damping along the normals is in the matrix."""
