"""Slow, obvious twins of the compiled kernels, written from the equations in plain numpy and Python loops.

Nothing here calls a kernel. Every function takes one body (no batch) and returns new arrays.
"""

from functools import partial

import numpy as np
from scipy.integrate import solve_ivp

TU = ("mass_spring", "published")
"""The bodies of Tu's topology, 23 nodes and 91 units; tests/test_four_bodies.py has the others."""


# Forces


def spring_force(springs, rest_length, x, v):
    """Elastic and viscous force of every unit on its two nodes, (N,3)."""
    force = np.zeros_like(x)
    for (i, j), c, k, natural in zip(springs.nodes, springs.stiffness, springs.damping, rest_length, strict=True):
        separation = x[j] - x[i]
        length = np.linalg.norm(separation)
        direction = separation / length
        elastic = c * (length - natural)
        viscous = k * np.dot(v[j] - v[i], direction)
        force[i] += (elastic + viscous) * direction
        force[j] -= (elastic + viscous) * direction
    return force


def spring_energy(springs, rest_length, x):
    """Elastic energy of all units."""
    lengths = [np.linalg.norm(x[j] - x[i]) for i, j in springs.nodes]
    return sum(
        0.5 * c * (length - natural) ** 2
        for c, length, natural in zip(springs.stiffness, lengths, rest_length, strict=True)
    )


def area_vector(corners):
    """Area times normal of a quadrilateral (4,3): half the cross product of its diagonals."""
    return 0.5 * np.cross(corners[2] - corners[0], corners[3] - corners[1])


def shares(corners):
    """Part of a face's force on each of its four corners: a quarter, or a third to each node of a triangle."""
    return np.array([1 / 3, 1 / 3, 1 / 6, 1 / 6]) if corners[2] == corners[3] else np.full(4, 0.25)


def face_force(corners, share, world, x, v):
    """Force of the water on one face, (3,): nothing on a face that moves inward."""
    linear, quadratic, current = world[:3]
    area = area_vector(x[corners])
    size = np.linalg.norm(area)
    normal = area / size
    velocity = share @ v[corners] - current
    outward = np.dot(normal, velocity)
    pressure = linear * outward + quadratic * np.linalg.norm(velocity) * outward
    return min(0.0, -pressure) * size * normal


def water_force(faces, world, x, v):
    """Force of the water on every node, (N,3)."""
    force = np.zeros_like(x)
    for corners in faces.nodes:
        share = shares(corners)
        push = face_force(corners, share, world, x, v)
        for node, part in zip(corners, share, strict=True):
            force[node] += part * push
    return force


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
        rate = strain_of(turn, v[nodes].T @ gradient) + np.eye(3)
        strain = strain_of(turn, deformation) + body.tets.relaxation_time[t] * rate
        stress = 2 * body.tets.shear[t] * strain + body.tets.dilation[t] * np.trace(strain) * np.eye(3)
        for node, slope in zip(nodes, gradient, strict=True):
            force[node] -= volume * turn @ stress @ slope
    return force


def tet_energy(body, x):
    """Elastic energy of all tetrahedra."""
    total = 0.0
    for t, _, _, volume, deformation, turn in tets_of(body, x):
        strain = strain_of(turn, deformation)
        total += volume * body.tets.shear[t] * np.sum(strain**2)
        total += 0.5 * volume * body.tets.dilation[t] * np.trace(strain) ** 2
    return total


def tet_blocks(body, x):
    """Stiffness (12,12) of every tetrahedron, R B^T C B V R^T, with its number and nodes."""
    for t, nodes, gradient, volume, _, turn in tets_of(body, x):
        b = np.zeros((6, 12))  # strains xx, yy, zz, and the engineer's xy, yz, zx, which are twice the tensor's
        for a, (gx, gy, gz) in enumerate(gradient):
            b[:, 3 * a : 3 * a + 3] = [[gx, 0, 0], [0, gy, 0], [0, 0, gz], [gy, gx, 0], [0, gz, gy], [gz, 0, gx]]
        c = np.diag(body.tets.shear[t] * np.array([2.0, 2, 2, 1, 1, 1]))
        c[:3, :3] += body.tets.dilation[t]
        turned = np.kron(np.eye(4), turn)
        yield t, nodes, turned @ (volume * b.T @ c @ b) @ turned.T


def triangles(face):
    """The triangles of a face with what each counts: a patch is the mean of its two triangulations."""
    p, q, r, s = face
    if r == s:
        return [((p, q, r), 1.0)]
    return [((p, q, r), 0.5), ((p, r, s), 0.5), ((p, q, s), 0.5), ((q, r, s), 0.5)]


def gas_volume(chambers, c, x):
    """Volume of a chamber, or area of a ring, and its gradient (N,3): signed simplices from the middle of the nodes."""
    volume, slope, x = 0.0, np.zeros_like(x), x - x.mean(axis=0)
    for face in chambers.faces[chambers.first[c] : chambers.first[c + 1]]:
        if face[2] < 0:
            p, q = face[:2]
            volume += np.linalg.det(x[[p, q], :2]) / 2
            slope[p, :2] += np.array([x[q, 1], -x[q, 0]]) / 2
            slope[q, :2] += np.array([-x[p, 1], x[p, 0]]) / 2
            continue
        for (p, q, r), part in triangles(face):
            volume += part * np.linalg.det(x[[p, q, r]]) / 6
            for i, j, k in ((p, q, r), (q, r, p), (r, p, q)):
                slope[i] += part * np.cross(x[j], x[k]) / 6
    return volume, slope


def gas_force(chambers, x):
    """Pressure nRT/V less that outside, times the volume's gradient, (N,3)."""
    force = np.zeros_like(x)
    for c, gas in enumerate(chambers.gas):
        volume, slope = gas_volume(chambers, c, x)
        force += (gas / volume - chambers.ambient[c]) * slope
    return force


def gas_energy(chambers, x):
    """Energy of gas at constant temperature, and of what it displaces."""
    volumes = [gas_volume(chambers, c, x)[0] for c in range(chambers.gas.size)]
    return sum(p * v - gas * np.log(v) for gas, p, v in zip(chambers.gas, chambers.ambient, volumes, strict=True))


def guard_shares(guards, x):
    """Of every guard: number, nodes, volume over that at rest, and its gradient at each of the nodes."""
    for k, (p, q, r, i) in enumerate(guards.nodes):
        if r < 0:
            a, b = x[p, :2] - x[i, :2], x[q, :2] - x[i, :2]
            outer = np.array([[b[1], -b[0], 0.0], [-a[1], a[0], 0.0]]) / 2
            nodes, volume = (p, q, i), np.linalg.det([a, b]) / 2
        else:
            a, b, c = x[[p, q, r]] - x[i]
            outer = np.array([np.cross(b, c), np.cross(c, a), np.cross(a, b)]) / 6
            nodes, volume = (p, q, r, i), np.linalg.det([a, b, c]) / 6
        yield k, nodes, volume / guards.volume[k], np.vstack([outer, -outer.sum(axis=0)]) / guards.volume[k]


def guard_force(guards, x):
    """Force of the barriers -(s - s0)^2 ln(s / s0), s0 = 0.6, on every node, (N,3)."""
    force = np.zeros_like(x)
    for k, nodes, s, slope in guard_shares(guards, x):
        if s < 0.6:
            push = 2 * (s - 0.6) * np.log(s / 0.6) + (s - 0.6) ** 2 / s
            for node, direction in zip(nodes, slope, strict=True):
                force[node] += guards.energy[k] * push * direction
    return force


def guard_energy(guards, x):
    """Energy of the barriers."""
    shares = [s for _, _, s, _ in guard_shares(guards, x)]
    return -sum(e * (s - 0.6) ** 2 * np.log(s / 0.6) for e, s in zip(guards.energy, shares, strict=True) if s < 0.6)


def anchor_force(anchors, x, v):
    """Pull of every anchor, (N,3): along itself, or, without a length, straight to its point."""
    force = np.zeros_like(x)
    for i, point, moving, c, k, natural in zip(*anchors, strict=True):
        r, u = point - x[i], moving - v[i]
        if natural == 0.0:
            force[i] += c * r + k * u
        else:
            direction = r / np.linalg.norm(r)
            force[i] += (c * (np.linalg.norm(r) - natural) + k * np.dot(u, direction)) * direction
    return force


def anchor_energy(anchors, x):
    """Elastic energy of the anchors."""
    lengths = np.linalg.norm(anchors.point - x[anchors.node], axis=1)
    return 0.5 * np.sum(anchors.stiffness * (lengths - anchors.rest_length) ** 2)


def weight_energy(body, world, x):
    """Energy of the weight."""
    return -np.sum(body.mass[:, None] * world.gravity * x)


def behind(plane, x, v, i):
    """Whether node i is behind a plane and does not come back by itself."""
    return plane[:3] @ x[i] <= plane[3] and plane[:3] @ v[i] <= 1e-12 * np.linalg.norm(v[i])


def with_reaction(planes, x, v, force):
    """The force (N,3) less what presses nodes further behind the planes."""
    force = force.copy()
    for plane in () if planes is None else planes:
        for i in range(len(x)):
            if behind(plane, x, v, i):
                force[i] -= min(0.0, plane[:3] @ force[i]) * plane[:3]
    return force


def borne(planes, x, v, h, acceleration):
    """Accelerations (N,3) that in h send no node further behind a plane that it is behind: it stops at most."""
    acceleration = acceleration.copy()
    for plane in () if planes is None else planes:
        for i in range(len(x)):
            if plane[:3] @ x[i] <= plane[3]:
                least = -max(0.0, plane[:3] @ v[i]) / h
                acceleration[i] += max(0.0, least - plane[:3] @ acceleration[i]) * plane[:3]
    return acceleration


def bounce(body, world, h, x, v):
    """Velocities (N,3) after the impacts on the planes that follow a step."""
    v = v.copy()
    for plane in () if world.planes is None else world.planes:
        normal = plane[:3]
        falling = 0.0 if world.gravity is None else 2 * h * abs(normal @ world.gravity)
        for i in range(len(x)):
            speed = normal @ v[i]
            if behind(plane, x, v, i) and speed < 0:
                hit = -speed > falling and normal @ x[i] - plane[3] > 2 * h * speed
                part = plane[4] if hit else 0.0
                v[i] -= (1 + part) * speed * normal * (body.inverse_mass[i] > 0)
    return v


def other_force(body, world, x, v):
    """All but the springs, the anchors and the walls, (N,3): what Tu's method takes explicitly."""
    force = water_force(body.faces, world, x, v)
    if body.tets is not None:
        force += tet_force(body, x, v)
    if body.chambers is not None:
        force += gas_force(body.chambers, x)
    if body.guards is not None:
        force += guard_force(body.guards, x)
    if world.gravity is not None:
        force += body.mass[:, None] * world.gravity - world.viscosity * v
    return force


def total_force(body, world, rest_length, x, v):
    """All forces together, (N,3)."""
    force = spring_force(body.springs, rest_length, x, v) + other_force(body, world, x, v)
    if world.anchors is not None:
        force += anchor_force(world.anchors, x, v)
    return with_reaction(world.planes, x, v, force)


def derivatives(force, x, v, displacement, speed):
    """-df/dx and -df/dv (3N,3N) of force(x, v) (N,3), by central differences of fourth order of these widths."""
    found = []
    for which, width in ((0, displacement), (1, speed)):
        matrix = np.zeros((x.size, x.size))
        for column in range(x.size):
            for shift, weight in ((-2, 1 / 12), (-1, -2 / 3), (1, 2 / 3), (2, -1 / 12)):
                state = [x.copy(), v.copy()]
                state[which].flat[column] += shift * width
                matrix[:, column] -= weight * force(*state).ravel() / width
        found.append(matrix)
    return found


def anchors_of(world, x):
    """Of every anchor: node, stiffness, damping, the axes it acts along (3,3), and its strain, at least zero."""
    for i, point, _, c, k, natural in zip(*world.anchors, strict=True) if world.anchors is not None else ():
        r = point - x[i]
        if natural == 0.0:
            yield i, c, k, np.eye(3), 1.0
        else:
            yield i, c, k, np.outer(r, r) / (r @ r), max(0.0, 1.0 - natural / np.linalg.norm(r))


def implicit_matrices(body, world, rest_length, x, v, projected=False, wet=False):
    """K and D (3N,3N) of a linearly implicit method, from those of each unit: c and eta, along it and across it.

    Of the tetrahedra they are those of linear elasticity, turned with them; of the anchors, along them or along all
    axes. The air damps every node. `projected` takes a negative eta as zero; `wet` adds to D what the normal velocity
    of a face changes in its force along the normal.
    """
    nodes, springs = len(x), body.springs
    stiffness, damping = np.zeros((nodes, 3, nodes, 3)), np.zeros((nodes, 3, nodes, 3))
    for (i, j), c, k, natural in zip(springs.nodes, springs.stiffness, springs.damping, rest_length, strict=True):
        length = np.linalg.norm(x[j] - x[i])
        along = np.outer(x[j] - x[i], x[j] - x[i]) / length**2
        rate = np.dot(v[j] - v[i], x[j] - x[i]) / length
        eta = (c * (length - natural) + k * rate) / length
        if projected and eta < 0:
            eta = 0.0
        for p, q, sign in ((i, i, 1), (j, j, 1), (i, j, -1), (j, i, -1)):
            stiffness[p, :, q] += sign * (c * along + eta * (np.eye(3) - along))
            damping[p, :, q] += sign * k * along
    for corners in body.faces.nodes if wet else ():
        share, area = shares(corners), area_vector(x[corners])
        size = np.linalg.norm(area)
        velocity = share @ v[corners] - world[2]
        outward, speed = np.dot(velocity, area) / size, np.linalg.norm(velocity)
        if outward > 0:
            drag = size * (world[0] + world[1] * (speed + outward**2 / speed))
            for p, part_p in zip(corners, share, strict=True):
                for q, part_q in zip(corners, share, strict=True):
                    damping[p, :, q] += part_p * part_q * drag * np.outer(area, area) / size**2
    for t, corners, block in tet_blocks(body, x) if body.tets is not None else ():
        for a, p in enumerate(corners):
            for b, q in enumerate(corners):
                part = block[3 * a : 3 * a + 3, 3 * b : 3 * b + 3]
                stiffness[p, :, q] += part
                damping[p, :, q] += body.tets.relaxation_time[t] * part
    for i, c, k, along, _ in anchors_of(world, x):
        stiffness[i, :, i] += c * along
        damping[i, :, i] += k * along
    for i in range(nodes):
        damping[i, :, i] += world.viscosity * np.eye(3)
    return stiffness.reshape(3 * nodes, -1), damping.reshape(3 * nodes, -1)


# One step of each method: rest(t) gives the rest lengths at time t


def symplectic_euler(body, world, rest, t, h, x, v):
    """Velocity first, then position with the new velocity."""
    v = v + h * total_force(body, world, rest(t), x, v) * body.inverse_mass
    return x + h * v, v


def rk4(body, world, rest, t, h, x, v):
    """The classical Runge-Kutta method on y = (x, v), with the rest lengths of each stage's own time."""

    def slope(time, y):
        return np.array([y[1], total_force(body, world, rest(time), y[0], y[1]) * body.inverse_mass])

    y = np.array([x, v])
    k1 = slope(t, y)
    k2 = slope(t + h / 2, y + h / 2 * k1)
    k3 = slope(t + h / 2, y + h / 2 * k2)
    k4 = slope(t + h, y + h * k3)
    x, v = y + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
    return x, v


def tu_system(body, world, rest_length, h, x, v):
    """Matrix A (N,N) and load G (N,3) of Tu's method: M/h + h Laplacian(eta), and M v/h + sum(eta r) + f.

    Anchors with a length are units too; those without are wholly implicit. The load is less what presses on walls.
    """
    matrix = np.diag(body.mass / h)
    load = other_force(body, world, x, v)
    springs = body.springs
    for (i, j), c, k, natural in zip(springs.nodes, springs.stiffness, springs.damping, rest_length, strict=True):
        r = x[j] - x[i]
        length = np.linalg.norm(r)
        elongation = length - natural
        rate = np.dot(v[j] - v[i], r) / length
        eta = (c * elongation + k * rate) / length
        matrix[i, i] += h * eta
        matrix[j, j] += h * eta
        matrix[i, j] -= h * eta
        matrix[j, i] -= h * eta
        load[i] += eta * r
        load[j] -= eta * r
    for i, point, moving, c, k, natural in zip(*world.anchors, strict=True) if world.anchors is not None else ():
        r, length = point - x[i], np.linalg.norm(point - x[i])
        if natural == 0.0:
            matrix[i, i] += h * c + k
            load[i] += c * r + k * moving
        else:
            eta = (c * (length - natural) + k * np.dot(moving - v[i], r) / length) / length
            matrix[i, i] += h * eta
            load[i] += eta * r
    return matrix, with_reaction(world.planes, x, v, load) + body.mass[:, None] / h * v


def semi_implicit(body, world, rest, t, h, x, v):
    """Tu's semi-implicit Euler method, solved as a dense system of the free nodes, axis by axis."""
    matrix, load = tu_system(body, world, rest(t), h, x, v)
    before, v = v, v.copy()
    for axis in range(3):
        free = body.inverse_mass[:, axis] > 0
        known = load[free, axis] - matrix[np.ix_(free, ~free)] @ v[~free, axis]
        v[free, axis] = np.linalg.solve(matrix[np.ix_(free, free)], known)
    v = before + borne(world.planes, x, before, 1.0, v - before)
    return x + h * v, v


def explicit_euler(body, world, rest, t, h, x, v):
    """Both with what they are at the start."""
    return x + h * v, v + h * total_force(body, world, rest(t), x, v) * body.inverse_mass


def midpoint(body, world, rest, t, h, x, v):
    """Slopes of the half step."""
    mx, mv = explicit_euler(body, world, rest, t, h / 2, x, v)
    return x + h * mv, v + h * total_force(body, world, rest(t + h / 2), mx, mv) * body.inverse_mass


def linearly_implicit(body, world, rest, t, h, x, v, **which):
    """Linearly implicit Euler as Baraff & Witkin have it, dense in what is free, rest lengths of its end."""
    stiffness, damping = implicit_matrices(body, world, rest(t + h), x, v, **which)
    matrix = np.diag(np.repeat(body.mass, 3)) + h * damping + h**2 * stiffness
    load = h * (total_force(body, world, rest(t + h), x, v).ravel() - h * stiffness @ v.ravel())
    free, change = body.inverse_mass.ravel() > 0, np.zeros(x.size)
    change[free] = np.linalg.solve(matrix[np.ix_(free, free)], load[free])
    v = v + h * borne(world.planes, x, v, h, change.reshape(x.shape) / h)
    return x + h * v, v


def rosenbrock(body, world, rest, t, h, x, v):
    """ROS2 on y = (x, v), as a dense system of order 6N, less the velocities that are held."""
    gamma, size, mass = 1 - 1 / np.sqrt(2), x.size, np.repeat(body.mass, 3)
    moves = np.concatenate([np.ones(size, bool), body.inverse_mass.ravel() > 0])
    stiffness, damping = implicit_matrices(body, world, rest(t), x, v)
    jacobian = np.zeros((2 * size, 2 * size))
    jacobian[:size, size:] = np.eye(size)
    jacobian[size:, :size] = -stiffness / mass[:, None]
    jacobian[size:, size:] = -damping / mass[:, None]
    matrix = np.eye(2 * size) - gamma * h * jacobian
    weight = np.repeat([1.0 / h, 1.0], size)  # positions and velocities in one unit: three digits better

    def solve(load):
        slope = np.zeros(2 * size)
        reduced = (weight[:, None] * matrix / weight)[np.ix_(moves, moves)]
        slope[moves] = np.linalg.solve(reduced, (weight * load)[moves])
        return slope / weight

    def slope(time, y):
        x, v = y.reshape(2, -1, 3)
        return np.concatenate([v.ravel(), total_force(body, world, rest(time), x, v).ravel() / mass])

    y = np.concatenate([x.ravel(), v.ravel()])
    k1 = solve(slope(t, y))
    p = borne(world.planes, x, v, h, k1[size:].reshape(x.shape)).ravel()
    k1 = np.concatenate([v.ravel() + gamma * h * p, p])
    k2 = solve(slope(t + h, y + h * k1) - 2 * k1)
    change = (1.5 * p + 0.5 * k2[size:]).reshape(x.shape)
    q = 2 * borne(world.planes, x, v, h, change).ravel() - 3 * p
    k2 = np.concatenate([v.ravel() + h * p - 2 * k1[:size] + gamma * h * q, q])
    return (y + 1.5 * h * k1 + 0.5 * h * k2).reshape(2, -1, 3)


def accurate(body, world, rest, t, h, x, v):
    """The true motion: every step to 1e-12 of the body's size, and of that times its highest frequency."""

    def slope(time, y):
        x, v = y.reshape(2, -1, 3)
        force = total_force(body, world, rest(time), x, v)
        return np.concatenate([v.ravel(), (force * body.inverse_mass).ravel()])

    y = np.concatenate([x.ravel(), v.ravel()])
    scale = np.abs(body.position).max() * np.repeat([1.0, highest_frequency(body)], x.size)
    end = solve_ivp(slope, (t, t + h), y, method="DOP853", rtol=1e-12, atol=1e-12 * scale).y[:, -1]
    return end.reshape(2, -1, 3)


def face_mobility(body, duration, corners):
    """Velocity that a face gains from a force of 1 N while half the faces around each corner feel the same."""
    gained = 0.0
    for node, part in zip(corners, shares(corners), strict=True):
        carried = sum(shares(other) @ (other == node) for other in body.faces.nodes)
        gained += 0.5 * duration * part * carried * body.inverse_mass[node].max()
    return gained


def water_change(body, world, duration, x, v, ahead):
    """Change of the water's force (N,3) when v becomes `ahead`, each face's drag on itself taken implicitly."""
    force = np.zeros_like(x)
    for corners in body.faces.nodes:
        share, area = shares(corners), area_vector(x[corners])
        size = np.linalg.norm(area)
        change = face_force(corners, share, world, x, ahead) - face_force(corners, share, world, x, v)
        velocity = share @ ahead[corners] - world[2]
        outward, speed = np.dot(velocity, area) / size, np.linalg.norm(velocity)
        if outward > 0:
            slope = size * (world[0] + world[1] * (speed + outward**2 / speed))
            change /= 1.0 + face_mobility(body, duration, corners) * slope
        for node, part in zip(corners, share, strict=True):
            force[node] += part * change
    return force


def filtered_matrix(body, world, rest_length, h, least, x):
    """What the leapfrog filters by, (3N,3N) kg: h^2 K + 2 h D of each element, frozen, but at least `least` h D.

    A unit's strain across is taken to be at least -0.1, an anchor's at least zero; gas counts by its compression.
    """

    def weight(stiffness, damping):
        return max(h**2 * stiffness + 2 * h * damping, least * h * damping)

    springs = body.springs
    matrix = np.zeros((len(x), 3, len(x), 3))
    for (i, j), c, k, natural in zip(springs.nodes, springs.stiffness, springs.damping, rest_length, strict=True):
        length = np.linalg.norm(x[j] - x[i])
        along = np.outer(x[j] - x[i], x[j] - x[i]) / length**2
        across = h**2 * c * max(-0.1, (length - natural) / length)
        block = weight(c, k) * along + across * (np.eye(3) - along)
        for p, q, sign in ((i, i, 1), (j, j, 1), (i, j, -1), (j, i, -1)):
            matrix[p, :, q] += sign * block
    for i, c, k, along, strain in anchors_of(world, x):
        matrix[i, :, i] += weight(c, k) * along + h**2 * c * strain * (np.eye(3) - along)
    for t, corners, block in tet_blocks(body, x) if body.tets is not None else ():
        for a, p in enumerate(corners):
            for b, q in enumerate(corners):
                part = block[3 * a : 3 * a + 3, 3 * b : 3 * b + 3]
                matrix[p, :, q] += weight(1.0, body.tets.relaxation_time[t]) * part
    matrix = matrix.reshape(x.size, x.size)
    for c, gas in enumerate(body.chambers.gas) if body.chambers is not None else ():
        volume, slope = gas_volume(body.chambers, c, x)
        matrix += h**2 * gas / volume**2 * np.outer(slope, slope)
    return matrix


def anchor_rates(body, world):
    """Stiffness and damping over mass of the node that anchors hold fastest."""
    stiffness, damping = np.zeros(len(body.mass)), np.zeros(len(body.mass))
    if world.anchors is not None:
        np.add.at(stiffness, world.anchors.node, world.anchors.stiffness)
        np.add.at(damping, world.anchors.node, world.anchors.damping)
    inverse = body.inverse_mass.max(axis=1)
    return (stiffness * inverse).max(), (damping * inverse).max()


def chebyshev_filter(stages, operator):
    """Polynomial C (1 - T_p(nu - beta z) / T_p(nu)) / z of a matrix: power series, by Horner. Also where it ends."""
    nu = 1.0 + 4.0 / stages**2
    chebyshev = np.polynomial.Chebyshev.basis(stages)
    top, slope = chebyshev(nu), chebyshev.deriv()(nu)
    constant = 4.0 / (1.0 + 1.0 / top)
    beta = top / slope / constant
    shifted = chebyshev.convert(kind=np.polynomial.Polynomial)(np.polynomial.Polynomial([nu, -beta]))
    coefficients = -constant * shifted.coef[1:] / top
    result = np.zeros_like(operator)
    for coefficient in coefficients[::-1]:
        result = result @ operator + coefficient * np.eye(len(operator))
    return result, (1.0 + nu) / beta, coefficients


def leapfrog_chebyshev(body, world, rest, t, h, x, v):
    """Half a drift, a kick through the filter as a polynomial of a dense matrix, half a drift; the air by itself."""
    slowed = np.exp(-0.5 * h * world.viscosity * body.inverse_mass)
    v, world = slowed * v, world._replace(viscosity=0.0)
    middle, lengths, inverse = x + 0.5 * h * v, rest(t + 0.5 * h), body.inverse_mass.ravel()
    pulled, held_back = anchor_rates(body, world)
    fastest = highest_rate(body, stiffness_matrix(body)) + pulled
    dampest = highest_rate(body, stiffness_matrix(body, "damping")) + held_back
    viscous = 1.2 * h * dampest
    wanted = 1.2 * h**2 * fastest + 2.0 * viscous
    stages = 2
    while chebyshev_filter(stages, np.zeros((1, 1)))[1] < wanted or (stages == 2 and viscous > 2.0):
        stages += 1
    _, _, coefficients = chebyshev_filter(stages, np.zeros((1, 1)))
    least = -0.5 / coefficients[1] if stages == 2 else 0.0  # two stages hold back half a step of damping or more
    matrix = filtered_matrix(body, world, lengths, h, least, middle)
    filtering, _, _ = chebyshev_filter(stages, inverse[:, None] * matrix)
    acceleration = total_force(body, world, lengths, middle, v).ravel() * inverse
    kick = borne(world.planes, middle, v, h, (filtering @ acceleration).reshape(x.shape))
    kick = kick + water_change(body, world, 0.5 * h, middle, v, v + 0.5 * h * kick) * body.inverse_mass
    v = v + h * kick
    return middle + 0.5 * h * v, slowed * v


STEPS = {
    "symplectic_euler": symplectic_euler,
    "rk4": rk4,
    "semi_implicit": semi_implicit,
    "explicit_euler": explicit_euler,
    "midpoint": midpoint,
    "linearly_implicit": linearly_implicit,
    "linearly_implicit_projected": partial(linearly_implicit, projected=True),
    "linearly_implicit_water": partial(linearly_implicit, wet=True),
    "rosenbrock": rosenbrock,
    "leapfrog_chebyshev": leapfrog_chebyshev,
    "dop853": accurate,
    "radau": accurate,
}
"""One step of every method of INTEGRATORS."""


def advance(name, body, world, rest_length, rate, x, v, h, n):
    """Take n steps of h with rest lengths that move linearly from `rest_length` at `rate`; returns (x, v)."""
    for s in range(n):
        x, v = STEPS[name](body, world, lambda t: rest_length + t * rate, s * h, h, x, v)
        v = bounce(body, world, h, x, v)
    return x, v


# Measures


def momentum(mass, v):
    """Linear momentum, (3,)."""
    return mass @ v


def angular_momentum(mass, x, v):
    """Angular momentum about the origin, (3,)."""
    return mass @ np.cross(x, v)


def kinetic_energy(mass, v):
    """Energy of motion."""
    return 0.5 * np.sum(mass * np.sum(v * v, axis=1))


def polygon(corners):
    """The different nodes of a face, in order: four, or three where the third is given twice."""
    return list(corners[:3]) if corners[2] == corners[3] else list(corners)


def enclosed_volume(faces, x):
    """Volume inside a closed surface of triangles and bilinear patches.

    The volume under a bilinear patch is the mean of those under its two triangulations.
    """
    return sum(part * np.linalg.det(x[list(nodes)]) / 6 for face in faces.nodes for nodes, part in triangles(face))


def stiffness_matrix(body, kind="stiffness"):
    """Stiffness, or damping, of the body at rest, linearised: (3N,3N), node by node."""
    n, x = len(body.mass), body.position
    matrix = np.zeros((n, 3, n, 3))
    for (i, j), c in zip(body.springs.nodes, getattr(body.springs, kind), strict=True):
        direction = (x[j] - x[i]) / np.linalg.norm(x[j] - x[i])
        block = c * np.outer(direction, direction)
        for p, q, sign in ((i, i, 1), (j, j, 1), (i, j, -1), (j, i, -1)):
            matrix[p, :, q] += sign * block
    for t, nodes, block in tet_blocks(body, x) if body.tets is not None else ():
        factor = 1.0 if kind == "stiffness" else body.tets.relaxation_time[t]
        for a, p in enumerate(nodes):
            for b, q in enumerate(nodes):
                matrix[p, :, q] += factor * block[3 * a : 3 * a + 3, 3 * b : 3 * b + 3]
    matrix = matrix.reshape(3 * n, 3 * n)
    for c, gas in enumerate(body.chambers.gas) if body.chambers is not None and kind == "stiffness" else ():
        volume, slope = gas_volume(body.chambers, c, x)
        matrix += gas / volume**2 * np.outer(slope, slope)
    return matrix


def highest_rate(body, matrix):
    """Highest eigenvalue of M^-1 times a symmetric matrix (3N,3N), held degrees of freedom left out."""
    weight = np.sqrt(body.inverse_mass.ravel())
    return np.linalg.eigvalsh(matrix * np.outer(weight, weight))[-1]


def highest_frequency(body):
    """Angular frequency of the body's fastest vibration about rest, rad per unit of time."""
    return np.sqrt(highest_rate(body, stiffness_matrix(body)))


def mirrored_muscles(fish):
    """(M,) the muscle that each muscle becomes when left and right are exchanged, found through its two nodes."""
    ends = [frozenset(map(int, fish.body.springs.nodes[e])) for e in fish.muscles]
    return np.array([ends.index(frozenset(int(fish.mirror[i]) for i in pair)) for pair in ends])


# Scenes


def random_state(fish, rng, displacement=0.02, speed=1.0):
    """A deformed, moving and turned fish: displacements in body lengths, speeds in body lengths a contraction time."""
    size = fish.body.position.shape
    turn, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    turn *= np.sign(np.linalg.det(turn))
    x = (fish.body.position + displacement * fish.length * rng.uniform(-1, 1, size)) @ turn.T
    v = speed * fish.length / fish.contraction_time * rng.uniform(-1, 1, size)
    return x, v


SHORTER = {"explicit_euler": 1 / 32, "midpoint": 1 / 4}
"""The part of an ordinary step that a method bears: light damping, all that holds explicit Euler, holds little."""


def dense_water(fish, law="quadratic", current=(0.0, 0.0, 0.0)):
    """Water about as dense as the fish, which fills a hundredth of its length cubed: (linear, quadratic, current).

    The linear law resists a speed of one length a contraction time as the quadratic one does. `current` is in that
    unit too.
    """
    unit = fish.length / fish.contraction_time
    quadratic = 0.5 * 1.5 * fish.body.mass.sum() / (0.01 * fish.length**3)
    flow = unit * np.asarray(current, dtype=float)
    return (0.0, quadratic, flow) if law == "quadratic" else (quadratic * unit, 0.0, flow)
