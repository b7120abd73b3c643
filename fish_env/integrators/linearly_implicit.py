"""Linearly implicit Euler: the whole stiffness and damping implicit, one Newton step (Baraff & Witkin 1998).

The rest lengths are those of the step's end, as an implicit method of first order wants them. Forces that have no
`add_system` are explicit, and so is the water, but for its damping in the variant WATER.

Legend: x, v positions and velocities of a block; h step; matrix the system matrix in its skyline of 3 x 3 blocks, then
L; g the load, then the acceleration; y the pull of the stiffness if the nodes moved on for a second.
"""

import math
from dataclasses import dataclass

from fish_env import forces
from fish_env._jit import kernel
from fish_env.forces.plan import H
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


@dataclass(frozen=True)
class LinearlyImplicit:
    """A variant of the method."""

    lowest: float = -math.inf
    """N/m, least effective stiffness with which a spring enters the matrix."""
    wet: bool = False
    """Whether the damping of the water is in the matrix."""

    def plan(self, elastic, viscous, h):
        """The row of `control.plans` for a step of h s."""
        return plan_of_step(elastic, viscous, h, lowest=self.lowest)

    def costs(self, row):
        """Force evaluations, factorisations and solves of a step."""
        return 1, 1, 1

    def make_work(self, body, kind):
        """Scratch of a block."""
        matrix, row = kind.vectors(3 * int(body.profile.start[-1])), kind.vectors(3 * len(body.mass))
        return scratch(body, kind, "g", "y", matrix=matrix, row=row)

    def make_run(self, names):
        """The kernel that takes n steps of a block on which the forces of these names act."""
        return make_run(names, self.wet)


PLAIN = LinearlyImplicit()
PROJECTED = LinearlyImplicit(lowest=0.0)
"""A compressed spring enters the matrix without its negative stiffness across: none is indefinite."""
WATER = LinearlyImplicit(wet=True)
"""The water's damping along the normals is in the matrix."""


def make_run(names, wet):
    """The kernel of a variant."""
    add_force, finish, constrain = (
        forces.total(names, "add_force"),
        forces.total(names, "finish"),
        make_constrain(names),
    )
    implicit = tuple(name for name in names if forces.any_has((name,), "add_system"))
    add_system, add_tangent = forces.total(implicit, "add_system"), forces.total(implicit, "add_tangent")
    add_damping = forces.total(names if wet else (), "add_damping")

    @kernel
    def run(body, world, control, x, v, work, cache, n):
        g, y, matrix, h = work.g, work.y, work.matrix, control.plans[control.row[0], H]
        for s in range(n):
            move_rest_lengths(control, (s + 1) * h)
            set_masses(body, matrix)
            for i in range(x.size):
                g[i] = zero(g)
                y[i] = zero(y)
            add_damping(body, world, control, x, v, matrix, cache)
            add_system(body, world, control, x, v, matrix, cache)  # (30)
            add_tangent(body, world, control, x, v, y, cache)
            add_force(body, world, control, x, v, g, cache)
            for i in range(x.size):
                g[i] = fma(h, y[i], g[i])
            zero_fixed(body, g)
            eliminate(body, matrix)
            count_pivots(control, ldlt.factor(body.profile, matrix, work.row))
            ldlt.solve(body.profile, matrix, g)  # (31)
            constrain(body, world, control, x, v, g, cache)
            for i in range(x.size):
                v[i] = fma(h, g[i], v[i])
                x[i] = fma(h, v[i], x[i])
            finish(body, world, control, x, v, g, cache)

    return run
