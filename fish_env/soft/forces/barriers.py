"""Non-penetration barriers between an inner and an outer layer (Song 2009, ch. 4.6.2; barrier of Li et al. 2020).

A barrier acts once the tetrahedron (on a ring, the triangle) between an outer face and an inner node has less than NEAR
of its volume at rest. Its energy rises as a logarithm with two continuous derivatives, and below STEEP as the parabola
that continues it. The stiffness is therefore bounded, and a stable step exists. A logarithm down to zero would stop
every node, but would require impracticably short steps. The force continues below zero volume; `failed` reports a call
that ends there, or with an inner node outside a closed outer layer, wherever it has left it.

Legend: k barrier; s its relative volume, the ratio to the volume at rest; d, e, f the corners of the outer face
relative to the inner node; slope gradients of s at the three corners of the face, at 3 k; a, b, c corners of an outer
face in the axes of RAY, relative to an inner node.
"""

import numpy as np

from fish_env.kernels.compile import INDEX, kernel
from fish_env.kernels.simd import Pack, any_lane, cross, dot, fma, log, nowhere, select, sqrt, vec3, zero
from fish_env.physics.failures import ESCAPED
from fish_env.physics.forces.plan import FACTOR, H
from fish_env.physics.linalg import rates
from fish_env.physics.records import Body, World

NEAR, STEEP = 0.6, 0.3  # relative volumes below which a barrier acts, and below which its energy is a parabola
FAILURE = ESCAPED
RAY = np.array([[0.8, -0.36, 0.48], [0.0, 0.8, 0.6], [-0.6, -0.48, 0.64]])  # its axes: no edge of an object is along z
ANYWHERE = True


def present(body: Body, world: World) -> bool:
    """Return True if the body has barriers."""
    return body.barriers is not None


def make_cache(body: Body, world: World, kind) -> Pack:
    """Data of `add_tangent`: gradients (3K,) times the root of their weights, and flags (K,) of active barriers."""
    # For `failed`: the outer faces (F,3), none if they do not close, the inner nodes (I,), and positions along RAY.
    assert body.barriers is not None  # else the force is not present
    count, faces = len(body.barriers.energy), np.unique(body.barriers.nodes[:, :3], axis=0)
    edges = {(a, b) for p, q, r in faces.tolist() for a, b in (((p, q), (q, r), (r, p)) if r >= 0 else ())}
    ends = faces[faces[:, 2] < 0, :2]
    closed = all((b, a) in edges for a, b in edges) and sorted(ends[:, 0]) == sorted(ends[:, 1])
    return Pack("barriers", slope=kind.vectors(3 * count), active=kind.scratch(count, "int64"),
                faces=faces if closed else faces[:0], inner=np.unique(body.barriers.nodes[:, 3]),
                turned=kind.vectors(len(body.mass)), ray=RAY)  # fmt: skip


def bounds(body: Body, world: World) -> tuple[float, float]:
    """Largest stiffness over mass of the barriers, 1/s2, with all of them active; and zero damping."""
    assert body.barriers is not None  # else the force is not present
    barriers = body.barriers
    inner, corners = barriers.nodes[:, 3], [body.position[barriers.nodes[:, k]] for k in range(2)]
    d, e = (corner - body.position[inner] for corner in corners)
    flat = barriers.nodes[:, 2] < 0
    f = np.where(flat[:, None], [0.0, 0.0, 3.0], body.position[barriers.nodes[:, 2]] - body.position[inner])
    slopes = np.stack([np.cross(e, f), np.cross(f, d), np.cross(d, e)], axis=1) / (6.0 * barriers.volume[:, None, None])
    slopes[flat, 2] = 0.0
    slopes = np.concatenate([slopes, -slopes.sum(axis=1, keepdims=True)], axis=1).reshape(len(inner), 12)
    nodes = np.where(barriers.nodes < 0, barriers.nodes[:, 3:], barriers.nodes)
    most = barriers.energy * barrier(STEEP)[2]
    blocks = most[:, None, None] * slopes[:, :, None] * slopes[:, None, :]
    return rates.highest([(nodes, blocks)], np.sqrt(body.inverse_mass)), 0.0


@kernel
def corners(barriers, k, x):
    """Outer corners of barrier k relative to its inner node; an edge is a face with one corner 3 m above it."""
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
    """Energy of a barrier over its scale, and its first and second derivative with respect to s."""
    s = select(s < NEAR, s, NEAR)
    t = select(s > STEEP, s, STEEP)
    gap, logarithm, beyond = t - NEAR, log(t / NEAR), s - t
    part = gap / t
    energy = -(gap * gap) * logarithm  # (80)
    first = -gap * fma(2.0, logarithm, part)
    second = fma(part, part, -fma(4.0, part, 2.0 * logarithm))
    return fma(beyond, fma(0.5 * beyond, second, first), energy), fma(beyond, second, first), second


@kernel
def push_apart(barriers, k, f, push, p, q, r):
    """Add the force of barrier k, `push` times the gradients of its s, to the nodes."""
    third = barriers.nodes[k, 2]
    p, q, r = push * p, push * q, push * r
    total = p + q
    if third >= 0:
        f[INDEX(third)] += r
        total = total + r
    f[INDEX(barriers.nodes[k, 0])] += p
    f[INDEX(barriers.nodes[k, 1])] += q
    f[INDEX(barriers.nodes[k, 3])] -= total


@kernel
def add_force(body, world, control, x, v, f, cache):
    """Add the force of every barrier. Those that act in no fish of a block are skipped, as logarithms are expensive."""
    barriers, factor = body.barriers, control.stiffness[0]
    for k in range(barriers.energy.size):
        s, p, q, r = relative_volume(barriers, k, x)
        if any_lane(s < NEAR):
            push_apart(barriers, k, f, (-barriers.energy[k] * factor) * barrier(s)[1], p, q, r)


@kernel
def add_force_cached(body, world, control, x, v, f, cache):
    """Add the force of every barrier, and store the data of `add_tangent` for a filtered step."""
    barriers, factor, slope = body.barriers, control.stiffness[0], cache.slope
    step = control.plans[control.row[0], H]
    weight = control.plans[control.row[0], FACTOR] * step * step
    for k in range(barriers.energy.size):
        s, p, q, r = relative_volume(barriers, k, x)
        cache.active[k] = 0
        if any_lane(s < NEAR):
            scale = barriers.energy[k] * factor
            _, first, second = barrier(s)
            push_apart(barriers, k, f, -scale * first, p, q, r)
            root = sqrt(weight * scale * second)
            cache.active[k] = 1 if weight > 0.0 else 0
            slope[INDEX(3 * k)], slope[INDEX(3 * k + 1)], slope[INDEX(3 * k + 2)] = root * p, root * q, root * r


@kernel
def add_tangent(body, world, control, x, y, f, cache):
    """Add the restoring force of displacements y: the stiffness of active barriers along the gradients of s."""
    barriers, slope = body.barriers, cache.slope
    for k in range(barriers.energy.size):
        if cache.active[k] == 0:
            continue
        p, q, r = slope[INDEX(3 * k)], slope[INDEX(3 * k + 1)], slope[INDEX(3 * k + 2)]
        inner, third = y[INDEX(barriers.nodes[k, 3])], barriers.nodes[k, 2]
        change = dot(p, y[INDEX(barriers.nodes[k, 0])] - inner) + dot(q, y[INDEX(barriers.nodes[k, 1])] - inner)
        if third >= 0:
            change += dot(r, y[INDEX(third)] - inner)
        push_apart(barriers, k, f, -change, p, q, r)  # (81)


@kernel
def energy(body, world, control, x, v, f, cache):
    """Energy of all barriers, J."""
    barriers, total = body.barriers, zero(control.stiffness)
    for k in range(barriers.energy.size):
        total += barriers.energy[k] * barrier(relative_volume(barriers, k, x)[0])[0]
    return control.stiffness[0] * total


@kernel
def failed(body, world, control, x, v, f, cache):
    """Mask of the fish in which an inner node has passed its outer face, or is not inside all of them."""
    barriers, escaped, ray, turned = body.barriers, nowhere(x), cache.ray, cache.turned
    for k in range(barriers.energy.size):
        escaped = escaped | (relative_volume(barriers, k, x)[0] <= 0.0)
    if cache.faces.shape[0] == 0:
        return escaped
    one, two = vec3(ray[0, 0], ray[0, 1], ray[0, 2]), vec3(ray[1, 0], ray[1, 1], ray[1, 2])
    three = vec3(ray[2, 0], ray[2, 1], ray[2, 2])
    for i in range(x.size):
        turned[i] = vec3(dot(one, x[i]), dot(two, x[i]), dot(three, x[i]))
    for m in range(cache.inner.size):
        escaped = escaped | (windings(cache, cache.inner[m]) < 0.5)
    return escaped


@kernel
def windings(cache, i):
    """Windings of the outer layer around node i: faces seen from inside less those from outside, along one ray."""
    faces, x, centre = cache.faces, cache.turned, cache.turned[INDEX(i)]
    total = 0.0 * centre.x
    for k in range(faces.shape[0]):
        a, b = x[INDEX(faces[k, 0])] - centre, x[INDEX(faces[k, 1])] - centre
        along = fma(a.x, b.y, -(a.y * b.x))
        if faces[k, 2] < 0:
            total += select((a.y <= 0.0) & (b.y > 0.0) & (along > 0.0), 1.0, 0.0)
            total -= select((b.y <= 0.0) & (a.y > 0.0) & (along < 0.0), 1.0, 0.0)
            continue
        c = x[INDEX(faces[k, 2])] - centre
        second, third = fma(b.x, c.y, -(b.y * c.x)), fma(c.x, a.y, -(c.y * a.x))
        ahead = fma(second, a.z, fma(third, b.z, along * c.z))
        total += select((along > 0.0) & (second > 0.0) & (third > 0.0) & (ahead > 0.0), 1.0, 0.0)
        total -= select((along < 0.0) & (second < 0.0) & (third < 0.0) & (ahead < 0.0), 1.0, 0.0)
    return total
