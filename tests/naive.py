"""Slow, obvious twins of the compiled kernels, written from the equations in plain numpy and Python loops.

Nothing here calls a kernel. Every function takes one body (no batch) and returns new arrays.
"""

import numpy as np

VACUUM = (0.0, 0.0, np.zeros(3))


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
    linear, quadratic, current = world
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


def total_force(body, world, rest_length, x, v):
    """Springs and water together, (N,3)."""
    return spring_force(body.springs, rest_length, x, v) + water_force(body.faces, world, x, v)


# One step of each method: rest(t) gives the rest lengths at time t


def symplectic_euler(body, world, rest, t, h, x, v):
    """Velocity first, then position with the new velocity."""
    v = v + h * total_force(body, world, rest(t), x, v) / body.mass[:, None]
    return x + h * v, v


def rk4(body, world, rest, t, h, x, v):
    """The classical Runge-Kutta method on y = (x, v), with the rest lengths of each stage's own time."""

    def slope(time, y):
        return np.array([y[1], total_force(body, world, rest(time), y[0], y[1]) / body.mass[:, None]])

    y = np.array([x, v])
    k1 = slope(t, y)
    k2 = slope(t + h / 2, y + h / 2 * k1)
    k3 = slope(t + h / 2, y + h / 2 * k2)
    k4 = slope(t + h, y + h * k3)
    x, v = y + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
    return x, v


def tu_system(body, world, rest_length, h, x, v):
    """Matrix A (N,N) and load G (N,3) of Tu's method: M/h + h Laplacian(eta), and M v/h + sum(eta r) + f."""
    matrix = np.diag(body.mass / h)
    load = body.mass[:, None] / h * v + water_force(body.faces, world, x, v)
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
    return matrix, load


def semi_implicit(body, world, rest, t, h, x, v):
    """Tu's semi-implicit Euler method, solved as a dense system."""
    matrix, load = tu_system(body, world, rest(t), h, x, v)
    v = np.linalg.solve(matrix, load)
    return x + h * v, v


STEPS = {"symplectic_euler": symplectic_euler, "rk4": rk4, "semi_implicit": semi_implicit}
"""One step of every method of INTEGRATORS."""


def advance(name, body, world, rest_length, rate, x, v, h, n):
    """Take n steps of h with rest lengths that move linearly from `rest_length` at `rate`; returns (x, v)."""
    for s in range(n):
        x, v = STEPS[name](body, world, lambda t: rest_length + t * rate, s * h, h, x, v)
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

    def under(*triangle):
        return np.linalg.det(x[list(triangle)]) / 6

    volume = 0.0
    for corners in faces.nodes:
        p, q, r, s = corners
        if r == s:
            volume += under(p, q, r)
        else:
            volume += 0.5 * (under(p, q, r) + under(p, r, s) + under(p, q, s) + under(q, r, s))
    return volume


def stiffness_matrix(body):
    """Stiffness of the body at rest, linearised: (3N,3N), node by node."""
    n = len(body.mass)
    matrix = np.zeros((3 * n, 3 * n))
    for (i, j), c in zip(body.springs.nodes, body.springs.stiffness, strict=True):
        direction = body.position[j] - body.position[i]
        direction /= np.linalg.norm(direction)
        block = c * np.outer(direction, direction)
        a, b = slice(3 * i, 3 * i + 3), slice(3 * j, 3 * j + 3)
        matrix[a, a] += block
        matrix[b, b] += block
        matrix[a, b] -= block
        matrix[b, a] -= block
    return matrix


def highest_frequency(body):
    """Angular frequency of the body's fastest vibration about rest, rad per unit of time."""
    weight = np.repeat(body.mass, 3) ** -0.5
    return np.sqrt(np.linalg.eigvalsh(stiffness_matrix(body) * np.outer(weight, weight))[-1])


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


def dense_water(fish, law="quadratic", current=(0.0, 0.0, 0.0)):
    """Water about as dense as the fish, which fills a hundredth of its length cubed: (linear, quadratic, current).

    The linear law resists a speed of one length a contraction time as the quadratic one does. `current` is in that
    unit too.
    """
    unit = fish.length / fish.contraction_time
    quadratic = 0.5 * 1.5 * fish.body.mass.sum() / (0.01 * fish.length**3)
    flow = unit * np.asarray(current, dtype=float)
    return (0.0, quadratic, flow) if law == "quadratic" else (quadratic * unit, 0.0, flow)
