"""Pose of each fish: centre of mass, its velocity, and the body's axes.

Legend: b fish; i node; forward, left, up are the rows of the axes.
"""

from typing import NamedTuple

import numpy as np

from fish_env.kernels.compile import INDEX, kernel
from fish_env.kernels.simd import Kind, Pack, Vectors, cross, dot, fma, sqrt, vec3

FORWARD, LEFT, UP = 0, 1, 2  # rows of the axes


class Pose(NamedTuple):
    """Pose of B fish."""

    centre: np.ndarray  # (B,3) centre of mass, m
    velocity: np.ndarray  # (B,3) of the centre of mass, m/s
    axes: np.ndarray  # (B,3,3) rows: unit vectors forward, left and up


def make_pose(num_fish: int) -> Pose:
    """Pose of `num_fish` fish, zero, for `measure` to fill."""
    return Pose(np.zeros((num_fish, 3)), np.zeros((num_fish, 3)), np.zeros((num_fish, 3, 3)))


def packed_pose(pose: Pose) -> Pack:
    """Arrays of a pose as vectors, as kernels read them."""
    return Pack("pose", **{name: Vectors(array, Kind(1)) for name, array in pose._asdict().items()})


@kernel
def measure(tank, pose, b):
    """Fill the pose of fish b from the positions and velocities of its nodes."""
    # Forward is the sum of the positions times the weights `Fish.line`; left is the mean of the differences from
    # `right` to `left`, made orthogonal to it; up is their cross product (docs/physics-more.md, eq. 45).
    x, v = tank.position, tank.velocity
    middle = drift = ahead = aside = vec3(0.0, 0.0, 0.0)
    total = 0.0
    for i in range(tank.mass.size):
        weight = tank.mass[i]
        total += weight
        middle = fma(weight, x[b, i], middle)
        drift = fma(weight, v[b, i], drift)
        ahead = fma(tank.line[i], x[b, i], ahead)
    for i in range(tank.left.size):
        aside += x[b, INDEX(tank.left[i])] - x[b, INDEX(tank.right[i])]
    pose.centre[b] = middle / total
    pose.velocity[b] = drift / total
    forward = unit(ahead)
    left = unit(aside - dot(aside, forward) * forward)
    pose.axes[b, FORWARD] = forward
    pose.axes[b, LEFT] = left
    pose.axes[b, UP] = cross(forward, left)


@kernel
def unit(a):
    """Scale a vector to unit length; a null vector stays null."""
    length = sqrt(dot(a, a))
    return a / (length if length > 0.0 else 1.0)
