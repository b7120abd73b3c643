"""Rejected methods that make a matrix at every step."""

import numpy as np

from benchmarks.accuracy.rejected_methods.common import (
    RejectedMethod,
    leapfrog,
    make_force,
    pour,
    pour_back,
    set_masses,
    solve,
    spring,
    system,
)
from fish_env._jit import kernel
from fish_env.forces.evaluate import make_dual, make_jacobian
from fish_env.forces.plan import H
from fish_env.integrators._common import move_rest_lengths
from fish_env.simd import Pack, dot, floats, fma
from fish_env.world import VACUUM

NAMES = ("water", "springs")  # the forces on the fish that methods are tried on
RADIUS = 0.5  # of generalised-alpha: what is left of the fastest vibrations after a step
OLD_A, OLD = (2.0 * RADIUS - 1.0) / (RADIUS + 1.0), RADIUS / (RADIUS + 1.0)
GAMMA, BETA = 0.5 - OLD_A + OLD, 0.25 * (1.0 - OLD_A + OLD) ** 2


def one_for_all_axes(body, kind, number):
    """An (N,N) matrix."""
    return system(len(body.mass), 3)


def whole(body, kind, number):
    """A (3N,3N) matrix, and the exact derivatives of the forces."""
    size = 3 * len(body.mass)
    matrices = Pack("matrices", stiffness=np.zeros((size, size)), damping=np.zeros((size, size)),
                    dual=make_dual(body, VACUUM, NAMES))  # fmt: skip
    stored = {name: kind.vectors(len(body.mass)) for name in ("x", "v", "acceleration")}
    return {"matrices": matrices, "begun": np.zeros(1), **stored, **system(size, 1)}


@kernel
def add_effective(body, control, x, v, square, least, a):
    """Add to a matrix (N,N) the springs' effective stiffness, at least `least`, times the square of a time."""
    for e in range(body.springs.stiffness.size):
        i, j, r, inverse, strain = spring(body, control, x, e)
        fast = dot(r, v[j] - v[i]) * inverse * inverse
        weight = square * max(body.springs.stiffness[e] * strain + body.springs.damping[e] * fast, least)
        a[i, i] += weight
        a[j, j] += weight
        a[i, j] -= weight
        a[j, i] -= weight


def semi_implicit_positive(names):
    """Tu's step, its matrix made definite: only stretched springs are implicit. One (N,N) matrix a step."""
    force = make_force(names)

    @kernel
    def run(body, world, control, x, v, work, cache, n):
        h, f, a, b = control.plans[control.row[0], H], work.f, work.a, work.b
        for s in range(n):
            move_rest_lengths(control, s * h)
            force(body, world, control, x, v, f, cache)
            set_masses(body, a)
            add_effective(body, control, x, v, h * h, 0.0, a)
            for i in range(x.size):
                f[i] = fma(h, f[i], body.mass[i] * v[i])
            pour(f, b)
            solve(a, b)
            pour_back(b, v)
            for i in range(x.size):
                x[i] = fma(h, v[i], x[i])

    return run


@leapfrog
def semi_implicit_leapfrog(names):
    """Tu's matrix, his effective stiffness lagged, symmetric in time: one (N,N) matrix a step."""
    force = make_force(names)

    @kernel
    def kick(body, world, control, x, v, work, cache):
        h, f, a, b = control.plans[control.row[0], H], work.f, work.a, work.b
        force(body, world, control, x, v, f, cache)
        set_masses(body, a)
        add_effective(body, control, x, v, 0.25 * h * h, -np.inf, a)
        for i in range(x.size):
            f[i] = h * f[i]
        pour(f, b)
        solve(a, b)
        pour_back(b, f)

    return kick


def make_derive(names):
    """The kernel that sets the derivatives in `matrices` to those of these forces, at x and v."""
    jacobian = make_jacobian(names)

    @kernel
    def derive(body, world, control, x, v, matrices):
        dual = matrices.dual
        here, speed, rest = floats(dual.x), floats(dual.v), floats(dual.control.rest_length)
        from_x, from_v, from_rest = floats(x), floats(v), floats(control.rest_length)
        for i in range(x.size):
            for k in range(3):
                here[i, k, 0] = from_x[i, k, 0]
                speed[i, k, 0] = from_v[i, k, 0]
        for e in range(rest.shape[0]):
            rest[e, 0] = from_rest[e, 0]
        jacobian(body, world, dual, matrices.stiffness, matrices.damping, 0)

    return derive


@kernel
def set_system(body, matrices, inertia, viscous, elastic, a):
    """Set a matrix (3N,3N) to a part of the masses, and the derivatives times a time and the square of one."""
    stiffness, damping = matrices.stiffness, matrices.damping
    set_masses(body, a)
    for p in range(a.shape[0]):
        a[p, p] *= inertia
        for q in range(a.shape[1]):
            a[p, q] += viscous * damping[p, q] + elastic * stiffness[p, q]


def make_newton_kick(names, implicit, elastic):
    """A kick of leapfrog by the derivatives of the forces named `implicit`, of the stiffness or the damping alone."""
    force, derive = make_force(names), make_derive(implicit)
    quarter = 0.25 if elastic else 0.0

    @kernel
    def kick(body, world, control, x, v, work, cache):
        h, f, b = control.plans[control.row[0], H], work.f, work.b
        force(body, world, control, x, v, f, cache)
        derive(body, world, control, x, v, work.matrices)
        set_system(body, work.matrices, 1.0, 0.5 * h, quarter * h * h, work.a)
        for i in range(x.size):
            f[i] = h * f[i]
        pour(f, b)
        solve(work.a, b)
        pour_back(b, f)

    return kick


@leapfrog
def implicit_damping(names):
    """Leapfrog with the springs' damping implicit, stiffness and water explicit: one (3N,3N) matrix a step."""
    return make_newton_kick(names, ("springs",), elastic=False)


@leapfrog
def implicit_midpoint(names):
    """Implicit midpoint, one Newton step with the exact Jacobian: the best a matrix made beforehand can hope for."""
    return make_newton_kick(names, names, elastic=True)


@kernel
def predict(x, v, h, work):
    """Where the acceleration stored from the last step leads in a step: x and v; between, the state of the balance."""
    a = work.acceleration
    for i in range(x.size):
        guess_x, guess_v = fma(0.5 * h * h, a[i], fma(h, v[i], x[i])), fma(h, a[i], v[i])
        work.x[i] = (1.0 - OLD) * guess_x + OLD * x[i]
        work.v[i] = (1.0 - OLD) * guess_v + OLD * v[i]
        x[i] = guess_x
        v[i] = guess_v


def generalised_alpha(names):
    """Generalised-alpha (Chung & Hulbert 1993), one correction with the exact Jacobian."""
    force, derive = make_force(names), make_derive(names)

    @kernel
    def run(body, world, control, x, v, work, cache, n):
        h, f, b, stored = control.plans[control.row[0], H], work.f, work.b, work.acceleration
        if work.begun[0] == 0.0:
            work.begun[0] = 1.0
            move_rest_lengths(control, 0.0)
            force(body, world, control, x, v, f, cache)
            for i in range(x.size):
                stored[i] = body.inverse_mass[i] * f[i]
        for s in range(n):
            predict(x, v, h, work)
            move_rest_lengths(control, (s + 1.0 - OLD) * h)
            force(body, world, control, work.x, work.v, f, cache)
            derive(body, world, control, work.x, work.v, work.matrices)
            set_system(body, work.matrices, 1.0 - OLD_A, (1.0 - OLD) * GAMMA * h, (1.0 - OLD) * BETA * h * h, work.a)
            for i in range(x.size):
                f[i] = fma(-body.mass[i], stored[i], f[i])
            pour(f, b)
            solve(work.a, b)
            pour_back(b, f)
            for i in range(x.size):
                stored[i] += f[i]
                x[i] = fma(BETA * h * h, f[i], x[i])
                v[i] = fma(GAMMA * h, f[i], v[i])

    return run


MATRIX_EVERY_STEP = (
    RejectedMethod("semi_implicit_positive", semi_implicit_positive, one_for_all_axes, (1, 1, 1)),
    RejectedMethod("semi_implicit_leapfrog", semi_implicit_leapfrog, one_for_all_axes, (1, 1, 1)),
    RejectedMethod("implicit_damping", implicit_damping, whole, (1, 1, 1)),
    RejectedMethod("implicit_midpoint", implicit_midpoint, whole, (1, 1, 1)),
    RejectedMethod("generalised_alpha", generalised_alpha, whole, (1, 1, 1), (1, 0)),
)
