"""Rosenbrock methods, whose stages solve linear systems with one matrix: linearly implicit Euler and ROS2.

Linearly implicit Euler is that of one stage (Baraff & Witkin 1998), ROS2 that of two (Verwer et al. 1999), of second
order for any approximate Jacobian and L-stable. The whole stiffness and damping of forces with an `add_system` are
implicit. Other forces are explicit, and so is the water, but for its damping in the variant WATER.

Legend: x, v positions and velocities of a block; h step, inner the part of it that is implicit; matrix the system
matrix in its skyline of 3 x 3 blocks, then L; f the right-hand side of a stage, then its acceleration, then a, that of
the step so far, as u is its speed; sx, sv where they lead; p the acceleration of the first stage; rate what positions
would move at; y the pull of the stiffness if the nodes moved at that rate for a second.
"""

import math
from dataclasses import dataclass

from fish_env import forces
from fish_env._jit import kernel
from fish_env.forces.plan import INNER, H
from fish_env.integrators import _common as common
from fish_env.linalg import ldlt
from fish_env.simd import fma, zero

GAMMA = 1.0 - math.sqrt(0.5)  # of ROS2: of the two values that make it L-stable, the smaller and more accurate one


@dataclass(frozen=True)
class Rosenbrock:
    """A `fish_env.integrators.Method` of one or two stages."""

    gamma: float = 1.0
    """The part of the step that is implicit."""
    time: tuple[float, ...] = (1.0,)
    """When each stage takes its rest lengths, in steps: an implicit method of first order wants those of the end."""
    lowest: float = -math.inf
    """N/m, least effective stiffness with which a spring enters the matrix."""
    wet: bool = False
    """Whether the damping of the water is in the matrix."""

    def plan(self, elastic, viscous, h):
        return common.plan_of_step(elastic, viscous, h, self.gamma, self.lowest)

    def costs(self, row):
        return len(self.time), 1, len(self.time)

    def make_work(self, body, kind):
        matrix, row = kind.vectors(3 * int(body.profile.start[-1])), kind.vectors(3 * len(body.mass))
        return common.scratch(body, kind, "f", "y", "sx", "sv", "p", "rate", matrix=matrix, row=row)

    def make_run(self, names):
        time, last = self.time, len(self.time) - 1
        add_force, finish = forces.total(names, "add_force"), forces.total(names, "finish")
        constrain = common.make_constrain(names)
        implicit = tuple(name for name in names if forces.any_has((name,), "add_system"))
        add_system, add_tangent = forces.total(implicit, "add_system"), forces.total(implicit, "add_tangent")
        add_damping = forces.total(names if self.wet else (), "add_damping")

        @kernel
        def run(body, world, control, x, v, work, cache, n):
            f, y, sx, sv, p, rate, matrix = work.f, work.y, work.sx, work.sv, work.p, work.rate, work.matrix
            h, inner = control.plans[control.row[0], H], control.plans[control.row[0], INNER]
            for s in range(n):
                for stage in range(last + 1):
                    px, pv, speed = (x, v, v) if stage == 0 else (sx, sv, rate)
                    common.move_rest_lengths(control, (s + time[stage]) * h)
                    for i in range(x.size):
                        f[i] = zero(f)
                        y[i] = zero(y)
                    if stage == 0:
                        common.set_masses(body, matrix)
                        add_damping(body, world, control, x, v, matrix, cache)
                        add_system(body, world, control, x, v, matrix, cache)  # (30)
                        common.eliminate(body, matrix)
                        common.count_pivots(control, ldlt.factor(body.profile, matrix, work.row))
                    add_tangent(body, world, control, x, speed, y, cache)
                    add_force(body, world, control, px, pv, f, cache)
                    for i in range(x.size):
                        f[i] = fma(inner, y[i], f[i] if stage == 0 else fma(-2.0 * body.mass[i], p[i], f[i]))
                    common.zero_fixed(body, f)
                    ldlt.solve(body.profile, matrix, f)  # (31), (33), (34)
                    if stage > 0:
                        for i in range(x.size):
                            f[i] = fma(0.5, f[i], 1.5 * p[i])
                    constrain(body, world, control, x, v, f, cache)
                    for i in range(x.size):
                        a, u = f[i], fma(inner, f[i], v[i])
                        if stage > 0:
                            second = fma(inner, fma(2.0, a, -3.0 * p[i]), rate[i])
                            u = fma(0.5, second, 1.5 * fma(inner, p[i], v[i]))
                        if stage < last:
                            sx[i], sv[i], p[i] = fma(h, u, x[i]), fma(h, a, v[i]), a
                            rate[i] = fma(-2.0, u, sv[i])
                        else:
                            x[i], v[i] = fma(h, u, x[i]), fma(h, a, v[i])  # (32)
                finish(body, world, control, x, v, f, cache)

        return run


EULER = Rosenbrock()
PROJECTED = Rosenbrock(lowest=0.0)
"""A compressed spring enters the matrix without its negative stiffness across: none is indefinite."""
WATER = Rosenbrock(wet=True)
"""The water's damping along the normals is in the matrix."""
ROS2 = Rosenbrock(GAMMA, (0.0, 1.0))
