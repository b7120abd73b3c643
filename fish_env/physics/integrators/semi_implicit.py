"""Tu's semi-implicit Euler method: effective stiffness implicit but lagged, water explicit (Tu 1996, ch. 4).

The force of a spring is eta r with eta from the start of the step and r from its end, so one symmetric N x N matrix
serves x, y and z. Each force adds itself to that matrix (`add_lagged`); forces without that function are explicit.
Newton and Warp use the name semi-implicit for symplectic Euler, which is in `runge_kutta.py`.

Legend: x, v positions and velocities of a block; h step; matrix the system matrix in its skyline, then L; load the
right-hand side, then the new velocities; eta effective stiffness.
"""

import numpy as np

from fish_env.kernels.compile import INDEX, kernel
from fish_env.kernels.simd import floats, fma, zero
from fish_env.physics import forces
from fish_env.physics.forces import reactive
from fish_env.physics.forces.plan import H
from fish_env.physics.integrators.common import (
    add_work,
    count_pivots,
    make_constrain,
    make_measure,
    move_rest_lengths,
    plan_of_step,
    scratch,
)
from fish_env.physics.linalg import ldlt
from fish_env.physics.records import Body

plan = plan_of_step


def costs(row):
    """Force evaluations, factorisations and solves of a step."""
    return 1, 1, 1


def make_work(body: Body, kind):
    """Scratch memory: the system, the nodes (K,) fixed along every axis with a free node, `reactive.lagged_work`."""
    n, free = len(body.mass), body.inverse_mass > 0.0
    fixed = np.flatnonzero(~free[:, free.any(axis=0)].any(axis=1))
    matrix = kind.numbers(int(body.profile.start[n]))
    return scratch(
        body, kind, "load", matrix=matrix, inverse_pivot=kind.numbers(n), row=kind.numbers(n), fixed=fixed,
        **reactive.lagged_work(body, kind),
    )  # fmt: skip


@kernel
def eliminate(body, v, work):
    """Eliminate the fixed nodes from the system: their equations become that their velocity is constant."""
    first, start, row, fixed = body.profile.first, body.profile.start, body.profile.row, work.fixed
    matrix, load, none = work.matrix, work.load, zero(work.matrix)
    for m in range(fixed.size):
        i = fixed[m]
        for j in range(first.size):
            low, high = min(row[i], row[j]), max(row[i], row[j])
            if j != i and low >= first[high]:
                place = INDEX(start[high] + low - first[high])
                load[INDEX(j)] = fma(-matrix[place], v[INDEX(i)], load[INDEX(j)])
                matrix[place] = none
        matrix[INDEX(body.profile.diagonal[i])] = none + 1.0
        load[INDEX(i)] = v[INDEX(i)]


@kernel
def restore_fixed(body, v, u):
    """Set the new velocities u along fixed degrees of freedom to those in v."""
    was, become, fixed = floats(v), floats(u), body.fixed
    for m in range(fixed.shape[0]):
        i, k = INDEX(fixed[m, 0]), INDEX(fixed[m, 1])
        for lane in range(was.shape[2]):
            become[i, k, lane] = was[i, k, lane]


def make_run(names, flows=False):
    """Make the kernel that takes n steps of a block, for the forces of these names."""
    measure = make_measure(names, flows)
    lagged = tuple(name for name in names if forces.any_has((name,), "add_lagged"))
    add_lagged = forces.total(lagged, "add_lagged")
    add_force = forces.total(tuple(name for name in names if name not in lagged), "add_force")
    constrain, finish = make_constrain(names), forces.total(names, "finish")
    constrained = forces.any_has(names, "constrain")
    solve_lagged = forces.total(names, "solve_lagged")

    @kernel
    def run(body, world, control, x, v, work, cache, n):
        matrix, load, mass, h = work.matrix, work.load, body.mass, control.plans[control.row[0], H]
        for s in range(n):
            move_rest_lengths(control, s * h)
            add_work(body, control, x, h)
            for p in range(matrix.size):
                matrix[p] = zero(matrix)
            for i in range(x.size):
                matrix[INDEX(body.profile.diagonal[i])] = zero(matrix) + mass[i]
                load[i] = zero(load)
            add_lagged(body, world, control, x, v, work, cache)  # (29), (30)
            add_force(body, world, control, x, v, load, cache)
            for i in range(x.size):
                load[i] = fma(h, load[i], mass[i] * v[i])
            eliminate(body, v, work)
            found = ldlt.factor_forward(body.profile, matrix, load, work.inverse_pivot, work.row)  # (31)
            count_pivots(control, found)
            solve_lagged(body, world, control, x, v, work, cache)
            ldlt.backward(body.profile, matrix, load, work.inverse_pivot)
            restore_fixed(body, v, load)
            if constrained:
                for i in range(x.size):
                    load[i] = (1.0 / h) * (load[i] - v[i])
                constrain(body, world, control, x, v, load, cache)
                for i in range(x.size):
                    load[i] = fma(h, load[i], v[i])
            if flows:
                for i in range(x.size):
                    control.flows.v[i], control.flows.a[i] = 0.5 * (load[i] + v[i]), (1.0 / h) * (load[i] - v[i])
                measure(body, world, control, x, cache, h)
            for i in range(x.size):
                v[i] = load[i]
                x[i] = fma(h, load[i], x[i])
            finish(body, world, control, x, v, load, cache)

    return run
