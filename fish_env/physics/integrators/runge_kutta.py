"""Explicit Runge-Kutta methods whose stages each use the slope of the previous stage (Song 2009, ch. 5).

Symplectic Euler is one of them: it is explicit Euler except that positions move at the new velocity. Newton and Warp
call it semi-implicit; in this package, that is Tu's method (see `semi_implicit.py`).

Legend: x, v positions and velocities of a block; f forces; h step; sx, sv the stage, with slopes u, a; kx, kv the
weighted sums of slopes.
"""

from dataclasses import dataclass

from fish_env.kernels.compile import kernel
from fish_env.kernels.simd import fma, zero
from fish_env.physics import forces
from fish_env.physics.forces.plan import H
from fish_env.physics.integrators.common import add_work, make_measure, move_rest_lengths, plan_of_step, scratch
from fish_env.physics.records import Body


@dataclass(frozen=True)
class RungeKutta:
    """Explicit Runge-Kutta method, a `fish_env.physics.integrators.Method` given by its tableau."""

    time: tuple[float, ...]  # time of each stage, in steps: the step along the slope of the previous stage
    weight: tuple[float, ...]  # weight of each stage's slope; the sum is 1
    symplectic: bool = False  # true if positions move at the velocity at the end of the step; for one stage only

    def plan(self, elastic, viscous, h):
        return plan_of_step(elastic, viscous, h)

    def costs(self, row):
        return len(self.time), 0, 0

    def make_work(self, body: Body, kind):
        return scratch(body, kind, "f", "sx", "sv", "kx", "kv")

    def make_run(self, names, flows=False):
        add_force, finish = forces.total(names, "add_force"), forces.total(names, "finish")
        add_reaction, measure = forces.total(names, "add_reaction"), make_measure(names, flows)
        time, weight, last, symplectic = self.time, self.weight, len(self.time) - 1, self.symplectic

        @kernel
        def run(body, world, control, x, v, work, cache, n):
            f, sx, sv, kx, kv, none = work.f, work.sx, work.sv, work.kx, work.kv, zero(work.f)
            inverse_mass, h = body.inverse_mass, control.plans[control.row[0], H]
            for s in range(n):
                for stage in range(last + 1):
                    px, pv = (x, v) if stage == 0 else (sx, sv)
                    part, ahead = weight[stage], time[min(stage + 1, last)] * h
                    move_rest_lengths(control, (s + time[stage]) * h)
                    add_work(body, control, px, part * h)
                    for i in range(x.size):
                        f[i] = none
                    add_force(body, world, control, px, pv, f, cache)
                    add_reaction(body, world, control, px, pv, f, cache)
                    if flows:
                        for i in range(x.size):
                            control.flows.v[i], control.flows.a[i] = pv[i], inverse_mass[i] * f[i]
                        measure(body, world, control, px, cache, part * h)
                    for i in range(x.size):
                        u, a = pv[i], inverse_mass[i] * f[i]
                        if symplectic:
                            u = fma(h, a, u)  # (32)
                        speed, acceleration = (none, none) if stage == 0 else (kx[i], kv[i])
                        speed, acceleration = fma(part, u, speed), fma(part, a, acceleration)
                        if stage < last:
                            kx[i], kv[i] = speed, acceleration
                            sx[i], sv[i] = fma(ahead, u, x[i]), fma(ahead, a, v[i])
                        else:
                            x[i], v[i] = fma(h, speed, x[i]), fma(h, acceleration, v[i])  # (33), (34), (35)
                finish(body, world, control, x, v, f, cache)

        return run


EULER = RungeKutta((0.0,), (1.0,))
SYMPLECTIC_EULER = RungeKutta((0.0,), (1.0,), symplectic=True)
MIDPOINT = RungeKutta((0.0, 0.5), (0.0, 1.0))
RK4 = RungeKutta((0.0, 0.5, 0.5, 1.0), (1 / 6, 1 / 3, 1 / 3, 1 / 6))
