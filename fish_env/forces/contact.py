"""Walls: a plane throws a node that has come through it back, and bears what presses on it (Song 2009, ch. 4.6).

An impact turns the node's normal velocity round and leaves a part of it, the plane's restitution: it can only take
energy away. A node behind the plane that does not come back by itself is borne: the part of the force on it that
presses further in is taken off, which does no work either. So a node gets behind a plane by no more than what it moves
in one step, and no energy comes from it.

Legend: p plane; n its normal into the free side; d how far a node is in front of it, m.
"""

import numpy as np

from fish_env._jit import njit, njit_inline


@njit
def add_reaction(planes, x, v, f):
    """Take from the sum of all other forces f (N,3) N what presses a node further behind a plane; call it last."""
    if planes is None:
        return
    for p in range(planes.shape[0]):
        n0, n1, n2, offset = planes[p, 0], planes[p, 1], planes[p, 2], planes[p, 3]
        for i in range(x.shape[0]):
            if n0 * x[i, 0] + n1 * x[i, 1] + n2 * x[i, 2] - offset > 0.0:
                continue
            if n0 * v[i, 0] + n1 * v[i, 1] + n2 * v[i, 2] > 0.0:
                continue
            press = n0 * f[i, 0] + n1 * f[i, 1] + n2 * f[i, 2]
            if press < 0.0:
                f[i, 0] -= press * n0  # (59)
                f[i, 1] -= press * n1
                f[i, 2] -= press * n2


@njit
def scratch(planes, nodes):
    """What `bear` fills, (P,N); None without planes."""
    if planes is None:
        return None
    return np.empty((planes.shape[0], nodes), np.bool_)


@njit_inline
def bear(planes, x, v, a, borne):
    """Note in borne (P,N) which nodes `add_reaction` has kept from pressing on, a (N,3) being what all forces give."""
    if planes is None:
        return
    for p in range(planes.shape[0]):
        n0, n1, n2, offset = planes[p, 0], planes[p, 1], planes[p, 2], planes[p, 3]
        for i in range(x.shape[0]):
            behind = n0 * x[i, 0] + n1 * x[i, 1] + n2 * x[i, 2] - offset <= 0.0
            resting = n0 * v[i, 0] + n1 * v[i, 1] + n2 * v[i, 2] <= 0.0
            size = abs(a[i, 0]) + abs(a[i, 1]) + abs(a[i, 2])
            borne[p, i] = behind and resting and n0 * a[i, 0] + n1 * a[i, 1] + n2 * a[i, 2] <= 1e-12 * size


@njit_inline
def hold(planes, borne, a):
    """Take from a (N,3) what moves a borne node along its plane's normal: the filter hands on its neighbours' pull."""
    if planes is None:
        return
    for p in range(planes.shape[0]):
        n0, n1, n2 = planes[p, 0], planes[p, 1], planes[p, 2]
        for i in range(a.shape[0]):
            if borne[p, i]:
                part = n0 * a[i, 0] + n1 * a[i, 1] + n2 * a[i, 2]
                a[i, 0] -= part * n0
                a[i, 1] -= part * n1
                a[i, 2] -= part * n2


@njit
def along(gravity, n0, n1, n2):
    """Part of gravity along a normal, m/s2."""
    if gravity is None:
        return 0.0
    return n0 * gravity[0] + n1 * gravity[1] + n2 * gravity[2]


@njit
def bounce(planes, inverse_mass, gravity, h, x, v):
    """Turn back the velocities v (N,3) of free nodes that are behind a plane and go on inward; after a step of h s.

    No impact is what a step of free fall would give a node anyway, nor what presses back one that was behind the plane
    before the step: it comes to rest there. Thrown back again and again it would creep further in with every step.
    """
    if planes is None:
        return
    for p in range(planes.shape[0]):
        n0, n1, n2, offset = planes[p, 0], planes[p, 1], planes[p, 2], planes[p, 3]
        resting = 2.0 * h * abs(along(gravity, n0, n1, n2))
        for i in range(x.shape[0]):
            depth = offset - n0 * x[i, 0] - n1 * x[i, 1] - n2 * x[i, 2]
            if depth < 0.0:
                continue
            speed = n0 * v[i, 0] + n1 * v[i, 1] + n2 * v[i, 2]
            if speed < 0.0:
                part = planes[p, 4] if -speed > resting and -speed * h > depth else 0.0
                change = -(1.0 + part) * speed  # (60)
                if inverse_mass[i, 0] > 0.0:
                    v[i, 0] += change * n0
                if inverse_mass[i, 1] > 0.0:
                    v[i, 1] += change * n1
                if inverse_mass[i, 2] > 0.0:
                    v[i, 2] += change * n2
