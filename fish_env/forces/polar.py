"""The rotation nearest to a 3 x 3 matrix: of a deformation gradient, how the element has turned.

It maximises tr(R^T F) over all rotations, so it exists for flat and inverted elements too. In terms of the trace t of
the stretch S, F = R S, it is an algebraic function of F; t is the largest root of a quartic (Horn 1987). Where the root
is not simple, the nearest rotation is not unique, and one of them is taken from the eigenvectors of Horn's matrix.

Legend: f the matrix by rows; n its square norm, d its determinant, c its cofactors; m is F^T F; t, u invariants of S.
"""

import math

import numpy as np

from fish_env._jit import njit

NEWTON = 50  # steps at most; near a rotation three are enough
CLEAR = 1e-2  # of n^1.5: a smaller (s1 + s2)(s2 + s3)(s3 + s1) leaves the algebraic form too few digits


@njit
def rotation(f00, f01, f02, f10, f11, f12, f20, f21, f22):
    """Nearest rotation, nine numbers by rows, of a matrix given by rows; finite for all numbers below 1e70."""
    n = f00 * f00 + f01 * f01 + f02 * f02 + f10 * f10 + f11 * f11 + f12 * f12 + f20 * f20 + f21 * f21 + f22 * f22
    c00, c01, c02 = f11 * f22 - f12 * f21, f12 * f20 - f10 * f22, f10 * f21 - f11 * f20
    c10, c11, c12 = f02 * f21 - f01 * f22, f00 * f22 - f02 * f20, f01 * f20 - f00 * f21
    c20, c21, c22 = f01 * f12 - f02 * f11, f02 * f10 - f00 * f12, f00 * f11 - f01 * f10
    d = f00 * c00 + f01 * c01 + f02 * c02
    squares = c00 * c00 + c01 * c01 + c02 * c02 + c10 * c10 + c11 * c11 + c12 * c12 + c20 * c20 + c21 * c21 + c22 * c22
    constant = n * n - 4.0 * squares
    t = math.sqrt(3.0 * n)  # no trace of S is larger: Newton comes down to the largest root
    for _ in range(NEWTON):
        square = t * t
        value = (square - 2.0 * n) * square - 8.0 * d * t + constant  # (48)
        slope = 4.0 * (square - n) * t - 8.0 * d
        if not slope > 0.0:
            break
        change = value / slope
        t -= change
        if not abs(change) > 1e-15 * t:
            break
    u = 0.5 * (t * t - n)
    pairs = t * u - d  # (s1 + s2)(s2 + s3)(s3 + s1)
    if not pairs > CLEAR * n * math.sqrt(n):
        return unclear(f00, f01, f02, f10, f11, f12, f20, f21, f22)
    a, b, inverse = t, t * t - u, 1.0 / pairs
    m00, m01, m02 = (
        f00 * f00 + f10 * f10 + f20 * f20,
        f00 * f01 + f10 * f11 + f20 * f21,
        f00 * f02 + f10 * f12 + f20 * f22,
    )
    m11, m12, m22 = (
        f01 * f01 + f11 * f11 + f21 * f21,
        f01 * f02 + f11 * f12 + f21 * f22,
        f02 * f02 + f12 * f12 + f22 * f22,
    )
    return (
        (a * c00 + b * f00 - (f00 * m00 + f01 * m01 + f02 * m02)) * inverse,  # (49)
        (a * c01 + b * f01 - (f00 * m01 + f01 * m11 + f02 * m12)) * inverse,
        (a * c02 + b * f02 - (f00 * m02 + f01 * m12 + f02 * m22)) * inverse,
        (a * c10 + b * f10 - (f10 * m00 + f11 * m01 + f12 * m02)) * inverse,
        (a * c11 + b * f11 - (f10 * m01 + f11 * m11 + f12 * m12)) * inverse,
        (a * c12 + b * f12 - (f10 * m02 + f11 * m12 + f12 * m22)) * inverse,
        (a * c20 + b * f20 - (f20 * m00 + f21 * m01 + f22 * m02)) * inverse,
        (a * c21 + b * f21 - (f20 * m01 + f21 * m11 + f22 * m12)) * inverse,
        (a * c22 + b * f22 - (f20 * m02 + f21 * m12 + f22 * m22)) * inverse,
    )


@njit
def unclear(f00, f01, f02, f10, f11, f12, f20, f21, f22):
    """As `rotation`, where two singular values with their signs add up to almost nothing: by the Jacobi method."""
    k = np.empty((4, 4))
    k[0, 0] = f00 + f11 + f22
    k[0, 1] = k[1, 0] = f21 - f12
    k[0, 2] = k[2, 0] = f02 - f20
    k[0, 3] = k[3, 0] = f10 - f01
    k[1, 1], k[2, 2], k[3, 3] = f00 - f11 - f22, f11 - f00 - f22, f22 - f00 - f11
    k[1, 2] = k[2, 1] = f01 + f10
    k[1, 3] = k[3, 1] = f02 + f20
    k[2, 3] = k[3, 2] = f12 + f21
    q = np.eye(4)
    for _ in range(20):
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
                    q[m, i], q[m, j] = c * q[m, i] - s * q[m, j], s * q[m, i] + c * q[m, j]
        if not off > 0.0:
            break
    best = 0
    for i in range(1, 4):
        if k[i, i] > k[best, best]:
            best = i
    w, x, y, z = q[0, best], q[1, best], q[2, best], q[3, best]
    scale = 2.0 / (w * w + x * x + y * y + z * z)
    return (
        1.0 - scale * (y * y + z * z), scale * (x * y - w * z), scale * (x * z + w * y),
        scale * (x * y + w * z), 1.0 - scale * (x * x + z * z), scale * (y * z - w * x),
        scale * (x * z - w * y), scale * (y * z + w * x), 1.0 - scale * (x * x + y * y),
    )  # fmt: skip
