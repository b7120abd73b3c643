"""Walls: a plane throws a node that has come through it back, and takes up what presses on it (Song 2009, ch. 4.6).

An impact turns the node's normal velocity round and leaves a part of it, the plane's restitution: it can only take
energy away. Of a node that is behind the plane and does not come back, the part of the force that presses it further in
is taken off, which does no work either. So a node gets behind a plane by no more than what it moves in one step, and no
energy comes from it.

Legend: p plane; n its normal into the free side; depth how far a node is behind it, m.
"""

import numpy as np

from fish_env.kernels.compile import kernel
from fish_env.kernels.simd import Pack, dot, epsilon, fma, select, vec3
from fish_env.physics.forces.plan import H
from fish_env.physics.records import Body, World

JUMPS = True  # its force has no derivatives
LEAVING = 4096.0  # times the precision, of its speed, that a node's normal velocity is more than by rounding


def present(body: Body, world: World) -> bool:
    """Whether the world has walls."""
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
    """Take from the sum of all other forces what presses a node further behind a plane.

    Methods that spread a force over the nodes around, by a filter or a solve, call `constrain` besides.
    """
    planes, rounding = world.planes, LEAVING * epsilon(x)
    for p in range(planes.shape[0]):
        n = normal(planes, p)
        for i in range(x.size):
            depth, speed, press = planes[p, 3] - dot(n, x[i]), dot(n, v[i]), dot(n, f[i])
            leaves = (speed > 0.0) & (speed * speed > (rounding * rounding) * dot(v[i], v[i]))
            taken = select((depth >= 0.0) & (press < 0.0), select(leaves, 0.0, press), 0.0)
            f[i] = fma(-taken, n, f[i])  # (60)


@kernel
def constrain(body, world, control, x, v, a, cache):
    """Change the accelerations a so that none, in a step, sends a node further behind a plane it is behind."""
    planes, often = world.planes, 1.0 / control.plans[control.row[0], H]
    for p in range(planes.shape[0]):
        n = normal(planes, p)
        for i in range(x.size):
            depth, speed = planes[p, 3] - dot(n, x[i]), dot(n, v[i])
            lacking = fma(-often, select(speed > 0.0, speed, 0.0), -dot(n, a[i]))
            a[i] = fma(select((depth >= 0.0) & (lacking > 0.0), lacking, 0.0), n, a[i])


@kernel
def finish(body, world, control, x, v, f, cache):
    """Turn back the velocities of free nodes that are behind a plane and go on inward, at the end of a step.

    What a step of free fall would give a node anyway is no impact, nor is it one to be pressed further in by what lies
    on it: such a node comes to rest. Else it would bounce at every step, and sink all the while.
    """
    planes, gravity, h = world.planes, cache.gravity, control.plans[control.row[0], H]
    for p in range(planes.shape[0]):
        n, resting, part = normal(planes, p), 2.0 * h * gravity[p], planes[p, 4]
        for i in range(x.size):
            depth, speed, free = planes[p, 3] - dot(n, x[i]), dot(n, v[i]), body.inverse_mass[i]
            hit = (speed < -resting) & (depth < -2.0 * h * speed)  # deeper: it was behind the plane before the step
            change = -speed - select(hit, part * speed, 0.0)  # (61)
            change = select((depth >= 0.0) & (speed < 0.0), change, 0.0)
            axes = vec3(select(free.x > 0.0, 1.0, 0.0), select(free.y > 0.0, 1.0, 0.0), select(free.z > 0.0, 1.0, 0.0))
            v[i] = fma(change, axes * n, v[i])
