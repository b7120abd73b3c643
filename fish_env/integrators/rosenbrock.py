"""ROS2: a Rosenbrock method of two stages, second order for any approximate Jacobian, L-stable (Verwer et al. 1999).

The Jacobian is that of `linearly_implicit.PLAIN`; the water is explicit. The two stages share one matrix.

Legend: x, v positions and velocities of a block; h step, inner the part of it that is implicit; matrix the system
matrix in its skyline of 3 x 3 blocks, then L; f the right-hand side of a stage, then its acceleration; p that of the
first stage, change that of the step; sx, sv the state at which a stage is taken; rate what its positions would move at;
y the pull of the stiffness if the nodes moved at that rate for a second.
"""

import math

from fish_env import forces
from fish_env._jit import kernel
from fish_env.forces.plan import INNER, H
from fish_env.integrators._common import (
    count_pivots,
    eliminate,
    make_constrain,
    move_rest_lengths,
    plan_of_step,
    scratch,
    set_masses,
    zero_fixed,
)
from fish_env.linalg import ldlt
from fish_env.simd import fma, zero

GAMMA = 1.0 - math.sqrt(0.5)  # the smaller of the two values that make the method L-stable, and the more accurate


def plan(elastic, viscous, h):
    """The row of `control.plans` for a step of h s."""
    return plan_of_step(elastic, viscous, h, inner=GAMMA)


def costs(row):
    """Force evaluations, factorisations and solves of a step."""
    return 2, 1, 2


def make_work(body, kind):
    """Scratch of a block."""
    matrix, row = kind.vectors(3 * int(body.profile.start[-1])), kind.vectors(3 * len(body.mass))
    return scratch(body, kind, "f", "y", "p", "sx", "sv", "rate", "change", matrix=matrix, row=row)


@kernel
def begin(x, v, work):
    """The first stage is taken at the start of the step."""
    for i in range(x.size):
        work.sx[i] = x[i]
        work.sv[i] = v[i]
        work.rate[i] = v[i]
        work.p[i] = zero(x)


@kernel
def go_on(x, v, h, inner, work):
    """The second stage is taken where the first one's acceleration leads."""
    for i in range(x.size):
        p = work.f[i]
        speed = fma(inner, p, v[i])  # of the first stage
        work.p[i] = p
        work.sx[i] = fma(h, speed, x[i])
        work.sv[i] = fma(h, p, v[i])
        work.rate[i] = fma(-2.0, speed, work.sv[i])


@kernel
def end(x, v, h, inner, work):
    """Take the step, of which `work.change` is the acceleration: 3/2 of the first stage's and 1/2 of the second's."""
    for i in range(x.size):
        p, change = work.p[i], work.change[i]
        first = fma(inner, p, v[i])
        second = fma(inner, fma(2.0, change, -3.0 * p), work.rate[i])
        x[i] = fma(h, fma(0.5, second, 1.5 * first), x[i])  # (32)
        v[i] = fma(h, change, v[i])


def make_run(names):
    """The kernel that takes n steps of a block on which the forces of these names act."""
    add_force, finish, constrain = (
        forces.total(names, "add_force"),
        forces.total(names, "finish"),
        make_constrain(names),
    )
    implicit = tuple(name for name in names if forces.any_has((name,), "add_system"))
    add_system, add_tangent = forces.total(implicit, "add_system"), forces.total(implicit, "add_tangent")

    @kernel
    def run(body, world, control, x, v, work, cache, n):
        f, y, p, sx, sv, matrix, change = work.f, work.y, work.p, work.sx, work.sv, work.matrix, work.change
        h, inner = control.plans[control.row[0], H], control.plans[control.row[0], INNER]
        for s in range(n):
            begin(x, v, work)
            for stage in range(2):
                move_rest_lengths(control, (s + stage) * h)
                for i in range(x.size):
                    f[i] = zero(f)
                    y[i] = zero(y)
                if stage == 0:
                    set_masses(body, matrix)
                    add_system(body, world, control, x, v, matrix, cache)
                    eliminate(body, matrix)
                    count_pivots(control, ldlt.factor(body.profile, matrix, work.row))
                add_tangent(body, world, control, x, work.rate, y, cache)
                add_force(body, world, control, sx, sv, f, cache)
                for i in range(x.size):
                    f[i] = fma(inner, y[i], fma(-2.0 * body.mass[i], p[i], f[i]))
                zero_fixed(body, f)
                ldlt.solve(body.profile, matrix, f)  # (33), (34)
                if stage == 0:
                    constrain(body, world, control, x, v, f, cache)
                    go_on(x, v, h, inner, work)
            for i in range(x.size):
                change[i] = fma(0.5, f[i], 1.5 * p[i])
            constrain(body, world, control, x, v, change, cache)
            end(x, v, h, inner, work)
            finish(body, world, control, x, v, f, cache)

    return run
