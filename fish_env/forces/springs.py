"""Viscoelastic units: an elastic and a viscous force along the line between two nodes (Tu 1996, ch. 4).

Legend: i, j the unit's nodes; r = x_j - x_i; u = v_j - v_i; e elongation; eta effective stiffness; n = r/|r|; f the
force on node i; g = df/dr less its turning part n q^T, symmetric, by rows xx, xy, xz, yy, yz, zz; df/du = k n n^T.
"""

import math

import numpy as np

from fish_env._jit import INDEX, njit, njit_inline

MOST_COMPRESSED = -0.1  # strain below which a unit's negative stiffness across grows no further in `add_tangent`


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


@njit_inline
def add_force_tangent(body, rest_length, x, v, f, tangent):
    """As `add_force`, and keep what `add_tangent` needs: tangent (7,E).

    Its rows: separation r (3), 1/|r|^2, strain 1 - l/|r| but no less than MOST_COMPRESSED, and two of scratch. In three
    loops, so that the middle one, with the root and the divisions, does several units at a time.
    """
    springs = body.springs
    for e in range(springs.stiffness.size):
        i, j = INDEX(springs.nodes[e, 0]), INDEX(springs.nodes[e, 1])
        rx, ry, rz = x[j, 0] - x[i, 0], x[j, 1] - x[i, 1], x[j, 2] - x[i, 2]
        tangent[0, e], tangent[1, e], tangent[2, e] = rx, ry, rz
        tangent[5, e] = rx * rx + ry * ry + rz * rz
        tangent[6, e] = rx * (v[j, 0] - v[i, 0]) + ry * (v[j, 1] - v[i, 1]) + rz * (v[j, 2] - v[i, 2])
    for e in range(springs.stiffness.size):
        inverse = 1.0 / math.sqrt(tangent[5, e])
        strain = 1.0 - rest_length[e] * inverse
        tangent[3, e] = inverse * inverse
        tangent[4, e] = max(strain, MOST_COMPRESSED)
        tangent[5, e] = springs.stiffness[e] * strain + springs.damping[e] * tangent[6, e] * inverse * inverse  # (4)
    for e in range(springs.stiffness.size):
        i, j = INDEX(springs.nodes[e, 0]), INDEX(springs.nodes[e, 1])
        eta = tangent[5, e]
        fx, fy, fz = eta * tangent[0, e], eta * tangent[1, e], eta * tangent[2, e]
        f[i, 0] += fx  # (3)
        f[i, 1] += fy
        f[i, 2] += fz
        f[j, 0] -= fx
        f[j, 1] -= fy
        f[j, 2] -= fz


@njit_inline
def add_tangent(body, elastic, along, tangent, y, f):
    """Add to f (N,3) the pull of the units if every node moved by y (N,3).

    elastic (E,): their stiffness; along (E,): the same plus their damping over a time, which acts along them only.
    """
    for e in range(along.size):
        i, j = INDEX(body.springs.nodes[e, 0]), INDEX(body.springs.nodes[e, 1])
        ux, uy, uz = y[j, 0] - y[i, 0], y[j, 1] - y[i, 1], y[j, 2] - y[i, 2]
        rx, ry, rz = tangent[0, e], tangent[1, e], tangent[2, e]
        across = elastic[e] * tangent[4, e]
        pull = (along[e] - across) * (rx * ux + ry * uy + rz * uz) * tangent[3, e]
        gx, gy, gz = across * ux + pull * rx, across * uy + pull * ry, across * uz + pull * rz
        f[i, 0] += gx
        f[i, 1] += gy
        f[i, 2] += gz
        f[j, 0] -= gx
        f[j, 1] -= gy
        f[j, 2] -= gz


@njit
def derivative(springs, rest_length, x, v, e, lowest):
    """How the force of unit e on node i follows its separation: direction n (3 numbers), g (6, N/m), q (3, N/m).

    eta is taken to be at least `lowest` N/m: with 0, g is positive semi-definite; with -inf it is the derivative.
    """
    i, j = INDEX(springs.nodes[e, 0]), INDEX(springs.nodes[e, 1])
    rx, ry, rz, eta = unit(springs, rest_length, x, v, e)
    inverse = 1.0 / math.sqrt(rx * rx + ry * ry + rz * rz)
    nx, ny, nz = rx * inverse, ry * inverse, rz * inverse
    ux, uy, uz = v[j, 0] - v[i, 0], v[j, 1] - v[i, 1], v[j, 2] - v[i, 2]
    speed = ux * nx + uy * ny + uz * nz
    turn = springs.damping[e] * inverse
    qx, qy, qz = turn * (ux - speed * nx), turn * (uy - speed * ny), turn * (uz - speed * nz)
    eta = max(eta, lowest)
    axial = springs.stiffness[e] - eta
    gxx, gxy, gxz = eta + axial * nx * nx, axial * nx * ny, axial * nx * nz  # (22)
    gyy, gyz, gzz = eta + axial * ny * ny, axial * ny * nz, eta + axial * nz * nz
    return nx, ny, nz, gxx, gxy, gxz, gyy, gyz, gzz, qx, qy, qz


@njit
def add_jacobian(body, rest_length, x, v, stiffness, damping):
    """Add -df/dx to stiffness (3N,3N) N/m and -df/dv to damping (3N,3N) N s/m, both exact."""
    block = np.empty((3, 3))
    for e in range(body.springs.stiffness.size):
        i, j = INDEX(body.springs.nodes[e, 0]), INDEX(body.springs.nodes[e, 1])
        nx, ny, nz, gxx, gxy, gxz, gyy, gyz, gzz, qx, qy, qz = derivative(body.springs, rest_length, x, v, e, -math.inf)
        n, q = (nx, ny, nz), (qx, qy, qz)
        block[0, 0], block[0, 1], block[0, 2] = gxx, gxy, gxz
        block[1, 0], block[1, 1], block[1, 2] = gxy, gyy, gyz
        block[2, 0], block[2, 1], block[2, 2] = gxz, gyz, gzz
        for p, s in ((i, j), (j, i)):
            for k in range(3):
                for m in range(3):
                    along = block[k, m] + n[k] * q[m]  # (22)
                    across = body.springs.damping[e] * n[k] * n[m]  # (23)
                    stiffness[3 * p + k, 3 * p + m] += along
                    stiffness[3 * p + k, 3 * s + m] -= along
                    damping[3 * p + k, 3 * p + m] += across
                    damping[3 * p + k, 3 * s + m] -= across


@njit
def add_system(body, rest_length, x, v, h, lowest, a):
    """Add h D + h^2 K to a (S,3,3) kg, a block for each entry of the nodes' skyline.

    D is -df/dv and K is -df/dx less the turning part n q^T, which is not symmetric; `lowest` as in `derivative`.
    """
    springs, diagonal = body.springs, body.profile.diagonal
    for e in range(springs.stiffness.size):
        nx, ny, nz, gxx, gxy, gxz, gyy, gyz, gzz, _, _, _ = derivative(springs, rest_length, x, v, e, lowest)
        square, along = h * h, h * springs.damping[e]
        gxx, gxy, gxz = square * gxx + along * nx * nx, square * gxy + along * nx * ny, square * gxz + along * nx * nz
        gyy, gyz, gzz = square * gyy + along * ny * ny, square * gyz + along * ny * nz, square * gzz + along * nz * nz
        for node in range(2):
            d = a[INDEX(diagonal[INDEX(springs.nodes[e, node])])]
            d[0, 0] += gxx  # only the lower triangle of a diagonal block is read
            d[1, 0] += gxy
            d[1, 1] += gyy
            d[2, 0] += gxz
            d[2, 1] += gyz
            d[2, 2] += gzz
        s = a[INDEX(springs.entry[e])]
        s[0, 0] -= gxx
        s[0, 1] -= gxy
        s[0, 2] -= gxz
        s[1, 0] -= gxy
        s[1, 1] -= gyy
        s[1, 2] -= gyz
        s[2, 0] -= gxz
        s[2, 1] -= gyz
        s[2, 2] -= gzz


@njit
def add_stiffness_force(body, rest_length, x, v, y, h, lowest, f):
    """Add -h K y to f (N,3), with y (N,3) and the K of `add_system`."""
    for e in range(body.springs.stiffness.size):
        i, j = INDEX(body.springs.nodes[e, 0]), INDEX(body.springs.nodes[e, 1])
        _, _, _, gxx, gxy, gxz, gyy, gyz, gzz, _, _, _ = derivative(body.springs, rest_length, x, v, e, lowest)
        yx, yy, yz = h * (y[j, 0] - y[i, 0]), h * (y[j, 1] - y[i, 1]), h * (y[j, 2] - y[i, 2])
        fx, fy, fz = gxx * yx + gxy * yy + gxz * yz, gxy * yx + gyy * yy + gyz * yz, gxz * yx + gyz * yy + gzz * yz
        f[i, 0] += fx
        f[i, 1] += fy
        f[i, 2] += fz
        f[j, 0] -= fx
        f[j, 1] -= fy
        f[j, 2] -= fz


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
