"""Springs: viscoelastic elements, an elastic and a viscous force along the line between two nodes (Tu 1996, ch. 4).

Legend: i, j the element's nodes; r = x_j - x_i; u = v_j - v_i; eta effective stiffness; n = r/|r|; the force on node i
is eta r.
"""

import numpy as np

from fish_env._jit import INDEX, kernel
from fish_env.failures import STRETCH_LIMIT, TORN
from fish_env.forces.plan import FACTOR, INNER, LEAST, LOWEST, H
from fish_env.simd import Pack, dot, fma, nowhere, select, sqrt, vec3, zero

MOST_COMPRESSED = -0.1  # strain below which an element's negative stiffness across grows no further in `add_tangent`
FAILURE = TORN


def present(body, world) -> bool:
    """Whether the body has springs."""
    return len(body.springs.nodes) > 0


def make_cache(body, world, kind) -> Pack:
    """What `add_force_cached` keeps: separation r, and stiffness across and along less across over |r|^2."""
    count = len(body.springs.nodes)
    return Pack("springs", r=kind.vectors(count), across=kind.numbers(count), pull=kind.numbers(count))


def rest_matrices(body, elastic):
    """Stiffness, N/m, or damping, N s/m, at rest: nodes (E,2) and matrices (E,6,6)."""
    springs, x = body.springs, body.position
    r = x[springs.nodes[:, 1]] - x[springs.nodes[:, 0]]
    row = np.concatenate([r, -r], axis=1) / np.linalg.norm(r, axis=1)[:, None]
    constant = springs.stiffness if elastic else springs.damping
    yield springs.nodes, constant[:, None, None] * row[:, :, None] * row[:, None, :]


@kernel
def add_force(body, world, control, x, v, f, cache):
    """Add the elastic and viscous force of every spring."""
    nodes, stiffness, damping = body.springs.nodes, body.springs.stiffness, body.springs.damping
    rest, factor = control.rest_length, control.stiffness[0]
    for e in range(stiffness.size):
        i, j = INDEX(nodes[e, 0]), INDEX(nodes[e, 1])
        r, u = x[j] - x[i], v[j] - v[i]
        inverse = 1.0 / sqrt(dot(r, r))
        strain = fma(-rest[e], inverse, 1.0)
        fast = dot(r, u) * (inverse * inverse)  # (2)
        pull = (factor * fma(damping[e], fast, stiffness[e] * strain)) * r  # (3), (4)
        f[i] += pull
        f[j] -= pull


@kernel
def add_force_cached(body, world, control, x, v, f, cache):
    """As `add_force`, and keep what `add_tangent` needs to resist acceleration in a filtered step.

    A spring does so by the mass FACTOR h^2 c across, and along itself by that of its damping besides. Two stages could
    hold back less than half a step of damping, at small steps: then they hold back just that, LEAST, so that the
    damping stays of second order.
    """
    nodes, stiffness, damping = body.springs.nodes, body.springs.stiffness, body.springs.damping
    rest, factor, fastest = control.rest_length, control.stiffness[0], control.fastest[0]
    plans, row = control.plans, control.row[0]
    h, least = plans[row, H], plans[row, LEAST]
    elastic_part, viscous_part = plans[row, FACTOR] * h * h, 2.0 * plans[row, FACTOR] * h
    kept_r, kept_across, kept_pull = cache.r, cache.across, cache.pull
    for e in range(stiffness.size):
        i, j = INDEX(nodes[e, 0]), INDEX(nodes[e, 1])
        c, k = stiffness[e], damping[e]
        elastic = elastic_part * c
        along = max(elastic + viscous_part * k, least * h * k)
        r, u = x[j] - x[i], v[j] - v[i]
        inverse = 1.0 / sqrt(dot(r, r))
        square = inverse * inverse
        strain = fma(-rest[e], inverse, 1.0)
        fast = dot(r, u) * square  # (2)
        pull = (factor * fma(k, fast, c * strain)) * r  # (3), (4)
        f[i] += pull
        f[j] -= pull
        across = (factor * elastic) * select(strain > MOST_COMPRESSED, strain, MOST_COMPRESSED)
        kept_r[e] = r
        kept_across[e] = across
        kept_pull[e] = fma(factor, along, -across) * square
        fast = abs(fast)
        fastest = select(fast > fastest, fast, fastest)
    control.fastest[0] = fastest


@kernel
def add_tangent(body, world, control, x, y, f, cache):
    """Add the pull of the springs if every node moved by y, by the stiffness that was kept."""
    nodes = body.springs.nodes
    kept_r, kept_across, kept_pull = cache.r, cache.across, cache.pull
    for e in range(nodes.shape[0]):
        i, j = INDEX(nodes[e, 0]), INDEX(nodes[e, 1])
        u, r = y[j] - y[i], kept_r[e]
        g = fma(kept_pull[e] * dot(r, u), r, kept_across[e] * u)
        f[i] += g
        f[j] -= g


@kernel
def derivative(body, control, x, v, e, lowest):
    """How the force of spring e follows its separation: r, eta, c, k, q; df/dr = eta + (c - eta) n n^T + n q^T.

    eta, N/m, is taken to be at least `lowest`: with 0, df/dr less its last part is positive semi-definite.
    """
    i, j = INDEX(body.springs.nodes[e, 0]), INDEX(body.springs.nodes[e, 1])
    factor = control.stiffness[0]
    r, u = x[j] - x[i], v[j] - v[i]
    inverse = 1.0 / sqrt(dot(r, r))
    n = inverse * r
    speed = dot(u, n)
    c, k = factor * body.springs.stiffness[e], factor * body.springs.damping[e]
    eta = fma(-(c * control.rest_length[e]), inverse, c) + k * (speed * inverse)
    q = (k * inverse) * (u - speed * n)
    return r, inverse, select(eta > lowest, eta, lowest), c, k, q


@kernel
def add_jacobian(body, world, control, x, v, matrices, cache):
    """Add -df/dx to `matrices.stiffness` (3N,3N) and -df/dv to `matrices.damping`, both exact; of one fish."""
    stiffness, damping = matrices.stiffness, matrices.damping
    for e in range(body.springs.nodes.shape[0]):
        i, j = body.springs.nodes[e, 0], body.springs.nodes[e, 1]
        r, inverse, eta, c, k, q = derivative(body, control, x, v, e, -np.inf)
        n = inverse * r
        direction, turning = (n.x, n.y, n.z), (q.x, q.y, q.z)
        for p, s in ((i, j), (j, i)):
            for a in range(3):
                for b in range(3):
                    straight = direction[a] * direction[b]
                    along = (c - eta) * straight + direction[a] * turning[b] + (eta if a == b else 0.0)  # (22)
                    stiffness[3 * p + a, 3 * p + b] += along
                    stiffness[3 * p + a, 3 * s + b] -= along
                    damping[3 * p + a, 3 * p + b] += k * straight  # (23)
                    damping[3 * p + a, 3 * s + b] -= k * straight


@kernel
def add_system(body, world, control, x, v, a, cache):
    """Add h D + h^2 K to the matrix a, with h the INNER step, and keep K for `add_tangent`.

    D is -df/dv and K is -df/dx less the turning part n q^T, which is not symmetric. a holds three columns for each
    entry of the nodes' skyline.
    """
    plans, row = control.plans, control.row[0]
    h, lowest = plans[row, INNER], plans[row, LOWEST]
    nodes, entry, diagonal = body.springs.nodes, body.springs.entry, body.profile.diagonal
    for e in range(nodes.shape[0]):
        r, inverse, eta, c, k, _ = derivative(body, control, x, v, e, lowest)
        n = inverse * r
        m = (h * h * (c - eta) + h * k) * n
        even = h * h * eta
        columns = (n.x * m + even * vec3(1.0, 0.0, 0.0), n.y * m + even * vec3(0.0, 1.0, 0.0),
                   n.z * m + even * vec3(0.0, 0.0, 1.0))  # fmt: skip
        one, other, both = 3 * diagonal[INDEX(nodes[e, 0])], 3 * diagonal[INDEX(nodes[e, 1])], 3 * entry[e]
        for axis in range(3):
            a[INDEX(one + axis)] += columns[axis]
            a[INDEX(other + axis)] += columns[axis]
            a[INDEX(both + axis)] -= columns[axis]
        cache.r[e] = r
        cache.across[e] = eta
        cache.pull[e] = (c - eta) * (inverse * inverse)


@kernel
def add_lagged(body, world, control, x, v, system, cache):
    """Add the force at the start of the step to `system.load`, and h^2 eta, that of its end, to `system.matrix`.

    The effective stiffness eta is the same for all axes and is taken to stay what it is. The matrix holds a number for
    each entry of the nodes' skyline.
    """
    matrix, load, h = system.matrix, system.load, control.plans[control.row[0], INNER]
    nodes, entry, diagonal = body.springs.nodes, body.springs.entry, body.profile.diagonal
    stiffness, damping = body.springs.stiffness, body.springs.damping
    rest, factor = control.rest_length, control.stiffness[0]
    for e in range(stiffness.size):
        i, j = INDEX(nodes[e, 0]), INDEX(nodes[e, 1])
        r, u = x[j] - x[i], v[j] - v[i]
        inverse = 1.0 / sqrt(dot(r, r))
        strain = fma(-rest[e], inverse, 1.0)
        fast = dot(r, u) * (inverse * inverse)  # (2)
        eta = factor * fma(damping[e], fast, stiffness[e] * strain)
        weight = (h * h) * eta
        matrix[INDEX(diagonal[i])] += weight  # (7)
        matrix[INDEX(diagonal[j])] += weight
        matrix[INDEX(entry[e])] -= weight
        pull = eta * r
        load[i] += pull  # (8)
        load[j] -= pull


@kernel
def energy(body, world, control, x, v, f, cache):
    """Elastic energy of all springs, J."""
    nodes, stiffness, total = body.springs.nodes, body.springs.stiffness, zero(control.rest_length)
    for e in range(stiffness.size):
        r = x[INDEX(nodes[e, 1])] - x[INDEX(nodes[e, 0])]
        stretch = sqrt(dot(r, r)) - control.rest_length[e]
        total = fma(0.5 * stiffness[e], stretch * stretch, total)  # (5)
    return control.stiffness[0] * total


@kernel
def failed(body, world, control, x, v, f, cache):
    """Where a spring is longer than STRETCH_LIMIT times its natural length."""
    nodes, natural = body.springs.nodes, body.springs.rest_length
    torn = nowhere(x)
    for e in range(natural.size):
        r = x[INDEX(nodes[e, 1])] - x[INDEX(nodes[e, 0])]
        allowed = STRETCH_LIMIT * natural[e]
        torn = torn | (dot(r, r) > allowed * allowed)
    return torn
