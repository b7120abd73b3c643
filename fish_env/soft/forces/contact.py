"""Walls: a plane reflects a node that has passed through it, and supports a node at rest on it (Song 2009, ch. 4.6).

An impact reverses the node's normal velocity and multiplies it by the plane's restitution, so it only removes energy.
If a node behind the plane does not return, the inward part of the force on it is removed, which does no work. So a node
penetrates a plane by at most its displacement in one step, and walls never add energy.

Legend: p plane; n its normal into the free side; depth distance of a node behind it, m.
"""

import numpy as np

from fish_env.kernels.compile import kernel
from fish_env.kernels.simd import Pack, dot, epsilon, fma, select, vec3
from fish_env.physics.forces.plan import H
from fish_env.physics.records import Body, World

JUMPS = True  # its force has no derivatives
LEAVING = 4096.0  # times precision and speed: a larger normal velocity is not rounding


def present(body: Body, world: World) -> bool:
    """Return True if the world has walls."""
    return world.planes is not None


def make_cache(body: Body, world: World, kind) -> Pack:
    """Part of gravity along each plane's normal (P,), m/s2."""
    assert world.planes is not None  # else the force is not present
    pull = np.zeros(3) if world.gravity is None else world.gravity
    return Pack("contact", gravity=kind.scalars(np.abs(world.planes[:, :3] @ pull)))


@kernel
def normal(planes, p):
    """Unit normal of plane p."""
    return vec3(planes[p, 0], planes[p, 1], planes[p, 2])


@kernel
def add_force(body, world, control, x, v, f, cache):
    """Remove from the sum of all other forces the part that pushes a node further behind a plane."""
    # Methods that distribute a force over neighbouring nodes, by a filter or a solve, also call `constrain`.
    planes, rounding = world.planes, LEAVING * epsilon(x)
    for p in range(planes.shape[0]):
        n = normal(planes, p)
        for i in range(x.size):
            depth, speed, press = planes[p, 3] - dot(n, x[i]), dot(n, v[i]), dot(n, f[i])
            leaves = (speed > 0.0) & (speed * speed > (rounding * rounding) * dot(v[i], v[i]))
            taken = select((depth >= 0.0) & (press < 0.0), select(leaves, 0.0, press), 0.0)
            f[i] = fma(-taken, n, f[i])  # (85)


@kernel
def constrain(body, world, control, x, v, a, cache):
    """Constrain the accelerations a so that no node behind a plane moves further behind it in a step."""
    planes, often = world.planes, 1.0 / control.plans[control.row[0], H]
    for p in range(planes.shape[0]):
        n = normal(planes, p)
        for i in range(x.size):
            depth, speed = planes[p, 3] - dot(n, x[i]), dot(n, v[i])
            lacking = fma(-often, select(speed > 0.0, speed, 0.0), -dot(n, a[i]))
            a[i] = fma(select((depth >= 0.0) & (lacking > 0.0), lacking, 0.0), n, a[i])


@kernel
def finish(body, world, control, x, v, f, cache):
    """Reflect the velocities of free nodes that are behind a plane and move inward, at the end of a step."""
    # A velocity that a step of free fall would cause is no impact, nor is a push by nodes that lie on it: such a node
    # comes to rest. Otherwise it would bounce at every step and slowly sink.
    planes, gravity, h = world.planes, cache.gravity, control.plans[control.row[0], H]
    for p in range(planes.shape[0]):
        n, resting, part = normal(planes, p), 2.0 * h * gravity[p], planes[p, 4]
        for i in range(x.size):
            depth, speed, free = planes[p, 3] - dot(n, x[i]), dot(n, v[i]), body.inverse_mass[i]
            hit = (speed < -resting) & (depth < -2.0 * h * speed)  # deeper: it was behind the plane before the step
            change = -speed - select(hit, part * speed, 0.0)  # (86)
            change = select((depth >= 0.0) & (speed < 0.0), change, 0.0)
            axes = vec3(select(free.x > 0.0, 1.0, 0.0), select(free.y > 0.0, 1.0, 0.0), select(free.z > 0.0, 1.0, 0.0))
            v[i] = fma(change, axes * n, v[i])
