"""Measurements of an object: volume, strains, and forces as arrows. numpy only.

Legend: Q faces, each a quadrilateral or a triangle with its third point twice; T tetrahedra; E springs.
"""

from typing import Any

import numpy as np

from fish_env.scene.look import Look
from fish_env.soft.room import GRAVITY

STRAIN = 0.3  # strain at the ends of the colour scale
ARROWS = 150  # forces that are drawn: the largest
USUAL, LONGEST = 0.2, 0.35  # lengths of the object: the arrow of the quantile, and of the largest force
QUANTILE = 0.9
LEAST = 0.02  # weights of a node on Earth: forces are not blown up beyond the scale on which this is the quantile


def enclosed_volume(thing: Any, look: Look, x: np.ndarray) -> float:
    """Volume of the tetrahedra or inside the outer surface, m3; of a ring its area, m2; NaN for a string."""
    if thing.body.tets is not None:
        a, b, c, d = (x[thing.body.tets.nodes[:, k]] for k in range(4))
        return float(np.einsum("ij,ij->", np.cross(b - a, c - a), d - a)) / 6.0
    skin = thing.landmarks.faces if hasattr(thing, "landmarks") else thing.skin
    if not len(skin):
        return np.nan
    if skin.shape[1] == 2:
        p, q = x[skin[:, 0]], x[skin[:, 1]]
        return 0.5 * float((p[:, 0] * q[:, 1] - p[:, 1] * q[:, 0]).sum())
    points = look.marks(x)
    a, b, c, d = points[skin.T] - points[skin[0, 0]]
    return float(np.einsum("ij,ij->", a, np.cross(b, c)) + np.einsum("ij,ij->", a, np.cross(c, d))) / 6.0


def spring_strain(springs, rest_length, x) -> np.ndarray:
    """Change of every spring's length over its present natural length, (E,)."""
    return np.linalg.norm(x[springs.nodes[:, 1]] - x[springs.nodes[:, 0]], axis=1) / rest_length - 1.0


def most_strained(nodes: np.ndarray, strain: np.ndarray) -> int:
    """A node of the element (K,n) that is strained (K,) most; -1 without elements."""
    return int(nodes[np.abs(np.nan_to_num(strain)).argmax(), 0]) if strain.size else -1


def tet_strain(tets, x) -> np.ndarray:
    """The largest principal strain of every tetrahedron by magnitude, (T,): a principal stretch less 1."""
    gradient = np.matmul(tets.gradient[:, 1:].transpose(0, 2, 1), x[tets.nodes[:, 1:]] - x[tets.nodes[:, :1]])
    stretch = np.linalg.svd(gradient, compute_uv=False) - 1.0
    high, low = stretch[:, 0], stretch[:, -1]
    return np.where(np.abs(high) >= np.abs(low), high, low)


def tone(count: int, nodes: np.ndarray, strain: np.ndarray) -> np.ndarray:
    """Mean strain at each of so many nodes of elements (K,n) with strains (K,), from -1 to 1 on a scale of roots.

    So a strain of one percent is visible next to one of thirty, at the end of the scale.
    """
    each = np.bincount(nodes.ravel(), minlength=count)
    total = np.bincount(nodes.ravel(), np.repeat(strain, nodes.shape[1]), minlength=count)
    mean = np.clip(np.nan_to_num(total / np.maximum(each, 1)), -STRAIN, STRAIN)
    return np.sign(mean) * np.sqrt(np.abs(mean) / STRAIN)


def arrows(force: np.ndarray, mass: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The nodes of the largest forces (N,3) N, and an arrow for each of these, (K,3) in lengths of the object.

    An arrow's length is proportional to the square root of the force: USUAL for the 90 % quantile of all, at most
    LONGEST. One force that is much larger than the others, of a node that is fixed, does not make these invisible.
    """
    size = np.linalg.norm(np.nan_to_num(force), axis=1)
    nodes = np.argsort(size)[-min(ARROWS, len(size)) :]
    reference = max(float(np.quantile(size, QUANTILE)), LEAST * GRAVITY * float(mass.mean()))
    length = np.minimum(USUAL * np.sqrt(size[nodes] / reference), LONGEST)
    return nodes, force[nodes] * (length / np.maximum(size[nodes], 1e-300))[:, None]
