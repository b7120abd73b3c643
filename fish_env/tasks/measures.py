"""Effort of a motion: the largest strain of its springs, and the work its muscles do."""

from typing import NamedTuple

import numpy as np

from fish_env.kernels.compile import INDEX, kernel
from fish_env.kernels.simd import dot, sqrt
from fish_env.physics.forces.control import STIFFNESS
from fish_env.physics.tank import Tank


class Effort(NamedTuple):
    """Strain and work of B fish since their start, and data of the last environment step for the next."""

    strain: np.ndarray  # (B,) the largest |length / natural length - 1| of any spring after an environment step
    work: np.ndarray  # (B,) J, put in by shortening the muscles' rest lengths under tension
    tension: np.ndarray  # (B,K) N, of each fibre after the last environment step
    rest: np.ndarray  # (B,K) m, its rest length then


def make_effort(tank: Tank) -> Effort:
    """No strain and no work yet, of relaxed fish of a tank."""
    b, k = tank.num_fish, tank.fish.fibres.size
    return Effort(np.zeros(b), np.zeros(b), np.zeros((b, k)), np.tile(tank.fibre_length, (b, 1)))


@kernel
def measure_load(tank, load, b):
    """Take the state of fish b into account, once an environment step.

    A fibre whose rest length l0 moves under the elastic tension T takes in the work -T dl0, by the trapezoidal rule
    over the interval (docs/physics.md, eq. 41).
    """
    for e in range(tank.spring_length.size):
        load.strain[b] = max(load.strain[b], abs(distance(tank, b, e) / tank.spring_length[e] - 1.0))
    for m in range(tank.fibres.size):
        e = tank.fibres[m]
        now = tank.rest_length[b, INDEX(e)]
        pull = tank.variation[b, STIFFNESS] * tank.spring_stiffness[INDEX(e)] * (distance(tank, b, e) - now)
        load.work[b] -= 0.5 * (pull + load.tension[b, m]) * (now - load.rest[b, m])  # (41)
        load.tension[b, m], load.rest[b, m] = pull, now


@kernel
def distance(tank, b, e):
    """Length of spring e of fish b, m."""
    x, nodes = tank.position, tank.spring_nodes
    r = x[b, INDEX(nodes[e, 1])] - x[b, INDEX(nodes[e, 0])]
    return sqrt(dot(r, r))
