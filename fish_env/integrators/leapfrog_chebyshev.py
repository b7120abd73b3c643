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
from fish_env.forces import springs, water
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
def plan(body, h, t):
    """Smallest number of stages, at least 2, that keeps a step of h s stable; fills t as `polynomial` does."""
    viscous = SAFETY * h * body.viscous_rate
    wanted = SAFETY * h * h * body.elastic_rate + 2.0 * viscous
    stages = min(max(2, int(math.sqrt(wanted / 3.0))), MOST_STAGES)  # the reach is at most 3 times their square
    while stages < MOST_STAGES and (polynomial(stages, t)[3] < wanted or (stages == 2 and viscous > 2.0)):
        stages += 1
    return stages


@njit
def stage_weights(body, h, stages, t, elastic, along):
    """Masses (E,) kg with which each unit resists acceleration in a stage, by its stiffness and in all along itself.

    Two stages could hold back less than half a step of damping, at small steps: then they hold back just that, so that
    the damping stays of second order. Returns the filter's midpoint and first factor.
    """
    midpoint, first, factor, _ = polynomial(stages, t)  # (36)
    least = 0.5 * t[2] / first if stages == 2 else 0.0
    for e in range(along.size):
        viscous = h * body.springs.damping[e]
        elastic[e] = factor * h * h * body.springs.stiffness[e]
        along[e] = max(elastic[e] + 2.0 * factor * viscous, least * viscous)
    return midpoint, first


@njit_inline
def step(body, world, rest, h, stages, filtering, inverse_mass, mobility, x, v, scratch):
    """One step of one body; x and v are changed in place. filtering and scratch are tuples made by `advance`."""
    midpoint, first, t, elastic, along = filtering
    f, kick, a, before, tangent, kept = scratch
    for i in range(x.shape[0]):
        for k in range(3):
            x[i, k] += 0.5 * h * v[i, k]  # (35)
            before[i, k] = 0.0
    forces.add_total_kept(body, world, rest, x, v, f, tangent, kept)
    for i in range(x.shape[0]):
        for k in range(3):
            kick[i, k] = inverse_mass[i] * f[i, k]
            a[i, k] = first / midpoint * kick[i, k]
            f[i, k] = 0.0
    for s in range(1, stages):
        springs.add_tangent(body, elastic, along, tangent, a, f)
        now, last = t[s] / t[s + 1], t[s - 1] / t[s + 1]
        for i in range(x.shape[0]):
            for k in range(3):
                pull = 2.0 * (first * kick[i, k] + midpoint * a[i, k]) + inverse_mass[i] * f[i, k]
                f[i, k] = 0.0
                a[i, k], before[i, k] = now * pull - last * before[i, k], a[i, k]  # (37)
    for i in range(x.shape[0]):
        for k in range(3):
            before[i, k] = v[i, k] + 0.5 * h * a[i, k]
    forces.add_change(body, world, kept, mobility, before, f)
    for i in range(x.shape[0]):
        for k in range(3):
            v[i, k] += h * (a[i, k] + inverse_mass[i] * f[i, k])
            x[i, k] += 0.5 * h * v[i, k]
            f[i, k] = 0.0


@njit
def advance(body, world, state, control, h, n):
    """Move every sound body n steps of h seconds; state is changed in place."""
    nodes, units, faces = body.mass.size, body.springs.stiffness.size, body.faces.share.shape[0]
    t, rest, elastic, along = np.empty(MOST_STAGES + 1), np.empty(units), np.empty(units), np.empty(units)
    stages = plan(body, h, t)
    midpoint, first = stage_weights(body, h, stages, t, elastic, along)
    filtering = (midpoint, first, t, elastic, along)
    inverse_mass, mobility = 1.0 / body.mass, np.empty(faces)
    water.mobilities(body, 0.5 * h, mobility)
    f, kick, a, before = np.zeros((nodes, 3)), np.empty((nodes, 3)), np.empty((nodes, 3)), np.empty((nodes, 3))
    scratch = (f, kick, a, before, np.empty((7, units)), np.empty((faces, 5)))
    before_x, before_v = np.empty((nodes, 3)), np.empty((nodes, 3))
    for b in range(state.t.size):
        if state.failure[b]:
            continue
        x, v = state.x[b], state.v[b]
        before_x[:] = x
        before_v[:] = v
        for s in range(n):
            rest_lengths(control, b, (s + 0.5) * h, rest)
            step(body, world, rest, h, stages, filtering, inverse_mass, mobility, x, v, scratch)
        count(state, b, stages * n, 0, 0)
        settle(body, state, control, b, before_x, before_v, 0, n * h)
