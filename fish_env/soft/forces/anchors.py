"""Springs from a node to a point of the world: a drag spring (Song 2009, ch. 4.4), or a penalty that moves the node.

An anchor with a rest length acts and damps along its own direction. One of zero length pulls by stiffness times
distance, linear in the position, and damps along all axes: it adds to the node's diagonal of a matrix only.

Legend: m anchor; i its node; r from the node to the point; u the point's velocity minus the node's; c stiffness, k
damping, l rest length. `lightness` divides by the fish's factor on mass.
"""

import numpy as np

from fish_env.kernels.compile import INDEX, kernel
from fish_env.kernels.simd import Pack, dot, fma, select, sqrt, zero
from fish_env.physics.forces.plan import FACTOR, INNER, LEAST, H
from fish_env.physics.forces.springs import add_columns
from fish_env.physics.records import Body, World


def present(body: Body, world: World) -> bool:
    """Return True if the world has anchors."""
    return world.anchors is not None


def constant(body: Body, world: World) -> bool:
    """Return True if all anchors have zero length: their stiffness is then isotropic and constant."""
    return world.anchors is not None and not world.anchors.rest_length.any()


def make_cache(body: Body, world: World, kind) -> Pack:
    """Data of `add_tangent`: r, isotropic stiffness, and the additional stiffness along the anchor over |r|^2."""
    assert world.anchors is not None  # else the force is not present
    count = len(world.anchors.node)
    return Pack("anchors", r=kind.vectors(count), across=kind.numbers(count), pull=kind.numbers(count))


def bounds(body: Body, world: World) -> tuple[float, float]:
    """Largest total stiffness and damping of the anchors of one node, over its mass, 1/s2 and 1/s."""
    assert world.anchors is not None  # else the force is not present
    anchors, inverse = world.anchors, body.inverse_mass.max(axis=1)
    stiffness, damping = (np.bincount(anchors.node, constant, len(inverse))
                          for constant in (anchors.stiffness, anchors.damping))  # fmt: skip
    return float((stiffness * inverse).max()), float((damping * inverse).max())


@kernel
def measure_anchor(anchors, m, elapsed, x, v):
    """Values i, r, 1 / |r| (0 for null r), strain over present length, and its rate, 1/s, of anchor m."""
    i = INDEX(anchors.node[m])
    r, u = fma(elapsed, anchors.velocity[m], anchors.point[m]) - x[i], anchors.velocity[m] - v[i]
    square = dot(r, r)
    somewhere = square > 0.0
    inverse = select(somewhere, 1.0 / sqrt(square), 0.0)
    strain = select(somewhere, fma(-anchors.rest_length[m], inverse, 1.0), 0.0)
    return i, r, inverse, strain, dot(r, u) * (inverse * inverse)


@kernel
def add_one(anchors, m, control, light, x, v, f):
    """Add the force of one anchor; return its r, 1 / |r| and strain."""
    c, k = anchors.stiffness[m], anchors.damping[m]
    i, r, inverse, strain, fast = measure_anchor(anchors, m, control.elapsed[0], x, v)
    if anchors.rest_length[m] == 0.0:
        f[i] = fma(light, fma(k, anchors.velocity[m] - v[i], c * r), f[i])  # (83)
    else:
        f[i] = fma(light * fma(k, fast, c * strain), r, f[i])  # (84)
    return r, inverse, strain


@kernel
def add_force(body, world, control, x, v, f, cache):
    """Add the force of every anchor."""
    for m in range(world.anchors.node.size):
        add_one(world.anchors, m, control, control.lightness[0], x, v, f)


@kernel
def add_force_cached(body, world, control, x, v, f, cache):
    """Add the force of every anchor, and store the data of `add_tangent` for a filtered step."""
    # The weights are those of `springs.add_force_cached`; a compressed anchor has no transverse stiffness.
    anchors, light = world.anchors, control.lightness[0]
    plans, row = control.plans, control.row[0]
    h, factor, least = plans[row, H], plans[row, FACTOR], plans[row, LEAST]
    for m in range(anchors.node.size):
        r, inverse, taut = add_one(anchors, m, control, light, x, v, f)
        elastic, viscous = factor * h * h * anchors.stiffness[m], h * anchors.damping[m]
        along = light * max(elastic + 2.0 * factor * viscous, least * viscous)
        if anchors.rest_length[m] == 0.0:
            keep(cache, m, r, along, 0.0 * light)
        else:
            across = (light * elastic) * select(taut > 0.0, taut, 0.0)
            keep(cache, m, r, across, (along - across) * (inverse * inverse))


@kernel
def keep(cache, m, r, across, pull):
    """Store the stiffness of an anchor: the isotropic part, and the additional part along r, over |r|^2."""
    cache.r[m] = r
    cache.across[m] = across
    cache.pull[m] = pull


@kernel
def add_tangent(body, world, control, x, y, f, cache):
    """Add the restoring force of displacements y, by the stored stiffness."""
    for m in range(world.anchors.node.size):
        i, r = INDEX(world.anchors.node[m]), cache.r[m]
        f[i] -= fma(cache.pull[m] * dot(r, y[i]), r, cache.across[m] * y[i])


@kernel
def add_system(body, world, control, x, v, a, cache):
    """Add h D + h^2 K to the matrix a, as `springs.add_system`, and store K for `add_tangent`."""
    anchors, light, h = world.anchors, control.lightness[0], control.plans[control.row[0], INNER]
    for m in range(anchors.node.size):
        i, r, inverse, _, _ = measure_anchor(anchors, m, control.elapsed[0], x, v)
        c, k, place = light * anchors.stiffness[m], light * anchors.damping[m], 3 * body.profile.diagonal[i]
        both, none = h * fma(h, c, k), 0.0 * light
        if anchors.rest_length[m] == 0.0:
            keep(cache, m, r, c, none)
            add_columns(a, place, 1.0, r, none * r, both)
        else:
            keep(cache, m, r, none, c * (inverse * inverse))
            add_columns(a, place, 1.0, r, (both * (inverse * inverse)) * r, none)


@kernel
def add_lagged(body, world, control, x, v, system, cache):
    """Add the force at the start of the step to `system.load`, and its implicit part to `system.matrix`."""
    # It is that of `springs.add_lagged`; an anchor of zero length is fully implicit.
    anchors, light, h = world.anchors, control.lightness[0], control.plans[control.row[0], INNER]
    for m in range(anchors.node.size):
        i, r, _, strain, fast = measure_anchor(anchors, m, control.elapsed[0], x, v)
        place, c, k = INDEX(body.profile.diagonal[i]), light * anchors.stiffness[m], light * anchors.damping[m]
        if anchors.rest_length[m] == 0.0:
            system.load[i] += fma(fma(h, c, k), anchors.velocity[m], c * r)  # the point where the step ends
            system.matrix[place] += h * fma(h, c, k)
        else:
            eta = fma(k, fast, c * strain)
            system.load[i] = fma(eta, r, system.load[i])
            system.matrix[place] += (h * h) * eta


@kernel
def energy(body, world, control, x, v, f, cache):
    """Elastic energy of all anchors, J."""
    anchors, total = world.anchors, zero(control.lightness)
    for m in range(anchors.node.size):
        point = fma(control.elapsed[0], anchors.velocity[m], anchors.point[m])
        r = point - x[INDEX(anchors.node[m])]
        stretch = sqrt(dot(r, r)) - anchors.rest_length[m]
        total = fma(0.5 * anchors.stiffness[m], stretch * stretch, total)
    return control.lightness[0] * total
