"""Rejected methods that make one constant matrix, for the body at rest and the step."""

import numpy as np

from benchmarks.accuracy.rejected_methods.common import (
    RejectedMethod,
    at_rest,
    isotropic,
    leapfrog,
    make_force,
    multiply,
    pour,
    pour_back,
)
from fish_env._jit import INDEX, kernel
from fish_env.bodies.mass_spring import LAYERS
from fish_env.forces.plan import H
from fish_env.integrators._common import move_rest_lengths
from fish_env.simd import Kind, cross, dot, fma, sqrt, zero

ITERATIONS = 10  # of the local-global method, a step
FIRST = tuple(layer[0] for layer in LAYERS)  # node of each layer; the others follow it
SIZE = tuple(len(layer) for layer in LAYERS)


def inverse(matrix, columns) -> dict:
    """The inverse of a matrix, right-hand sides and solutions."""
    return {"inverse": np.linalg.inv(matrix), "b": np.zeros((len(matrix), columns)),
            "c": np.zeros((len(matrix), columns))}  # fmt: skip


# Springs that resist in all directions


def euler_bound(body, kind, h) -> dict:
    """Of implicit Euler's system, with every spring's stiffness and damping in all directions."""
    return inverse(isotropic(body, h * body.springs.damping + h * h * body.springs.stiffness), 3)


def leapfrog_bound(body, kind, h) -> dict:
    """The same of leapfrog's."""
    return inverse(isotropic(body, 0.5 * h * body.springs.damping + 0.25 * h * h * body.springs.stiffness), 3)


def make_kick(names):
    """The kick of the forces on the mass and the resistance that the inverse stands for."""
    force = make_force(names)

    @kernel
    def kick(body, world, control, x, v, work, cache):
        h, f = control.plans[control.row[0], H], work.f
        force(body, world, control, x, v, f, cache)
        for i in range(x.size):
            f[i] = h * f[i]
        pour(f, work.b)
        multiply(work.inverse, work.b, work.c)
        pour_back(work.c, f)

    return kick


def isotropic_euler(names):
    """Each spring's stiffness and damping in all directions, which bounds any tangent: one constant (N,N) matrix."""
    kick = make_kick(names)

    @kernel
    def run(body, world, control, x, v, work, cache, n):
        h = control.plans[control.row[0], H]
        for s in range(n):
            move_rest_lengths(control, s * h)
            kick(body, world, control, x, v, work, cache)
            for i in range(x.size):
                v[i] += work.f[i]
                x[i] = fma(h, v[i], x[i])

    return run


# The stiffness at rest, turned with the body


@kernel
def orthonormal(forward, left):
    """Unit vectors along the first, along the second as far as it is at right angles to it, and along both."""
    forward = forward / sqrt(dot(forward, forward))
    left = left - dot(left, forward) * forward
    left = left / sqrt(dot(left, left))
    return forward, left, cross(forward, left)


@kernel
def side(x, k):
    """From the right to the left of the square layer k."""
    i = FIRST[k]
    return x[INDEX(i)] - x[INDEX(i + 1)] - x[INDEX(i + 2)] + x[INDEX(i + 3)]


@kernel
def frames_of_layers(x, centre, frames):
    """Forward, left and up of every layer, from its neighbours and itself, in frames (21,); centre (7,) is scratch."""
    for k in range(7):
        centre[k] = zero(x)
        for m in range(SIZE[k]):
            centre[k] += (1.0 / SIZE[k]) * x[INDEX(FIRST[k] + m)]
    for k in range(7):
        forward = centre[INDEX(max(k - 1, 0))] - centre[INDEX(min(k + 1, 6))]
        f, left, u = orthonormal(forward, side(x, min(max(k, 1), 5)))
        frames[3 * k], frames[3 * k + 1], frames[3 * k + 2] = f, left, u


@kernel
def frames_of_body(x, centre, frames):
    """The same of the body as a whole for every layer."""
    forward, left = zero(x), zero(x)
    for k in range(1, 6):
        left += side(x, k)
    for m in range(4):
        forward += x[INDEX(FIRST[1] + m)] - x[INDEX(FIRST[4] + m)]
    f, across, u = orthonormal(forward, left)
    for k in range(7):
        frames[3 * k], frames[3 * k + 1], frames[3 * k + 2] = f, across, u


@kernel
def turn(vectors, old, new):
    """Turn the vectors (N,) of every layer as its old frame would have to be turned to become the new one."""
    for k in range(7):
        p, q, r = old[3 * k], old[3 * k + 1], old[3 * k + 2]
        for m in range(SIZE[k]):
            i = INDEX(FIRST[k] + m)
            y = vectors[i]
            vectors[i] = dot(p, y) * new[3 * k] + dot(q, y) * new[3 * k + 1] + dot(r, y) * new[3 * k + 2]


def turning(frames):
    """The scratch of a method whose matrix turns with the body."""

    def extra(body, kind, h) -> dict:
        masses, stiffness, damping = at_rest(body)
        vectors = {name: kind.vectors(21) for name in ("start", "frames")}
        vectors |= {"centre": kind.vectors(7), "acceleration": kind.vectors(len(body.mass)), "begun": np.zeros(1)}
        plain = getattr(frames, "py_func", frames)
        plain(Kind(1).rows(body.position), vectors["centre"], vectors["start"])
        return vectors | inverse(masses + 0.5 * h * damping + 0.25 * h * h * stiffness, 1)

    return extra


def make_turned(frames):
    """The kernel that solves for what stands in `work.f`, turned back to rest, and turns the solution again."""

    @kernel
    def turned(x, work):
        frames(x, work.centre, work.frames)
        turn(work.f, work.frames, work.start)
        pour(work.f, work.b)
        multiply(work.inverse, work.b, work.c)
        pour_back(work.c, work.f)
        turn(work.f, work.start, work.frames)

    return turned


def rest_matrix(frames):
    """Leapfrog with the (3N,3N) matrix of the body at rest, inverted once, turned with each layer or the body."""

    @leapfrog
    def make_run(names):
        force, turned = make_force(names), make_turned(frames)

        @kernel
        def kick(body, world, control, x, v, work, cache):
            h, f = control.plans[control.row[0], H], work.f
            force(body, world, control, x, v, f, cache)
            for i in range(x.size):
                f[i] = h * f[i]
            turned(x, work)

        return kick

    return make_run


def newmark_rest_matrix(names):
    """Newmark's trapezoid (Newmark 1959), one correction with the turned matrix: of second order whatever that is."""
    force, turned = make_force(names), make_turned(frames_of_layers)

    @kernel
    def run(body, world, control, x, v, work, cache, n):
        h, f, a = control.plans[control.row[0], H], work.f, work.acceleration
        if work.begun[0] == 0.0:
            work.begun[0] = 1.0
            move_rest_lengths(control, 0.0)
            force(body, world, control, x, v, f, cache)
            for i in range(x.size):
                a[i] = body.inverse_mass[i] * f[i]
        for s in range(n):
            for i in range(x.size):
                x[i] = fma(0.5 * h * h, a[i], fma(h, v[i], x[i]))
                v[i] = fma(h, a[i], v[i])
            move_rest_lengths(control, (s + 1) * h)
            force(body, world, control, x, v, f, cache)
            for i in range(x.size):
                f[i] = fma(-body.mass[i], a[i], f[i])
            turned(x, work)
            for i in range(x.size):
                a[i] += f[i]
                x[i] = fma(0.25 * h * h, f[i], x[i])
                v[i] = fma(0.5 * h, f[i], v[i])

    return run


# Local-global iteration


def local_global_work(body, kind, h) -> dict:
    """Weights (E,) of the springs, wanted lengths (E,), where inertia leads (N,), and the system."""
    weight = body.springs.stiffness + body.springs.damping / h
    stored = {name: kind.vectors(len(body.mass)) for name in ("inertia", "new")}
    matrix = isotropic(body, h * h * weight)
    return {"weight": weight, "wanted": np.zeros(len(weight)), **stored, **inverse(matrix, 3)}


@kernel
def wanted_lengths(body, control, x, h, work):
    """The lengths that stiffness and damping, which draws a spring to what it was, want together."""
    springs = body.springs
    for e in range(springs.stiffness.size):
        r = x[INDEX(springs.nodes[e, 1])] - x[INDEX(springs.nodes[e, 0])]
        now = springs.damping[e] / h * sqrt(dot(r, r))
        work.wanted[e] = (springs.stiffness[e] * control.rest_length[e] + now) / work.weight[e]


def local_global(names):
    """Implicit Euler by local-global iteration, one constant (N,N) matrix (Liu et al. 2013; Bouaziz et al. 2014).

    A spring's damping draws its length to what it was: a stiffness k/h towards that.
    """
    water = make_force(tuple(name for name in names if name == "water"))

    @kernel
    def run(body, world, control, x, v, work, cache, n):
        h, f, new, inertia = control.plans[control.row[0], H], work.f, work.new, work.inertia
        for s in range(n):
            move_rest_lengths(control, (s + 1) * h)
            water(body, world, control, x, v, f, cache)
            wanted_lengths(body, control, x, h, work)
            for i in range(x.size):
                inertia[i] = fma(h * h, body.inverse_mass[i] * f[i], fma(h, v[i], x[i]))
                new[i] = inertia[i]
            for _ in range(ITERATIONS):
                for i in range(x.size):
                    f[i] = body.mass[i] * inertia[i]
                for e in range(work.weight.size):
                    i, j = INDEX(body.springs.nodes[e, 0]), INDEX(body.springs.nodes[e, 1])
                    r = new[j] - new[i]
                    goal = (h * h * work.weight[e] * work.wanted[e] / sqrt(dot(r, r))) * r
                    f[i] -= goal
                    f[j] += goal
                pour(f, work.b)
                multiply(work.inverse, work.b, work.c)
                pour_back(work.c, new)
            for i in range(x.size):
                v[i] = (1.0 / h) * (new[i] - x[i])
                x[i] = new[i]

    return run


CONSTANT_MATRIX = (
    RejectedMethod("isotropic", isotropic_euler, euler_bound, (1, 0, 1), (0, 1)),
    RejectedMethod("isotropic_leapfrog", leapfrog(make_kick), leapfrog_bound, (1, 0, 1), (0, 1)),
    RejectedMethod("rest_matrix", rest_matrix(frames_of_layers), turning(frames_of_layers), (1, 0, 1), (0, 1)),
    RejectedMethod("rest_matrix_body", rest_matrix(frames_of_body), turning(frames_of_body), (1, 0, 1), (0, 1)),
    RejectedMethod("newmark_rest_matrix", newmark_rest_matrix, turning(frames_of_layers), (1, 0, 1), (1, 1)),
    RejectedMethod("local_global", local_global, local_global_work, (ITERATIONS, 0, ITERATIONS), (0, 1)),
)
