"""Rosenbrock methods, whose stages solve linear systems with one matrix: linearly implicit Euler and ROS2.

Linearly implicit Euler has one stage (Baraff & Witkin 1998). ROS2 has two (Verwer et al. 1999), and is L-stable and of
second order for any approximate Jacobian. Stiffness and damping of forces with an `add_system` are fully implicit.
Other forces are explicit. Water is explicit too, except its damping in the variant WATER.

If the matrix does not depend on the motion, as in linear elasticity, its factors are reused for further steps, calls
and fish, until the step or a fish's factors on stiffness or mass change. Other boundary conditions are a new engine.

Legend: x, v positions and velocities of a block; h step, inner the part of it that is implicit; matrix the system
matrix in its skyline of 3 x 3 blocks, then L; f the right-hand side of a stage, then its acceleration, then a, that of
the step so far; u the velocity of the step so far; sx, sv the resulting state; p the acceleration of the first stage;
rate a velocity of the positions; still what
the added mass of the start of the step resists; y the restoring force of a displacement by that rate in one second.
"""

import math
from dataclasses import dataclass

from fish_env.kernels.compile import kernel
from fish_env.kernels.simd import floats, fma, zero
from fish_env.physics import forces
from fish_env.physics.forces.plan import INNER, H
from fish_env.physics.integrators import common
from fish_env.physics.linalg import ldlt
from fish_env.physics.records import Body

GAMMA = 1.0 - math.sqrt(0.5)  # of ROS2: the smaller and more accurate of the two L-stable values


@dataclass(frozen=True)
class Rosenbrock:
    """Rosenbrock method of one or two stages, a `fish_env.physics.integrators.Method`."""

    gamma: float = 1.0  # implicit part of the step
    time: tuple[float, ...] = (1.0,)
    """Time of each stage's rest lengths and anchors, in steps.

    An implicit method of first order uses those of the end; in one of second order, they add their rate of change.
    """
    lowest: float = -math.inf  # least effective stiffness of a spring in the matrix, N/m
    wet: bool = False  # true if the damping of the water is in the matrix

    def plan(self, elastic, viscous, h):
        return common.plan_of_step(elastic, viscous, h, self.gamma, self.lowest)

    def costs(self, row):
        return len(self.time), 1, len(self.time)

    def make_work(self, body: Body, kind):
        matrix, row = kind.vectors(3 * int(body.profile.start[-1])), kind.vectors(3 * len(body.mass))
        return common.scratch(
            body, kind, "f", "y", "sx", "sv", "p", "rate", "still", matrix=matrix, row=row,
            step=kind.scratch(1), stiffness=kind.numbers(1), lightness=kind.numbers(1),
        )  # fmt: skip

    def make_run(self, names, flows=False):
        time, last = self.time, len(self.time) - 1
        add_force, finish = forces.total(names, "add_force"), forces.total(names, "finish")
        compare, constrain = make_compare(names), common.make_constrain(names)
        measure = common.make_measure(names, flows)
        implicit = tuple(name for name in names if forces.any_has((name,), "add_system"))
        add_system, add_tangent = forces.total(implicit, "add_system"), forces.total(implicit, "add_tangent")
        add_damping = forces.total(names if self.wet else (), "add_damping")
        steady = not (self.wet and forces.any_has(names, "add_damping"))

        @kernel
        def run(body, world, control, x, v, work, cache, n):
            f, y, sx, sv, p, rate, matrix = work.f, work.y, work.sx, work.sv, work.p, work.rate, work.matrix
            h, inner = control.plans[control.row[0], H], control.plans[control.row[0], INNER]
            for s in range(n):
                for stage in range(last + 1):
                    px, pv, speed = (x, v, v) if stage == 0 else (sx, sv, rate)
                    common.move_rest_lengths(control, (s + time[stage]) * h)
                    common.add_work(body, control, px, h / (last + 1))
                    for i in range(x.size):
                        f[i] = zero(f)
                        y[i] = zero(y)
                    if stage == 0 and steady and factors_are_valid(control, work, inner):
                        control.reused[0] += 1
                    elif stage == 0:
                        common.set_masses(body, matrix)
                        add_damping(body, world, control, x, v, matrix, cache)
                        add_system(body, world, control, x, v, matrix, cache)  # (39)
                        common.eliminate(body, matrix)
                        common.count_pivots(control, ldlt.factor(body.profile, matrix, work.row))
                        store_validity(control, work, inner)
                    add_tangent(body, world, control, x, speed, y, cache)
                    add_force(body, world, control, px, pv, f, cache)
                    if stage > 0:
                        compare(body, world, control, x, sx, sv, work, cache)
                    for i in range(x.size):
                        f[i] = fma(inner, y[i], f[i])
                    common.zero_fixed(body, f)
                    ldlt.solve(body.profile, matrix, f)  # (40), (42), (43)
                    if stage > 0:
                        for i in range(x.size):
                            f[i] = fma(0.5, f[i], 1.5 * p[i])
                    constrain(body, world, control, x, v, f, cache)
                    if flows and stage == last:
                        common.move_rest_lengths(control, (s + 0.5) * h)
                        set_middle(control.flows, x, v, f, 0.5 * h, y)
                        measure(body, world, control, y, cache, h)
                    for i in range(x.size):
                        a, u = f[i], fma(inner, f[i], v[i])
                        if stage > 0:
                            second = fma(inner, fma(2.0, a, -3.0 * p[i]), rate[i])
                            u = fma(0.5, second, 1.5 * fma(inner, p[i], v[i]))
                        if stage < last:
                            sx[i], sv[i], p[i] = fma(h, u, x[i]), fma(h, a, v[i]), a
                            rate[i] = fma(-2.0, u, sv[i])
                        else:
                            x[i], v[i] = fma(h, u, x[i]), fma(h, a, v[i])  # (41)
                finish(body, world, control, x, v, f, cache)

        return run


@kernel
def set_middle(flows, x, v, a, half, y):
    """Store positions y and the velocities and accelerations a at the middle of a step, to be measured."""
    for i in range(x.size):
        y[i] = fma(half, v[i], x[i])
        flows.v[i], flows.a[i] = fma(half, a[i], v[i]), a[i]


def make_compare(names: tuple[str, ...]):
    """Make the kernel that subtracts twice the first stage's acceleration from the second's, times the mass."""
    # With added mass, the second is that of the stage's positions, and the mass that of the start of the step.
    add_reaction, add_inertia = forces.total(names, "add_reaction"), forces.total(names, "add_inertia")
    heavy = forces.any_has(names, "add_inertia")

    @kernel
    def compare(body, world, control, x, sx, sv, work, cache):
        f, p, still = work.f, work.p, work.still
        add_reaction(body, world, control, sx, sv, f, cache)
        for i in range(x.size):
            f[i] = fma(-2.0 * body.mass[i], p[i], f[i])
        if heavy:
            for i in range(x.size):
                still[i] = body.inverse_mass[i] * f[i]
            add_inertia(body, world, control, x, still, f, cache)

    return compare


@kernel
def factors_are_valid(control, work, inner):
    """Return True if the factors in `work` are valid for this step's matrix and every fish of the block."""
    stiffness, lightness, same = floats(work.stiffness), floats(work.lightness), control.constant
    same = same and work.step[0] == inner
    for lane in range(stiffness.shape[1]):
        same = same and stiffness[0, lane] == floats(control.stiffness)[0, lane]
        same = same and lightness[0, lane] == floats(control.lightness)[0, lane]
    return same


@kernel
def store_validity(control, work, inner):
    """Store the parameters of the factors in `work`, invalid ones if a pivot of any fish is untrusted."""
    untrusted = floats(control.untrusted)
    work.step[0], work.stiffness[0], work.lightness[0] = inner, control.stiffness[0], control.lightness[0]
    for lane in range(untrusted.shape[1]):
        if untrusted[0, lane] > 0.0:
            work.step[0] = 0.0


EULER = Rosenbrock()
PROJECTED = Rosenbrock(lowest=0.0)
"""Variant without the negative transverse stiffness of compressed springs, so that no spring's part is indefinite."""
WATER = Rosenbrock(wet=True)  # variant with the water's damping along the normals in the matrix
ROS2 = Rosenbrock(GAMMA, (GAMMA, 1.0 - GAMMA))
