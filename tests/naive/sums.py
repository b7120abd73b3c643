"""Reference implementations of the sums over forces, of their derivatives, and of the implicit methods' matrices."""

import numpy as np

from naive.elements import barrier_force, gas_force, gas_volume, tet_blocks, tet_force
from naive.forces import (
    anchor_force,
    anchors_of,
    area_vector,
    face_friction,
    spring_force,
    water_force,
    with_reaction,
)  # fmt: skip


def other_force(body, world, x, v):
    """All but the springs, the anchors and the walls, (N,3): what Tu's method takes explicitly."""
    force = water_force(body, world, x, v)
    if body.tets is not None:
        force += tet_force(body, x, v)
    if body.compartments is not None:
        force += gas_force(body.compartments, x)
    if body.barriers is not None:
        force += barrier_force(body.barriers, x)
    if world.gravity is not None:
        force += body.mass[:, None] * world.gravity - world.viscosity * v
    return force


def total_force(body, world, rest_length, x, v, more=0.0):
    """All forces together, (N,3); with `more`, (N,3), before what walls answer."""
    force = spring_force(body.springs, rest_length, x, v) + other_force(body, world, x, v) + more
    if world.anchors is not None:
        force += anchor_force(world.anchors, x, v)
    return with_reaction(world.planes, x, v, force)


def derivatives(force, x, v, displacement, speed, columns=None):
    """-df/dx and -df/dv (3N,3N) of force(x, v) (N,3), by central differences of fourth order of these widths.

    Only some columns are computed if they are given.
    """
    found = []
    for which, width in ((0, displacement), (1, speed)):
        matrix = np.zeros((x.size, x.size))
        for column in range(x.size) if columns is None else columns:
            for shift, weight in ((-2, 1 / 12), (-1, -2 / 3), (1, 2 / 3), (2, -1 / 12)):
                state = [x.copy(), v.copy()]
                state[which].flat[column] += shift * width
                matrix[:, column] -= weight * force(*state).ravel() / width
        found.append(matrix)
    return found


def implicit_matrices(body, world, rest_length, x, v, projected=False, wet=False):
    """K and D (3N,3N) of a linearly implicit method, from those of each unit: c and eta, along it and across it.

    Of the tetrahedra they are those of linear elasticity, turned with them; of the anchors, along them or along all
    axes. The air damps every node. `projected` takes a negative eta as zero; `wet` adds to D what the normal velocity
    of a face changes in its force along the normal, and the ratio of friction to the velocity along the face.
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
    faces = zip(body.faces.nodes, body.faces.share, body.faces.drag, strict=True)
    for corners, share, factor in faces if wet else ():
        area = area_vector(x[corners])
        size = np.linalg.norm(area)
        velocity = share @ v[corners] - world[2]
        outward = np.dot(velocity, area) / size
        speed = np.sqrt(outward**2 + world.oblique * (velocity @ velocity - outward**2))
        normal = np.outer(area, area) / size**2
        drag = factor * size * (world[0] + world[1] * (speed + outward**2 / speed)) if outward > 0 else 0.0
        rough, _ = face_friction(body, corners, share, world, x, v)
        for p, part_p in zip(corners, share, strict=True):
            for q, part_q in zip(corners, share, strict=True):
                damping[p, :, q] += part_p * part_q * (drag * normal + rough * (np.eye(3) - normal))
    for t, corners, block, turning in tet_blocks(body, x, v, projected) if body.tets is not None else ():
        for a, p in enumerate(corners):
            for b, q in enumerate(corners):
                part = block[3 * a : 3 * a + 3, 3 * b : 3 * b + 3]
                stiffness[p, :, q] += part + turning[3 * a : 3 * a + 3, 3 * b : 3 * b + 3]
                damping[p, :, q] += body.tets.relaxation_time[t] * part
    for i, c, k, along, _ in anchors_of(world, x):
        stiffness[i, :, i] += c * along
        damping[i, :, i] += k * along
    for i in range(nodes):
        damping[i, :, i] += world.viscosity * np.eye(3)
    return stiffness.reshape(3 * nodes, -1), damping.reshape(3 * nodes, -1)


def stiffness_matrix(body, kind="stiffness"):
    """Stiffness, or damping, of the body at rest, linearised: (3N,3N), node by node."""
    n, x = len(body.mass), body.position
    matrix = np.zeros((n, 3, n, 3))
    for e, ((i, j), c) in enumerate(zip(body.springs.nodes, getattr(body.springs, kind), strict=True)):
        direction = (x[j] - x[i]) / np.linalg.norm(x[j] - x[i])
        block = c * np.outer(direction, direction)
        if kind == "stiffness":  # of a taut spring, also across it
            taut = c * (1 - body.springs.rest_length[e] / np.linalg.norm(x[j] - x[i]))
            block += taut * (np.eye(3) - np.outer(direction, direction))
        for p, q, sign in ((i, i, 1), (j, j, 1), (i, j, -1), (j, i, -1)):
            matrix[p, :, q] += sign * block
    for t, nodes, block, _ in tet_blocks(body, x, 0 * x) if body.tets is not None else ():
        factor = 1.0 if kind == "stiffness" else body.tets.relaxation_time[t]
        for a, p in enumerate(nodes):
            for b, q in enumerate(nodes):
                matrix[p, :, q] += factor * block[3 * a : 3 * a + 3, 3 * b : 3 * b + 3]
    matrix = matrix.reshape(3 * n, 3 * n)
    for c, gas in enumerate(body.compartments.gas) if body.compartments is not None and kind == "stiffness" else ():
        volume, slope = gas_volume(body.compartments, c, x)
        matrix += gas / volume**2 * np.outer(slope, slope)
        for k, way in enumerate(np.eye(3 * n)):  # the gradient is quadratic, so differences are exact
            ahead, behind = (gas_volume(body.compartments, c, x + sign * way.reshape(n, 3))[1] for sign in (1, -1))
            matrix[:, k] -= (gas / volume - body.compartments.ambient[c]) * (ahead - behind).ravel() / 2
    return matrix


def highest_rate(body, matrix):
    """Highest eigenvalue of M^-1 times a symmetric matrix (3N,3N), fixed degrees of freedom left out."""
    weight = np.sqrt(body.inverse_mass.ravel())
    return np.linalg.eigvalsh(matrix * np.outer(weight, weight))[-1]


def highest_frequency(body):
    """Angular frequency of the body's fastest vibration about rest, rad per unit of time."""
    return np.sqrt(highest_rate(body, stiffness_matrix(body)))
