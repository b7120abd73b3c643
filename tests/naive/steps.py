"""Reference implementations of the methods: one step of each, and many. rest(t) gives the rest lengths at time t."""

from functools import partial

import numpy as np
from scipy.integrate import solve_ivp

from naive.leapfrog import leapfrog_chebyshev
from naive.sums import highest_frequency, implicit_matrices, other_force, total_force
from naive.surroundings import at, bounce, constrain, with_reaction


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
            load[i] += c * r + k * moving
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
    """ROS2 on y = (x, v), as a dense system of order 6N, less those that are fixed."""
    gamma, size, mass = 1 - 1 / np.sqrt(2), x.size, np.repeat(body.mass, 3)
    moves = np.concatenate([np.ones(size, bool), body.inverse_mass.ravel() > 0])
    stiffness, damping = implicit_matrices(body, at(world, t), rest(t), x, v)
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
    k1 = solve(slope(t, y))
    p = constrain(world.planes, x, v, h, k1[size:].reshape(x.shape)).ravel()
    k1 = np.concatenate([v.ravel() + gamma * h * p, p])
    k2 = solve(slope(t + h, y + h * k1) - 2 * k1)
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
