"""Walls: a plane throws a node that has come through it back, and bears what presses on it (Song 2009, ch. 4.6).

An impact turns the node's normal velocity round and leaves a part of it, the plane's restitution: it can only take
energy away. A node behind the plane that does not come back by itself is borne: the part of the force on it that
presses further in is taken off, which does no work either. So a node gets behind a plane by no more than what it moves
in one step, and no energy comes from it.

Legend: p plane; n its normal into the free side; d how far a node is in front of it, m.
"""

from fish_env._jit import njit

LEAVING = 1e-12  # of its speed, that a node's normal velocity is more than by rounding


@njit
def add_reaction(planes, x, v, f):
    """Take from the sum of all other forces f (N,3) N what presses a node further behind a plane; call it last.

    Methods that spread a force over the nodes around, by a filter or a solve, call `bear` besides.
    """
    if planes is None:
        return
    for p in range(planes.shape[0]):
        n0, n1, n2, offset = planes[p, 0], planes[p, 1], planes[p, 2], planes[p, 3]
        for i in range(x.shape[0]):
            if n0 * x[i, 0] + n1 * x[i, 1] + n2 * x[i, 2] - offset > 0.0:
                continue
            speed = n0 * v[i, 0] + n1 * v[i, 1] + n2 * v[i, 2]
            square = v[i, 0] * v[i, 0] + v[i, 1] * v[i, 1] + v[i, 2] * v[i, 2]
            if speed > 0.0 and speed * speed > LEAVING * LEAVING * square:
                continue
            press = n0 * f[i, 0] + n1 * f[i, 1] + n2 * f[i, 2]
            if press < 0.0:
                f[i, 0] -= press * n0  # (60)
                f[i, 1] -= press * n1
                f[i, 2] -= press * n2


@njit
def bear(planes, x, v, h, a):
    """Change the accelerations a (N,3) m/s2 so that none, in h s, sends a node further behind a plane it is behind."""
    if planes is None:
        return
    for p in range(planes.shape[0]):
        n0, n1, n2, offset = planes[p, 0], planes[p, 1], planes[p, 2], planes[p, 3]
        for i in range(x.shape[0]):
            if n0 * x[i, 0] + n1 * x[i, 1] + n2 * x[i, 2] - offset > 0.0:
                continue
            speed = n0 * v[i, 0] + n1 * v[i, 1] + n2 * v[i, 2]
            lacking = -max(speed, 0.0) / h - (n0 * a[i, 0] + n1 * a[i, 1] + n2 * a[i, 2])
            if lacking > 0.0:
                a[i, 0] += lacking * n0
                a[i, 1] += lacking * n1
                a[i, 2] += lacking * n2


@njit
def along(gravity, n0, n1, n2):
    """Part of gravity along a normal, m/s2."""
    if gravity is None:
        return 0.0
    return n0 * gravity[0] + n1 * gravity[1] + n2 * gravity[2]


@njit
def bounce(planes, inverse_mass, gravity, h, x, v):
    """Turn back the velocities v (N,3) of free nodes that are behind a plane and go on inward; after a step of h s.

    What a step of free fall would give a node anyway is no impact, nor is it one to be pressed further in by what lies
    on it: such a node comes to rest. Else it would bounce at every step, and sink all the while.
    """
    if planes is None:
        return
    for p in range(planes.shape[0]):
        n0, n1, n2, offset = planes[p, 0], planes[p, 1], planes[p, 2], planes[p, 3]
        resting = 2.0 * h * abs(along(gravity, n0, n1, n2))
        for i in range(x.shape[0]):
            ahead = n0 * x[i, 0] + n1 * x[i, 1] + n2 * x[i, 2] - offset
            if ahead > 0.0:
                continue
            speed = n0 * v[i, 0] + n1 * v[i, 1] + n2 * v[i, 2]
            if speed < 0.0:
                hit = -speed > resting and ahead > 2.0 * h * speed  # deeper: it was behind the plane before the step
                part = planes[p, 4] if hit else 0.0
                change = -(1.0 + part) * speed  # (61)
                if inverse_mass[i, 0] > 0.0:
                    v[i, 0] += change * n0
                if inverse_mass[i, 1] > 0.0:
                    v[i, 1] += change * n1
                if inverse_mass[i, 2] > 0.0:
                    v[i, 2] += change * n2
