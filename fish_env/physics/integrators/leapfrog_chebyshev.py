"""Leapfrog with Chebyshev-filtered kicks: explicit, its stable step grows with the number of stages.

Drift half a step, kick, drift half a step. The kick passes a Chebyshev polynomial of the stiffness and damping at the
start of the step, which slows only motion that the step cannot resolve. It is a leapfrog-Chebyshev scheme (Gilbert &
Joly 2008; Carle, Hochbruck & Sturm 2020), with damped elements and implicit drag of each face. `plan` chooses the
number of stages, at most MOST_STAGES; the cost grows with the root of the stiffness. The order is two with two stages;
with more, as at the default step, the damping is of first order.

Legend: x, v positions and velocities of a block; h step; f the force; a the filtered acceleration of this stage, before
of the last one, kick of all forces; t Chebyshev polynomials T_k at their midpoint.
"""

import math

import numpy as np

from fish_env.kernels.compile import INDEX, kernel
from fish_env.kernels.simd import fma, zero
from fish_env.physics import forces
from fish_env.physics.forces.plan import FACTOR, FIRST, LEAST, MIDPOINT, POLYNOMIAL, STAGES, H
from fish_env.physics.integrators.common import add_work, make_constrain, make_measure, move_rest_lengths, scratch
from fish_env.physics.records import Body

DAMPING = 3.5  # of the polynomial: excess of its midpoint over 1, times the square of the number of stages
MARGIN = 0.8  # of the bound of a leapfrog on z P(z), which a deformed body would pass where the filter touched it
SAFETY = 1.1  # ratio of the highest rates of a deformed body to those at rest
MOST_STAGES = 1000


def polynomial(stages: int) -> tuple[float, float, float, float]:
    """Midpoint of the filter, its first factor, the factor on stiffness, and its reach."""
    # The reach is the largest h^2 c/m + 2 h k/m of a vibration that the filter keeps stable.
    midpoint = 1.0 + DAMPING / (stages * stages)
    angle = math.acosh(midpoint)
    last, second = math.cosh(stages * angle), math.sinh(stages * angle) / math.sinh(angle)  # T_s, U_(s-1)
    first = last / (stages * second)
    slope = first * (1.0 + 1.0 / last) / (4.0 * MARGIN)
    return midpoint, first, 2.0 * slope, (1.0 + midpoint) / slope


def stages_for(elastic: float, viscous: float, h: float) -> int:
    """Smallest number of stages, at least 2, that keeps a step of h s stable at these rates, 1/s2 and 1/s."""
    damped = SAFETY * h * viscous
    wanted = SAFETY * h * h * elastic + 2.0 * damped
    stages = int(min(max(2.0, math.sqrt(wanted / 3.0)), MOST_STAGES))  # the reach is at most 3 times their square
    while stages < MOST_STAGES and (polynomial(stages)[3] < wanted or (stages == 2 and damped > 2.0)):
        stages += 1
    return stages


def plan(elastic: float, viscous: float, h: float) -> np.ndarray:
    """Coefficients of a step of h s for a body with these highest rates, 1/s2 and 1/s, a row of `control.plans`."""
    stages = stages_for(elastic, viscous, h)
    midpoint, first, factor, _ = polynomial(stages)  # (22)
    row = np.zeros(POLYNOMIAL + stages + 1)
    row[POLYNOMIAL:] = np.cosh(np.arange(stages + 1) * math.acosh(midpoint))
    row[[H, STAGES, MIDPOINT, FIRST, FACTOR]] = h, stages, midpoint, first, factor
    row[LEAST] = 0.5 * row[POLYNOMIAL + 2] / first if stages == 2 else 0.0
    return row


def costs(row: np.ndarray) -> tuple[int, int, int]:
    """Force evaluations, factorisations and solves of a step."""
    return int(row[STAGES]), 0, 0


def make_work(body: Body, kind):
    """Scratch memory of a block."""
    return scratch(body, kind, "f", "kick", "a", "before")


@kernel
def set_motion(flows, inverse_mass, v, a, f, half):
    """Store the accelerations of a kick, of a and the forces f, and the velocities half of it later, to be measured."""
    for i in range(v.size):
        flows.a[i] = fma(inverse_mass[i], f[i], a[i])
        flows.v[i] = fma(half, flows.a[i], v[i])


def make_run(names, flows=False):
    """Make the kernel that takes n steps of a block, for the forces of these names."""
    add_force = forces.total(names, "add_force_cached", "add_force")
    add_tangent, add_change = forces.total(names, "add_tangent"), forces.total(names, "add_change")
    add_reaction, measure = forces.total(names, "add_reaction"), make_measure(names, flows)
    constrain, decay, finish = make_constrain(names), forces.total(names, "decay"), forces.total(names, "finish")
    whole = not forces.any_has(names, "decay", "finish")  # the drifts of two consecutive steps are merged

    @kernel
    def run(body, world, control, x, v, work, cache, n):
        f, kick, a, before, inverse_mass = work.f, work.kick, work.a, work.before, body.inverse_mass
        t, row = control.plans, control.row[0]
        h, stages, midpoint, first = t[row, H], int(t[row, STAGES]), t[row, MIDPOINT], t[row, FIRST]
        half, start, double = 0.5 * h, first / midpoint, 2.0 * first
        for s in range(n):
            if s == 0 or not whole:
                decay(body, world, control, x, v, f, cache)
                for i in range(x.size):
                    x[i] = fma(half, v[i], x[i])  # (3)
                    f[i] = zero(f)
            move_rest_lengths(control, (s + 0.5) * h)
            add_work(body, control, x, h)
            add_force(body, world, control, x, v, f, cache)
            add_reaction(body, world, control, x, v, f, cache)
            for i in range(x.size):
                y = inverse_mass[i] * f[i]
                kick[i] = y
                a[i] = start * y
                before[i] = zero(f)
                f[i] = zero(f)
            for g in range(1, stages):
                add_tangent(body, world, control, x, a, f, cache)
                add_reaction(body, world, control, x, a, f, cache)
                ahead = INDEX(POLYNOMIAL + g)
                now = t[row, ahead] / t[row, ahead + INDEX(1)]
                last = t[row, ahead - INDEX(1)] / t[row, ahead + INDEX(1)]
                for i in range(x.size):
                    y = a[i]
                    pull = fma(2.0 * midpoint, y, fma(inverse_mass[i], f[i], double * kick[i]))
                    a[i] = fma(now, pull, -last * before[i])  # (23)
                    before[i] = y
                    f[i] = zero(f)
            constrain(body, world, control, x, v, a, cache)
            for i in range(x.size):
                before[i] = fma(half, a[i], v[i])
            add_change(body, world, control, x, before, f, cache)
            add_reaction(body, world, control, x, before, f, cache)
            if flows:
                set_motion(control.flows, inverse_mass, v, a, f, half)
                measure(body, world, control, x, cache, h)
            drift = h if whole and s < n - 1 else half
            for i in range(x.size):
                y = fma(h, fma(inverse_mass[i], f[i], a[i]), v[i])
                v[i] = y
                x[i] = fma(drift, y, x[i])
                f[i] = zero(f)
            decay(body, world, control, x, v, f, cache)
            finish(body, world, control, x, v, f, cache)

    return run
