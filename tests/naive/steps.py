"""Reference implementations of the methods: one step of each, and many. rest(t) gives the rest lengths at time t."""

from functools import partial

import numpy as np
from scipy.integrate import solve_ivp

from naive.elements import barrier_stiffness, gas_volume, tet_blocks
from naive.forces import (
    anchor_rates,
    anchors_of,
    area_vector,
    at,
    bounce,
    constrain,
    face_force,
    face_friction,
    with_reaction,
)
from naive.sums import (
    highest_frequency,
    highest_rate,
    implicit_matrices,
    other_force,
    stiffness_matrix,
    total_force,
)  # fmt: skip


def symplectic_euler(body, world, rest, t, h, x, v):
    """Velocity first, then position with the new velocity."""
    v = v + h * total_force(body, at(world, t), rest(t), x, v) * body.inverse_mass
    return x + h * v, v


def rk4(body, world, rest, t, h, x, v):
    """The classical Runge-Kutta method on y = (x, v), with the rest lengths of each stage's own time."""

    def slope(time, y):
        return np.array([y[1], total_force(body, at(world, time), rest(time), y[0], y[1]) * body.inverse_mass])

    y = np.array([x, v])
    k1 = slope(t, y)
    k2 = slope(t + h / 2, y + h / 2 * k1)
    k3 = slope(t + h / 2, y + h / 2 * k2)
    k4 = slope(t + h, y + h * k3)
    x, v = y + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
    return x, v


def tu_system(body, world, rest_length, h, x, v):
    """Matrix A (N,N) and load G (N,3) of Tu's method: M/h + h Laplacian(eta), and M v/h + sum(eta r) + f.

    Anchors with a length are springs too; those without are wholly implicit. The load is less what presses on walls.
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
            load[i] += c * (r + h * moving) + k * moving
        else:
            eta = (c * (length - natural) + k * np.dot(moving - v[i], r) / length) / length
            matrix[i, i] += h * eta
            load[i] += eta * r
    return matrix, with_reaction(world.planes, x, v, load) + body.mass[:, None] / h * v


def semi_implicit(body, world, rest, t, h, x, v):
    """Tu's semi-implicit Euler method, solved as a dense system of the free nodes, axis by axis."""
    matrix, load = tu_system(body, at(world, t), rest(t), h, x, v)
    before, v = v, v.copy()
    for axis in range(3):
        free = body.inverse_mass[:, axis] > 0
        known = load[free, axis] - matrix[np.ix_(free, ~free)] @ v[~free, axis]
        v[free, axis] = np.linalg.solve(matrix[np.ix_(free, free)], known)
    v = before + constrain(world.planes, x, before, 1.0, v - before)
    return x + h * v, v


def explicit_euler(body, world, rest, t, h, x, v):
    """Both with what they are at the start."""
    return x + h * v, v + h * total_force(body, at(world, t), rest(t), x, v) * body.inverse_mass


def midpoint(body, world, rest, t, h, x, v):
    """Slopes of the half step."""
    mx, mv = explicit_euler(body, world, rest, t, h / 2, x, v)
    return x + h * mv, v + h * total_force(body, at(world, t + h / 2), rest(t + h / 2), mx, mv) * body.inverse_mass


def linearly_implicit(body, world, rest, t, h, x, v, **which):
    """Linearly implicit Euler as Baraff & Witkin have it, dense in what is free, rest lengths of its end."""
    stiffness, damping = implicit_matrices(body, at(world, t + h), rest(t + h), x, v, **which)
    matrix = np.diag(np.repeat(body.mass, 3)) + h * damping + h**2 * stiffness
    load = h * (total_force(body, at(world, t + h), rest(t + h), x, v).ravel() - h * stiffness @ v.ravel())
    free, change = body.inverse_mass.ravel() > 0, np.zeros(x.size)
    change[free] = np.linalg.solve(matrix[np.ix_(free, free)], load[free])
    v = v + h * constrain(world.planes, x, v, h, change.reshape(x.shape) / h)
    return x + h * v, v


def rosenbrock(body, world, rest, t, h, x, v):
    """ROS2 on y = (x, v), as a dense system of order 6N, less those that are fixed.

    The rates of change of rest lengths and anchors add gamma h in the first slope, and take it away in the second.
    """
    gamma, size, mass = 1 - 1 / np.sqrt(2), x.size, np.repeat(body.mass, 3)
    moves = np.concatenate([np.ones(size, bool), body.inverse_mass.ravel() > 0])
    early, late = t + gamma * h, t + (1.0 - gamma) * h
    stiffness, damping = implicit_matrices(body, at(world, early), rest(early), x, v)
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
        return np.concatenate([v.ravel(), total_force(body, at(world, time), rest(time), x, v).ravel() / mass])

    y = np.concatenate([x.ravel(), v.ravel()])
    k1 = solve(slope(early, y))
    p = constrain(world.planes, x, v, h, k1[size:].reshape(x.shape)).ravel()
    k1 = np.concatenate([v.ravel() + gamma * h * p, p])
    k2 = solve(slope(late, y + h * k1) - 2 * k1)
    change = (1.5 * p + 0.5 * k2[size:]).reshape(x.shape)
    q = 2 * constrain(world.planes, x, v, h, change).ravel() - 3 * p
    k2 = np.concatenate([v.ravel() + h * p - 2 * k1[:size] + gamma * h * q, q])
    return (y + 1.5 * h * k1 + 0.5 * h * k2).reshape(2, -1, 3)


def accurate(body, world, rest, t, h, x, v):
    """The reference solution: every step to 1e-12 of the body's size, and of that times its highest frequency."""

    def slope(time, y):
        x, v = y.reshape(2, -1, 3)
        force = total_force(body, at(world, time), rest(time), x, v)
        return np.concatenate([v.ravel(), (force * body.inverse_mass).ravel()])

    y = np.concatenate([x.ravel(), v.ravel()])
    scale = np.abs(body.position).max() * np.repeat([1.0, highest_frequency(body)], x.size)
    end = solve_ivp(slope, (t, t + h), y, method="DOP853", rtol=1e-12, atol=1e-12 * scale).y[:, -1]
    return end.reshape(2, -1, 3)


# The leapfrog with Chebyshev-filtered kicks


def face_mobility(body, duration, corners, share):
    """Velocity that a face gains from a force of 1 N while the faces around have the same, as far as they face so."""
    rest, gained = body.position, 0.0
    own = area_vector(rest[corners])
    for other, parts in zip(body.faces.nodes, body.faces.share, strict=True):
        area = area_vector(rest[other])
        alike = max(0.0, own @ area / np.linalg.norm(own) / np.linalg.norm(area))
        for node, part in zip(corners, share, strict=True):
            gained += alike * duration * part * (parts @ (other == node)) * body.inverse_mass[node].max()
    return gained


def water_pushes(body, world, duration, x, v, ahead):
    """Forces of the water (N,3) at v, and their change when v becomes `ahead`, each face's drag on itself implicit.

    A face that its push would turn around in this time is pushed no more than stops it. Friction
    stops no face within a step, as if all faces around had the same.
    """
    first, change = np.zeros_like(x), np.zeros_like(x)
    for corners, share, factor in zip(body.faces.nodes, body.faces.share, body.faces.drag, strict=True):
        area = area_vector(x[corners])
        size, mobility = np.linalg.norm(area), face_mobility(body, duration, corners, share)
        push = factor * face_force(corners, share, world, x, v)
        outward = np.dot(share @ v[corners] - world[2], area) / size
        if mobility * np.linalg.norm(push) > outward > 0:
            push = -outward / mobility * area / size
        differs = factor * face_force(corners, share, world, x, ahead) - push
        velocity = share @ ahead[corners] - world[2]
        outward = np.dot(velocity, area) / size
        speed = np.sqrt(outward**2 + world.oblique * (velocity @ velocity - outward**2))
        if outward > 0:
            slope = factor * size * (world[0] + world[1] * (speed + outward**2 / speed))
            differs /= 1.0 + mobility * slope
        most = 0.25 / mobility if mobility else np.inf
        pulls = []
        for speeds in (v, ahead):
            rough, along = face_friction(body, corners, share, world, x, speeds)
            pulls.append(-min(rough, most) * along)
        push, differs = push + pulls[0], differs + pulls[1] - pulls[0]
        for node, part in zip(corners, share, strict=True):
            first[node] += part * push
            change[node] += part * differs
    return first, change


def filtered_matrix(body, world, rest_length, h, least, x, factor=1.0):
    """What the leapfrog filters by, (3N,3N) kg: factor (h^2 K + 2 h D) of each element, frozen, at least `least` h D.

    A unit's strain across is taken to be at least -0.1, an anchor's at least zero; gas counts by its compression,
    a barrier by its stiffness along the gradient of its volume.
    """

    def weight(stiffness, damping):
        return max(factor * (h**2 * stiffness + 2 * h * damping), least * h * damping)

    springs = body.springs
    matrix = np.zeros((len(x), 3, len(x), 3))
    for (i, j), c, k, natural in zip(springs.nodes, springs.stiffness, springs.damping, rest_length, strict=True):
        length = np.linalg.norm(x[j] - x[i])
        along = np.outer(x[j] - x[i], x[j] - x[i]) / length**2
        across = factor * h**2 * c * max(-0.1, (length - natural) / length)
        block = weight(c, k) * along + across * (np.eye(3) - along)
        for p, q, sign in ((i, i, 1), (j, j, 1), (i, j, -1), (j, i, -1)):
            matrix[p, :, q] += sign * block
    for i, c, k, along, strain in anchors_of(world, x):
        matrix[i, :, i] += weight(c, k) * along + factor * h**2 * c * strain * (np.eye(3) - along)
    for t, corners, block, turning in tet_blocks(body, x, 0 * x, projected=True) if body.tets is not None else ():
        for a, p in enumerate(corners):
            for b, q in enumerate(corners):
                here = slice(3 * a, 3 * a + 3), slice(3 * b, 3 * b + 3)
                matrix[p, :, q] += weight(1.0, body.tets.relaxation_time[t]) * block[here]
                matrix[p, :, q] += factor * h**2 * turning[here]
    matrix = matrix.reshape(x.size, x.size)
    for c, gas in enumerate(body.compartments.gas) if body.compartments is not None else ():
        volume, slope = gas_volume(body.compartments, c, x)
        matrix += factor * h**2 * gas / volume**2 * np.outer(slope, slope)
    if body.barriers is not None:
        matrix += factor * h**2 * barrier_stiffness(body.barriers, x)
    return matrix


def chebyshev_filter(stages, operator):
    """Polynomial C (1 - T_p(nu - beta z) / T_p(nu)) / z of a matrix: power series, by Horner. Also where it ends."""
    nu = 1.0 + 3.5 / stages**2
    chebyshev = np.polynomial.Chebyshev.basis(stages)
    top, slope = chebyshev(nu), chebyshev.deriv()(nu)
    constant = 0.8 * 4.0 / (1.0 + 1.0 / top)
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
    viscous = 1.1 * h * dampest
    wanted = 1.1 * h**2 * fastest + 2.0 * viscous
    stages = 2
    while chebyshev_filter(stages, np.zeros((1, 1)))[1] < wanted or (stages == 2 and viscous > 2.0):
        stages += 1
    _, _, coefficients = chebyshev_filter(stages, np.zeros((1, 1)))
    least = -0.5 / coefficients[1] if stages == 2 else 0.0  # two stages hold back half a step of damping or more
    world = at(world, t + 0.5 * h)
    matrix = filtered_matrix(body, world, lengths, h, least, middle)
    filtering, _, _ = chebyshev_filter(stages, inverse[:, None] * matrix)
    pushed, _ = water_pushes(body, world, 0.5 * h, middle, v, v)
    dry = world._replace(linear=0.0, quadratic=0.0, friction=0.0)
    acceleration = total_force(body, dry, lengths, middle, v, pushed).ravel() * inverse
    kick = constrain(world.planes, middle, v, h, (filtering @ acceleration).reshape(x.shape))
    _, change = water_pushes(body, world, 0.5 * h, middle, v, v + 0.5 * h * kick)
    kick = kick + change * body.inverse_mass
    v = v + h * kick
    return middle + 0.5 * h * v, slowed * v


# All methods

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
