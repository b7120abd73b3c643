"""Rejected methods that need no matrix."""

import numpy as np

from benchmarks.accuracy.rejected_methods.common import RejectedMethod, leapfrog, make_force, spring
from fish_env._jit import kernel
from fish_env.forces.plan import H
from fish_env.integrators._common import move_rest_lengths
from fish_env.simd import dot, fma, sqrt

GRADIENT = 1.0 / 12.0  # part of h^2 times the force's gradient by which its kick is corrected
TOLERANCE = 0.01  # body lengths that step doubling may err in a step, at one substep; a quarter of it at two
MOST_FORCES = 4000  # a control interval, after which step doubling has failed


def verlet_work(body, kind, number) -> dict:
    """Accelerations stored from step to step, and predicted velocities."""
    return {**{name: kind.vectors(len(body.mass)) for name in ("a", "ahead")}, "begun": np.zeros(1)}


def velocity_verlet(names):
    """Velocity Verlet, the force at the end of the step taken with a predicted velocity."""
    force = make_force(names)

    @kernel
    def run(body, world, control, x, v, work, cache, n):
        h, f, a, ahead = control.plans[control.row[0], H], work.f, work.a, work.ahead
        if work.begun[0] == 0.0:
            work.begun[0] = 1.0
            move_rest_lengths(control, 0.0)
            force(body, world, control, x, v, f, cache)
            for i in range(x.size):
                a[i] = body.inverse_mass[i] * f[i]
        for s in range(n):
            for i in range(x.size):
                x[i] = fma(0.5 * h * h, a[i], fma(h, v[i], x[i]))
                ahead[i] = fma(h, a[i], v[i])
            move_rest_lengths(control, (s + 1) * h)
            force(body, world, control, x, ahead, f, cache)
            for i in range(x.size):
                after = body.inverse_mass[i] * f[i]
                v[i] = fma(0.5 * h, a[i] + after, v[i])
                a[i] = after

    return run


def gradient_work(body, kind, number) -> dict:
    """Accelerations, velocities ahead, and the water's forces before and after."""
    return {name: kind.vectors(len(body.mass)) for name in ("a", "ahead", "before", "after")}


@leapfrog
def force_gradient(names):
    """Leapfrog whose kick is corrected by the force's gradient (Takahashi & Imada 1984), damping and water centred."""
    force, water = make_force(names), make_force(tuple(name for name in names if name == "water"))

    @kernel
    def kick(body, world, control, x, v, work, cache):
        h, f, a, ahead = control.plans[control.row[0], H], work.f, work.a, work.ahead
        force(body, world, control, x, v, f, cache)
        for i in range(x.size):
            a[i] = body.inverse_mass[i] * f[i]
            ahead[i] = fma(0.5 * h, a[i], v[i])
        water(body, world, control, x, v, work.before, cache)
        water(body, world, control, x, ahead, work.after, cache)
        for i in range(x.size):
            f[i] = work.after[i] - work.before[i]
        for e in range(body.springs.stiffness.size):
            i, j, r, inverse, strain = spring(body, control, x, e)
            turned = a[j] - a[i]
            along = (dot(r, turned) * inverse * inverse) * r
            elastic = (GRADIENT * h * h * body.springs.stiffness[e]) * (along + strain * (turned - along))
            pull = elastic + (0.5 * h * body.springs.damping[e]) * along
            f[i] += pull
            f[j] -= pull
        for i in range(x.size):
            f[i] = h * (a[i] + body.inverse_mass[i] * f[i])

    return kick


def doubling_work(body, kind, allowed) -> dict:
    """The states of a whole step and of halves; the step tried next, s; what it may err, m; forces evaluated."""
    names = ("a", "between", "half_x", "half_v", "twice_x")
    vectors = {name: kind.vectors(len(body.mass)) for name in names}
    return vectors | {"trial": np.zeros(1), "allowed": allowed, "spent": np.zeros(1, dtype=np.int64)}


def step_doubling(names):
    """Symplectic Euler, every step tried whole and halved, and again smaller where the two differ too much.

    Its step covers a control interval. The first evaluation of the next interval is the last of this one.
    """
    force = make_force(names)

    @kernel
    def accelerate(body, world, control, x, v, work, cache, elapsed, a):
        move_rest_lengths(control, elapsed)
        force(body, world, control, x, v, work.f, cache)
        for i in range(x.size):
            a[i] = body.inverse_mass[i] * work.f[i]
        work.spent[0] += 1

    @kernel
    def try_step(body, world, control, x, v, work, cache, now, length):
        a, between, half_x, half_v, twice_x = work.a, work.between, work.half_x, work.half_v, work.twice_x
        for i in range(x.size):
            half_v[i] = fma(0.5 * length, a[i], v[i])
            half_x[i] = fma(0.5 * length, half_v[i], x[i])
        accelerate(body, world, control, half_x, half_v, work, cache, now + 0.5 * length, between)
        largest = 0.0
        for i in range(x.size):
            speed = fma(0.5 * length, between[i], half_v[i])
            twice_x[i] = fma(0.5 * length, speed, half_x[i])
            off = twice_x[i] - fma(length, fma(length, a[i], v[i]), x[i])
            largest = max(largest, dot(off, off))
        return sqrt(largest)

    @kernel
    def run(body, world, control, x, v, work, cache, n):
        duration, now, before = n * control.plans[control.row[0], H], 0.0, work.spent[0]
        accelerate(body, world, control, x, v, work, cache, 0.0, work.a)
        trial = work.trial[0] if work.trial[0] > 0.0 else duration
        while now < duration * (1.0 - 1e-12):
            length = min(trial, duration - now)
            error = try_step(body, world, control, x, v, work, cache, now, length)
            if work.spent[0] - before > MOST_FORCES or not error < np.inf:
                for i in range(x.size):
                    x[i] = np.nan * x[i]
                break
            trial = length * min(max(0.9 * np.sqrt(work.allowed / max(error, 1e-300)), 0.2), 2.0)
            if error <= work.allowed:
                now += length
                for i in range(x.size):
                    v[i] = fma(0.5 * length, work.between[i], work.half_v[i])
                    x[i] = work.twice_x[i]
                accelerate(body, world, control, x, v, work, cache, now, work.a)
        work.trial[0] = trial

    return run


WITHOUT_MATRIX = (
    RejectedMethod("velocity_verlet", velocity_verlet, verlet_work, (1, 0, 0), (1, 0)),
    RejectedMethod("force_gradient", force_gradient, gradient_work, (2, 0, 0)),
    RejectedMethod("step_doubling", step_doubling, doubling_work, (0, 0, 0)),
)
