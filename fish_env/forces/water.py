"""Water on the surface: every face that moves outward through the water is pushed back along its normal.

The linear law is Tu & Terzopoulos 1994; the quadratic one Terzopoulos, Tu & Grzeszczuk 1994 with half the density
times a drag coefficient in place of their unit constant. No lift, added mass, friction or wake.

Legend: a area vector (area times outward normal); w velocity of the face through the water; p, q, r, s its corners.
"""

import math

import numpy as np

from fish_env._jit import INDEX, njit, njit_inline


@njit_inline
def velocity(body, world, v, k):
    """Velocity of face k through the water, 3 numbers, m/s."""
    p, q = INDEX(body.faces.nodes[k, 0]), INDEX(body.faces.nodes[k, 1])
    r, s = INDEX(body.faces.nodes[k, 2]), INDEX(body.faces.nodes[k, 3])
    sp, sq, sr, ss = body.faces.share[k, 0], body.faces.share[k, 1], body.faces.share[k, 2], body.faces.share[k, 3]
    w0 = sp * v[p, 0] + sq * v[q, 0] + sr * v[r, 0] + ss * v[s, 0] - world.current[0]  # (11)
    w1 = sp * v[p, 1] + sq * v[q, 1] + sr * v[r, 1] + ss * v[s, 1] - world.current[1]
    w2 = sp * v[p, 2] + sq * v[q, 2] + sr * v[r, 2] + ss * v[s, 2] - world.current[2]
    return w0, w1, w2


@njit_inline
def face(body, world, x, v, k):
    """Area vector (3 numbers, m2) of face k and its velocity through the water (3 numbers, m/s)."""
    p, q = INDEX(body.faces.nodes[k, 0]), INDEX(body.faces.nodes[k, 1])
    r, s = INDEX(body.faces.nodes[k, 2]), INDEX(body.faces.nodes[k, 3])
    d0, d1, d2 = x[r, 0] - x[p, 0], x[r, 1] - x[p, 1], x[r, 2] - x[p, 2] + body.faces.depth[k]
    e0, e1, e2 = x[s, 0] - x[q, 0], x[s, 1] - x[q, 1], x[s, 2] - x[q, 2] + body.faces.depth[k]
    a0, a1, a2 = 0.5 * (d1 * e2 - d2 * e1), 0.5 * (d2 * e0 - d0 * e2), 0.5 * (d0 * e1 - d1 * e0)  # (10)
    w0, w1, w2 = velocity(body, world, v, k)
    return a0, a1, a2, w0, w1, w2


@njit_inline
def spread(body, k, f0, f1, f2, f):
    """Share a force on face k (3 numbers, N) among its corners: adds to f (N,3) N."""
    p, q = INDEX(body.faces.nodes[k, 0]), INDEX(body.faces.nodes[k, 1])
    r, s = INDEX(body.faces.nodes[k, 2]), INDEX(body.faces.nodes[k, 3])
    sp, sq, sr, ss = body.faces.share[k, 0], body.faces.share[k, 1], body.faces.share[k, 2], body.faces.share[k, 3]
    f[p, 0] += sp * f0
    f[p, 1] += sp * f1
    f[p, 2] += sp * f2
    f[q, 0] += sq * f0
    f[q, 1] += sq * f1
    f[q, 2] += sq * f2
    f[r, 0] += sr * f0
    f[r, 1] += sr * f1
    f[r, 2] += sr * f2
    f[s, 0] += ss * f0
    f[s, 1] += ss * f1
    f[s, 2] += ss * f2


@njit
def add_force(body, world, x, v, f):
    """Add the force of the water on every face to f (N,3) N, shared among the face's corners."""
    if world.linear == 0.0 and world.quadratic == 0.0:
        return
    for k in range(body.faces.nodes.shape[0]):
        a0, a1, a2, w0, w1, w2 = face(body, world, x, v, k)
        flux = a0 * w0 + a1 * w1 + a2 * w2
        if flux <= 0.0:  # moving inward: the one-sided laws exert no suction
            continue
        area = math.sqrt(a0 * a0 + a1 * a1 + a2 * a2)
        speed = math.sqrt(w0 * w0 + w1 * w1 + w2 * w2)
        push = -(world.linear + world.quadratic * speed) * flux / area  # (12), (13)
        spread(body, k, push * a0, push * a1, push * a2, f)


@njit_inline
def add_force_kept(body, world, x, v, f, kept):
    """As `add_force`, and keep (F,5) for `add_change`: each face's normal (3 numbers), area, m2, and force, N."""
    for k in range(body.faces.nodes.shape[0]):
        a0, a1, a2, w0, w1, w2 = face(body, world, x, v, k)
        area = math.sqrt(a0 * a0 + a1 * a1 + a2 * a2)
        inverse = 1.0 / area
        n0, n1, n2 = a0 * inverse, a1 * inverse, a2 * inverse
        outward = n0 * w0 + n1 * w1 + n2 * w2
        push = 0.0
        if outward > 0.0:
            speed = math.sqrt(w0 * w0 + w1 * w1 + w2 * w2)
            push = -(world.linear + world.quadratic * speed) * outward * area
            spread(body, k, push * n0, push * n1, push * n2, f)
        kept[k, 0], kept[k, 1], kept[k, 2], kept[k, 3], kept[k, 4] = n0, n1, n2, area, push


@njit_inline
def add_change(body, world, kept, mobility, v, f):
    """Add to f (N,3) what the force changes by when the velocities become v (N,3), positions being those of `kept`.

    Each face's drag is taken implicitly, as if it alone slowed the face down: mobility (F,), as `mobilities` gives it.
    """
    for k in range(mobility.size):
        n0, n1, n2, area, push = kept[k, 0], kept[k, 1], kept[k, 2], kept[k, 3], kept[k, 4]
        w0, w1, w2 = velocity(body, world, v, k)
        outward = n0 * w0 + n1 * w1 + n2 * w2
        if outward > 0.0:
            square = w0 * w0 + w1 * w1 + w2 * w2
            speed = math.sqrt(square)
            change = -(world.linear + world.quadratic * speed) * outward * area - push
            slope = world.linear * speed + world.quadratic * (square + outward * outward)  # times the speed
            change *= speed / (speed + mobility[k] * area * slope)  # (38)
        elif push < 0.0:
            change = -push
        else:
            continue
        spread(body, k, change * n0, change * n1, change * n2, f)


@njit
def mobilities(body, duration, mobility):
    """Velocity (F,) m/s a face gains in `duration` s from a force of 1 N, if half the faces around it feel as much.

    Half: while a fish swims, about half its faces move outward and are pushed.
    """
    carried = np.zeros(body.mass.size)
    for k in range(mobility.size):
        for c in range(4):
            carried[INDEX(body.faces.nodes[k, c])] += body.faces.share[k, c]
    for k in range(mobility.size):
        mobility[k] = 0.0
        for c in range(4):
            node = INDEX(body.faces.nodes[k, c])
            free = body.inverse_mass[node]
            inverse = max(free[0], free[1], free[2])
            mobility[k] += 0.5 * duration * body.faces.share[k, c] * carried[node] * inverse


@njit
def derivative(body, world, x, v, k, normal, by_area, by_velocity):
    """How the force on face k follows its area vector and its velocity: -df/da and -df/dw (3,3), and the normal (3,).

    All three are overwritten: N/m2, N s/m, 1. Returns False, with nothing written, for a face that moves inward.
    """
    a0, a1, a2, w0, w1, w2 = face(body, world, x, v, k)
    flux = a0 * w0 + a1 * w1 + a2 * w2
    if flux <= 0.0:
        return False
    area = math.sqrt(a0 * a0 + a1 * a1 + a2 * a2)
    speed = math.sqrt(w0 * w0 + w1 * w1 + w2 * w2)
    w = (w0, w1, w2)
    normal[0], normal[1], normal[2] = a0 / area, a1 / area, a2 / area
    push = world.linear + world.quadratic * speed
    outward, rise = flux / area, world.quadratic * flux / speed
    for i in range(3):
        for j in range(3):
            by_velocity[i, j] = push * area * normal[i] * normal[j] + rise * normal[i] * w[j]  # (24)
            by_area[i, j] = push * normal[i] * (w[j] - outward * normal[j])  # (25)
        by_area[i, i] += push * outward
    return True


@njit
def add_jacobian(body, world, x, v, stiffness, damping):
    """Add -df/dx to stiffness (3N,3N) N/m and -df/dv to damping (3N,3N) N s/m, both exact; 0 for inward faces."""
    if world.linear == 0.0 and world.quadratic == 0.0:
        return
    normal, by_area, by_velocity = np.empty(3), np.empty((3, 3)), np.empty((3, 3))
    half = np.empty(3)
    for k in range(body.faces.nodes.shape[0]):
        if not derivative(body, world, x, v, k, normal, by_area, by_velocity):
            continue
        nodes, share = body.faces.nodes[k], body.faces.share[k]
        for m in range(4):  # da = 1/2 (dx_r - dx_p) x (x_s - x_q) + 1/2 (x_r - x_p) x (dx_s - dx_q)
            other, sign = 1 - m % 2, 0.5 if m in (0, 3) else -0.5
            for c in range(3):
                half[c] = sign * (x[nodes[other + 2], c] - x[nodes[other], c])  # da = half x dx_m
            half[2] += sign * body.faces.depth[k]
            for i in range(3):
                for j in range(3):
                    low, high = (j + 1) % 3, (j + 2) % 3
                    along = by_area[i, low] * half[high] - by_area[i, high] * half[low]  # (26)
                    for p in range(4):
                        stiffness[3 * nodes[p] + i, 3 * nodes[m] + j] += share[p] * along
                        damping[3 * nodes[p] + i, 3 * nodes[m] + j] += share[p] * share[m] * by_velocity[i, j]


@njit
def add_system(body, world, x, v, h, a):
    """Add h D to a (S,3,3) kg, a block for each entry of the nodes' skyline.

    D is the part of -df/dv that is symmetric and positive semi-definite: what the outward velocity of a face changes in
    the push along its normal.
    """
    if world.linear == 0.0 and world.quadratic == 0.0:
        return
    normal, by_area, by_velocity = np.empty(3), np.empty((3, 3)), np.empty((3, 3))
    first, start = body.profile.first, body.profile.start
    for k in range(body.faces.nodes.shape[0]):
        if not derivative(body, world, x, v, k, normal, by_area, by_velocity):
            continue
        drag = 0.0
        for i in range(3):
            for j in range(3):
                drag += h * normal[i] * by_velocity[i, j] * normal[j]  # (27)
        for m in range(4):
            for p in range(4):
                row, column = INDEX(body.faces.nodes[k, m]), INDEX(body.faces.nodes[k, p])
                if row < column:  # above the diagonal
                    continue
                block = a[INDEX(start[row]) + column - INDEX(first[row])]
                weight = body.faces.share[k, m] * body.faces.share[k, p] * drag
                for i in range(3):
                    for j in range(3):
                        block[i, j] += weight * normal[i] * normal[j]
