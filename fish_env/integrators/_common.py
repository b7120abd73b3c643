"""What every `advance` does before the first and after the last step of a call."""

import math

import numpy as np

from fish_env._jit import INDEX, njit
from fish_env.body import ESCAPED, FACTORISATIONS, FORCES, NON_FINITE, SOLVES, STRETCH_LIMIT, TORN
from fish_env.forces import guards, pressure, springs, tets


@njit
def rest_lengths(control, b, elapsed, out):
    """Rest lengths (E,) m of body b, `elapsed` seconds into the call."""
    start, rate = control.rest_length[b], control.rate[b]
    for e in range(out.size):
        out[e] = start[e] + elapsed * rate[e]  # (14)


@njit
def count(state, b, forces, factorisations, solves):
    """Add what a call did to the counters of body b."""
    state.counters[b, FORCES] += forces
    state.counters[b, FACTORISATIONS] += factorisations
    state.counters[b, SOLVES] += solves


@njit
def check(body, x, v):
    """0 if the state of one body is sound, else the reason it is not: an index into FAILURES."""
    for i in range(x.shape[0]):
        for k in range(3):
            if not (math.isfinite(x[i, k]) and math.isfinite(v[i, k])):
                return NON_FINITE
    if not springs.all_shorter(body, x, STRETCH_LIMIT):
        return TORN
    if not tets.all_shorter(body.tets, x, STRETCH_LIMIT):
        return TORN
    if not (pressure.all_filled(body.chambers, x) and guards.all_inside(body.guards, x)):
        return ESCAPED
    return 0


@njit
def settle(body, state, control, b, before_x, before_v, failure, elapsed):
    """End a call for body b: advance its clock, or record why it failed and put back its last sound state.

    Its rest lengths stop where their rates have taken them.

    That is the one it had before the call, or the body at rest if it was handed over broken already.
    """
    start, rate = control.rest_length[b], control.rate[b]
    for e in range(rate.size):
        start[e] += elapsed * rate[e]
        rate[e] = 0.0
    if failure == 0:
        failure = check(body, state.x[b], state.v[b])
    if failure == 0:
        state.t[b] += elapsed
    else:
        broken = check(body, before_x, before_v)
        state.failure[b] = broken if broken else failure
        state.x[b] = body.position if broken else before_x
        state.v[b] = np.zeros_like(before_v) if broken else before_v


@njit
def eliminate(body, a, g):
    """Take the held degrees of freedom out of a system of accelerations: row and column of a (S,3,3), entry of g (N,3).

    In their place stands the equation that they are not accelerated, so the matrix keeps its shape.
    """
    first, start, diagonal = body.profile.first, body.profile.start, body.profile.diagonal
    for m in range(body.held.shape[0]):
        i, k = INDEX(body.held[m, 0]), INDEX(body.held[m, 1])
        for j in range(body.mass.size):
            if j < i and j >= first[i]:
                a[INDEX(start[i]) + INDEX(j) - INDEX(first[i]), k, :] = 0.0
            elif j > i and i >= INDEX(first[j]):
                a[INDEX(start[j]) + i - INDEX(first[j]), :, k] = 0.0
        block = a[INDEX(diagonal[i])]
        block[k, :] = 0.0
        block[:, k] = 0.0
        block[k, k] = 1.0
        g[i, k] = 0.0
