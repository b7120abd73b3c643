"""Nearest rotation to a 3 x 3 matrix: the rotation of an element, from its deformation gradient.

It maximises tr(R^T F) over all rotations, so it exists for flat and inverted elements too. In terms of the trace t of
the stretch S, F = R S, it is an algebraic function of F; t is the largest root of a quartic (Horn 1987). If the root is
not simple, the nearest rotation is not unique, and one of them is taken from the eigenvectors of Horn's matrix.

Legend: p, q, r columns of F; n its square norm, d its determinant, a, b, c the columns of its cofactors; m_ij is
F^T F; t, u invariants of S; k Horn's matrix, e its eigenvectors in columns.
"""

import math

from fish_env.kernels.compile import kernel, part
from fish_env.kernels.simd import (
    Pack,
    all_lanes,
    any_lane,
    block_size,
    cross,
    directions,
    dot,
    epsilon,
    floats,
    fma,
    lane,
    select,
    sqrt,
    vec3,
)

NEWTON = 50  # steps at most; near a rotation three are enough
RATE = 100.0  # times the square of Newton's relative step: bound of the next step if the root is CLEAR
CLEAR = 1e-2  # times n^1.5: below, (s1 + s2)(s2 + s3)(s3 + s1) makes the algebraic form inaccurate
SWEEPS = 20  # at most, of the Jacobi method


def make_scratch(kind) -> Pack:
    """Scratch memory of `rotation`: columns of the matrix and of the rotation, k and e (4,4)."""
    return Pack("polar", f=kind.vectors(3), r=kind.vectors(3), k=kind.scratch((4, 4)), e=kind.scratch((4, 4)))


@kernel
def rotation(p, q, r, scratch):
    """Columns of the nearest rotation to a matrix given by columns; finite for numbers below 1e70 (float32: 1e9)."""
    # Newton's method iterates until every fish has converged; values that have converged do not change any more.
    m00, m11, m22, m01, m02, m12 = dot(p, p), dot(q, q), dot(r, r), dot(p, q), dot(p, r), dot(q, r)
    a, b, c = cross(q, r), cross(r, p), cross(p, q)
    n, d = m00 + m11 + m22, dot(p, a)
    constant = fma(n, n, -4.0 * (dot(a, a) + dot(b, b) + dot(c, c)))
    precision = epsilon(scratch.f)
    t = sqrt(3.0 * n)  # an upper bound of the trace of S: Newton's method descends to the largest root
    going = n > 0.0
    for _ in range(NEWTON):
        square = t * t
        value = fma(fma(-2.0, n, square), square, fma(-8.0 * d, t, constant))  # (64)
        slope = fma(4.0 * (square - n), t, -8.0 * d)
        going = going & (slope > 0.0)
        change = select(going, value / slope, 0.0)
        t = t - change
        going = going & (change > 0.0) & (RATE * (change * change) > precision * square)
        if not any_lane(going):
            break
    square = t * t
    u = 0.5 * (square - n)
    pairs = fma(t, u, -d)  # (s1 + s2)(s2 + s3)(s3 + s1)
    inverse, rest = 1.0 / pairs, square - u
    x = inverse * (fma(t, a, rest * p) - fma(m02, r, fma(m01, q, m00 * p)))  # (65)
    y = inverse * (fma(t, b, rest * q) - fma(m12, r, fma(m11, q, m01 * p)))
    z = inverse * (fma(t, c, rest * r) - fma(m22, r, fma(m12, q, m02 * p)))
    clear = pairs > CLEAR * n * sqrt(n)
    if not all_lanes(clear) or directions(scratch.f):
        f, turn = scratch.f, scratch.r
        f[0], f[1], f[2] = p, q, r
        turn[0], turn[1], turn[2] = x, y, z
        for fish in range(block_size(f)):
            if not lane(clear, fish):
                by_jacobi(scratch, fish)
        x, y, z = turn[0], turn[1], turn[2]
        if directions(f):
            x, y, z = with_derivatives(p, q, r, turn)
    return x, y, z


@kernel
def with_derivatives(p, q, r, turn):
    """Rotation `turn` of a matrix of dual numbers, with derivatives, which come from a final Newton step."""
    # The step rotates it by w, (tr S - S) w = sum of x cross p, with S = F R^T. The value of w is zero; its derivatives
    # are not.
    columns = floats(turn)
    for i in range(3):
        for k in range(3):
            for direction in range(directions(turn)):
                columns[i, k, 1 + direction] = 0.0
    x, y, z = turn[0], turn[1], turn[2]
    a, b, c = fma(z.x, r, fma(y.x, q, x.x * p)), fma(z.y, r, fma(y.y, q, x.y * p)), fma(z.z, r, fma(y.z, q, x.z * p))
    trace, xy, xz, yz = a.x + b.y + c.z, -0.5 * (a.y + b.x), -0.5 * (a.z + c.x), -0.5 * (b.z + c.y)
    a, b, c = vec3(trace - a.x, xy, xz), vec3(xy, trace - b.y, yz), vec3(xz, yz, trace - c.z)
    one, two, three, off = cross(b, c), cross(c, a), cross(a, b), cross(x, p) + cross(y, q) + cross(z, r)
    w = (1.0 / dot(a, one)) * fma(off.z, three, fma(off.y, two, off.x * one))  # (67)
    return x + cross(w, x), y + cross(w, y), z + cross(w, z)


@part
def by_jacobi(scratch, fish):
    """Compute `rotation` of one fish if two signed singular values have a sum that is almost zero or negative."""
    # It reads `scratch.f` and writes `scratch.r`, in scalar arithmetic, because such elements are rare.
    f, r, k, e = floats(scratch.f), floats(scratch.r), scratch.k, scratch.e
    k[0, 0] = f[0, 0, fish] + f[1, 1, fish] + f[2, 2, fish]
    for i in range(3):
        a, b = (i + 1) % 3, (i + 2) % 3
        k[0, i + 1] = f[a, b, fish] - f[b, a, fish]
        k[i + 1, i + 1] = 2.0 * f[i, i, fish] - k[0, 0]
        k[a + 1, b + 1] = f[a, b, fish] + f[b, a, fish]
    k[1, 3] = k[3, 1]
    for i in range(4):
        for j in range(4):
            e[i, j] = 1.0 if i == j else 0.0
        for j in range(i):
            k[i, j] = k[j, i]
    for _ in range(SWEEPS):
        if not sweep(k, e) > 0.0:
            break
    best = 0
    for i in range(1, 4):
        if k[i, i] > k[best, best]:
            best = i
    w, square = e[0, best], 0.0  # the rotation as a quaternion
    for i in range(4):
        square += e[i, best] * e[i, best]
    for i in range(3):
        a, b = (i + 1) % 3, (i + 2) % 3
        x, y, z = e[i + 1, best], e[a + 1, best], e[b + 1, best]
        r[i, i, fish] = 1.0 - 2.0 * (y * y + z * z) / square
        r[i, a, fish] = 2.0 * (x * y + w * z) / square
        r[i, b, fish] = 2.0 * (x * z - w * y) / square


@part
def sweep(k, e):
    """Perform one Jacobi sweep of k (4,4), and rotate e with it; return its largest off-diagonal entry."""
    off = 0.0
    for i in range(4):
        for j in range(i + 1, 4):
            off = max(off, abs(k[i, j]))
            if k[i, j] == 0.0:
                continue
            angle = 0.5 * math.atan2(2.0 * k[i, j], k[j, j] - k[i, i])
            c, s = math.cos(angle), math.sin(angle)
            for m in range(4):
                k[m, i], k[m, j] = c * k[m, i] - s * k[m, j], s * k[m, i] + c * k[m, j]
            for m in range(4):
                k[i, m], k[j, m] = c * k[i, m] - s * k[j, m], s * k[i, m] + c * k[j, m]
            for m in range(4):
                e[m, i], e[m, j] = c * e[m, i] - s * e[m, j], s * e[m, i] + c * e[m, j]
    return off
