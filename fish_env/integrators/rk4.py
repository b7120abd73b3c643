"""The classical Runge-Kutta method: four force evaluations a step, fourth order, explicit (Song 2009, ch. 5).

Legend: x, v positions and velocities of a block; f forces; h step; sx, sv the stage; kx, kv the weighted sums.
"""

from fish_env import forces
from fish_env._jit import kernel
from fish_env.forces.plan import H
from fish_env.integrators._common import move_rest_lengths, plan_of_step, scratch
from fish_env.simd import fma, zero

TIME = (0.0, 0.5, 0.5, 1.0)  # when each stage is taken, in steps
WEIGHT = (1 / 6, 1 / 3, 1 / 3, 1 / 6)

plan = plan_of_step


def costs(row):
    """Force evaluations, factorisations and solves of a step."""
    return 4, 0, 0


def make_work(body, kind):
    """Scratch of a block."""
    return scratch(body, kind, "f", "sx", "sv", "kx", "kv")


def make_run(names):
    """The kernel that takes n steps of a block on which the forces of these names act."""
    add_force, finish = forces.total(names, "add_force"), forces.total(names, "finish")

    @kernel
    def run(body, world, control, x, v, work, cache, n):
        f, sx, sv, kx, kv = work.f, work.sx, work.sv, work.kx, work.kv
        inverse_mass, h = body.inverse_mass, control.plans[control.row[0], H]
        for s in range(n):
            for i in range(x.size):
                sx[i] = x[i]
                sv[i] = v[i]
                kx[i] = zero(f)
                kv[i] = zero(f)
            for stage in range(4):
                move_rest_lengths(control, (s + TIME[stage]) * h)
                for i in range(x.size):
                    f[i] = zero(f)
                add_force(body, world, control, sx, sv, f, cache)
                weight, ahead = WEIGHT[stage], TIME[min(stage + 1, 3)] * h
                for i in range(x.size):
                    u, a = sv[i], inverse_mass[i] * f[i]
                    kx[i] = fma(weight, u, kx[i])
                    kv[i] = fma(weight, a, kv[i])
                    sx[i] = fma(ahead, u, x[i])
                    sv[i] = fma(ahead, a, v[i])
            for i in range(x.size):
                x[i] = fma(h, kx[i], x[i])  # (16)
                v[i] = fma(h, kv[i], v[i])
            finish(body, world, control, x, v, f, cache)

    return run
