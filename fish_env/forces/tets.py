"""Linear tetrahedra: small strain in a frame that turns with each element, or in a fixed one (Müller & Gross 2004).

With the nearest rotation R of the deformation gradient F, the energy is V (mu |F - R|^2 + lambda/2 tr(R^T F - 1)^2),
and the force its gradient: rigid rotation costs nothing. Damping acts on the rate of the same strain.

Legend: t element; a, b its corners; g gradients of the shape functions; F = sum x_a g_a^T; r the rotation by rows;
e strain R^T F - 1, made symmetric; q stress in the turned frame; h step; s what the strain's rate adds to it, a time.
"""

import numpy as np

from fish_env._jit import INDEX, njit
from fish_env.forces.polar import rotation


@njit
def deformation(tets, x, t):
    """Sum of x_a g_a^T over the corners of element t: nine numbers by rows. Of positions (N,3), F."""
    g = tets.gradient[t]
    a, b, c, d = (INDEX(tets.nodes[t, 0]), INDEX(tets.nodes[t, 1]), INDEX(tets.nodes[t, 2]), INDEX(tets.nodes[t, 3]))
    p0, p1, p2 = x[b, 0] - x[a, 0], x[b, 1] - x[a, 1], x[b, 2] - x[a, 2]  # the gradients add up to nothing
    q0, q1, q2 = x[c, 0] - x[a, 0], x[c, 1] - x[a, 1], x[c, 2] - x[a, 2]
    s0, s1, s2 = x[d, 0] - x[a, 0], x[d, 1] - x[a, 1], x[d, 2] - x[a, 2]
    return (
        p0 * g[1, 0] + q0 * g[2, 0] + s0 * g[3, 0],
        p0 * g[1, 1] + q0 * g[2, 1] + s0 * g[3, 1],
        p0 * g[1, 2] + q0 * g[2, 2] + s0 * g[3, 2],
        p1 * g[1, 0] + q1 * g[2, 0] + s1 * g[3, 0],
        p1 * g[1, 1] + q1 * g[2, 1] + s1 * g[3, 1],
        p1 * g[1, 2] + q1 * g[2, 2] + s1 * g[3, 2],
        p2 * g[1, 0] + q2 * g[2, 0] + s2 * g[3, 0],
        p2 * g[1, 1] + q2 * g[2, 1] + s2 * g[3, 1],
        p2 * g[1, 2] + q2 * g[2, 2] + s2 * g[3, 2],
    )  # (46)


@njit
def turn_of(tets, d):
    """The rotation of an element deformed by d, nine numbers by rows: the unit matrix unless the elements rotate."""
    if not tets.rotating:
        return 1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0
    return rotation(*d)


@njit
def frame(tets, x, t):
    """The rotation of element t at positions x (N,3)."""
    return turn_of(tets, deformation(tets, x, t))


@njit
def strain(r, d):
    """Symmetric part of R^T D, six numbers xx, yy, zz, xy, xz, yz, for a rotation and a matrix of nine numbers each."""
    xx = r[0] * d[0] + r[3] * d[3] + r[6] * d[6]
    yy = r[1] * d[1] + r[4] * d[4] + r[7] * d[7]
    zz = r[2] * d[2] + r[5] * d[5] + r[8] * d[8]
    xy = 0.5 * (r[0] * d[1] + r[3] * d[4] + r[6] * d[7] + r[1] * d[0] + r[4] * d[3] + r[7] * d[6])
    xz = 0.5 * (r[0] * d[2] + r[3] * d[5] + r[6] * d[8] + r[2] * d[0] + r[5] * d[3] + r[8] * d[6])
    yz = 0.5 * (r[1] * d[2] + r[4] * d[5] + r[7] * d[8] + r[2] * d[1] + r[5] * d[4] + r[8] * d[7])
    return xx, yy, zz, xy, xz, yz


@njit
def turned(r0, r1, r2, q00, q11, q22, q01, q02, q12):
    """A row of a rotation times a symmetric matrix."""
    return r0 * q00 + r1 * q01 + r2 * q02, r0 * q01 + r1 * q11 + r2 * q12, r0 * q02 + r1 * q12 + r2 * q22


@njit
def spread(tets, t, r, e, scale, f):
    """Add to f (N,3) the nodal forces of the strain e (six numbers) in the frame r, times `scale`."""
    mu, la = 2.0 * tets.shear[t], tets.dilation[t] * (e[0] + e[1] + e[2])
    v = -scale * tets.volume[t]
    q00, q11, q22 = v * (mu * e[0] + la), v * (mu * e[1] + la), v * (mu * e[2] + la)  # (47)
    q01, q02, q12 = v * mu * e[3], v * mu * e[4], v * mu * e[5]
    p00, p01, p02 = turned(r[0], r[1], r[2], q00, q11, q22, q01, q02, q12)
    p10, p11, p12 = turned(r[3], r[4], r[5], q00, q11, q22, q01, q02, q12)
    p20, p21, p22 = turned(r[6], r[7], r[8], q00, q11, q22, q01, q02, q12)
    g = tets.gradient[t]
    i = INDEX(tets.nodes[t, 0])
    s0, s1, s2 = 0.0, 0.0, 0.0
    for a in range(1, 4):
        j = INDEX(tets.nodes[t, a])
        f0 = p00 * g[a, 0] + p01 * g[a, 1] + p02 * g[a, 2]
        f1 = p10 * g[a, 0] + p11 * g[a, 1] + p12 * g[a, 2]
        f2 = p20 * g[a, 0] + p21 * g[a, 1] + p22 * g[a, 2]
        f[j, 0] += f0
        f[j, 1] += f1
        f[j, 2] += f2
        s0 += f0
        s1 += f1
        s2 += f2
    f[i, 0] -= s0
    f[i, 1] -= s1
    f[i, 2] -= s2


@njit
def add_force(tets, x, v, f):
    """Add the elastic and viscous force of every tetrahedron to f (N,3) N."""
    if tets is None:
        return
    for t in range(tets.volume.size):
        d = deformation(tets, x, t)
        r = turn_of(tets, d)
        add_element(tets, v, t, d, r, f)


@njit
def add_element(tets, v, t, d, r, f):
    """Add the force of element t, deformed by d and turned by r, at velocities v (N,3)."""
    e, s = strain(r, d), tets.relaxation_time[t]
    xx, yy, zz, xy, xz, yz = e[0] - 1.0, e[1] - 1.0, e[2] - 1.0, e[3], e[4], e[5]
    if s > 0.0:
        w = strain(r, deformation(tets, v, t))
        xx, yy, zz = xx + s * w[0], yy + s * w[1], zz + s * w[2]
        xy, xz, yz = xy + s * w[3], xz + s * w[4], yz + s * w[5]
    spread(tets, t, r, (xx, yy, zz, xy, xz, yz), 1.0, f)


@njit
def add_force_kept(tets, x, v, f, kept):
    """As `add_force`, and keep the rotations (T,9) for `add_tangent`."""
    if tets is None:
        return
    for t in range(tets.volume.size):
        d = deformation(tets, x, t)
        r = turn_of(tets, d)
        for k in range(9):
            kept[t, k] = r[k]
        add_element(tets, v, t, d, r, f)


@njit
def weights(tets, factor, h, least):
    """What `add_tangent` is to multiply each element by (T,), s2: a factor on its stiffness and damping in a step of h.

    No less than `least` s times the damping. None without elements.
    """
    if tets is None:
        return None
    weight = np.empty(tets.volume.size)
    for t in range(weight.size):
        viscous = h * tets.relaxation_time[t]
        weight[t] = max(factor * (h * h + 2.0 * viscous), least * viscous)
    return weight


@njit
def scratch(tets):
    """What `add_force_kept` fills, (T,9); None without elements."""
    if tets is None:
        return None
    return np.empty((tets.volume.size, 9))


@njit
def add_tangent(tets, weight, kept, y, f):
    """Add to f (N,3) the pull of the tetrahedra, each times weight (T,), if every node moved by y (N,3)."""
    if tets is None:
        return
    for t in range(weight.size):
        k = kept[t]
        r = (k[0], k[1], k[2], k[3], k[4], k[5], k[6], k[7], k[8])
        spread(tets, t, r, strain(r, deformation(tets, y, t)), weight[t], f)


@njit
def add_stiffness_force(tets, x, y, h, f):
    """Add -h K y to f (N,3), with y (N,3) and the K of `add_system`."""
    if tets is None:
        return
    for t in range(tets.volume.size):
        r = frame(tets, x, t)
        spread(tets, t, r, strain(r, deformation(tets, y, t)), h, f)


@njit
def add_system(tets, profile, x, h, a):
    """Add h D + h^2 K to a (S,3,3) kg, a block for each entry of the nodes' skyline.

    Both are those of linear elasticity, turned with the element: what its turning changes in turn is left out, so they
    are symmetric and positive semi-definite.
    """
    if tets is None:
        return
    first, start = profile.first, profile.start
    now = np.empty((4, 3))
    for t in range(tets.volume.size):
        r = frame(tets, x, t)
        g = tets.gradient[t]
        for p in range(4):
            for k in range(3):
                now[p, k] = r[3 * k] * g[p, 0] + r[3 * k + 1] * g[p, 1] + r[3 * k + 2] * g[p, 2]
        weight = tets.volume[t] * h * (h + tets.relaxation_time[t])
        mu, la = weight * tets.shear[t], weight * tets.dilation[t]
        for p in range(4):
            for q in range(4):
                row, column = INDEX(tets.nodes[t, p]), INDEX(tets.nodes[t, q])
                if row < column:  # above the diagonal
                    continue
                block = a[INDEX(start[row]) + column - INDEX(first[row])]
                along = 0.0
                for k in range(3):
                    along += now[p, k] * now[q, k]
                for k in range(3):
                    for m in range(3):
                        block[k, m] += mu * now[q, k] * now[p, m] + la * now[p, k] * now[q, m]  # (50)
                    block[k, k] += mu * along


@njit
def add_jacobian(tets, x, v, stiffness, damping):
    """Add -df/dx to stiffness (3N,3N) N/m and -df/dv to damping (3N,3N) N s/m, both exact."""
    if tets is None:
        return
    for t in range(tets.volume.size):
        d, w, s = deformation(tets, x, t), deformation(tets, v, t), tets.relaxation_time[t]
        r = frame(tets, x, t)
        turn, stretch, rate = np.empty((3, 3)), np.empty((3, 3)), np.empty((3, 3))  # R, R^T F, R^T dF/dt
        for k in range(3):
            for m in range(3):
                turn[k, m] = r[3 * k + m]
                stretch[k, m] = r[k] * d[m] + r[3 + k] * d[3 + m] + r[6 + k] * d[6 + m]
                rate[k, m] = r[k] * w[m] + r[3 + k] * w[3 + m] + r[6 + k] * w[6 + m]
        stress = material(tets, t, stretch - np.eye(3) + s * rate)
        spin = np.zeros((3, 3))  # inverse of tr(S) - S
        if tets.rotating:
            spin = np.ascontiguousarray(np.linalg.inv(np.trace(stretch) * np.eye(3) - 0.5 * (stretch + stretch.T)))
        for b in range(4):
            for k in range(3):
                moved = np.outer(turn[k], tets.gradient[t, b])  # R^T dF where corner b moves along axis k
                slope = material(tets, t, s * moved)
                push(tets, t, b, k, turn @ slope, damping)
                skew = np.array([moved[2, 1] - moved[1, 2], moved[0, 2] - moved[2, 0], moved[1, 0] - moved[0, 1]])
                o = spin @ skew
                omega = np.array([[0.0, -o[2], o[1]], [o[2], 0.0, -o[0]], [-o[1], o[0], 0.0]])
                change = moved - omega @ stretch - s * (omega @ rate)
                push(tets, t, b, k, turn @ (omega @ stress + material(tets, t, change)), stiffness)  # (51)


@njit
def material(tets, t, e):
    """Stress (3,3) of the symmetric part of a strain (3,3)."""
    return tets.shear[t] * (e + e.T) + tets.dilation[t] * np.trace(e) * np.eye(3)


@njit
def push(tets, t, b, k, stress, matrix):
    """Add to a (3N,3N) matrix, column of corner b and axis k, what a stress (3,3) does to the corners."""
    column = 3 * tets.nodes[t, b] + k
    for a in range(4):
        for m in range(3):
            total = 0.0
            for i in range(3):
                total += stress[m, i] * tets.gradient[t, a, i]
            matrix[3 * tets.nodes[t, a] + m, column] += tets.volume[t] * total


@njit
def energy(tets, x):
    """Elastic energy of all tetrahedra, J."""
    if tets is None:
        return 0.0
    tets, total = tets, 0.0
    for t in range(tets.volume.size):
        e = strain(frame(tets, x, t), deformation(tets, x, t))
        trace = e[0] + e[1] + e[2] - 3.0
        squares = (e[0] - 1.0) ** 2 + (e[1] - 1.0) ** 2 + (e[2] - 1.0) ** 2
        squares += 2.0 * (e[3] * e[3] + e[4] * e[4] + e[5] * e[5])
        total += tets.volume[t] * (tets.shear[t] * squares + 0.5 * tets.dilation[t] * trace * trace)
    return total


@njit
def all_shorter(tets, x, limit):
    """True if no tetrahedron is stretched to more than `limit` times its natural length, along any direction."""
    if tets is None:
        return True
    for t in range(tets.volume.size):
        d, total = deformation(tets, x, t), 0.0
        for k in range(9):
            total += d[k] * d[k]
        if not total <= limit * limit + 2.0:  # the other two stretches being about 1
            return False
    return True
