"""Springs from a node to a point of the world: the mouse's (Song 2009, ch. 4.4), or a penalty that moves the node.

An anchor with a rest length pulls and damps along itself. One without pulls by stiffness times distance, linear in the
place, and damps along all axes: in matrices it adds to the node's diagonal only, as a penalty should.

Legend: a anchor; i its node; r from the node to the point; u the point's velocity less the node's.
"""

import math

import numpy as np

from fish_env._jit import INDEX, njit


@njit
def add_force(anchors, x, v, f):
    """Add the pull of every anchor to f (N,3) N."""
    if anchors is None:
        return
    for a in range(anchors.node.size):
        i = INDEX(anchors.node[a])
        r0, r1, r2 = anchors.point[a, 0] - x[i, 0], anchors.point[a, 1] - x[i, 1], anchors.point[a, 2] - x[i, 2]
        u0, u1, u2 = (
            anchors.velocity[a, 0] - v[i, 0],
            anchors.velocity[a, 1] - v[i, 1],
            anchors.velocity[a, 2] - v[i, 2],
        )
        c, k, natural = anchors.stiffness[a], anchors.damping[a], anchors.rest_length[a]
        if natural == 0.0:
            f[i, 0] += c * r0 + k * u0  # (58)
            f[i, 1] += c * r1 + k * u1
            f[i, 2] += c * r2 + k * u2
            continue
        length = math.sqrt(r0 * r0 + r1 * r1 + r2 * r2)
        if length == 0.0:  # it points nowhere
            continue
        eta = c * (1.0 - natural / length) + k * (r0 * u0 + r1 * u1 + r2 * u2) / (length * length)  # (59)
        f[i, 0] += eta * r0
        f[i, 1] += eta * r1
        f[i, 2] += eta * r2


@njit
def add_jacobian(anchors, x, v, stiffness, damping):
    """Add -df/dx to stiffness (3N,3N) N/m and -df/dv to damping (3N,3N) N s/m, both exact."""
    if anchors is None:
        return
    for a in range(anchors.node.size):
        i, c, k, natural = anchors.node[a], anchors.stiffness[a], anchors.damping[a], anchors.rest_length[a]
        r, u = anchors.point[a] - x[i], anchors.velocity[a] - v[i]
        length = math.sqrt(np.sum(r * r))
        if natural > 0.0 and length == 0.0:
            continue
        for p in range(3):
            if natural == 0.0:
                stiffness[3 * i + p, 3 * i + p] += c
                damping[3 * i + p, 3 * i + p] += k
                continue
            speed = np.sum(r * u) / length
            eta = (c * (length - natural) + k * speed) / length
            stiffness[3 * i + p, 3 * i + p] += eta
            for q in range(3):
                n, o = r[p] / length, r[q] / length
                turning = k * n * (u[q] - speed * o) / length
                stiffness[3 * i + p, 3 * i + q] += (c - eta) * n * o + turning
                damping[3 * i + p, 3 * i + q] += k * n * o


@njit
def add_system(anchors, diagonal, x, h, a):
    """Add h D + h^2 K of every anchor to the diagonal blocks of a (S,3,3) kg: along it, or along all axes."""
    if anchors is None:
        return
    for m in range(anchors.node.size):
        i = INDEX(anchors.node[m])
        block = a[INDEX(diagonal[i])]
        weight = h * h * anchors.stiffness[m] + h * anchors.damping[m]
        if anchors.rest_length[m] == 0.0:
            for k in range(3):
                block[k, k] += weight
            continue
        r = anchors.point[m] - x[i]
        square = np.sum(r * r)
        for k in range(3 if square > 0.0 else 0):
            for n in range(3):
                block[k, n] += weight * r[k] * r[n] / square


@njit
def add_stiffness_force(anchors, x, y, h, f):
    """Add -h K y to f (N,3), with y (N,3) and the K of `add_system`."""
    if anchors is None:
        return
    for m in range(anchors.node.size):
        i, weight = INDEX(anchors.node[m]), h * anchors.stiffness[m]
        if anchors.rest_length[m] == 0.0:
            for k in range(3):
                f[i, k] -= weight * y[i, k]
            continue
        r = anchors.point[m] - x[i]
        square = np.sum(r * r)
        along = np.sum(r * y[i])
        for k in range(3 if square > 0.0 else 0):
            f[i, k] -= weight * along * r[k] / square


@njit
def weights(anchors, factor, h, least):
    """What `add_tangent` multiplies each anchor's displacement by, (A,2) kg: by its stiffness, and in all along itself.

    As `tets.weights`. None without anchors.
    """
    if anchors is None:
        return None
    weight = np.empty((anchors.node.size, 2))
    for a in range(anchors.node.size):
        viscous = h * anchors.damping[a]
        weight[a, 0] = factor * h * h * anchors.stiffness[a]
        weight[a, 1] = max(weight[a, 0] + 2.0 * factor * viscous, least * viscous)
    return weight


@njit
def add_tangent(anchors, weight, x, y, f):
    """Add to f (N,3) the pull of the anchors, by their weights (A,2), if every node moved by y (N,3) from x (N,3)."""
    if anchors is None:
        return
    for a in range(anchors.node.size):
        i, natural = INDEX(anchors.node[a]), anchors.rest_length[a]
        if natural == 0.0:
            for k in range(3):
                f[i, k] -= weight[a, 1] * y[i, k]
            continue
        square, along = 0.0, 0.0
        for k in range(3):
            r = anchors.point[a, k] - x[i, k]
            square += r * r
            along += r * y[i, k]
        if square == 0.0:
            continue
        across = weight[a, 0] * max(1.0 - natural / math.sqrt(square), 0.0)
        pull = (weight[a, 1] - across) * along / square
        for k in range(3):
            f[i, k] -= across * y[i, k] + pull * (anchors.point[a, k] - x[i, k])


@njit
def rates(anchors, inverse_mass):
    """The largest stiffness and damping that the anchors of one node have together, over its mass, 1/s2 and 1/s."""
    if anchors is None:
        return 0.0, 0.0
    elastic, viscous = 0.0, 0.0
    for a in range(anchors.node.size):
        i = INDEX(anchors.node[a])
        inverse, stiffness, damping = max(inverse_mass[i, 0], inverse_mass[i, 1], inverse_mass[i, 2]), 0.0, 0.0
        for b in range(anchors.node.size):
            if anchors.node[b] == anchors.node[a]:
                stiffness += anchors.stiffness[b]
                damping += anchors.damping[b]
        elastic, viscous = max(elastic, stiffness * inverse), max(viscous, damping * inverse)
    return elastic, viscous


@njit
def energy(anchors, x):
    """Elastic energy of all anchors, J."""
    if anchors is None:
        return 0.0
    total = 0.0
    for a in range(anchors.node.size):
        length = math.sqrt(np.sum((anchors.point[a] - x[anchors.node[a]]) ** 2))
        total += 0.5 * anchors.stiffness[a] * (length - anchors.rest_length[a]) ** 2
    return total
