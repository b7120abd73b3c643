"""Leapfrog with Chebyshev-filtered kicks: second order, explicit, its stable step grows with the number of stages.

Drift half a step, kick, drift half a step. The kick passes through a polynomial of the frozen stiffness and damping,
which slows only what the step cannot resolve: a leapfrog-Chebyshev scheme (Gilbert & Joly 2008; Carle, Hochbruck &
Sturm 2020), here with damped units and with a face's own drag taken implicitly. `plan` says how many stages a step of h
needs: small motion is stable at any h that MOST_STAGES reach, at a price that grows with the root of the stiffness.

Legend: x, v positions and velocities of one body; h step; f the force; w the water's correction; a the filtered
acceleration of this stage, before of the last one, kick of all forces; t Chebyshev polynomials T_k at their midpoint.
"""

import math

import numpy as np

from fish_env import forces
from fish_env._jit import njit, njit_inline
from fish_env.forces import anchors, contact, gravity, pressure, tets, water
from fish_env.integrators._common import count, rest_lengths, settle

DAMPING = 4.0  # of the polynomial: how far above 1 its midpoint lies, times the square of the stages
SAFETY = 1.2  # the body's highest rates when bent and pulled, over those at rest
MOST_STAGES = 1000


@njit
def polynomial(stages, t):
    """Coefficients of the filter: fills t (stages + 1,), returns its midpoint, first factor, stiffness factor, reach.

    The reach is the largest h^2 c/m + 2 h k/m of a vibration that the filter keeps stable.
    """
    midpoint = 1.0 + DAMPING / (stages * stages)
    t[0], t[1] = 1.0, midpoint
    u, u_before = 2.0 * midpoint, 1.0  # second kind: the derivative of T_k is k U_(k-1)
    for k in range(1, stages):
        t[k + 1] = 2.0 * midpoint * t[k] - t[k - 1]
        if k > 1:
            u, u_before = 2.0 * midpoint * u - u_before, u
    first = t[stages] / (stages * u)
    slope = first * (1.0 + 1.0 / t[stages]) / 4.0
    return midpoint, first, 2.0 * slope, (1.0 + midpoint) / slope


@njit
def plan(elastic_rate, viscous_rate, h, t):
    """Smallest number of stages, at least 2, that keeps a step of h s stable; fills t as `polynomial` does."""
    viscous = SAFETY * h * viscous_rate
    wanted = SAFETY * h * h * elastic_rate + 2.0 * viscous
    stages = min(max(2, int(math.sqrt(wanted / 3.0))), MOST_STAGES)  # the reach is at most 3 times their square
    while stages < MOST_STAGES and (polynomial(stages, t)[3] < wanted or (stages == 2 and viscous > 2.0)):
        stages += 1
    return stages


@njit
def stage_weights(springs, h, stages, t, elastic, along):
    """Masses (E,) kg with which each unit resists acceleration in a stage, by its stiffness and in all along itself.

    Two stages could hold back less than half a step of damping, at small steps: then they hold back just that, so that
    the damping stays of second order. Returns the filter's midpoint and first factor, and for the other elements the
    factor on stiffness and that least part of the damping.
    """
    midpoint, first, factor, _ = polynomial(stages, t)  # (36)
    least = 0.5 * t[2] / first if stages == 2 else 0.0
    for e in range(along.size):
        viscous = h * springs.damping[e]
        elastic[e] = factor * h * h * springs.stiffness[e]
        along[e] = max(elastic[e] + 2.0 * factor * viscous, least * viscous)
    return midpoint, first, factor, least


@njit_inline
def step(body, world, rest, h, stages, filtering, mobility, x, v, scratch):
    """One step of one body; x and v are changed in place. filtering and scratch are tuples made by `advance`.

    The drag of the air acts by itself before and after: filtered, it would feed what the filter turns round.
    """
    midpoint, first, t, weights = filtering
    f, kick, a, before, kept = scratch
    gravity.slow(body.inverse_mass, world.gravity, world.viscosity, 0.5 * h, v)
    for i in range(x.shape[0]):
        for k in range(3):
            x[i, k] += 0.5 * h * v[i, k]  # (35)
            before[i, k] = 0.0
    forces.add_total_kept(body, world, rest, x, v, f, kept)
    for i in range(x.shape[0]):
        for k in range(3):
            kick[i, k] = body.inverse_mass[i, k] * f[i, k]
            a[i, k] = first / midpoint * kick[i, k]
            f[i, k] = 0.0
    for s in range(1, stages):
        forces.add_tangent(body, world, weights, kept, x, a, f)
        now, last = t[s] / t[s + 1], t[s - 1] / t[s + 1]
        for i in range(x.shape[0]):
            for k in range(3):
                pull = 2.0 * (first * kick[i, k] + midpoint * a[i, k]) + body.inverse_mass[i, k] * f[i, k]
                f[i, k] = 0.0
                a[i, k], before[i, k] = now * pull - last * before[i, k], a[i, k]  # (37)
    contact.bear(world.planes, x, v, h, a)
    for i in range(x.shape[0]):
        for k in range(3):
            before[i, k] = v[i, k] + 0.5 * h * a[i, k]
    forces.add_change(body, world, kept, mobility, before, f)
    for i in range(x.shape[0]):
        for k in range(3):
            v[i, k] += h * (a[i, k] + body.inverse_mass[i, k] * f[i, k])
            x[i, k] += 0.5 * h * v[i, k]
            f[i, k] = 0.0
    gravity.slow(body.inverse_mass, world.gravity, world.viscosity, 0.5 * h, v)


@njit
def advance(body, world, state, control, h, n):
    """Move every sound body n steps of h seconds; state is changed in place."""
    nodes, units, faces = body.mass.size, body.springs.stiffness.size, body.faces.share.shape[0]
    t, rest, elastic, along = np.empty(MOST_STAGES + 1), np.empty(units), np.empty(units), np.empty(units)
    elastic_rate, viscous_rate = anchors.rates(world.anchors, body.inverse_mass)
    stages = plan(body.elastic_rate + elastic_rate, body.viscous_rate + viscous_rate, h, t)
    midpoint, first, factor, least = stage_weights(body.springs, h, stages, t, elastic, along)
    solid = tets.weights(body.tets, factor, h, least)
    pulling = anchors.weights(world.anchors, factor, h, least)
    filtering = (midpoint, first, t, (elastic, along, solid, pulling, factor * h * h))
    mobility = np.empty(faces)
    water.mobilities(body, 0.5 * h, mobility)
    f, kick, a, before = np.zeros((nodes, 3)), np.empty((nodes, 3)), np.empty((nodes, 3)), np.empty((nodes, 3))
    turned, compressed = tets.scratch(body.tets), pressure.scratch(body.chambers, nodes)
    scratch = (f, kick, a, before, (np.empty((faces, 5)), np.empty((7, units)), turned, compressed))
    before_x, before_v = np.empty((nodes, 3)), np.empty((nodes, 3))
    for b in range(state.t.size):
        if state.failure[b]:
            continue
        x, v = state.x[b], state.v[b]
        before_x[:] = x
        before_v[:] = v
        for s in range(n):
            rest_lengths(control, b, (s + 0.5) * h, rest)
            step(body, world, rest, h, stages, filtering, mobility, x, v, scratch)
            contact.bounce(world.planes, body.inverse_mass, world.gravity, h, x, v)
        count(state, b, stages * n, 0, 0)
        settle(body, state, control, b, before_x, before_v, state.failure[b], n * h)
