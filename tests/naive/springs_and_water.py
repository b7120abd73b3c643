"""Reference implementations of the springs and of the water on the faces."""

import numpy as np


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
    """Force of the water along the normal of one face, (3,): nothing on a face that moves inward."""
    linear, quadratic, current = world[:3]
    area = area_vector(x[corners])
    size = np.linalg.norm(area)
    normal = area / size
    velocity = share @ v[corners] - current
    outward = np.dot(normal, velocity)
    pressure = linear * outward + quadratic * np.linalg.norm(velocity) * outward
    return min(0.0, -pressure) * size * normal


def face_friction(body, corners, share, world, x, v):
    """Friction of the water on one face over its velocity along itself, N s/m, and that velocity (3,)."""
    area = area_vector(x[corners])
    size = np.linalg.norm(area)
    velocity = share @ v[corners] - world.current
    length = max(np.ptp(body.position[:, axis]) for axis in range(3))
    coefficient = world.friction / np.sqrt(length)
    along = velocity - np.dot(velocity, area) * area / size**2
    return coefficient * size * np.linalg.norm(velocity) ** 0.5, along


def water_force(body, world, x, v):
    """Force of the water on every node, (N,3)."""
    force, faces = np.zeros_like(x), body.faces
    for corners, share, factor in zip(faces.nodes, faces.share, faces.drag, strict=True):
        push = factor * face_force(corners, share, world, x, v)
        rough, along = face_friction(body, corners, share, world, x, v)
        push -= rough * along
        for node, part in zip(corners, share, strict=True):
            force[node] += part * push
    return force
