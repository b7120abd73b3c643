"""One linear tetrahedron: its deformation, its frame, its stress and its nodal forces.

Strain and stress are expressed in world axes: with R the frame, R (R^T F) R^T = F R^T is the sum of x_a (R g_a)^T. The
material is isotropic, so only the rotated gradients R g_a are needed.

Legend: t element; a its corners; g gradients of the shape functions; h = R g the rotated ones, of corners 1 to 3; F the
sum of x_a g_a^T; a matrix m is a tuple of its columns, also p, q, r.
"""

from fish_env.kernels.compile import INDEX, kernel
from fish_env.kernels.simd import fma, vec3
from fish_env.physics.forces import polar


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
    )  # (46)


@kernel
def turned(tets, t, e, scratch):
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
    )  # (47)


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
