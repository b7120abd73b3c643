"""What a fish sees (nodes in its own frame, muscles, the vertical, what is asked; one float32 row) and what it does."""

import math

import numpy as np

from fish_env._jit import njit

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


@njit
def observe(x, v, node, height, centres, frames, length, rest_length, muscles, natural, span, vectors, limits, out):
    """Fill out (B,D) float32 in the order of `table`.

    From x, v (B,N,3), the landmarks' nodes and heights (L,), the poses' centres (B,3) and axes (B,3,3), the rest
    lengths (B,E) with the muscles' numbers, natural length and span (M,), and the task's vectors (B,K,3) with their
    limits (K,). Values beyond the bounds of the observation space are set to the bound.
    """
    nodes = node.size
    scale = 1.0 / length
    for b in range(x.shape[0]):
        axes, centre = frames[b], centres[b]
        for i in range(nodes):
            n = node[i]
            dx, dy, dz = x[b, n, 0] - centre[0], x[b, n, 1] - centre[1], x[b, n, 2] + height[i] - centre[2]
            vx, vy, vz = v[b, n, 0], v[b, n, 1], v[b, n, 2]
            for k in range(3):
                position = scale * (axes[k, 0] * dx + axes[k, 1] * dy + axes[k, 2] * dz)
                velocity = scale * (axes[k, 0] * vx + axes[k, 1] * vy + axes[k, 2] * vz)
                out[b, 3 * i + k] = bounded(position, POSITION_LIMIT)
                out[b, 3 * (nodes + i) + k] = bounded(velocity, VELOCITY_LIMIT)
        base = 6 * nodes
        for m in range(muscles.size):
            contraction = (natural[m] - rest_length[b, muscles[m]]) / span[m]
            out[b, base + m] = bounded(2.0 * contraction - 1.0, 1.0)
        base += muscles.size
        for k in range(3):
            out[b, base + k] = axes[k, 2]
        base += 3
        for q in range(vectors.shape[1]):
            for k in range(3):
                value = axes[k, 0] * vectors[b, q, 0] + axes[k, 1] * vectors[b, q, 1] + axes[k, 2] * vectors[b, q, 2]
                out[b, base + 3 * q + k] = bounded(value, limits[q])


@njit
def contractions(action, groups, out):
    """Contractions (B,M) in [0, 1] for actions (B,A) clipped to [-1, 1]; False (and void) if one is not finite."""
    for b in range(action.shape[0]):
        for m in range(groups.size):
            command = action[b, groups[m]]
            if not math.isfinite(command):
                return False
            out[b, m] = 0.5 * (bounded(command, 1.0) + 1.0)
    return True


@njit
def bounded(value, limit):
    """value, no further from zero than limit."""
    return min(max(value, -limit), limit)


def bounds(fish, task) -> np.ndarray:
    """The symmetric bound of every element, (D,) float32."""
    return np.array([bound for _, _, bound in table(fish, task)], dtype=np.float32)
