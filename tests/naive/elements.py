"""Reference implementations of the tetrahedra, of the gas in compartments, and of the barriers."""

import numpy as np


def shape_gradients(corners):
    """Gradients (4,3) of the functions that are linear in a tetrahedron (4,3) and 1 at one corner, 0 at the others."""
    return np.linalg.inv(np.column_stack([np.ones(4), corners]))[1:].T


def nearest_rotation(matrix):
    """The rotation R that maximises tr(R^T F): from the singular values, the sign of the smallest repaired."""
    left, _, right = np.linalg.svd(matrix)
    signs = np.diag([1.0, 1.0, np.linalg.det(left @ right)])
    return left @ signs @ right


def tets_of(body, x):
    """Of every tetrahedron: number, nodes, shape gradients and volume at rest, deformation gradient, frame."""
    for t, nodes in enumerate(body.tets.nodes):
        corners = body.position[nodes]
        gradient = shape_gradients(corners)
        volume = np.linalg.det(corners[1:] - corners[0]) / 6
        deformation = x[nodes].T @ gradient
        turn = nearest_rotation(deformation) if body.tets.rotating else np.eye(3)
        yield t, nodes, gradient, volume, deformation, turn


def strain_of(turn, deformation):
    """Symmetric part of R^T F - 1."""
    stretch = turn.T @ deformation
    return 0.5 * (stretch + stretch.T) - np.eye(3)


def tet_force(body, x, v):
    """Elastic and viscous force of every tetrahedron on its nodes, (N,3): stress of the strain and of its rate."""
    force = np.zeros_like(x)
    for t, nodes, gradient, volume, deformation, turn in tets_of(body, x):
        if body.tets.quadratic:
            stress = quadratic_stress(body.tets, t, deformation, v[nodes].T @ gradient)
            for node, slope in zip(nodes, gradient, strict=True):
                force[node] -= volume * deformation @ stress @ slope
            continue
        rate = strain_of(turn, v[nodes].T @ gradient) + np.eye(3)
        strain = strain_of(turn, deformation) + body.tets.relaxation_time[t] * rate
        stress = 2 * body.tets.shear[t] * strain + body.tets.dilation[t] * np.trace(strain) * np.eye(3)
        for node, slope in zip(nodes, gradient, strict=True):
            force[node] -= volume * turn @ stress @ slope
    return force


def green_lagrange(deformation):
    """The strain (F^T F - 1) / 2."""
    return 0.5 * (deformation.T @ deformation - np.eye(3))


def quadratic_stress(tets, t, deformation, rate):
    """Second stress of Piola and Kirchhoff of the strain and of its rate, given F and its rate."""
    strain = green_lagrange(deformation)
    strain = strain + tets.relaxation_time[t] * 0.5 * (deformation.T @ rate + rate.T @ deformation)
    return 2 * tets.shear[t] * strain + tets.dilation[t] * np.trace(strain) * np.eye(3)


def pulling(stress):
    """A stress, lifted along all axes until Gershgorin's bound shows no pressure along any."""
    off = np.abs(stress - np.diag(np.diag(stress))).sum(axis=1)
    return stress + max(0.0, -(np.diag(stress) - off).min()) * np.eye(3)


def tet_energy(body, x):
    """Elastic energy of all tetrahedra."""
    total = 0.0
    for t, _, _, volume, deformation, turn in tets_of(body, x):
        strain = green_lagrange(deformation) if body.tets.quadratic else strain_of(turn, deformation)
        total += volume * body.tets.shear[t] * np.sum(strain**2)
        total += 0.5 * volume * body.tets.dilation[t] * np.trace(strain) ** 2
    return total


def tet_blocks(body, x, v, projected=False):
    """Stiffness of every tetrahedron, with its number and nodes: of the material and of the stress, (12,12) both.

    Of small strain R B^T C B V R^T and nothing; of the quadratic one B^T C B V, with B the strain's derivative, and
    what the stress resists rotation by, which may be `projected`.
    """
    for t, nodes, gradient, volume, deformation, turn in tets_of(body, x):
        if body.tets.quadratic:
            b = np.zeros((3, 3, 12))
            for a, slope in enumerate(gradient):
                for k in range(3):
                    rate = np.outer(np.eye(3)[k], slope)
                    b[:, :, 3 * a + k] = 0.5 * (deformation.T @ rate + rate.T @ deformation)
            trace = np.trace(b)
            block = 2 * body.tets.shear[t] * np.einsum("ijp,ijq->pq", b, b)
            block += body.tets.dilation[t] * np.outer(trace, trace)
            stress = quadratic_stress(body.tets, t, deformation, v[nodes].T @ gradient)
            stress = pulling(stress) if projected else stress
            yield t, nodes, volume * block, volume * np.kron(gradient @ stress @ gradient.T, np.eye(3))
            continue
        b = np.zeros((6, 12))  # strains xx, yy, zz, and the engineer's xy, yz, zx, which are twice the tensor's
        for a, (gx, gy, gz) in enumerate(gradient):
            b[:, 3 * a : 3 * a + 3] = [[gx, 0, 0], [0, gy, 0], [0, 0, gz], [gy, gx, 0], [0, gz, gy], [gz, 0, gx]]
        c = np.diag(body.tets.shear[t] * np.array([2.0, 2, 2, 1, 1, 1]))
        c[:3, :3] += body.tets.dilation[t]
        turned = np.kron(np.eye(4), turn)
        yield t, nodes, turned @ (volume * b.T @ c @ b) @ turned.T, np.zeros((12, 12))


def triangles(face):
    """The triangles of a face with what each counts: a patch is the mean of its two triangulations."""
    p, q, r, s = face
    if r == s:
        return [((p, q, r), 1.0)]
    return [((p, q, r), 0.5), ((p, r, s), 0.5), ((p, q, s), 0.5), ((q, r, s), 0.5)]


def gas_volume(compartments, c, x):
    """Volume of a compartment, or area of a ring, and its gradient (N,3): signed simplices from the nodes' middle."""
    volume, slope, x = 0.0, np.zeros_like(x), x - x.mean(axis=0)
    for face in compartments.faces[compartments.first[c] : compartments.first[c + 1]]:
        if face[2] < 0:
            p, q = face[:2]
            volume += np.linalg.det(x[[p, q], :2]) / 2
            slope[p, :2] += np.array([x[q, 1], -x[q, 0]]) / 2
            slope[q, :2] += np.array([-x[p, 1], x[p, 0]]) / 2
            continue
        for (p, q, r), part in triangles(face):
            normals = part * np.cross(x[[q, r, p]], x[[r, p, q]]) / 6
            volume += x[p] @ normals[0]
            slope[[p, q, r]] += normals
    return volume, slope


def gas_force(compartments, x):
    """Pressure nRT/V less that outside, times the volume's gradient, (N,3)."""
    force = np.zeros_like(x)
    for c, gas in enumerate(compartments.gas):
        volume, slope = gas_volume(compartments, c, x)
        force += (gas / volume - compartments.ambient[c]) * slope
    return force


def gas_energy(compartments, x):
    """Energy of gas at constant temperature, and of what it displaces."""
    volumes = [gas_volume(compartments, c, x)[0] for c in range(compartments.gas.size)]
    return sum(
        p * v - gas * np.log(v) for gas, p, v in zip(compartments.gas, compartments.ambient, volumes, strict=True)
    )


def barrier_shares(barriers, x):
    """Of every barrier: number, nodes, volume over that at rest, and its gradient at each of the nodes."""
    for k, (p, q, r, i) in enumerate(barriers.nodes):
        if r < 0:
            a, b = x[p, :2] - x[i, :2], x[q, :2] - x[i, :2]
            outer = np.array([[b[1], -b[0], 0.0], [-a[1], a[0], 0.0]]) / 2
            nodes, volume = (p, q, i), np.linalg.det([a, b]) / 2
        else:
            a, b, c = x[[p, q, r]] - x[i]
            outer = np.array([np.cross(b, c), np.cross(c, a), np.cross(a, b)]) / 6
            nodes, volume = (p, q, r, i), np.linalg.det([a, b, c]) / 6
        yield k, nodes, volume / barriers.volume[k], np.vstack([outer, -outer.sum(axis=0)]) / barriers.volume[k]


def barrier_law(s):
    """Energy -(s - s0)^2 ln(s / s0), s0 = 0.6, with its first and second derivative; below 0.3 its Taylor parabola."""
    if s >= 0.6:
        return 0.0, 0.0, 0.0
    t = max(s, 0.3)
    energy = -((t - 0.6) ** 2) * np.log(t / 0.6)
    first = -2 * (t - 0.6) * np.log(t / 0.6) - (t - 0.6) ** 2 / t
    second = -2 * np.log(t / 0.6) - 4 * (t - 0.6) / t + ((t - 0.6) / t) ** 2
    return energy + (s - t) * first + (s - t) ** 2 * second / 2, first + (s - t) * second, second


def barrier_force(barriers, x):
    """Force of the barriers on every node, (N,3)."""
    force = np.zeros_like(x)
    for k, nodes, s, slope in barrier_shares(barriers, x):
        for node, direction in zip(nodes, slope, strict=True):
            force[node] -= barriers.energy[k] * barrier_law(s)[1] * direction
    return force


def barrier_energy(barriers, x):
    """Energy of the barriers."""
    return sum(barriers.energy[k] * barrier_law(s)[0] for k, _, s, _ in barrier_shares(barriers, x))


def barrier_stiffness(barriers, x):
    """What resists where a barrier is at work, its second derivative along the gradient of s, (3N,3N) N/m."""
    matrix = np.zeros((len(x), 3, len(x), 3))
    for k, nodes, s, slope in barrier_shares(barriers, x):
        for p, first in zip(nodes, slope, strict=True):
            for q, second in zip(nodes, slope, strict=True):
                matrix[p, :, q] += barriers.energy[k] * barrier_law(s)[2] * np.outer(first, second)
    return matrix.reshape(x.size, x.size)
