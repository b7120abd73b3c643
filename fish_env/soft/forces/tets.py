"""Linear tetrahedra: small strain in a corotational frame, or in a fixed one (Müller & Gross 2004).

With the nearest rotation R of the deformation gradient F, the energy is V (mu |F - R|^2 + lambda/2 tr(R^T F - 1)^2),
and the force its gradient: rigid rotation costs no energy. Damping acts on the rate of the same strain.

Strain and stress are expressed in world axes: with R the frame, R (R^T F) R^T = F R^T is the sum of x_a (R g_a)^T. The
material is isotropic, so only the rotated gradients R g_a are needed.

A filter of many stages uses the assembled stiffness, one matrix for each side of the mesh, because several elements
share a side. A translation costs no energy, so the force on a node depends on displacements relative to its neighbours.

Legend: t element; a, b its corners; e its edges; g gradients of the shape functions; h = R g the rotated ones, of
corners 1 to 3; F the sum of x_a g_a^T; a matrix m is a tuple of its columns, also p, q, r; s factor on the strain's
rate, a time; k stiffness between the ends of a side.
"""

import numpy as np

from fish_env.kernels.compile import INDEX, kernel
from fish_env.kernels.simd import Pack, dot, fma, nowhere, vec3, zero
from fish_env.physics.failures import STRETCH_LIMIT, TORN
from fish_env.physics.forces.plan import FACTOR, INNER, LEAST, STAGES, H
from fish_env.physics.records import Body, World
from fish_env.soft.forces import polar

FAILURE = TORN
CORNERS = (0, 1), (0, 2), (0, 3), (1, 2), (1, 3), (2, 3)
MANY_STAGES = 8  # number of stages from which the assembly of the sides' stiffness saves time
ANYWHERE = True


def present(body: Body, world: World) -> bool:
    """Return True if the body has tetrahedra of these measures of strain."""
    return body.tets is not None and not body.tets.quadratic


def constant(body: Body, world: World) -> bool:
    """Return True for linear elasticity, whose stiffness does not depend on the motion."""
    return body.tets is not None and not body.tets.rotating


def sides_of(nodes) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Ends (S,2) of the sides of elements (T,4), the lower node first; each element's sides (T,6), and corners."""
    # The corners (T,6,2) are those at the first and the second end.
    some = np.array(CORNERS)
    swapped = nodes[:, some[:, 0]] > nodes[:, some[:, 1]]
    corners = np.where(swapped[..., None], some[:, ::-1], some)
    pairs = np.take_along_axis(nodes, corners.reshape(len(nodes), 12), axis=1).reshape(-1, 2)
    ends, sides = np.unique(pairs, axis=0, return_inverse=True)
    return ends, sides.reshape(len(nodes), 6), np.ascontiguousarray(corners)


def make_cache(body: Body, world: World, kind) -> Pack:
    """Data of `add_tangent`: rotated gradients (3T,) and the weighted Lame constants (T,), Pa m3; and scratch."""
    # Alternatively, the columns of the weighted stiffness of the sides (3S,), N/m.
    assert body.tets is not None  # else the force is not present
    count = len(body.tets.nodes)
    ends, sides, corners = sides_of(body.tets.nodes)
    shear, dilation = kind.scratch(count, kind.dtype), kind.scratch(count, kind.dtype)
    return Pack("tets", h=kind.vectors(3 * count), shear=shear, dilation=dilation, corner=kind.vectors(4),
                polar=polar.make_scratch(kind), ends=ends, sides=sides, corners=corners,
                k=kind.vectors(3 * len(ends)))  # fmt: skip


def rest_matrices(body: Body, elastic):
    """Stiffness, N/m, or damping, N s/m, at rest, of any measure: nodes (T,4) and matrices (T,12,12)."""
    if body.tets is None:
        return
    tets, g = body.tets, body.tets.gradient
    weight = tets.volume * (1.0 if elastic else tets.relaxation_time)
    shear, dilation = tets.shear * weight, tets.dilation * weight
    block = np.einsum("t,tac,tbc,ij->taibj", shear, g, g, np.eye(3))
    block += np.einsum("t,tbi,taj->taibj", shear, g, g) + np.einsum("t,tai,tbj->taibj", dilation, g, g)
    yield tets.nodes, block.reshape(-1, 12, 12)


@kernel
def edges(tets, t, x):
    """Differences of a field x between corners 1, 2 and 3 of element t and corner 0."""
    nodes = tets.nodes
    base = x[INDEX(nodes[t, 0])]
    return x[INDEX(nodes[t, 1])] - base, x[INDEX(nodes[t, 2])] - base, x[INDEX(nodes[t, 3])] - base


@kernel
def gradient(tets, t, e):
    """Gradient, the sum of x_a g_a^T, of the field whose edges are e: F for positions. All four g sum to zero."""
    g = tets.gradient
    return (
        fma(g[t, 3, 0], e[2], fma(g[t, 2, 0], e[1], g[t, 1, 0] * e[0])),
        fma(g[t, 3, 1], e[2], fma(g[t, 2, 1], e[1], g[t, 1, 1] * e[0])),
        fma(g[t, 3, 2], e[2], fma(g[t, 2, 2], e[1], g[t, 1, 2] * e[0])),
    )  # (62)


@kernel
def rotated_gradients(tets, t, e, scratch):
    """Gradients h of element t with edges e: rotated with it, or those at rest in a fixed frame."""
    p, q, r = gradient(tets, t, e)
    if tets.rotating:
        p, q, r = polar.rotation(p, q, r, scratch)
    else:
        nothing = 0.0 * p
        p, q, r = nothing + vec3(1.0, 0.0, 0.0), nothing + vec3(0.0, 1.0, 0.0), nothing + vec3(0.0, 0.0, 1.0)
    g = tets.gradient
    return (
        fma(g[t, 1, 2], r, fma(g[t, 1, 1], q, g[t, 1, 0] * p)),
        fma(g[t, 2, 2], r, fma(g[t, 2, 1], q, g[t, 2, 0] * p)),
        fma(g[t, 3, 2], r, fma(g[t, 3, 1], q, g[t, 3, 0] * p)),
    )


@kernel
def world_gradient(e, h):
    """Sum of x_a h_a^T of the field whose edges are e: F R^T for positions."""
    return (
        fma(h[2].x, e[2], fma(h[1].x, e[1], h[0].x * e[0])),
        fma(h[2].y, e[2], fma(h[1].y, e[1], h[0].y * e[0])),
        fma(h[2].z, e[2], fma(h[1].z, e[1], h[0].z * e[0])),
    )


@kernel
def less_one(m):
    """Matrix m minus the unit matrix."""
    return m[0] - vec3(1.0, 0.0, 0.0), m[1] - vec3(0.0, 1.0, 0.0), m[2] - vec3(0.0, 0.0, 1.0)


@kernel
def stress(m, shear, dilation):
    """Stress of the symmetric part of a matrix of strains."""
    p, q, r = m
    even, double = dilation * (p.x + q.y + r.z), 2.0 * shear
    xy, xz, yz = shear * (p.y + q.x), shear * (p.z + r.x), shear * (q.z + r.y)
    return (
        vec3(fma(double, p.x, even), xy, xz),
        vec3(xy, fma(double, q.y, even), yz),
        vec3(xz, yz, fma(double, r.z, even)),
    )  # (63)


@kernel
def product(m, h):
    """Product of a matrix and a vector."""
    return fma(h.z, m[2], fma(h.y, m[1], h.x * m[0]))


@kernel
def scatter(tets, t, m, h, f):
    """Subtract from f the nodal forces of a stress m times the volume of element t."""
    nodes = tets.nodes
    a, b, c = product(m, h[0]), product(m, h[1]), product(m, h[2])
    f[INDEX(nodes[t, 0])] += a + b + c
    f[INDEX(nodes[t, 1])] -= a
    f[INDEX(nodes[t, 2])] -= b
    f[INDEX(nodes[t, 3])] -= c


@kernel
def constants(tets, t, factor):
    """Lame's constants times the volume and a factor, Pa m3."""
    return factor * (tets.volume[t] * tets.shear[t]), factor * (tets.volume[t] * tets.dilation[t])


@kernel
def add_element(tets, t, e, h, factor, v, f):
    """Add the elastic and viscous force of element t with edges e and rotated gradients h."""
    u, s = edges(tets, t, v), tets.relaxation_time[t]
    m = world_gradient((fma(s, u[0], e[0]), fma(s, u[1], e[1]), fma(s, u[2], e[2])), h)
    shear, dilation = constants(tets, t, factor)
    scatter(tets, t, stress(less_one(m), shear, dilation), h, f)


@kernel
def add_force(body, world, control, x, v, f, cache):
    """Add the elastic and viscous force of every tetrahedron."""
    tets, factor = body.tets, control.stiffness[0]
    for t in range(tets.volume.size):
        e = edges(tets, t, x)
        add_element(tets, t, e, rotated_gradients(tets, t, e, cache.polar), factor, v, f)


@kernel
def add_force_cached(body, world, control, x, v, f, cache):
    """Add the force of every tetrahedron, and store the data of `add_tangent` for a filtered step."""
    # The filter weight is FACTOR (h^2 K + 2 h D), but at least LEAST h D (see `springs.add_force_cached`).
    tets, factor = body.tets, control.stiffness[0]
    plans, row = control.plans, control.row[0]
    h, share, least, sideways = plans[row, H], plans[row, FACTOR], plans[row, LEAST], by_sides(control)
    if sideways:
        for i in range(cache.k.size):
            cache.k[i] = zero(f)
    for t in range(tets.volume.size):
        e = edges(tets, t, x)
        g = rotated_gradients(tets, t, e, cache.polar)
        add_element(tets, t, e, g, factor, v, f)
        viscous = h * tets.relaxation_time[t]
        weight = max(share * (h * h + 2.0 * viscous), least * viscous)
        if sideways:
            add_sides(tets, t, g, factor * weight, cache)
        else:
            keep(tets, t, g, weight, cache)


@kernel
def by_sides(control):
    """Return True if the number of stages makes the assembled stiffness of the sides faster."""
    return control.plans[control.row[0], STAGES] >= MANY_STAGES


@kernel
def keep(tets, t, h, weight, cache):
    """Store the stiffness of element t, times a weight."""
    kept = cache.h
    kept[3 * t], kept[3 * t + 1], kept[3 * t + 2] = h
    cache.shear[t], cache.dilation[t] = constants(tets, t, weight)


@kernel
def add_sides(tets, t, h, weight, cache):
    """Add the stiffness of element t, times a weight, to that of its sides."""
    now, k, sides, corners = cache.corner, cache.k, cache.sides, cache.corners
    now[0] = -(h[0] + h[1] + h[2])
    now[1], now[2], now[3] = h
    mu, la = constants(tets, t, weight)
    for s in range(sides.shape[1]):
        first, here, there = 3 * sides[t, s], now[INDEX(corners[t, s, 0])], now[INDEX(corners[t, s, 1])]
        one, two, along = mu * here, la * there, mu * dot(here, there)
        k[INDEX(first)] += fma(one.x, there, fma(two.x, here, vec3(along, 0.0, 0.0)))  # (66)
        k[INDEX(first + 1)] += fma(one.y, there, fma(two.y, here, vec3(0.0, along, 0.0)))
        k[INDEX(first + 2)] += fma(one.z, there, fma(two.z, here, vec3(0.0, 0.0, along)))


@kernel
def add_tangent(body, world, control, x, y, f, cache):
    """Add the restoring force of displacements y, by the stored stiffness."""
    tets, factor, kept = body.tets, control.stiffness[0], cache.h
    if by_sides(control):
        add_pull(cache.ends, cache.k, y, f)
        return
    for t in range(tets.volume.size):
        h = kept[3 * t], kept[3 * t + 1], kept[3 * t + 2]
        m = world_gradient(edges(tets, t, y), h)
        scatter(tets, t, stress(m, factor * cache.shear[t], factor * cache.dilation[t]), h, f)


@kernel
def add_pull(ends, k, y, f):
    """Add the restoring force of all sides for displacements y."""
    for s in range(ends.shape[0]):
        i, j = INDEX(ends[s, 0]), INDEX(ends[s, 1])
        p, q, r = k[3 * s], k[3 * s + 1], k[3 * s + 2]
        way = y[j] - y[i]
        f[i] -= fma(way.z, r, fma(way.y, q, way.x * p))
        f[j] += vec3(dot(p, way), dot(q, way), dot(r, way))


@kernel
def add_system(body, world, control, x, v, a, cache):
    """Add h D + h^2 K to the matrix a, as `springs.add_system`, and store K for `add_tangent`."""
    # Both are those of linear elasticity, rotated with the element. The derivative of the rotation is omitted, so they
    # are symmetric and positive semi-definite.
    tets, factor, now = body.tets, control.stiffness[0], cache.corner
    first, start, rows = body.profile.first, body.profile.start, body.profile.row
    step = control.plans[control.row[0], INNER]
    for t in range(tets.volume.size):
        h = rotated_gradients(tets, t, edges(tets, t, x), cache.polar)
        keep(tets, t, h, 1.0, cache)
        now[0] = -(h[0] + h[1] + h[2])
        now[1], now[2], now[3] = h
        mu, la = constants(tets, t, factor * (step * (step + tets.relaxation_time[t])))
        for p in range(4):
            for q in range(4):
                row, column = rows[tets.nodes[t, p]], rows[tets.nodes[t, q]]
                if row < column:  # above the diagonal
                    continue
                here, there = now[p], now[q]
                place, along = 3 * (start[row] + column - first[row]), mu * dot(here, there)
                a[place] += fma(mu * here.x, there, (la * there.x) * here) + along * vec3(1.0, 0.0, 0.0)  # (66)
                a[place + 1] += fma(mu * here.y, there, (la * there.y) * here) + along * vec3(0.0, 1.0, 0.0)
                a[place + 2] += fma(mu * here.z, there, (la * there.z) * here) + along * vec3(0.0, 0.0, 1.0)


@kernel
def strain_energy(m, shear, dilation):
    """Energy of the symmetric part of a matrix of strains, with Lame's constants times the volume."""
    p, q, r = m
    xy, xz, yz, trace = p.y + q.x, p.z + r.x, q.z + r.y, p.x + q.y + r.z
    squares = fma(p.x, p.x, fma(q.y, q.y, r.z * r.z)) + 0.5 * fma(xy, xy, fma(xz, xz, yz * yz))
    return fma(shear, squares, (0.5 * dilation) * (trace * trace))


@kernel
def energy(body, world, control, x, v, f, cache):
    """Elastic energy of all tetrahedra, J."""
    tets, total = body.tets, zero(control.stiffness)
    for t in range(tets.volume.size):
        e = edges(tets, t, x)
        strain = less_one(world_gradient(e, rotated_gradients(tets, t, e, cache.polar)))
        total += strain_energy(strain, *constants(tets, t, control.stiffness[0]))
    return total


@kernel
def loss(body, world, control, x, v, f, cache):
    """Power lost in the damping of all tetrahedra, W."""
    tets, total = body.tets, zero(control.stiffness)
    for t in range(tets.volume.size):
        h = rotated_gradients(tets, t, edges(tets, t, x), cache.polar)
        rate = world_gradient(edges(tets, t, v), h)
        total += strain_energy(rate, *constants(tets, t, (2.0 * tets.relaxation_time[t]) * control.stiffness[0]))
    return total


@kernel
def failed(body, world, control, x, v, f, cache):
    """Mask of the fish in which a tetrahedron is stretched in any direction to more than STRETCH_LIMIT."""
    # The stretch is below STRETCH_LIMIT if all leading minors of STRETCH_LIMIT^2 - F^T F are positive.
    tets, torn, square = body.tets, nowhere(x), STRETCH_LIMIT * STRETCH_LIMIT
    for t in range(tets.volume.size):
        p, q, r = gradient(tets, t, edges(tets, t, x))
        a, b, c = square - dot(p, p), square - dot(q, q), square - dot(r, r)
        u, v, w = dot(q, r), dot(p, r), dot(p, q)
        two = fma(a, b, -(w * w))
        three = fma(c, two, -fma(a * u, u, fma(b * v, v, 2.0 * (u * v * w))))
        torn = torn | (a <= 0.0) | (two <= 0.0) | (three <= 0.0)
    return torn
