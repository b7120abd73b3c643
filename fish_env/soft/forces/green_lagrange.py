"""Tetrahedra with Green-Lagrange strain: the St. Venant-Kirchhoff material (Bonet & Wood 2008, ch. 6).

The strain is E = (F^T F - 1) / 2, quadratic in the deformation gradient F, and invariant under rotation without a
corotational frame. Its energy is V (mu E : E + lambda/2 (tr E)^2), and damping acts on the rate of E.
A bar stiffens in tension and softens in compression: below 0.58 of its length it collapses, and a flat element has no
restoring force. Small strains equal those of the other two measures.

Legend: t element; F its columns p, q, r; G the columns a, b, c of the gradient of another field, velocities or
displacements; S the second Piola-Kirchhoff stress, symmetric, as its diagonal and its off-diagonal yz, xz, xy; n F
times the gradient of the shape function of a corner.
"""

from fish_env.kernels.compile import INDEX, kernel
from fish_env.kernels.simd import Pack, dot, fma, select, vec3, zero
from fish_env.physics.forces.plan import FACTOR, INNER, LEAST, LOWEST, H
from fish_env.physics.records import Body, World
from fish_env.soft.forces import tets
from fish_env.soft.forces.tets import constants, edges, gradient

FAILURE = tets.FAILURE
failed = tets.failed
ANYWHERE = True


def present(body: Body, world: World) -> bool:
    """Return True if the body has tetrahedra of this measure of strain."""
    return body.tets is not None and body.tets.quadratic


def make_cache(body: Body, world: World, kind) -> Pack:
    """Data of `add_tangent`: F and S (5T,) and the weighted Lame constants (T,), Pa m3; and scratch."""
    assert body.tets is not None  # else the force is not present
    count = len(body.tets.nodes)
    shear, dilation = kind.scratch(count, kind.dtype), kind.scratch(count, kind.dtype)
    return Pack("green_lagrange", kept=kind.vectors(5 * count), shear=shear, dilation=dilation, corner=kind.vectors(4))


@kernel
def double_symmetric_part(m, n):
    """Diagonal and off-diagonal of F^T G + G^T F, for the columns m of F and n of G."""
    p, q, r = m
    a, b, c = n
    return (
        vec3(2.0 * dot(p, a), 2.0 * dot(q, b), 2.0 * dot(r, c)),
        vec3(dot(q, c) + dot(r, b), dot(p, c) + dot(r, a), dot(p, b) + dot(q, a)),
    )


@kernel
def stress(double, shear, dilation):
    """Stress for twice a strain, both as diagonal and off-diagonal."""
    diagonal, off = double
    even = (0.5 * dilation) * (diagonal.x + diagonal.y + diagonal.z)
    return vec3(fma(shear, diagonal.x, even), fma(shear, diagonal.y, even), fma(shear, diagonal.z, even)), shear * off


@kernel
def double_strain(m, n, relaxation):
    """Twice the strain plus `relaxation` times its rate, from F and the velocity gradient."""
    p, q, r = m
    diagonal, off = double_symmetric_part(m, n)
    unit = vec3(dot(p, p) - 1.0, dot(q, q) - 1.0, dot(r, r) - 1.0)
    return fma(relaxation, diagonal, unit), fma(relaxation, off, vec3(dot(q, r), dot(p, r), dot(p, q)))  # (68)


@kernel
def product(m, s):
    """Columns of the product of a matrix m and a symmetric one s."""
    p, q, r = m
    d, o = s
    return (
        fma(o.y, r, fma(o.z, q, d.x * p)),
        fma(o.x, r, fma(d.y, q, o.z * p)),
        fma(d.z, r, fma(o.x, q, o.y * p)),
    )


@kernel
def along(shape, t, a, m):
    """Product of a matrix m and the gradient of the shape function of corner a of element t."""
    return fma(shape[t, a, 2], m[2], fma(shape[t, a, 1], m[1], shape[t, a, 0] * m[0]))


@kernel
def scatter(elements, t, m, f):
    """Subtract from f the nodal forces of the first Piola-Kirchhoff stress m times the volume of element t."""
    nodes, shape = elements.nodes, elements.gradient
    a, b, c = along(shape, t, 1, m), along(shape, t, 2, m), along(shape, t, 3, m)
    f[INDEX(nodes[t, 0])] += a + b + c
    f[INDEX(nodes[t, 1])] -= a
    f[INDEX(nodes[t, 2])] -= b
    f[INDEX(nodes[t, 3])] -= c


@kernel
def add_element(elements, t, factor, x, v, f):
    """Add the elastic and viscous force of element t; return F, and S of the elastic force times the volume."""
    m, n = gradient(elements, t, edges(elements, t, x)), gradient(elements, t, edges(elements, t, v))
    shear, dilation = constants(elements, t, factor)
    s = stress(double_strain(m, n, elements.relaxation_time[t]), shear, dilation)
    scatter(elements, t, product(m, s), f)  # (69)
    return m, stress(double_strain(m, n, 0.0), shear, dilation)


@kernel
def add_force(body, world, control, x, v, f, cache):
    """Add the elastic and viscous force of every tetrahedron."""
    elements = body.tets
    for t in range(elements.volume.size):
        add_element(elements, t, control.stiffness[0], x, v, f)


@kernel
def tensile_part(s):
    """Positive semi-definite matrix that equals s if s is tensile along every axis (Gershgorin's bound)."""
    d, o = s
    x, y, z = abs(o.x), abs(o.y), abs(o.z)
    low = d.x - (y + z)
    second, third = d.y - (x + z), d.z - (x + y)
    low = select(second < low, second, low)
    low = select(third < low, third, low)
    lift = select(low < 0.0, -low, 0.0)
    return vec3(d.x + lift, d.y + lift, d.z + lift), o


@kernel
def add_force_cached(body, world, control, x, v, f, cache):
    """Add the force of every tetrahedron, and store the data of `add_tangent` for a filtered step."""
    # The weights are those of `tets.add_force_cached`. Only tensile stress resists rotation.
    elements, factor = body.tets, control.stiffness[0]
    plans, row = control.plans, control.row[0]
    h, share, least = plans[row, H], plans[row, FACTOR], plans[row, LEAST]
    for t in range(elements.volume.size):
        m, s = add_element(elements, t, factor, x, v, f)
        viscous = h * elements.relaxation_time[t]
        d, o = tensile_part(s)
        weight = share * h * h
        keep(elements, t, m, (weight * d, weight * o),
             max(share * (h * h + 2.0 * viscous), least * viscous), cache)  # fmt: skip


@kernel
def keep(elements, t, m, s, weight, cache):
    """Store F and S of element t, and its stiffness times a weight."""
    kept, shear, dilation = cache.kept, cache.shear, cache.dilation
    kept[5 * t], kept[5 * t + 1], kept[5 * t + 2] = m
    kept[5 * t + 3], kept[5 * t + 4] = s
    shear[t], dilation[t] = constants(elements, t, weight)


@kernel
def add_tangent(body, world, control, x, y, f, cache):
    """Add the restoring force of displacements y, by the stored stiffness."""
    elements, factor, kept = body.tets, control.stiffness[0], cache.kept
    for t in range(elements.volume.size):
        m, s = (kept[5 * t], kept[5 * t + 1], kept[5 * t + 2]), (kept[5 * t + 3], kept[5 * t + 4])
        n = gradient(elements, t, edges(elements, t, y))
        change = stress(double_symmetric_part(m, n), factor * cache.shear[t], factor * cache.dilation[t])
        a, b, c = product(m, change)
        p, q, r = product(n, s)
        scatter(elements, t, (a + p, b + q, c + r), f)


@kernel
def add_system(body, world, control, x, v, a, cache):
    """Add h D + h^2 K to the matrix a, as `springs.add_system`, and store K for `add_tangent`."""
    # K is exact for an element without damping: material and geometric stiffness. Tensile stress resists rotation and
    # compressive stress favours it; the latter is omitted if LOWEST is zero or more. The change of viscous forces by
    # rotation is not symmetric, and is omitted.
    elements, factor, now = body.tets, control.stiffness[0], cache.corner
    first, start, rows, shape = body.profile.first, body.profile.start, body.profile.row, elements.gradient
    step, lowest = control.plans[control.row[0], INNER], control.plans[control.row[0], LOWEST]
    for t in range(elements.volume.size):
        m, n = gradient(elements, t, edges(elements, t, x)), gradient(elements, t, edges(elements, t, v))
        shear, dilation = constants(elements, t, factor)
        s = stress(double_strain(m, n, elements.relaxation_time[t]), shear, dilation)
        if lowest >= 0.0:
            s = tensile_part(s)
        keep(elements, t, m, s, 1.0, cache)
        d, o = s
        mu, la = constants(elements, t, factor * (step * (step + elements.relaxation_time[t])))
        p, q, r = m
        square = (  # F F^T
            fma(p.x, p, fma(q.x, q, r.x * r)), fma(p.y, p, fma(q.y, q, r.y * r)), fma(p.z, p, fma(q.z, q, r.z * r))
        )  # fmt: skip
        for i in range(4):
            now[i] = along(shape, t, i, m)
        for i in range(4):
            for j in range(4):
                row, column = rows[elements.nodes[t, i]], rows[elements.nodes[t, j]]
                if row < column:  # above the diagonal
                    continue
                here, there, place = now[i], now[j], 3 * (start[row] + column - first[row])
                gx, gy, gz, hx, hy, hz = (
                    shape[t, i, 0], shape[t, i, 1], shape[t, i, 2], shape[t, j, 0], shape[t, j, 1], shape[t, j, 2]
                )  # fmt: skip
                both = mu * (gx * hx + gy * hy + gz * hz)
                turn = (gx * hx) * d.x + (gy * hy) * d.y + (gz * hz) * d.z + (gy * hz + gz * hy) * o.x
                turn = (step * step) * (turn + (gx * hz + gz * hx) * o.y + (gx * hy + gy * hx) * o.z)
                even = turn * vec3(1.0, 0.0, 0.0), turn * vec3(0.0, 1.0, 0.0), turn * vec3(0.0, 0.0, 1.0)
                a[place] += column_of(here, there, mu, la, square[0], both, here.x, there.x) + even[0]
                a[place + 1] += column_of(here, there, mu, la, square[1], both, here.y, there.y) + even[1]
                a[place + 2] += column_of(here, there, mu, la, square[2], both, here.z, there.z) + even[2]


@kernel
def column_of(here, there, mu, la, square, both, this, that):
    """Column of the block of two corners: mu n_j n_i^T + lambda n_i n_j^T + mu (g_i . g_j) F F^T."""  # (70)
    return fma(both, square, fma(mu * this, there, (la * that) * here))


@kernel
def strain_energy(double, shear, dilation):
    """Energy of twice a symmetric strain (diagonal, off the diagonal), with Lame's constants times the volume."""
    d, o = double
    trace = d.x + d.y + d.z
    return fma(0.25 * shear, fma(2.0, dot(o, o), dot(d, d)), (0.125 * dilation) * (trace * trace))


@kernel
def energy(body, world, control, x, v, f, cache):
    """Elastic energy of all tetrahedra, J."""
    elements, total = body.tets, zero(control.stiffness)
    for t in range(elements.volume.size):
        m = gradient(elements, t, edges(elements, t, x))
        total += strain_energy(double_strain(m, m, 0.0), *constants(elements, t, control.stiffness[0]))
    return total


@kernel
def loss(body, world, control, x, v, f, cache):
    """Power lost in the damping of all tetrahedra, W."""
    elements, total = body.tets, zero(control.stiffness)
    for t in range(elements.volume.size):
        m, n = gradient(elements, t, edges(elements, t, x)), gradient(elements, t, edges(elements, t, v))
        factor = (2.0 * elements.relaxation_time[t]) * control.stiffness[0]
        total += strain_energy(double_symmetric_part(m, n), *constants(elements, t, factor))
    return total
