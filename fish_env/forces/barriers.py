"""Barriers that keep the inner layer inside the outer one (Song 2009, ch. 4.6.2; the barrier of Li et al. 2020).

A barrier acts once the tetrahedron (on a ring, the triangle) between an outer face and an inner node has less than NEAR
of its volume at rest: its energy rises without bound as that goes to nothing, with two continuous derivatives. Beyond,
where there is no way back, it pushes nowhere, and `failed` says so.

Legend: k barrier; s its relative volume, that over the volume at rest; d, e, f the corners of the outer face seen from
the inner node.
"""

import numpy as np

from fish_env._jit import INDEX, kernel
from fish_env.failures import ESCAPED
from fish_env.simd import any_lane, cross, dot, fma, log, nowhere, select, vec3, zero

NEAR = 0.6  # of the volume at rest, below which a barrier acts
FAILURE = ESCAPED


def present(body, world) -> bool:
    """Whether the body has barriers."""
    return body.barriers is not None


@kernel
def corners(barriers, k, x):
    """Outer corners of barrier k as seen from its inner node; an edge counts as a face of which one is 3 m above it."""
    inner, third = x[INDEX(barriers.nodes[k, 3])], barriers.nodes[k, 2]
    d, e = x[INDEX(barriers.nodes[k, 0])] - inner, x[INDEX(barriers.nodes[k, 1])] - inner
    if third < 0:
        f = 0.0 * d + vec3(0.0, 0.0, 3.0)
    else:
        f = x[INDEX(third)] - inner
    return d, e, f


@kernel
def relative_volume(barriers, k, x):
    """Relative volume of barrier k, and its gradients at the outer corners, 1/m."""
    d, e, f = corners(barriers, k, x)
    scale = 1.0 / (6.0 * barriers.volume[k])
    p = scale * cross(e, f)
    return dot(d, p), p, scale * cross(f, d), scale * cross(d, e)


@kernel
def barrier(s):
    """Energy of a barrier over its scale, its first and its second derivative with respect to s; zero where s <= 0."""
    s = select((s > 0.0) & (s < NEAR), s, NEAR)
    gap, logarithm = s - NEAR, log(s / NEAR)
    part = gap / s
    energy = -(gap * gap) * logarithm  # (56)
    return energy, -gap * fma(2.0, logarithm, part), fma(part, part, -fma(4.0, part, 2.0 * logarithm))


@kernel
def add_force(body, world, control, x, v, f, cache):
    """Add the force of every barrier. Those that act in no fish of a block are skipped: logarithms are expensive."""
    barriers, factor = body.barriers, control.stiffness[0]
    for k in range(barriers.energy.size):
        s, p, q, r = relative_volume(barriers, k, x)
        if not any_lane(s < NEAR):
            continue
        push, third = (-barriers.energy[k] * factor) * barrier(s)[1], barriers.nodes[k, 2]
        p, q, r = push * p, push * q, push * r
        total = p + q
        if third >= 0:
            f[INDEX(third)] += r
            total = total + r
        f[INDEX(barriers.nodes[k, 0])] += p
        f[INDEX(barriers.nodes[k, 1])] += q
        f[INDEX(barriers.nodes[k, 3])] -= total


@kernel
def energy(body, world, control, x, v, f, cache):
    """Energy of all barriers, J; infinite beyond one."""
    barriers, total = body.barriers, zero(control.stiffness)
    for k in range(barriers.energy.size):
        s = relative_volume(barriers, k, x)[0]
        total += select(s > 0.0, barriers.energy[k] * barrier(s)[0], np.inf)
    return control.stiffness[0] * total


@kernel
def failed(body, world, control, x, v, f, cache):
    """Where an inner node has left its place behind the outer faces."""
    barriers, escaped = body.barriers, nowhere(x)
    for k in range(barriers.energy.size):
        escaped = escaped | (relative_volume(barriers, k, x)[0] <= 0.0)
    return escaped
