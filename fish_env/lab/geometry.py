"""Geometry of an object to draw and measure: its surface as triangles, volumes and strains. numpy only.

Legend: F faces, each a quadrilateral or a triangle with its third node twice; T tetrahedra; E springs.
"""

from typing import Any, NamedTuple

import numpy as np

from fish_env.bodies import Fish

SIDES = np.array([(1, 2, 3), (0, 3, 2), (0, 1, 3), (0, 2, 1)])
"""The four sides of a tetrahedron, outward."""


class Surface(NamedTuple):
    """Triangles between the points that a matrix of an object's nodes gives."""

    triangles: np.ndarray  # (K,3) indices of points
    nodes: np.ndarray  # (P,) the node each point lies on
    height: np.ndarray  # (P,) m above that node: zero, but for a flat fish
    closed: bool  # whether it encloses a volume

    def points(self, x) -> np.ndarray:
        """Positions of the points, (P,3) m, for nodes at x (N,3) m."""
        return x[self.nodes] + self.height[:, None] * (0.0, 0.0, 1.0)


def triangulate(faces: np.ndarray) -> np.ndarray:
    """Two triangles for each quadrilateral (F,4), one for each triangle: (K,3)."""
    halves = np.concatenate([faces[:, [0, 1, 2]], faces[:, [0, 2, 3]]])
    proper = (halves[:, 0] != halves[:, 1]) & (halves[:, 1] != halves[:, 2]) & (halves[:, 0] != halves[:, 2])
    return halves[proper]


def boundary(tets: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The sides (K,3) of tetrahedra (T,4) that only one of them has, outward, and whose each is, (K,)."""
    sides = tets[:, SIDES].reshape(-1, 3)
    _, first, count = np.unique(np.sort(sides, axis=1), axis=0, return_index=True, return_counts=True)
    outside = np.sort(first[count == 1])
    return sides[outside], outside // 4


def surfaces(thing: Any) -> list[Surface]:
    """The outer surface of an object and, if there is one, an inner one; empty for a string."""
    nodes = np.arange(thing.body.mass.size)
    if isinstance(thing, Fish):
        marks = thing.landmarks
        return [Surface(triangulate(marks.faces), marks.node, marks.height, True)]
    closed = True
    if thing.body.tets is not None:
        triangles = [boundary(thing.body.tets.nodes)[0]]
    elif not len(thing.skin):
        triangles = []
    elif thing.skin.shape[1] == 4:
        outer = triangulate(thing.skin)
        triangles = [outer, thing.inner[outer]] if len(thing.inner) else [outer]
    else:
        closed, triangles = False, ring_triangles(thing.skin, thing.inner)
    return [Surface(each, nodes, np.zeros(nodes.size), closed) for each in triangles]


def ring_triangles(edges: np.ndarray, inner: np.ndarray) -> list[np.ndarray]:
    """Triangles of the band from edges (F,2) to an inner ring, and of the disc within that, as a fan."""
    a, b = edges[:, 0], edges[:, 1]
    if not len(inner):
        return [fan(a)]
    i, j = inner[a], inner[b]
    return [np.concatenate([np.stack([a, b, j], axis=1), np.stack([a, j, i], axis=1)]), fan(i)]


def fan(ring: np.ndarray) -> np.ndarray:
    """Triangles (K-2,3) from the first node of a ring (K,) to all its edges."""
    return np.stack([np.full(len(ring) - 2, ring[0]), ring[1:-1], ring[2:]], axis=1)


def signed_volume(triangles: np.ndarray, points: np.ndarray) -> float:
    """Volume inside closed triangles (K,3) between points (P,3) m, m3, by Gauss' theorem."""
    a, b, c = (points[triangles[:, k]] - points[triangles[0, 0]] for k in range(3))
    return float(np.einsum("ij,ij->", a, np.cross(b, c))) / 6.0


def enclosed_volume(thing: Any, outside: list[Surface], x: np.ndarray) -> float:
    """Volume of the tetrahedra or inside the outer surface, m3; of a ring its area, m2; NaN for a string."""
    if thing.body.tets is not None:
        a, b, c, d = (x[thing.body.tets.nodes[:, k]] for k in range(4))
        return float(np.einsum("ij,ij->", np.cross(b - a, c - a), d - a)) / 6.0
    if not outside:
        return np.nan
    if not outside[0].closed:
        p, q = x[thing.skin[:, 0]], x[thing.skin[:, 1]]
        return 0.5 * float((p[:, 0] * q[:, 1] - p[:, 1] * q[:, 0]).sum())
    return signed_volume(outside[0].triangles, outside[0].points(x))


def spring_strain(springs, rest_length, x) -> np.ndarray:
    """Change of every spring's length over its present natural length, (E,)."""
    way = x[springs.nodes[:, 1]] - x[springs.nodes[:, 0]]
    return np.sqrt(np.einsum("ij,ij->i", way, way)) / rest_length - 1.0


def tet_strain(tets, x) -> np.ndarray:
    """The largest principal strain of every tetrahedron by magnitude, (T,): a principal stretch less 1.

    The squares of the stretches are the eigenvalues of a symmetric matrix, whose largest and smallest are found in
    closed form (Smith 1961): LAPACK takes ten times as long for as many small matrices.
    """
    edges = x[tets.nodes[:, 1:]] - x[tets.nodes[:, :1]]
    gradient = np.matmul(tets.gradient[:, 1:].transpose(0, 2, 1), edges)
    square = np.matmul(gradient, gradient.transpose(0, 2, 1))
    a, b, c, d, e, f = (square[:, i, j] for i, j in ((0, 0), (1, 1), (2, 2), (1, 2), (0, 2), (0, 1)))
    mean = (a + b + c) / 3.0
    a, b, c = a - mean, b - mean, c - mean
    spread = np.sqrt((a * a + b * b + c * c + 2.0 * (d * d + e * e + f * f)) / 6.0)
    volume = a * (b * c - d * d) - f * (f * c - d * e) + e * (f * d - b * e)
    angle = np.arccos(np.clip(0.5 * volume / np.maximum(spread, 1e-100) ** 3, -1.0, 1.0)) / 3.0
    high = np.sqrt(np.maximum(mean + 2.0 * spread * np.cos(angle), 0.0)) - 1.0
    low = np.sqrt(np.maximum(mean + 2.0 * spread * np.cos(angle + 2.0 * np.pi / 3.0), 0.0)) - 1.0
    return np.where(np.abs(high) >= np.abs(low), high, low)
