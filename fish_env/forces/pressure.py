"""Gas in closed chambers: an ideal gas at constant temperature, the volume by Gauss' theorem (Song 2009, ch. 4.5).

The pressure is n R T over the volume, and its force that times the gradient of the volume: minus the gradient of the
gas' energy. Exact for surfaces of triangles, of bilinear patches, and for flat rings of edges.

Legend: c chamber; p, q, r, s corners of a face; o a point near it, so that no digits are lost far from the origin;
m sum of the corners less 4 o; d, e diagonals; slope gradient of the volume.
"""

import numpy as np

from fish_env._jit import INDEX, njit


@njit
def add_volume(chambers, c, x, slope):
    """Volume of chamber c, m3 (of a ring: m2); its gradient, m2, is added to slope (N,3)."""
    volume = 0.0
    base = chambers.faces[INDEX(chambers.first[c]), 0]
    o0, o1, o2 = x[base, 0], x[base, 1], x[base, 2]
    for k in range(chambers.first[c], chambers.first[c + 1]):
        p, q, r, s = chambers.faces[k, 0], chambers.faces[k, 1], chambers.faces[k, 2], chambers.faces[k, 3]
        if r < 0:  # an edge of a ring
            px, py, qx, qy = x[p, 0] - o0, x[p, 1] - o1, x[q, 0] - o0, x[q, 1] - o1
            volume += 0.5 * (px * qy - qx * py)
            slope[p, 0] += 0.5 * qy
            slope[p, 1] -= 0.5 * qx
            slope[q, 0] -= 0.5 * py
            slope[q, 1] += 0.5 * px
            continue
        m0 = x[p, 0] + x[q, 0] + x[r, 0] + x[s, 0] - 4.0 * o0
        m1 = x[p, 1] + x[q, 1] + x[r, 1] + x[s, 1] - 4.0 * o1
        m2 = x[p, 2] + x[q, 2] + x[r, 2] + x[s, 2] - 4.0 * o2
        d0, d1, d2 = x[r, 0] - x[p, 0], x[r, 1] - x[p, 1], x[r, 2] - x[p, 2]
        e0, e1, e2 = x[s, 0] - x[q, 0], x[s, 1] - x[q, 1], x[s, 2] - x[q, 2]
        a0, a1, a2 = (d1 * e2 - d2 * e1) / 24.0, (d2 * e0 - d0 * e2) / 24.0, (d0 * e1 - d1 * e0) / 24.0
        volume += m0 * a0 + m1 * a1 + m2 * a2  # (52)
        b0, b1, b2 = (e1 * m2 - e2 * m1) / 24.0, (e2 * m0 - e0 * m2) / 24.0, (e0 * m1 - e1 * m0) / 24.0
        c0, c1, c2 = (m1 * d2 - m2 * d1) / 24.0, (m2 * d0 - m0 * d2) / 24.0, (m0 * d1 - m1 * d0) / 24.0
        slope[p, 0] += a0 - b0  # (53)
        slope[p, 1] += a1 - b1
        slope[p, 2] += a2 - b2
        slope[r, 0] += a0 + b0
        slope[r, 1] += a1 + b1
        slope[r, 2] += a2 + b2
        slope[q, 0] += a0 - c0
        slope[q, 1] += a1 - c1
        slope[q, 2] += a2 - c2
        slope[s, 0] += a0 + c0
        slope[s, 1] += a1 + c1
        slope[s, 2] += a2 + c2
    return volume


@njit
def add_force(chambers, x, f):
    """Add the force of the gas on the walls of its chambers to f (N,3) N."""
    if chambers is None:
        return
    slope = np.empty_like(x)
    for c in range(chambers.gas.size):
        slope[:] = 0.0
        push = chambers.gas[c] / add_volume(chambers, c, x, slope) - chambers.ambient[c]
        for i in range(x.shape[0]):
            for k in range(3):
                f[i, k] += push * slope[i, k]  # (54)


@njit
def add_force_kept(chambers, x, f, kept):
    """As `add_force`, and keep for `add_tangent`, kept (C,N,3): volume gradients times the root of nRT / V^2."""
    if chambers is None:
        return
    for c in range(chambers.gas.size):
        slope = kept[c]
        slope[:] = 0.0
        volume, gas = add_volume(chambers, c, x, slope), chambers.gas[c]
        push = gas / volume - chambers.ambient[c]
        root = np.sqrt(gas) / volume
        for i in range(x.shape[0]):
            for k in range(3):
                f[i, k] += push * slope[i, k]
                slope[i, k] *= root


@njit
def scratch(chambers, nodes):
    """What `add_force_kept` fills, (C,N,3); None without chambers."""
    if chambers is None:
        return None
    return np.empty((chambers.gas.size, nodes, 3))


@njit
def add_tangent(weight, kept, y, f):
    """Add to f (N,3) what the gas' compression pushes back, times weight, if every node moved by y (N,3)."""
    if kept is None:
        return
    for c in range(kept.shape[0]):
        slope, change = kept[c], 0.0
        for i in range(y.shape[0]):
            for k in range(3):
                change += slope[i, k] * y[i, k]
        for i in range(y.shape[0]):
            for k in range(3):
                f[i, k] -= weight * change * slope[i, k]  # (55)


@njit
def add_jacobian(chambers, x, stiffness):
    """Add -df/dx to stiffness (3N,3N) N/m, exact: the gas' compression and the turning of its walls."""
    if chambers is None:
        return
    slope = np.empty_like(x)
    d, e, m, w = np.empty(3), np.empty(3), np.empty(3), np.empty(3)
    for c in range(chambers.gas.size):
        slope[:] = 0.0
        volume = add_volume(chambers, c, x, slope)
        flat = slope.reshape(-1)
        rise = chambers.gas[c] / volume**2
        for i in range(flat.size):
            for j in range(flat.size):
                stiffness[i, j] += rise * flat[i] * flat[j]
        push = chambers.gas[c] / volume - chambers.ambient[c]
        base = x[chambers.faces[chambers.first[c], 0]]
        for k in range(chambers.first[c], chambers.first[c + 1]):
            face = chambers.faces[k]
            p, q = face[0], face[1]
            if face[2] < 0:
                for i, j, sign in ((p, q, 0.5), (q, p, -0.5)):
                    stiffness[3 * i, 3 * j + 1] -= push * sign
                    stiffness[3 * i + 1, 3 * j] += push * sign
                continue
            for i in range(3):
                d[i], e[i] = x[face[2], i] - x[p, i], x[face[3], i] - x[q, i]
                m[i] = x[p, i] + x[q, i] + x[face[2], i] + x[face[3], i] - 4.0 * base[i]
            for a in range(4):
                da, ea = (a == 2) * 1.0 - (a == 0) * 1.0, (a == 3) * 1.0 - (a == 1) * 1.0
                for b in range(4):
                    db, eb = (b == 2) * 1.0 - (b == 0) * 1.0, (b == 3) * 1.0 - (b == 1) * 1.0
                    for i in range(3):
                        w[i] = ((db - da) * e[i] - (eb - ea) * d[i] + (da * eb - ea * db) * m[i]) / 24.0
                    for i in range(3):
                        low, high = (i + 1) % 3, (i + 2) % 3  # the gradient at a changes by u x w where b moves by u
                        stiffness[3 * face[a] + i, 3 * face[b] + low] -= push * w[high]
                        stiffness[3 * face[a] + i, 3 * face[b] + high] += push * w[low]


@njit
def energy(chambers, x):
    """Energy of the gas and of what it displaces, J, relative to chambers of one cubic metre."""
    if chambers is None:
        return 0.0
    slope, total = np.zeros_like(x), 0.0
    for c in range(chambers.gas.size):
        volume = add_volume(chambers, c, x, slope)
        total += chambers.ambient[c] * volume - chambers.gas[c] * np.log(volume)
    return total


@njit
def all_filled(chambers, x):
    """True if every chamber has a volume."""
    if chambers is None:
        return True
    slope, empty = np.zeros_like(x), 0
    for c in range(chambers.gas.size):
        if not add_volume(chambers, c, x, slope) > 0.0:
            empty += 1
    return empty == 0


def estimated_volume(nodes, x) -> float:
    """Song's estimate of a volume, from the springs of its surface (E,2): half their |dx| |n_x| length (eq. 4.16).

    Units of an area, whatever the dimension. Every term is of second order in a spring's length, so that the sum goes
    to nothing with finer rings: it follows the volume of one mesh, up to a constant that belongs to that mesh.
    """
    edge = x[nodes[:, 1]] - x[nodes[:, 0]]
    length = np.linalg.norm(edge, axis=1)
    return float(0.5 * np.sum(np.abs(edge[:, 0]) * np.abs(estimated_normals(nodes, x)[:, 0]) * length))


def estimated_normals(nodes, x) -> np.ndarray:
    """Song's estimate of the normals of springs (E,2), unit vectors (E,3): the spring turned about each axis.

    Two components change places, and one its sign, about z, then y, then x; in the plane about z alone (ch. 4.5.2).
    """
    edge = x[nodes[:, 1]] - x[nodes[:, 0]]
    turned = edge[:, [1, 0, 2]] * (1.0, -1.0, 1.0)  # about z
    if np.ptp(x[:, 2]) > 0.0:
        turned = turned[:, [2, 1, 0]] * (-1.0, 1.0, 1.0)  # about y
        turned = turned[:, [0, 2, 1]] * (1.0, 1.0, -1.0)  # about x
    return turned / np.linalg.norm(turned, axis=1)[:, None]
