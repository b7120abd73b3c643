"""Tu's semi-implicit Euler method: effective stiffness implicit but lagged, water explicit (Tu 1996, ch. 4).

The force of a unit is eta r with eta frozen at the start of the step and r at its end, so one symmetric N x N matrix
serves x, y and z. Not what Newton and Warp call semi-implicit; that is `symplectic_euler.py`.

Legend: x, v positions and velocities of one body; h step; a the system matrix in its skyline, then L; g the load,
then the new velocities; eta effective stiffness.
"""

import numpy as np

from fish_env import forces
from fish_env._jit import INDEX, njit
from fish_env.body import PIVOTS, UNTRUSTED_SOLVE
from fish_env.forces import contact, springs
from fish_env.integrators._common import count, rest_lengths, settle
from fish_env.linalg import ldlt


@njit
def assemble(body, world, rest, x, v, h, a, g):
    """System matrix a (S,) kg, in its skyline, and load g (N,3) kg m/s: both sides of the equation times h."""
    forces.external(body, world, x, v, g)
    a[:] = 0.0
    diagonal = body.profile.diagonal
    for i in range(body.mass.size):
        a[INDEX(diagonal[i])] = body.mass[i]
        for k in range(3):
            g[i, k] = body.mass[i] * v[i, k] + h * g[i, k]
    for e in range(body.springs.stiffness.size):
        i, j = INDEX(body.springs.nodes[e, 0]), INDEX(body.springs.nodes[e, 1])
        rx, ry, rz, eta = springs.unit(body.springs, rest, x, v, e)
        weight = h * eta
        a[INDEX(diagonal[i])] += h * weight  # (7)
        a[INDEX(diagonal[j])] += h * weight
        a[INDEX(body.springs.entry[e])] -= h * weight
        g[i, 0] += weight * rx  # (8)
        g[i, 1] += weight * ry
        g[i, 2] += weight * rz
        g[j, 0] -= weight * rx
        g[j, 1] -= weight * ry
        g[j, 2] -= weight * rz
    add_anchors(world.anchors, body.profile.diagonal, x, v, h, a, g)
    add_reaction(world.planes, body.mass, x, v, h, g)
    if body.held.size > 0:
        eliminate(body, v, a, g)


@njit
def add_anchors(anchors, diagonal, x, v, h, a, g):
    """The anchors' part, as `assemble`: those without length wholly implicit, the others as the units are."""
    if anchors is None:
        return
    for m in range(anchors.node.size):
        i, stiffness, damping = INDEX(anchors.node[m]), anchors.stiffness[m], anchors.damping[m]
        r = anchors.point[m] - x[i]
        length = np.sqrt(np.sum(r * r))
        if anchors.rest_length[m] > 0.0:
            if length == 0.0:
                continue
            speed = np.sum(r * (anchors.velocity[m] - v[i])) / length
            eta = (stiffness * (length - anchors.rest_length[m]) + damping * speed) / length
            a[INDEX(diagonal[i])] += h * h * eta
            for k in range(3):
                g[i, k] += h * eta * r[k]
            continue
        a[INDEX(diagonal[i])] += h * (h * stiffness + damping)
        for k in range(3):
            g[i, k] += h * (stiffness * r[k] + damping * anchors.velocity[m, k])


@njit
def add_reaction(planes, mass, x, v, h, g):
    """Take from the load what presses a node further behind a wall, as `contact.add_reaction` from a force."""
    if planes is None:
        return
    f = np.empty_like(g)
    for i in range(mass.size):
        for k in range(3):
            f[i, k] = (g[i, k] - mass[i] * v[i, k]) / h
    contact.add_reaction(planes, x, v, f)
    for i in range(mass.size):
        for k in range(3):
            g[i, k] = mass[i] * v[i, k] + h * f[i, k]


@njit
def keep_out(planes, x, v, g):
    """Take from the new velocities g (N,3) m/s what moves a node further behind a wall."""
    if planes is None:
        return
    change = g - v
    contact.bear(planes, x, v, 1.0, change)
    g[:] = v + change


@njit
def eliminate(body, v, a, g):
    """Take the nodes that are held along every axis in which any is free out of the system: they keep their v."""
    first, start, order = body.profile.first, body.profile.start, body.mass.size
    free = np.zeros(3, np.bool_)
    for i in range(order):
        for k in range(3):
            free[k] |= body.inverse_mass[i, k] > 0.0
    for i in range(order):
        fixed = True
        for k in range(3):
            fixed &= not (free[k] and body.inverse_mass[i, k] > 0.0)
        if not fixed:
            continue
        for j in range(order):
            low, high = min(i, j), max(i, j)
            if j == i or low < first[high]:
                continue
            place = start[high] + low - first[high]
            for k in range(3):
                g[j, k] -= a[place] * v[i, k]
            a[place] = 0.0
        a[body.profile.diagonal[i]] = 1.0
        g[i] = v[i]


@njit
def step(body, world, rest, x, v, h, a, g, inverse_pivot, row):
    """One step of one body, x and v changed in place, the rest scratch. Returns (non-positive pivots, trusted)."""
    assemble(body, world, rest, x, v, h, a, g)
    negative, trusted = ldlt.factor_solve(body.profile, a, g, inverse_pivot, row)  # (9)
    keep_out(world.planes, x, v, g)
    for i in range(body.mass.size):
        for k in range(3):
            if body.inverse_mass[i, k] > 0.0:
                v[i, k] = g[i, k]
            x[i, k] += h * v[i, k]
    return negative, trusted


@njit
def advance(body, world, state, control, h, n):
    """Move every sound body n steps of h seconds; state is changed in place."""
    nodes = body.mass.size
    a = np.empty(body.profile.start[nodes])
    g = np.empty((nodes, 3))
    inverse_pivot, row = np.empty(nodes), np.empty(nodes)
    rest = np.empty(body.springs.stiffness.size)
    before_x, before_v = np.empty((nodes, 3)), np.empty((nodes, 3))
    for b in range(state.t.size):
        if state.failure[b]:
            continue
        x, v = state.x[b], state.v[b]
        before_x[:] = x
        before_v[:] = v
        failure = taken = 0
        for s in range(n):
            rest_lengths(control, b, s * h, rest)
            negative, trusted = step(body, world, rest, x, v, h, a, g, inverse_pivot, row)
            contact.bounce(world.planes, body.inverse_mass, world.gravity, h, x, v)
            taken += 1
            state.counters[b, PIVOTS] += negative
            if not trusted:
                failure = UNTRUSTED_SOLVE
                break
        count(state, b, taken, taken, taken)
        settle(body, state, control, b, before_x, before_v, failure, n * h)
