"""Common parts of the methods: step coefficients, scratch memory, moving rest lengths, fixed degrees of freedom."""

from typing import Any

import numpy as np

from fish_env.kernels.compile import INDEX, kernel
from fish_env.kernels.simd import Kind, Pack, dot, floats, fma, select, sqrt, vec3, zero
from fish_env.physics import forces
from fish_env.physics.forces.plan import INNER, LOWEST, POLYNOMIAL, H
from fish_env.physics.records import Body


def plan_of_step(elastic: float, viscous: float, h: float, inner=1.0, lowest=-np.inf) -> np.ndarray:
    """Step coefficients, a row of `control.plans`, of a method that needs its step of h s only."""
    # `inner` is the part of the step in the system matrix, `lowest` as in `fish_env.physics.forces.plan`.
    row = np.zeros(POLYNOMIAL)
    row[[H, INNER, LOWEST]] = h, inner * h, lowest
    return row


def scratch(body: Body, kind: Kind, *names: str, **others) -> Pack:
    """Scratch pack of a block of fish: vectors (N,) of these names, and other fields."""
    return Pack("work", **{name: kind.vectors(len(body.mass)) for name in names}, **others)


def make_constrain(names: tuple[str, ...]):
    """Make the kernel in which these forces constrain accelerations; those of fixed degrees of freedom are zero."""
    constrain = forces.total(names, "constrain")
    if not forces.any_has(names, "constrain"):
        return constrain

    @kernel
    def constrain_free(body, world, control, x, v, a, cache):
        constrain(body, world, control, x, v, a, cache)
        zero_fixed(body, a)

    return constrain_free


@kernel
def move_rest_lengths(control, elapsed):
    """Set the rest lengths of the driven springs to those `elapsed` seconds into the call, and store the time."""
    control.elapsed[0] = elapsed
    rest, start, rate, driven = control.rest_length, control.start, control.rate, control.driven
    for d in range(driven.size):
        rest[INDEX(driven[d])] = fma(elapsed, rate[d], start[d])  # (1)


@kernel
def add_work(body, control, x, duration):
    """Add to `control.work` what the driven springs do in a duration, s, at their present lengths and rest lengths."""
    # A spring whose rest length l moves under the elastic tension g does the work -g dl, J. The factor on stiffness is
    # left out: it is the same in the whole call.
    nodes, stiffness = body.springs.nodes, body.springs.stiffness
    rest, rate, driven, power = control.rest_length, control.rate, control.driven, zero(control.work)
    for d in range(driven.size):
        e = INDEX(driven[d])
        r = x[INDEX(nodes[e, 1])] - x[INDEX(nodes[e, 0])]
        power = fma(stiffness[e] * (rest[e] - sqrt(dot(r, r))), rate[d], power)
    control.work[0] = fma(duration, power, control.work[0])  # (55)


@kernel
def positive_power(body, control, x):
    """Power of the driven springs that do positive work (see `add_work`), W over the factor on stiffness."""
    nodes, stiffness = body.springs.nodes, body.springs.stiffness
    rest, rate, driven, power = control.rest_length, control.rate, control.driven, zero(control.work)
    for d in range(driven.size):
        e = INDEX(driven[d])
        r = x[INDEX(nodes[e, 1])] - x[INDEX(nodes[e, 0])]
        own = stiffness[e] * (rest[e] - sqrt(dot(r, r))) * rate[d]
        power += select(own > 0.0, own, 0.0)
    return power


def make_measure(names: tuple[str, ...], flows: bool) -> Any:
    """Make the kernel that adds the energy flows of a duration, s, at positions x; None if flows are not measured."""
    # Before it is called, `control.flows` gets the velocities v and the accelerations a. The flows are in the order of
    # FLOWS, J over the factor on mass.
    if not flows:
        return None
    wet = tuple(name for name in names if hasattr(forces.FORCES[name], "IN_WATER"))
    damping = forces.total(tuple(name for name in names if name not in wet), "loss")
    water, add_force = forces.total(wet, "loss"), forces.total(wet, "add_force")
    add_inertia = forces.total(wet, "add_inertia")

    @kernel
    def measure(body, world, control, x, cache, duration):
        flows = control.flows
        total, v, f = flows.total, flows.v, flows.f
        total[0] = fma(duration * control.stiffness[0], positive_power(body, control, x), total[0])  # (57)
        total[1] = fma(duration, damping(body, world, control, x, v, f, cache), total[1])  # (58)
        total[2] = fma(duration, water(body, world, control, x, v, f, cache), total[2])  # (59)
        for i in range(x.size):
            f[i] = zero(f)
        add_inertia(body, world, control, x, flows.a, f, cache)
        ahead, drift, mass = zero(f), zero(f), 0.0
        for i in range(x.size):
            f[i] = -1.0 * f[i]
            ahead = fma(flows.line[i], x[i], ahead)
            drift = fma(body.mass[i], v[i], drift)
            mass += body.mass[i]
        add_force(body, world, control, x, v, f, cache)
        size, thrust = sqrt(dot(ahead, ahead)), zero(total)
        for i in range(x.size):
            push = dot(f[i], ahead)
            thrust += select(push > 0.0, push, 0.0)
        speed = dot((1.0 / mass) * drift - (world.current[0] + control.current[0]), ahead)
        total[3] = fma(duration, select(size > 0.0, thrust * speed / (size * size), 0.0), total[3])  # (60)

    return measure


@kernel
def zero_fixed(body, a):
    """Set the vectors a (N,) to zero along fixed degrees of freedom."""
    values, fixed = floats(a), body.fixed
    for m in range(fixed.shape[0]):
        for lane in range(values.shape[2]):
            values[INDEX(fixed[m, 0]), INDEX(fixed[m, 1]), lane] = 0.0


@kernel
def set_masses(body, a):
    """Set a matrix of 3 x 3 blocks, three columns (3S,) for each entry of the nodes' skyline, to the masses."""
    none = zero(a)
    for p in range(a.size):
        a[p] = none
    for i in range(body.mass.size):
        place, mass = 3 * body.profile.diagonal[i], body.mass[i]
        a[INDEX(place)] = none + vec3(mass, 0.0, 0.0)
        a[INDEX(place + 1)] = none + vec3(0.0, mass, 0.0)
        a[INDEX(place + 2)] = none + vec3(0.0, 0.0, mass)


@kernel
def eliminate(body, a):
    """Eliminate the rows and columns of fixed degrees of freedom from a matrix in the layout of `set_masses`."""
    # They are replaced by the equation that the unknown equals its right-hand side, so the matrix keeps its shape.
    first, start, fixed, values, none = body.profile.first, body.profile.start, body.fixed, floats(a), zero(a)
    for m in range(fixed.shape[0]):
        i, k = body.profile.row[fixed[m, 0]], fixed[m, 1]
        for row in range(i, first.size):
            if first[row] <= i:
                a[INDEX(3 * (start[row] + i - first[row]) + k)] = none
        for place in range(3 * start[i], 3 * start[i + 1]):
            for lane in range(values.shape[2]):
                values[INDEX(place), INDEX(k), lane] = 0.0
        for lane in range(values.shape[2]):
            values[INDEX(3 * (start[i + 1] - 1) + k), INDEX(k), lane] = 1.0


@kernel
def count_pivots(control, found):
    """Count (non-positive pivots, untrusted pivots) of a factorisation, but none after the first untrusted one."""
    negative, untrusted = found
    before, counted = control.untrusted[0], control.pivots[0]
    control.pivots[0] = select(before > 0.0, counted, counted + negative)
    control.untrusted[0] = before + untrusted
