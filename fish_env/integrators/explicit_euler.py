"""Explicit Euler: position with the old velocity, velocity with the old force (Song 2009, ch. 5). First order.

Legend: x, v positions and velocities of a block; f forces; h step.
"""

from fish_env import forces
from fish_env._jit import kernel
from fish_env.forces.plan import H
from fish_env.integrators._common import move_rest_lengths, plan_of_step, scratch
from fish_env.simd import fma, zero

plan = plan_of_step


def costs(row):
    """Force evaluations, factorisations and solves of a step."""
    return 1, 0, 0


def make_work(body, kind):
    """Scratch of a block."""
    return scratch(body, kind, "f")


def make_run(names):
    """The kernel that takes n steps of a block on which the forces of these names act."""
    add_force, finish = forces.total(names, "add_force"), forces.total(names, "finish")

    @kernel
    def run(body, world, control, x, v, work, cache, n):
        f, inverse_mass, h = work.f, body.inverse_mass, control.plans[control.row[0], H]
        for s in range(n):
            move_rest_lengths(control, s * h)
            for i in range(x.size):
                f[i] = zero(f)
            add_force(body, world, control, x, v, f, cache)
            for i in range(x.size):
                x[i] = fma(h, v[i], x[i])  # (28)
                v[i] = fma(h, inverse_mass[i] * f[i], v[i])
            finish(body, world, control, x, v, f, cache)

    return run
