"""Viscoelastic units: an elastic and a viscous force along the line between two nodes (Tu 1996, ch. 4).

Legend: i, j the unit's nodes; r = x_j - x_i; u = v_j - v_i; e elongation; eta effective stiffness.
"""

import math

from fish_env._jit import INDEX, njit


@njit
def unit(springs, rest_length, x, v, e):
    """One unit e: its separation r (3 numbers, m) and effective stiffness eta (N/m); the force on node i is eta r."""
    i, j = INDEX(springs.nodes[e, 0]), INDEX(springs.nodes[e, 1])
    rx, ry, rz = x[j, 0] - x[i, 0], x[j, 1] - x[i, 1], x[j, 2] - x[i, 2]
    ux, uy, uz = v[j, 0] - v[i, 0], v[j, 1] - v[i, 1], v[j, 2] - v[i, 2]
    inverse = 1.0 / math.sqrt(rx * rx + ry * ry + rz * rz)
    speed = (ux * rx + uy * ry + uz * rz) * inverse  # (2)
    # c (|r| - l)/|r| + k speed/|r|
    eta = springs.stiffness[e] * (1.0 - rest_length[e] * inverse) + springs.damping[e] * speed * inverse  # (4)
    return rx, ry, rz, eta


@njit
def add_force(body, rest_length, x, v, f):
    """Add the elastic and viscous force of every unit to f (N,3) N."""
    for e in range(body.springs.stiffness.size):
        i, j = INDEX(body.springs.nodes[e, 0]), INDEX(body.springs.nodes[e, 1])
        rx, ry, rz, eta = unit(body.springs, rest_length, x, v, e)
        f[i, 0] += eta * rx  # (3)
        f[i, 1] += eta * ry
        f[i, 2] += eta * rz
        f[j, 0] -= eta * rx
        f[j, 1] -= eta * ry
        f[j, 2] -= eta * rz


@njit
def energy(body, rest_length, x):
    """Elastic energy of all units, J."""
    total = 0.0
    for e in range(body.springs.stiffness.size):
        i, j = INDEX(body.springs.nodes[e, 0]), INDEX(body.springs.nodes[e, 1])
        rx, ry, rz = x[j, 0] - x[i, 0], x[j, 1] - x[i, 1], x[j, 2] - x[i, 2]
        stretch = math.sqrt(rx * rx + ry * ry + rz * rz) - rest_length[e]
        total += 0.5 * body.springs.stiffness[e] * stretch * stretch  # (5)
    return total


@njit
def all_shorter(body, x, limit):
    """True if no unit is longer than `limit` times its natural length."""
    for e in range(body.springs.stiffness.size):
        i, j = INDEX(body.springs.nodes[e, 0]), INDEX(body.springs.nodes[e, 1])
        rx, ry, rz = x[j, 0] - x[i, 0], x[j, 1] - x[i, 1], x[j, 2] - x[i, 2]
        allowed = limit * body.springs.rest_length[e]
        if rx * rx + ry * ry + rz * rz > allowed * allowed:
            return False
    return True
