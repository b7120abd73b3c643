"""Barriers that keep the inner layer inside the outer one (Song 2009, ch. 4.6.2; the barrier of Li et al. 2020).

A guard acts once the tetrahedron (on a ring, the triangle) between an outer face and an inner node has less than NEAR
of its volume at rest: its energy rises without bound as that goes to nothing, with two continuous derivatives.

Legend: k guard; s volume over that at rest; p, q, r the outer face; i the inner node.
"""

import math

import numpy as np

from fish_env._jit import INDEX, njit

NEAR = 0.6  # of the volume at rest, below which a guard acts


@njit
def share(guards, x, k, slope):
    """Volume of guard k over that at rest; its gradient at p, q, r and i, 1/m, is written to slope (4,3)."""
    p, q, r, i = guards.nodes[k, 0], guards.nodes[k, 1], guards.nodes[k, 2], INDEX(guards.nodes[k, 3])
    a0, a1, a2 = x[p, 0] - x[i, 0], x[p, 1] - x[i, 1], x[p, 2] - x[i, 2]
    b0, b1, b2 = x[q, 0] - x[i, 0], x[q, 1] - x[i, 1], x[q, 2] - x[i, 2]
    scale = 0.5 / guards.volume[k]
    if r < 0:
        slope[0, 0], slope[0, 1], slope[0, 2] = scale * b1, -scale * b0, 0.0
        slope[1, 0], slope[1, 1], slope[1, 2] = -scale * a1, scale * a0, 0.0
        for m in range(3):
            slope[2, m] = 0.0
            slope[3, m] = -slope[0, m] - slope[1, m]
        return scale * (a0 * b1 - a1 * b0)
    c0, c1, c2 = x[r, 0] - x[i, 0], x[r, 1] - x[i, 1], x[r, 2] - x[i, 2]
    scale /= 3.0
    slope[0, 0], slope[0, 1], slope[0, 2] = b1 * c2 - b2 * c1, b2 * c0 - b0 * c2, b0 * c1 - b1 * c0
    slope[1, 0], slope[1, 1], slope[1, 2] = c1 * a2 - c2 * a1, c2 * a0 - c0 * a2, c0 * a1 - c1 * a0
    slope[2, 0], slope[2, 1], slope[2, 2] = a1 * b2 - a2 * b1, a2 * b0 - a0 * b2, a0 * b1 - a1 * b0
    volume = a0 * slope[0, 0] + a1 * slope[0, 1] + a2 * slope[0, 2]
    for m in range(3):
        for n in range(3):
            slope[m, n] *= scale
        slope[3, m] = 0.0
    for m in range(3):
        slope[3, m] = -slope[0, m] - slope[1, m] - slope[2, m]
    return scale * volume


@njit
def barrier(s):
    """Energy of a guard over its scale, its first and its second derivative with respect to s; NaN where s <= 0."""
    if s >= NEAR:
        return 0.0, 0.0, 0.0
    if not s > 0.0:
        return math.nan, math.nan, math.nan
    gap, log = s - NEAR, math.log(s / NEAR)
    return (
        -gap * gap * log,  # (56)
        -2.0 * gap * log - gap * gap / s,
        -2.0 * log - 4.0 * gap / s + gap * gap / (s * s),
    )


@njit
def add_force(guards, x, f):
    """Add the force of every guard to f (N,3) N."""
    if guards is None:
        return
    slope = np.empty((4, 3))
    for k in range(guards.energy.size):
        s = share(guards, x, k, slope)
        if s >= NEAR:
            continue
        push = -guards.energy[k] * barrier(s)[1]
        for a in range(4):
            node = guards.nodes[k, a]
            if node >= 0:
                for m in range(3):
                    f[node, m] += push * slope[a, m]


@njit
def add_jacobian(guards, x, stiffness):
    """Add -df/dx to stiffness (3N,3N) N/m, exact."""
    if guards is None:
        return
    slope, ahead, behind, moved = np.empty((4, 3)), np.empty((4, 3)), np.empty((4, 3)), np.empty((4, 3))
    for k in range(guards.energy.size):
        s = share(guards, x, k, slope)
        if s >= NEAR:
            continue
        _, first, second = barrier(s)
        nodes = guards.nodes[k]
        for b in range(4):
            if nodes[b] < 0:
                continue
            for n in range(3):
                # the gradient is linear in each corner alone, so its difference quotient is exact
                for a in range(4):
                    for m in range(3):
                        moved[a, m] = 0.0 if nodes[a] < 0 else x[nodes[a], m]
                width = 0.5 * abs(guards.volume[k]) ** (1.0 / 3.0)
                moved[b, n] += width
                corner(guards, k, moved, ahead)
                moved[b, n] -= 2.0 * width
                corner(guards, k, moved, behind)
                for a in range(4):
                    if nodes[a] < 0:
                        continue
                    for m in range(3):
                        turning = (ahead[a, m] - behind[a, m]) / (2.0 * width)
                        stiffness[3 * nodes[a] + m, 3 * nodes[b] + n] += guards.energy[k] * (
                            second * slope[a, m] * slope[b, n] + first * turning
                        )


@njit
def corner(guards, k, x, slope):
    """As `share`, for the corners of guard k in x (4,3)."""
    p, q, i = x[0], x[1], x[3]
    scale = 0.5 / guards.volume[k]
    if guards.nodes[k, 2] < 0:
        slope[:] = 0.0
        slope[0, 0], slope[0, 1] = scale * (q[1] - i[1]), -scale * (q[0] - i[0])
        slope[1, 0], slope[1, 1] = -scale * (p[1] - i[1]), scale * (p[0] - i[0])
        slope[3] = -slope[0] - slope[1]
        return
    a, b, c = p - i, q - i, x[2] - i
    slope[0] = np.cross(b, c) * scale / 3.0
    slope[1] = np.cross(c, a) * scale / 3.0
    slope[2] = np.cross(a, b) * scale / 3.0
    slope[3] = -slope[0] - slope[1] - slope[2]


@njit
def energy(guards, x):
    """Energy of all guards, J."""
    if guards is None:
        return 0.0
    slope, total = np.empty((4, 3)), 0.0
    for k in range(guards.energy.size):
        total += guards.energy[k] * barrier(share(guards, x, k, slope))[0]
    return total


@njit
def all_inside(guards, x):
    """True if every inner node is behind its faces."""
    if guards is None:
        return True
    slope = np.empty((4, 3))
    escaped = 0
    for k in range(guards.energy.size):
        if not share(guards, x, k, slope) > 0.0:
            escaped += 1
    return escaped == 0
