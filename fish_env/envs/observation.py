"""Kernels that fill in what a fish sees, as `layout.py` lays it out."""

from fish_env.envs.layout import DIRECTIONS, POSITION, REST_LENGTH, VELOCITY, VERTICAL
from fish_env.kernels.compile import INDEX, kernel
from fish_env.kernels.simd import dot, vec3
from fish_env.physics.pose import FORWARD, LEFT, UP


@kernel
def observe(tank, pose, vectors, starts, limits, b, out):
    """Fill row b of out (B,D) float32.

    vectors (B,K) are the task's, in the world; starts (P,) say where each part of the `Layout` begins, limits (P,) its
    bound. What lies beyond the bounds of the observation space is set to the bound.
    """
    axes, centre, scale = pose.axes, pose.centre[b], 1.0 / tank.length
    forward, left, up = axes[b, FORWARD], axes[b, LEFT], axes[b, UP]
    for i in range(tank.node.size):
        n = INDEX(tank.node[i])
        r = tank.position[b, n] + vec3(0.0, 0.0, tank.height[i]) - centre
        write(forward, left, up, scale * r, limits[POSITION], b, starts[POSITION] + 3 * i, out)
        write(forward, left, up, scale * tank.velocity[b, n], limits[VELOCITY], b, starts[VELOCITY] + 3 * i, out)
    for m in range(tank.muscles.size):
        contraction = (tank.natural[m] - tank.rest_length[b, INDEX(tank.muscles[m])]) / tank.span[m]
        out[b, INDEX(starts[REST_LENGTH] + m)] = clip(2.0 * contraction - 1.0, limits[REST_LENGTH])
    write(forward, left, up, vec3(0.0, 0.0, 1.0), limits[VERTICAL], b, starts[VERTICAL], out)
    for p in range(DIRECTIONS, starts.size):
        write(forward, left, up, vectors[b, p - DIRECTIONS], limits[p], b, starts[p], out)


@kernel
def write(forward, left, up, vector, limit, b, place, out):
    """Put a vector into out[b, place:place + 3], by its parts along the axes, no further from zero than limit."""
    out[b, INDEX(place)] = clip(dot(forward, vector), limit)
    out[b, INDEX(place + 1)] = clip(dot(left, vector), limit)
    out[b, INDEX(place + 2)] = clip(dot(up, vector), limit)


@kernel
def clip(value, limit):
    """value, no further from zero than limit."""
    return min(max(value, -limit), limit)
