"""Pieces of rewards that more than one task is made of; kernels, of one fish b."""

import math

from fish_env.kernels.compile import INDEX, kernel
from fish_env.kernels.simd import dot
from fish_env.physics.pose import FORWARD, LEFT
from fish_env.tasks.options import weight

EFFORT_WEIGHT = weight(0.1, "weight of moving every muscle at its fastest all the time, body lengths/s")
SWAY_WEIGHT = weight(0.5, "weight of the speed of the nose to the side, over that speed")


@kernel
def progress(tank, pose, before, heading, b):
    """Distance covered along `heading` (B,) from `before` (B,), body lengths."""
    return dot(pose.centre[b] - before[b], heading[b]) / tank.length


@kernel
def alignment(pose, heading, b):
    """Alignment of the forward axis with a unit vector: 0 along it, -1 across, -2 away."""
    # It is linear in the angle, so that the last degrees count as much as the first ones. It is never positive, so that
    # an episode does not earn more by lasting longer.
    cosine = dot(pose.axes[b, FORWARD], heading)
    return -2.0 / math.pi * math.acos(min(max(cosine, -1.0), 1.0))


@kernel
def effort(tank, weight, interval, b):
    """Cost of moving the muscles in the last interval, s, as a reward: body lengths, never positive."""
    return tank.effort[b] * (-weight * interval)


@kernel
def sway(tank, pose, weight, interval, b):
    """Cost of the nose's present speed to the side, as a reward: body lengths, never positive."""
    # Without it, fish learn to sway the head nearly as far as the tail: swimming fish sway it a tenth to a seventh.
    aside = dot(tank.velocity[b, INDEX(tank.nose)] - pose.velocity[b], pose.axes[b, LEFT])
    return abs(aside) / tank.length * (-weight * interval)


@kernel
def wrap_angle(angle):
    """Bring an angle, rad, to [-pi, pi)."""
    return (angle + math.pi) % (2.0 * math.pi) - math.pi
