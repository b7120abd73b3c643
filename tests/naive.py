"""Slow, obvious twins of the compiled kernels, written from the equations in plain numpy and Python loops.

Nothing here calls a kernel. Every function takes one body (no batch) and returns new arrays.
"""

from functools import partial

import numpy as np
from scipy.integrate import solve_ivp

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


def implicit_matrices(body, world, rest_length, x, v, projected=False, wet=False):
    """K and D (3N,3N) of a linearly implicit method, from those of each unit: c and eta, along it and across it.

    `projected` takes a negative eta as zero; `wet` adds to D what the normal velocity of a face changes in its force
    along the normal.
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
    return stiffness.reshape(3 * nodes, -1), damping.reshape(3 * nodes, -1)


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


def explicit_euler(body, world, rest, t, h, x, v):
    """Both with what they are at the start."""
    return x + h * v, v + h * total_force(body, world, rest(t), x, v) / body.mass[:, None]


def midpoint(body, world, rest, t, h, x, v):
    """Slopes of the half step."""
    mx, mv = explicit_euler(body, world, rest, t, h / 2, x, v)
    return x + h * mv, v + h * total_force(body, world, rest(t + h / 2), mx, mv) / body.mass[:, None]


def linearly_implicit(body, world, rest, t, h, x, v, **which):
    """Linearly implicit Euler as Baraff & Witkin have it, as a dense system, rest lengths of its end."""
    stiffness, damping = implicit_matrices(body, world, rest(t + h), x, v, **which)
    matrix = np.diag(np.repeat(body.mass, 3)) + h * damping + h**2 * stiffness
    force = total_force(body, world, rest(t + h), x, v).ravel()
    v = v + np.linalg.solve(matrix, h * (force - h * stiffness @ v.ravel())).reshape(x.shape)
    return x + h * v, v


def rosenbrock(body, world, rest, t, h, x, v):
    """ROS2 on y = (x, v), as a dense system of order 6N."""
    gamma, size, mass = 1 - 1 / np.sqrt(2), x.size, np.repeat(body.mass, 3)
    stiffness, damping = implicit_matrices(body, world, rest(t), x, v)
    jacobian = np.zeros((2 * size, 2 * size))
    jacobian[:size, size:] = np.eye(size)
    jacobian[size:, :size] = -stiffness / mass[:, None]
    jacobian[size:, size:] = -damping / mass[:, None]
    matrix = np.eye(2 * size) - gamma * h * jacobian
    weight = np.repeat([1.0 / h, 1.0], size)  # positions and velocities in one unit: three digits better

    def solve(load):
        return np.linalg.solve(weight[:, None] * matrix / weight, weight * load) / weight

    def slope(time, y):
        x, v = y.reshape(2, -1, 3)
        return np.concatenate([v.ravel(), total_force(body, world, rest(time), x, v).ravel() / mass])

    y = np.concatenate([x.ravel(), v.ravel()])
    k1 = solve(slope(t, y))
    k2 = solve(slope(t + h, y + h * k1) - 2 * k1)
    return (y + 1.5 * h * k1 + 0.5 * h * k2).reshape(2, -1, 3)


def accurate(body, world, rest, t, h, x, v):
    """The true motion: every step to 1e-12 of the body's size, and of that times its highest frequency."""

    def slope(time, y):
        x, v = y.reshape(2, -1, 3)
        force = total_force(body, world, rest(time), x, v)
        return np.concatenate([v.ravel(), (force / body.mass[:, None]).ravel()])

    y = np.concatenate([x.ravel(), v.ravel()])
    scale = np.abs(body.position).max() * np.repeat([1.0, highest_frequency(body)], x.size)
    end = solve_ivp(slope, (t, t + h), y, method="DOP853", rtol=1e-12, atol=1e-12 * scale).y[:, -1]
    return end.reshape(2, -1, 3)


def face_mobility(body, duration, corners):
    """Velocity that a face gains from a force of 1 N while half the faces around each corner feel the same."""
    gained = 0.0
    for node, part in zip(corners, shares(corners), strict=True):
        carried = sum(shares(other) @ (other == node) for other in body.faces.nodes)
        gained += 0.5 * duration * part * carried / body.mass[node]
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


def elastic_tangent(springs, rest_length, x):
    """Stiffness (3N,3N) of the units, their strain across taken to be at least -0.1."""
    matrix = np.zeros((len(x), 3, len(x), 3))
    for (i, j), c, natural in zip(springs.nodes, springs.stiffness, rest_length, strict=True):
        length = np.linalg.norm(x[j] - x[i])
        along = np.outer(x[j] - x[i], x[j] - x[i]) / length**2
        block = c * (along + max(-0.1, (length - natural) / length) * (np.eye(3) - along))
        for p, q, sign in ((i, i, 1), (j, j, 1), (i, j, -1), (j, i, -1)):
            matrix[p, :, q] += sign * block
    return matrix.reshape(x.size, x.size)


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
    """Half a drift, a kick through the filter as a polynomial of a dense matrix, half a drift."""
    size, mass = x.size, np.repeat(body.mass, 3)
    middle, lengths = x + 0.5 * h * v, rest(t + 0.5 * h)
    stiffness = elastic_tangent(body.springs, lengths, middle)
    _, damping = implicit_matrices(body, VACUUM, lengths, middle, v)
    fastest = highest_frequency(body) ** 2
    dampest = highest_frequency(body._replace(springs=body.springs._replace(stiffness=body.springs.damping))) ** 2
    viscous = 1.2 * h * dampest
    wanted = 1.2 * h**2 * fastest + 2.0 * viscous
    stages = 2
    while chebyshev_filter(stages, np.zeros((1, 1)))[1] < wanted or (stages == 2 and viscous > 2.0):
        stages += 1
    acceleration = total_force(body, world, lengths, middle, v).ravel() / mass
    filtering, _, coefficients = chebyshev_filter(stages, (h**2 * stiffness + 2.0 * h * damping) / mass[:, None])
    if stages == 2:  # unit by unit, no less than half a step of damping
        held = -coefficients[1]
        elastic, viscous = held * h**2 * body.springs.stiffness, h * body.springs.damping
        along = np.maximum(elastic + 2.0 * held * viscous, 0.5 * viscous) - elastic
        least = body._replace(springs=body.springs._replace(stiffness=0 * along, damping=along))
        _, resisting = implicit_matrices(least, VACUUM, lengths, middle, 0 * v)
        filtering = np.eye(size) - (held * h**2 * stiffness + resisting) / mass[:, None]
    kick = (filtering @ acceleration).reshape(x.shape)
    kick = kick + water_change(body, world, 0.5 * h, middle, v, v + 0.5 * h * kick) / body.mass[:, None]
    v = v + h * kick
    return middle + 0.5 * h * v, v


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
