"""The midpoint method: half an explicit Euler step, then a step with what is found there (Song 2009, ch. 5).

Second order, explicit.

Legend: x, v positions and velocities of a block; f forces; h step; sx, sv the stage.
"""

from fish_env import forces
from fish_env._jit import kernel
from fish_env.forces.plan import H
from fish_env.integrators._common import move_rest_lengths, plan_of_step, scratch
from fish_env.simd import fma, zero

plan = plan_of_step


def costs(row):
    """Force evaluations, factorisations and solves of a step."""
    return 2, 0, 0


def make_work(body, kind):
    """Scratch of a block."""
    return scratch(body, kind, "f", "sx", "sv")


def make_run(names):
    """The kernel that takes n steps of a block on which the forces of these names act."""
    add_force, finish = forces.total(names, "add_force"), forces.total(names, "finish")

    @kernel
    def run(body, world, control, x, v, work, cache, n):
        f, sx, sv, inverse_mass, h = work.f, work.sx, work.sv, body.inverse_mass, control.plans[control.row[0], H]
        for s in range(n):
            for i in range(x.size):
                sx[i] = x[i]
                sv[i] = v[i]
            for stage in range(2):
                move_rest_lengths(control, (s + 0.5 * stage) * h)
                for i in range(x.size):
                    f[i] = zero(f)
                add_force(body, world, control, sx, sv, f, cache)
                ahead = 0.5 * h if stage == 0 else h
                for i in range(x.size):
                    sx[i] = fma(ahead, sv[i], x[i])  # (29)
                    sv[i] = fma(ahead, inverse_mass[i] * f[i], v[i])
            for i in range(x.size):
                x[i] = sx[i]
                v[i] = sv[i]
            finish(body, world, control, x, v, f, cache)

    return run
