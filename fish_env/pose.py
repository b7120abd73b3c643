"""Where each fish is and which way it points: centre of mass, its velocity, and the body's axes.

Legend: b fish; i node; k axis; forward, left, up are the rows of the axes.
"""

import math
from typing import NamedTuple

import numpy as np

from fish_env._jit import njit


class Pose(NamedTuple):
    """Pose of B fish."""

    centre: np.ndarray  # (B,3) centre of mass, m
    velocity: np.ndarray  # (B,3) of the centre of mass, m/s
    axes: np.ndarray  # (B,3,3) rows: unit vectors forward, left and up


def make_pose(num_fish: int) -> Pose:
    """An empty pose of `num_fish` fish, for `measure` to fill."""
    return Pose(np.empty((num_fish, 3)), np.empty((num_fish, 3)), np.empty((num_fish, 3, 3)))


@njit
def measure(mass, line, left, right, x, v, centre, velocity, axes):
    """Fill the three arrays of a `Pose` from positions and velocities x, v (B,N,3).

    Forward is the sum of the positions times the weights `line` (N,), `Fish.line`; left is the mean of the differences
    from `right` to `left`, made orthogonal to it; up is their cross product (docs/physics.md, eq. 18).
    """
    total = 0.0
    for i in range(mass.size):
        total += mass[i]
    for b in range(x.shape[0]):
        for k in range(3):
            middle, drift, ahead, aside = 0.0, 0.0, 0.0, 0.0
            for i in range(mass.size):
                middle += mass[i] * x[b, i, k]
                drift += mass[i] * v[b, i, k]
                ahead += line[i] * x[b, i, k]
            for i in range(left.size):
                aside += x[b, left[i], k] - x[b, right[i], k]
            centre[b, k] = middle / total
            velocity[b, k] = drift / total
            axes[b, 0, k] = ahead
            axes[b, 1, k] = aside
        f, s, u = axes[b, 0], axes[b, 1], axes[b, 2]
        normalise(f)
        along = s[0] * f[0] + s[1] * f[1] + s[2] * f[2]
        for k in range(3):
            s[k] -= along * f[k]
        normalise(s)
        u[0] = f[1] * s[2] - f[2] * s[1]
        u[1] = f[2] * s[0] - f[0] * s[2]
        u[2] = f[0] * s[1] - f[1] * s[0]


@njit
def normalise(a):
    """Scale a (3,) to unit length in place; a null vector stays null."""
    length = math.sqrt(a[0] * a[0] + a[1] * a[1] + a[2] * a[2])
    if length > 0.0:
        for k in range(3):
            a[k] /= length
