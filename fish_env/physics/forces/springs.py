"""Springs: viscoelastic elements, an elastic and a viscous force along the line between two nodes (Tu 1996, ch. 4).

Legend: i, j the element's nodes; r = x_j - x_i; u = v_j - v_i; eta effective stiffness; n = r/|r|; the force on node i
is eta r.
"""

import numpy as np

from fish_env.kernels.compile import INDEX, kernel
from fish_env.kernels.simd import Pack, dot, fma, nowhere, select, sqrt, vec3, zero
from fish_env.physics.failures import STRETCH_LIMIT, TORN
from fish_env.physics.forces.plan import FACTOR, INNER, LEAST, LOWEST, H
from fish_env.physics.records import Body, World

MOST_COMPRESSED = -0.1  # strain below which a spring's negative transverse stiffness is constant in `add_tangent`
EVERY_WAY = np.kron([[1.0, -1.0], [-1.0, 1.0]], np.eye(3))  # of a spring that resists in all directions
FAILURE = TORN
ANYWHERE = True


def present(body: Body, world: World) -> bool:
    """Return True if the body has springs."""
    return len(body.springs.nodes) > 0


def make_cache(body: Body, world: World, kind) -> Pack:
    """Data of `add_force_cached`: separation r, transverse stiffness, and axial minus transverse over |r|^2."""
    count = len(body.springs.nodes)
    return Pack("springs", r=kind.vectors(count), across=kind.numbers(count), pull=kind.numbers(count))


def rest_matrices(body: Body, elastic):
    """Stiffness, N/m, or damping, N s/m, at rest: nodes (E,2) and matrices (E,6,6)."""
    # Springs that are stretched or compressed at rest, as by gas, also have a stiffness transverse to them.
    springs, x = body.springs, body.position
    r = x[springs.nodes[:, 1]] - x[springs.nodes[:, 0]]
    row = np.concatenate([r, -r], axis=1) / np.linalg.norm(r, axis=1)[:, None]
    constant = springs.stiffness if elastic else springs.damping
    eta = effective(body) if elastic else np.zeros(len(constant))
    yield springs.nodes, (constant - eta)[:, None, None] * row[:, :, None] * row[:, None, :]  # (36)
    yield springs.nodes, eta[:, None, None] * EVERY_WAY


def effective(body: Body) -> np.ndarray:
    """Effective stiffness eta of the springs at rest, (E,) N/m: tension over length."""
    nodes, stiffness, _, rest, _ = body.springs
    return stiffness * (1.0 - rest / np.linalg.norm(body.position[nodes[:, 1]] - body.position[nodes[:, 0]], axis=1))


@kernel
def measure_spring(springs, rest, x, v, e):
    """Values i, j, r, 1 / |r|, strain over present length, and relative rate of change of |r|, 1/s, of spring e."""
    i, j = INDEX(springs.nodes[e, 0]), INDEX(springs.nodes[e, 1])
    r, u = x[j] - x[i], v[j] - v[i]
    inverse = 1.0 / sqrt(dot(r, r))
    return i, j, r, inverse, fma(-rest[e], inverse, 1.0), dot(r, u) * (inverse * inverse)  # (5)


@kernel
def add_force(body, world, control, x, v, f, cache):
    """Add the elastic and viscous force of every spring."""
    springs, rest, factor = body.springs, control.rest_length, control.stiffness[0]
    for e in range(springs.stiffness.size):
        i, j, r, _, strain, fast = measure_spring(springs, rest, x, v, e)
        pull = (factor * fma(springs.damping[e], fast, springs.stiffness[e] * strain)) * r  # (6), (7)
        f[i] += pull
        f[j] -= pull


@kernel
def add_force_cached(body, world, control, x, v, f, cache):
    """Add the force of every spring, and store the data of `add_tangent` for a filtered step."""
    # The filter weight is FACTOR h^2 c transverse to the spring; along it, the weight of its damping is added. With two
    # stages and small steps, that could be less than half a step of damping. LEAST is therefore its lower bound, so
    # that the damping remains of second order.
    springs, rest, factor, fastest = body.springs, control.rest_length, control.stiffness[0], control.fastest[0]
    plans, row = control.plans, control.row[0]
    h, least = plans[row, H], plans[row, LEAST]
    elastic_part, viscous_part = plans[row, FACTOR] * h * h, 2.0 * plans[row, FACTOR] * h
    for e in range(springs.stiffness.size):
        i, j, r, inverse, strain, fast = measure_spring(springs, rest, x, v, e)
        c, k = springs.stiffness[e], springs.damping[e]
        elastic = elastic_part * c
        along = max(elastic + viscous_part * k, least * h * k)
        pull = (factor * fma(k, fast, c * strain)) * r
        f[i] += pull
        f[j] -= pull
        across = (factor * elastic) * select(strain > MOST_COMPRESSED, strain, MOST_COMPRESSED)
        cache.r[e] = r
        cache.across[e] = across
        cache.pull[e] = fma(factor, along, -across) * (inverse * inverse)
        fast = abs(fast)
        fastest = select(fast > fastest, fast, fastest)
    control.fastest[0] = fastest


@kernel
def add_tangent(body, world, control, x, y, f, cache):
    """Add the restoring force of displacements y, by the stored stiffness."""
    nodes = body.springs.nodes
    for e in range(nodes.shape[0]):
        i, j = INDEX(nodes[e, 0]), INDEX(nodes[e, 1])
        u, r = y[j] - y[i], cache.r[e]
        g = fma(cache.pull[e] * dot(r, u), r, cache.across[e] * u)
        f[i] += g
        f[j] -= g


@kernel
def add_system(body, world, control, x, v, a, cache):
    """Add h D + h^2 K to the matrix a, with h the INNER step, and store K for `add_tangent`."""
    # D is -df/dv. K is -df/dx without its unsymmetric part, which comes from the rotation of the damping's direction.
    # The lower bound of the effective stiffness eta is LOWEST: with 0, K is positive semi-definite. a has three columns
    # for each entry of the nodes' skyline.
    springs, rest, factor, diagonal = body.springs, control.rest_length, control.stiffness[0], body.profile.diagonal
    h, lowest = control.plans[control.row[0], INNER], control.plans[control.row[0], LOWEST]
    for e in range(springs.stiffness.size):
        i, j, r, inverse, strain, fast = measure_spring(springs, rest, x, v, e)
        c, k = factor * springs.stiffness[e], factor * springs.damping[e]
        eta = fma(k, fast, c * strain)
        eta = select(eta > lowest, eta, lowest)
        along, across = ((h * h * (c - eta) + h * k) * (inverse * inverse)) * r, (h * h) * eta  # (36), (37)
        add_columns(a, 3 * diagonal[i], 1.0, r, along, across)
        add_columns(a, 3 * diagonal[j], 1.0, r, along, across)
        add_columns(a, 3 * springs.entry[e], -1.0, r, along, across)
        cache.r[e] = r
        cache.across[e] = eta
        cache.pull[e] = (c - eta) * (inverse * inverse)


@kernel
def add_columns(a, place, sign, r, along, across):
    """Add sign (along r^T + across) to the block whose columns begin at `place` in a."""
    a[INDEX(place)] += sign * fma(r.x, along, across * vec3(1.0, 0.0, 0.0))
    a[INDEX(place + 1)] += sign * fma(r.y, along, across * vec3(0.0, 1.0, 0.0))
    a[INDEX(place + 2)] += sign * fma(r.z, along, across * vec3(0.0, 0.0, 1.0))


@kernel
def add_lagged(body, world, control, x, v, system, cache):
    """Add the force at the start of the step to `system.load`, and h^2 eta, its implicit part, to `system.matrix`."""
    # The effective stiffness eta is the same for all axes and is assumed to be constant in the step. The matrix has one
    # number for each entry of the nodes' skyline.
    matrix, load, h = system.matrix, system.load, control.plans[control.row[0], INNER]
    springs, rest, factor, diagonal = body.springs, control.rest_length, control.stiffness[0], body.profile.diagonal
    for e in range(springs.stiffness.size):
        i, j, r, _, strain, fast = measure_spring(springs, rest, x, v, e)
        eta = factor * fma(springs.damping[e], fast, springs.stiffness[e] * strain)
        weight, pull = (h * h) * eta, eta * r
        matrix[INDEX(diagonal[i])] += weight  # (29)
        matrix[INDEX(diagonal[j])] += weight
        matrix[INDEX(springs.entry[e])] -= weight
        load[i] += pull  # (30)
        load[j] -= pull


@kernel
def energy(body, world, control, x, v, f, cache):
    """Elastic energy of all springs, J."""
    nodes, stiffness, total = body.springs.nodes, body.springs.stiffness, zero(control.stiffness)
    for e in range(stiffness.size):
        r = x[INDEX(nodes[e, 1])] - x[INDEX(nodes[e, 0])]
        stretch = sqrt(dot(r, r)) - control.rest_length[e]
        total = fma(0.5 * stiffness[e], stretch * stretch, total)  # (8)
    return control.stiffness[0] * total


@kernel
def loss(body, world, control, x, v, f, cache):
    """Power lost in the damping of all springs, W."""
    damping, total = body.springs.damping, zero(control.stiffness)
    for e in range(damping.size):
        _, _, r, _, _, fast = measure_spring(body.springs, control.rest_length, x, v, e)
        total = fma(damping[e] * (fast * fast), dot(r, r), total)
    return control.stiffness[0] * total


@kernel
def failed(body, world, control, x, v, f, cache):
    """Mask of the fish in which a spring is longer than STRETCH_LIMIT times its natural length."""
    nodes, natural = body.springs.nodes, body.springs.rest_length
    torn = nowhere(x)
    for e in range(natural.size):
        r = x[INDEX(nodes[e, 1])] - x[INDEX(nodes[e, 0])]
        allowed = STRETCH_LIMIT * natural[e]
        torn = torn | (dot(r, r) > allowed * allowed)
    return torn
