"""Pieces of rewards that more than one task is made of."""

import math

import numpy as np

from fish_env._jit import njit

EFFORT_WEIGHT = 0.1  # body lengths a second, the price of moving every muscle at its fastest all the time


@njit
def progress(centre, before, heading, length):
    """Distance covered along `heading` (B,3) from `before` to `centre` (B,3) m, (B,) body lengths."""
    out = np.empty(centre.shape[0])
    for b in range(out.size):
        along = 0.0
        for k in range(3):
            along += (centre[b, k] - before[b, k]) * heading[b, k]
        out[b] = along / length
    return out


@njit
def alignment(axes, heading):
    """How well the forward axis of axes (B,3,3) points along `heading` (B,3): 0 along it, -1 across, -2 away, (B,).

    Linear in the angle between them, so that the last degrees count as much as the first ones; never positive, so that
    staying out of trouble earns nothing.
    """
    out = np.empty(axes.shape[0])
    for b in range(out.size):
        cosine = axes[b, 0, 0] * heading[b, 0] + axes[b, 0, 1] * heading[b, 1] + axes[b, 0, 2] * heading[b, 2]
        out[b] = -2.0 / math.pi * math.acos(min(max(cosine, -1.0), 1.0))
    return out


def effort(tank, interval):
    """What moving the muscles in the last interval, s, costs, (B,) body lengths, never positive."""
    return tank.effort * (-EFFORT_WEIGHT * interval)


@njit
def wrapped(angle):
    """An angle, rad, brought to [-pi, pi)."""
    return (angle + math.pi) % (2.0 * math.pi) - math.pi
