"""Springs from a node to a point of the world: the mouse's (Song 2009, ch. 4.4), or a penalty that moves the node.

An anchor with a rest length pulls and damps along itself. One without pulls by stiffness times distance, linear in the
place, and damps along all axes: in matrices it adds to the node's diagonal only, as a penalty should.

Legend: m anchor; i its node; r from the node to the point; u the point's velocity less the node's; c stiffness, k
damping, l rest length. What the body is made of is over the fish's factor on mass; here that is `lightness`.
"""

import numpy as np

from fish_env._jit import INDEX, kernel
from fish_env.forces.plan import FACTOR, INNER, LEAST, H
from fish_env.simd import Pack, dot, fma, select, sqrt, vec3, zero


def present(body, world) -> bool:
    """Whether anything is anchored."""
    return world.anchors is not None


def make_cache(body, world, kind) -> Pack:
    """What `add_tangent` needs: r, stiffness along all axes, and that along the anchor beyond it over |r|^2."""
    count = len(world.anchors.node)
    return Pack("anchors", r=kind.vectors(count), across=kind.numbers(count), pull=kind.numbers(count))


def bounds(body, world) -> tuple[float, float]:
    """The largest stiffness and damping that the anchors of one node have together, over its mass, 1/s2 and 1/s."""
    anchors, inverse = world.anchors, body.inverse_mass.max(axis=1)
    stiffness, damping = (np.bincount(anchors.node, constant, len(inverse))
                          for constant in (anchors.stiffness, anchors.damping))  # fmt: skip
    return float((stiffness * inverse).max()), float((damping * inverse).max())


@kernel
def separation(anchors, m, x):
    """From the node of an anchor to its point: r, and 1 / |r|, zero where it points nowhere."""
    r = anchors.point[m] - x[INDEX(anchors.node[m])]
    square = dot(r, r)
    return r, select(square > 0.0, 1.0 / sqrt(square), 0.0)


@kernel
def add_one(anchors, m, lightness, x, v, f):
    """Add the pull of one anchor; returns its r and 1 / |r|."""
    i, c, k, natural = INDEX(anchors.node[m]), anchors.stiffness[m], anchors.damping[m], anchors.rest_length[m]
    r, inverse = separation(anchors, m, x)
    u = anchors.velocity[m] - v[i]
    if natural == 0.0:
        f[i] = fma(lightness, fma(k, u, c * r), f[i])  # (58)
    else:
        pull = fma(k, dot(r, u) * (inverse * inverse), c * fma(-natural, inverse, 1.0))
        f[i] = fma(lightness * select(inverse > 0.0, pull, 0.0), r, f[i])  # (59)
    return r, inverse


@kernel
def add_force(body, world, control, x, v, f, cache):
    """Add the pull of every anchor."""
    for m in range(world.anchors.node.size):
        add_one(world.anchors, m, control.lightness[0], x, v, f)


@kernel
def add_force_cached(body, world, control, x, v, f, cache):
    """As `add_force`, and keep what `add_tangent` needs to resist acceleration in a filtered step.

    An anchor does so as `springs.add_force_cached`; one under pressure not at all across.
    """
    anchors, light = world.anchors, control.lightness[0]
    plans, row = control.plans, control.row[0]
    h, factor, least = plans[row, H], plans[row, FACTOR], plans[row, LEAST]
    for m in range(anchors.node.size):
        r, inverse = add_one(anchors, m, light, x, v, f)
        elastic, viscous = factor * h * h * anchors.stiffness[m], h * anchors.damping[m]
        along = light * max(elastic + 2.0 * factor * viscous, least * viscous)
        if anchors.rest_length[m] == 0.0:
            keep(cache, m, r, along, 0.0 * light)
        else:
            taut = select(inverse > 0.0, fma(-anchors.rest_length[m], inverse, 1.0), 0.0)
            across = (light * elastic) * select(taut > 0.0, taut, 0.0)
            keep(cache, m, r, across, (along - across) * (inverse * inverse))


@kernel
def keep(cache, m, r, across, pull):
    """Keep the stiffness of an anchor: along all axes, and beyond it along r, over |r|^2."""
    cache.r[m] = r
    cache.across[m] = across
    cache.pull[m] = pull


@kernel
def add_tangent(body, world, control, x, y, f, cache):
    """Add the pull of the anchors if every node moved by y, by the stiffness that was kept."""
    for m in range(world.anchors.node.size):
        i, r = INDEX(world.anchors.node[m]), cache.r[m]
        f[i] -= fma(cache.pull[m] * dot(r, y[i]), r, cache.across[m] * y[i])


@kernel
def add_system(body, world, control, x, v, a, cache):
    """Add h D + h^2 K to the matrix a, as `springs.add_system`, and keep K for `add_tangent`: along r, or all axes."""
    anchors, light, h = world.anchors, control.lightness[0], control.plans[control.row[0], INNER]
    for m in range(anchors.node.size):
        r, inverse = separation(anchors, m, x)
        c, k, square = light * anchors.stiffness[m], light * anchors.damping[m], inverse * inverse
        both, place = h * fma(h, c, k), 3 * body.profile.diagonal[INDEX(anchors.node[m])]
        if anchors.rest_length[m] == 0.0:
            keep(cache, m, r, c, 0.0 * light)
            a[INDEX(place)] += both * vec3(1.0, 0.0, 0.0)
            a[INDEX(place + 1)] += both * vec3(0.0, 1.0, 0.0)
            a[INDEX(place + 2)] += both * vec3(0.0, 0.0, 1.0)
        else:
            keep(cache, m, r, 0.0 * light, c * square)
            a[INDEX(place)] += (both * square * r.x) * r
            a[INDEX(place + 1)] += (both * square * r.y) * r
            a[INDEX(place + 2)] += (both * square * r.z) * r


@kernel
def add_lagged(body, world, control, x, v, system, cache):
    """Add the pull at the start of the step to `system.load`, and what it becomes at its end to `system.matrix`.

    As `springs.add_lagged`; an anchor without length is taken implicitly as a whole.
    """
    anchors, light, h = world.anchors, control.lightness[0], control.plans[control.row[0], INNER]
    for m in range(anchors.node.size):
        i, natural = INDEX(anchors.node[m]), anchors.rest_length[m]
        place, c, k = INDEX(body.profile.diagonal[i]), light * anchors.stiffness[m], light * anchors.damping[m]
        r, inverse = separation(anchors, m, x)
        if natural == 0.0:
            system.load[i] += fma(k, anchors.velocity[m], c * r)
            system.matrix[place] += h * fma(h, c, k)
        else:
            fast = dot(r, anchors.velocity[m] - v[i]) * (inverse * inverse)
            eta = select(inverse > 0.0, fma(k, fast, c * fma(-natural, inverse, 1.0)), 0.0)
            system.load[i] = fma(eta, r, system.load[i])
            system.matrix[place] += (h * h) * eta


@kernel
def add_jacobian(body, world, control, x, v, matrices, cache):
    """Add -df/dx to `matrices.stiffness` (3N,3N) and -df/dv to `matrices.damping`, both exact; of one fish."""
    anchors, stiffness, damping = world.anchors, matrices.stiffness, matrices.damping
    for m in range(anchors.node.size):
        i, natural = anchors.node[m], anchors.rest_length[m]
        c, k = control.lightness[0] * anchors.stiffness[m], control.lightness[0] * anchors.damping[m]
        r, inverse = separation(anchors, m, x)
        u, n = anchors.velocity[m] - v[i], inverse * r
        speed = dot(n, u)
        eta = c - natural * inverse * c + k * speed * inverse
        q = (k * inverse) * (u - speed * n)
        direction, turning = (n.x, n.y, n.z), (q.x, q.y, q.z)
        for a in range(3):
            if natural == 0.0:
                stiffness[3 * i + a, 3 * i + a] += c
                damping[3 * i + a, 3 * i + a] += k
                continue
            if inverse == 0.0:  # it points nowhere
                continue
            stiffness[3 * i + a, 3 * i + a] += eta
            for b in range(3):
                straight = direction[a] * direction[b]
                stiffness[3 * i + a, 3 * i + b] += (c - eta) * straight + direction[a] * turning[b]
                damping[3 * i + a, 3 * i + b] += k * straight


@kernel
def energy(body, world, control, x, v, f, cache):
    """Elastic energy of all anchors, J."""
    anchors, total = world.anchors, zero(control.lightness)
    for m in range(anchors.node.size):
        r = anchors.point[m] - x[INDEX(anchors.node[m])]
        stretch = sqrt(dot(r, r)) - anchors.rest_length[m]
        total = fma(0.5 * anchors.stiffness[m], stretch * stretch, total)
    return control.lightness[0] * total
