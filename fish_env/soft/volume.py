"""Volume inside closed surfaces of triangles and bilinear patches, or area in flat rings, by Gauss' theorem.

The gas calls the kernel at every step. Builders that need a volume at rest run it in plain Python, without compilation.

Legend: p, q, r, s corners of a face; o a point near it, so that no digits are lost far from the origin; m sum of the
corners less 4 o; d, e diagonals; slope gradient of the volume.
"""

import numpy as np

from fish_env.kernels.compile import INDEX, kernel
from fish_env.kernels.simd import Kind, cross, dot, fma, vec3

ONE = Kind(1)


@kernel
def add_volume(faces, first, last, x, slope, base):
    """Return the volume inside faces first to last, m3 (m2 for a ring), and add its gradient to slope[base + i], m2."""
    # faces: (Q,4), outward; a triangle has its third node twice, an edge of a ring -1 for its third and fourth.
    o = x[INDEX(faces[first, 0])]
    volume = 0.0 * o.x
    for k in range(first, last):
        p, q, r, s = faces[k, 0], faces[k, 1], faces[k, 2], faces[k, 3]
        if r < 0:
            up, a, b = vec3(0.0, 0.0, 0.5), x[INDEX(p)] - o, x[INDEX(q)] - o
            volume += dot(cross(a, b), up)
            slope[INDEX(base + p)] += cross(b, up)
            slope[INDEX(base + q)] -= cross(a, up)
            continue
        xp, xq, xr, xs = x[INDEX(p)], x[INDEX(q)], x[INDEX(r)], x[INDEX(s)]
        d, e, m = xr - xp, xs - xq, fma(-4.0, o, xp + xq + xr + xs)
        a = (1.0 / 24.0) * cross(d, e)
        volume += dot(m, a)  # (76)
        b, c = (1.0 / 24.0) * cross(e, m), (1.0 / 24.0) * cross(m, d)
        slope[INDEX(base + p)] += a - b  # (77)
        slope[INDEX(base + r)] += a + b
        slope[INDEX(base + q)] += a - c
        slope[INDEX(base + s)] += a + c
    return volume


def volume_of(faces, x) -> tuple[float, np.ndarray]:
    """Volume inside faces (Q,4), m3 (m2 for a ring), and its gradient (N,3), m2, at positions x (N,3) m."""
    slope = ONE.vectors(len(x))
    plain = getattr(add_volume, "py_func", add_volume)
    return float(plain(np.asarray(faces), 0, len(faces), ONE.rows(x), slope, 0)), slope.memory


def curvature_of(faces, x) -> tuple[np.ndarray, np.ndarray]:
    """Second derivatives of that volume: nodes (Q,k) of each face and matrices (Q,3k,3k), m; k is 4, or 2 for edges."""
    # The volume m . (d x e) / 24 of a face is linear in each of the three, so that each pair has a cross product.
    flat, x = faces[0, 2] < 0, x - x[faces[0, 0]]
    nodes = faces[:, :2] if flat else faces
    corners = x[nodes].swapaxes(0, 1)
    if flat:
        parts = [([1.0, 0.0], [0.0, 1.0], np.full((len(faces), 3), [0.0, 0.0, 0.5]))]
    else:
        p, q, r, s = corners
        m, d, e = np.ones(4), np.array([-1.0, 0.0, 1.0, 0.0]), np.array([0.0, -1.0, 0.0, 1.0])
        parts = [(m, d, (s - q) / 24.0), (e, m, (r - p) / 24.0), (d, e, (p + q + r + s) / 24.0)]
    found = np.zeros((len(faces), nodes.shape[1], 3, nodes.shape[1], 3))
    for one, other, along in parts:
        turned = np.cross(along[:, None], np.eye(3)).swapaxes(1, 2)
        found += np.einsum("ab,fij->faibj", np.outer(other, one) - np.outer(one, other), turned)
    return nodes, found.reshape(len(faces), 3 * nodes.shape[1], -1)
