"""Water on the surface: every face that moves outward is resisted along its normal, and every face along itself.

The linear law is Tu & Terzopoulos 1994; the quadratic one Terzopoulos, Tu & Grzeszczuk 1994 with half the density
times a drag coefficient in place of their unit constant, or that of cross-flow (Taylor 1952), for which only the
velocity along the normal counts. Skin friction, if the world has it, is that of a laminar boundary layer on a flat
plate (Blasius 1908) times a factor, more where the flow is across. No lift, added mass or wake.

Legend: a area vector (area times outward normal n); w velocity of the face through the water; p, q, r, s its corners.
"""

import math

import numpy as np

from fish_env.kernels.compile import INDEX, kernel
from fish_env.kernels.simd import Pack, cross, dot, fma, select, sqrt, vec3, zero
from fish_env.physics.forces.plan import INNER, H
from fish_env.physics.records import Body, World

ANYWHERE = IN_WATER = True
WEAK, STRONG = 1.3, 2.6  # in water with inertia: part of a face's mobility that counts where drag is weak, and strong
TINY = 1e-30  # m2/s2, so that a face at rest divides by no zero


def present(body: Body, world: World) -> bool:
    """Return True if water acts on the body."""
    return (world.linear != 0.0 or world.quadratic != 0.0 or world.friction != 0.0) and len(body.faces.nodes) > 0


def make_cache(body: Body, world: World, kind) -> Pack:
    """Data of `add_change`: each face's normal, area, push, friction and mobility (F,). Coefficient of friction."""
    # `loaded` is the mobility with the water that moves sideways with the face. `carried` is the mass of the water that
    # moves with it along its normal, over its own; that water takes the faces around along.
    count, friction = len(body.faces.nodes), world.friction / math.sqrt(length(body))
    inverse, (sideways, upward) = body.inverse_mass.max(axis=1), water_over_own(body, world)
    own, loaded = mobility(body, inverse), mobility(body, inverse / (1.0 + sideways))
    across, over = ((body.faces.share * part[body.faces.nodes]).sum(axis=1) for part in (sideways, upward))
    _, aside, aloft = normals(body).T ** 2
    carried = aside * across + aloft * over
    return Pack(
        "water", normal=kind.vectors(count), size=kind.numbers(count), push=kind.numbers(count),
        pull=kind.vectors(count if friction else 0), mobility=kind.scalars(own), loaded=kind.scalars(loaded),
        carried=kind.scalars(carried), friction=friction, weak=1.0 if world.added_mass is None else WEAK,
        strong=1.0 if world.added_mass is None else STRONG,
    )  # fmt: skip


def normals(body: Body) -> np.ndarray:
    """Unit normals of the faces at rest, (F,3)."""
    p, q, r, s = body.position[body.faces.nodes].swapaxes(0, 1)
    rise = body.faces.depth[:, None] * [0.0, 0.0, 1.0]
    area = np.cross(r - p + rise, s - q + rise)
    return area / np.linalg.norm(area, axis=1, keepdims=True)


def length(body: Body) -> float:
    """Length of the body in the Reynolds number of its friction, m: its largest extent along an axis, at rest."""
    return float(np.ptp(body.position, axis=0).max()) or 1.0  # a point has no friction


def water_over_own(body: Body, world: World) -> np.ndarray:
    """Mass of the water that moves sideways, and upward, with each node over its own, (2,N): those of its section."""
    sections, ratio = body.sections, np.zeros((2, len(body.mass)))
    if world.added_mass is not None and sections is not None:
        section = np.repeat(np.arange(sections.lateral.size), np.diff(sections.first))
        own = np.bincount(section, body.mass[sections.nodes])
        for part, added, volume in zip(ratio, world.added_mass, (sections.lateral, sections.vertical), strict=True):
            part[sections.nodes] = (added * volume / own)[section]
    return ratio


def mobility(body: Body, inverse: np.ndarray) -> np.ndarray:
    """Velocity (F,) m/s that a face gains in 1 s from 1 N, if the faces around have the same, as far as they face so.

    `inverse` (N,) is one over the nodes' masses.
    """
    n, nodes, share = normals(body), body.faces.nodes.ravel(), body.faces.share.ravel()
    face, order = np.repeat(np.arange(len(n)), 4), np.argsort(nodes, kind="stable")
    first, count, gained = np.searchsorted(nodes[order], nodes), np.bincount(nodes)[nodes], np.zeros(nodes.size)
    for k in range(count.max()):  # the k-th corner of a face at each node
        other = order[np.minimum(first + k, nodes.size - 1)]
        alike = np.clip((n[face] * n[face[other]]).sum(axis=1), 0.0, None)
        gained += np.where(k < count, alike * share[other], 0.0)
    return np.bincount(face, share * inverse[nodes] * gained, len(n))


@kernel
def corners(body, k):
    """Node numbers of face k."""
    nodes = body.faces.nodes
    return INDEX(nodes[k, 0]), INDEX(nodes[k, 1]), INDEX(nodes[k, 2]), INDEX(nodes[k, 3])


@kernel
def velocity(body, current, v, k):
    """Velocity of face k through the water."""
    p, q, r, s = corners(body, k)
    share = body.faces.share
    return fma(share[k, 3], v[s], fma(share[k, 2], v[r], fma(share[k, 1], v[q], share[k, 0] * v[p] - current)))  # (10)


@kernel
def area_vector(body, x, k):
    """Area vector of face k."""
    p, q, r, s = corners(body, k)
    d, e = x[r] - x[p], x[s] - x[q]
    if body.faces.upright:
        rise = vec3(0.0, 0.0, body.faces.depth[k])
        d, e = d + rise, e + rise
    return 0.5 * cross(d, e)  # (9)


@kernel
def scatter(body, k, g, f):
    """Add the force g on face k to those of its corners."""
    p, q, r, s = corners(body, k)
    share = body.faces.share
    f[p] = fma(share[k, 0], g, f[p])
    f[q] = fma(share[k, 1], g, f[q])
    f[r] = fma(share[k, 2], g, f[r])
    f[s] = fma(share[k, 3], g, f[s])


@kernel
def laws(world, control, cache):
    """Coefficients of the linear law, of the quadratic law and of friction, and the current."""
    drag = control.drag[0]
    viscous, current = control.shortness[0] * drag, world.current[0] + control.current[0]  # (75)
    return world.linear * viscous, world.quadratic * drag, cache.friction * viscous, current


@kernel
def push_on(body, linear, quadratic, oblique, current, x, v, k):
    """Normal of face k, its velocity and area, and the force along the normal, zero if the face moves inward."""
    a, w = area_vector(body, x, k), velocity(body, current, v, k)
    size = sqrt(dot(a, a))
    n, area = (1.0 / size) * a, body.faces.drag[k] * size
    outward = dot(n, w)
    speed = sqrt(square_of(oblique, outward, w))
    return n, w, size, select(outward > 0.0, -(fma(quadratic, speed, linear) * outward * area), 0.0)  # (27), (12)


@kernel
def square_of(oblique, outward, w):
    """Square of the speed of a face in the quadratic law."""
    square, across = dot(w, w), outward * outward
    if oblique < 1.0:
        square = fma(oblique, square - across, across)
    return square


@kernel
def resistance(world, friction, n, w, size):
    """Friction on a face over its velocity along itself."""
    square, outward = dot(w, w), dot(n, w)
    speed = sqrt(square)
    rough = friction * size * fma(world.thinning * outward, outward, square) / (speed * sqrt(speed))
    return select(square > 0.0, rough, 0.0)  # (13)


@kernel
def limited(rough, h, mobility):
    """Friction over velocity that does not stop a face within a step, if all faces around it have the same."""
    most = 0.5 / (h * mobility)
    return select(rough < most, rough, most)


@kernel
def along(n, w):
    """Part of a velocity along a face."""
    return fma(-dot(n, w), n, w)


@kernel
def add_force(body, world, control, x, v, f, cache):
    """Add the force of the water on every face."""
    linear, quadratic, friction, current = laws(world, control, cache)
    for k in range(body.faces.nodes.shape[0]):
        n, w, size, push = push_on(body, linear, quadratic, world.oblique, current, x, v, k)
        g = push * n
        if cache.friction > 0.0:
            g = fma(-resistance(world, friction, n, w, size), along(n, w), g)
        scatter(body, k, g, f)


@kernel
def add_force_cached(body, world, control, x, v, f, cache):
    """Add the force of the water on every face, and store the data of `add_change`."""
    # A force that would reverse the motion of its face, and of the water with it, within half a step is limited to the
    # force that stops it. Otherwise the prediction, from which the change is computed, would grow from step to step.
    # Friction is limited too.
    linear, quadratic, friction, current = laws(world, control, cache)
    h = control.plans[control.row[0], H]
    half = 0.5 * h
    for k in range(body.faces.nodes.shape[0]):
        n, w, size, push = push_on(body, linear, quadratic, world.oblique, current, x, v, k)
        outward = dot(n, w)
        stopping = select(outward > 0.0, -outward / (half * cache.loaded[k]), 0.0)
        push = select(push < stopping, stopping, push)  # (24)
        g = push * n
        if cache.friction > 0.0:
            pull = -limited(resistance(world, friction, n, w, size), h, cache.mobility[k]) * along(n, w)
            cache.pull[k] = pull
            g = g + pull
        scatter(body, k, g, f)
        cache.normal[k] = n
        cache.size[k] = size
        cache.push[k] = push


@kernel
def add_change(body, world, control, x, v, f, cache):
    """Add the change of the force when the velocities become v, half a step later, at the stored positions."""
    # Each face's drag is implicit, as if it were the only force on the face. Friction, which is small, is explicit. The
    # water that moves with a section does not slow its nodes against each other: where drag is strong, less of it
    # counts, and more of the mobility.
    linear, quadratic, friction, current = laws(world, control, cache)
    h = control.plans[control.row[0], H]
    half = 0.5 * h
    for k in range(cache.size.size):
        n, size, push, w = cache.normal[k], cache.size[k], cache.push[k], velocity(body, current, v, k)
        area, outward = body.faces.drag[k] * size, dot(n, w)
        square = square_of(world.oblique, outward, w)
        speed = sqrt(square + TINY)
        change = -(fma(quadratic, speed, linear) * outward * area) - push
        slope = fma(quadratic, fma(outward, outward, square), linear * speed)  # times the speed
        rate = (half * cache.mobility[k]) * area * slope / speed
        many = fma(rate, rate, 1.0)
        slowed = rate * fma(cache.strong * rate, rate, cache.weak)  # times `many`, as the next two are
        both = fma(0.5, slowed, many)
        kept = many * fma(control.lightness[0] * cache.carried[k], many, both)
        ahead = change * (kept / fma(slowed, both, kept))  # (24)
        g = select(outward > 0.0, ahead, -push) * n
        if cache.friction > 0.0:
            rough = limited(resistance(world, friction, n, w, size), h, cache.mobility[k])
            g = fma(-rough, along(n, w), g - cache.pull[k])
        scatter(body, k, g, f)


@kernel
def loss(body, world, control, x, v, f, cache):
    """Power of all faces on the water, W."""
    linear, quadratic, friction, current = laws(world, control, cache)
    total = zero(control.stiffness)
    for k in range(body.faces.nodes.shape[0]):
        n, w, size, push = push_on(body, linear, quadratic, world.oblique, current, x, v, k)
        total = fma(-push, dot(n, w), total)
        if cache.friction > 0.0:
            u = along(n, w)
            total = fma(resistance(world, friction, n, w, size), dot(u, u), total)
    return total


@kernel
def add_damping(body, world, control, x, v, a, cache):
    """Add h D to the matrix a, as `springs.add_system`."""
    # D is a symmetric, positive semi-definite part of -df/dv: the derivative of the force along a face's normal with
    # respect to its outward velocity, and the ratio of friction to the velocity along the face.
    linear, quadratic, friction, current = laws(world, control, cache)
    h = control.plans[control.row[0], INNER]
    first, start, rows = body.profile.first, body.profile.start, body.profile.row
    nodes, share = body.faces.nodes, body.faces.share
    for k in range(nodes.shape[0]):
        n, w, size, _ = push_on(body, linear, quadratic, world.oblique, current, x, v, k)
        area, outward = body.faces.drag[k] * size, dot(n, w)
        speed = sqrt(square_of(world.oblique, outward, w))
        slope = fma(quadratic, fma(outward, outward, speed * speed), linear * speed) / speed
        drag = select(outward > 0.0, h * area * slope, 0.0)  # (38)
        rough, none = h * resistance(world, friction, n, w, size), zero(control.drag)
        across = drag - rough
        columns = (
            fma(across * n.x, n, vec3(rough, none, none)),
            fma(across * n.y, n, vec3(none, rough, none)),
            fma(across * n.z, n, vec3(none, none, rough)),
        )
        for m in range(4):
            for p in range(4):
                row, column = rows[nodes[k, m]], rows[nodes[k, p]]
                if row < column:  # above the diagonal
                    continue
                place = 3 * (start[INDEX(row)] + column - first[INDEX(row)])
                for axis in range(3):
                    a[INDEX(place + axis)] = fma(share[k, m] * share[k, p], columns[axis], a[INDEX(place + axis)])
