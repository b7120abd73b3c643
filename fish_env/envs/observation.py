"""What a fish sees (nodes in its own frame, muscles, the vertical, what is asked; one float32 row) and what it does."""

import math

import numpy as np

from fish_env._jit import INDEX, kernel
from fish_env.pose import FORWARD, LEFT, UP
from fish_env.simd import dot, vec3

POSITION_LIMIT, VELOCITY_LIMIT = 10.0, 1000.0  # body lengths, body lengths per second


def table(fish, task) -> list[tuple[str, str, float]]:
    """Name, unit and bound of every element of the observation, in order. The bound is symmetric about zero."""
    nodes, axes = range(fish.landmarks.node.size), ("forward", "left", "up")
    rows = [(f"position of node {i}, {axis}", "body lengths", POSITION_LIMIT) for i in nodes for axis in axes]
    rows += [(f"velocity of node {i}, {axis}", "body lengths/s", VELOCITY_LIMIT) for i in nodes for axis in axes]
    for spring, side, segment in zip(fish.muscles, fish.sides, fish.segments, strict=True):
        name = f"rest length of muscle {spring} ({'left' if side > 0 else 'right'}, segment {segment})"
        rows.append((name, "-1 natural, 1 contracted", 1.0))
    rows += [(f"vertical, {axis}", "in the body frame", 1.0) for axis in axes]
    rows += [(f"{d.name}, {axis}", d.unit, d.limit) for d in task.directions for axis in axes]
    return rows


@kernel
def observe(tank, pose, vectors, limits, b, out):
    """Fill row b of out (B,D) float32 in the order of `table`.

    vectors (B,K) are the task's, in the world, and limits (K,) their bounds. What lies beyond the bounds of the
    observation space is set to the bound.
    """
    axes, centre, scale = pose.axes, pose.centre[b], 1.0 / tank.length
    forward, left, up = axes[b, FORWARD], axes[b, LEFT], axes[b, UP]
    nodes, muscles = tank.node.size, tank.muscles.size
    for i in range(nodes):
        n = INDEX(tank.node[i])
        r = tank.position[b, n] + vec3(0.0, 0.0, tank.height[i]) - centre
        write(forward, left, up, scale * r, POSITION_LIMIT, b, 3 * i, out)
        write(forward, left, up, scale * tank.velocity[b, n], VELOCITY_LIMIT, b, 3 * (nodes + i), out)
    base = 6 * nodes
    for m in range(muscles):
        contraction = (tank.natural[m] - tank.rest_length[b, INDEX(tank.muscles[m])]) / tank.span[m]
        out[b, INDEX(base + m)] = bounded(2.0 * contraction - 1.0, 1.0)
    base += muscles
    write(forward, left, up, vec3(0.0, 0.0, 1.0), 1.0, b, base, out)
    for q in range(limits.size):
        write(forward, left, up, vectors[b, q], limits[q], b, base + 3 + 3 * q, out)


@kernel
def write(forward, left, up, vector, limit, b, place, out):
    """Put a vector into out[b, place:place + 3], by its parts along the axes, no further from zero than limit."""
    out[b, INDEX(place)] = bounded(dot(forward, vector), limit)
    out[b, INDEX(place + 1)] = bounded(dot(left, vector), limit)
    out[b, INDEX(place + 2)] = bounded(dot(up, vector), limit)


@kernel
def contract(action, groups, b, out):
    """Contractions (B,M) in [0, 1] of fish b for actions (B,A) clipped to [-1, 1]; False, and void, if not finite."""
    for m in range(groups.size):
        wanted = action[b, INDEX(groups[m])]
        if not math.isfinite(wanted):
            return False
        out[b, m] = 0.5 * (bounded(wanted, 1.0) + 1.0)
    return True


@kernel
def bounded(value, limit):
    """value, no further from zero than limit."""
    return min(max(value, -limit), limit)


def bounds(fish, task) -> np.ndarray:
    """The symmetric bound of every element, (D,) float32."""
    return np.array([bound for _, _, bound in table(fish, task)], dtype=np.float32)
