"""Closed skins of springs, and two of them joined into layers (Song 2009, ch. 3); no materials."""

from typing import NamedTuple

import numpy as np

from fish_env.soft.elements import make_compartments
from fish_env.soft.volume import volume_of

BALANCED = 1e-10  # of the load, that the tensions may leave unbalanced at a node
NEARBY = np.radians(30.0)  # seen from the centre
KINDS = ("outer", "inner", "radius", "shear left", "shear right")
"""The springs of a two-layered body, in their order: structural ones of each layer, and three kinds between them."""


class Skin(NamedTuple):
    """A closed surface of unit radius, or a closed line in the xy plane: n nodes, E edges."""

    place: np.ndarray  # (n,3) on the unit sphere, or circle
    edges: np.ndarray  # (E,2) each once
    faces: np.ndarray  # (F,4) outward, a triangle's third node twice; of a line its edges (n,2), counter-clockwise


def circle(nodes: int) -> Skin:
    """A regular polygon, the first node on the x axis."""
    angle = 2.0 * np.pi * np.arange(nodes) / nodes
    edges = np.stack([np.arange(nodes), np.roll(np.arange(nodes), -1)], axis=1)
    return Skin(np.stack([np.cos(angle), np.sin(angle), np.zeros(nodes)], axis=1), edges, edges)


def globe(slices: int, stacks: int) -> Skin:
    """A sphere of circles of latitude: quadrilaterals, closed by triangles at the poles (ch. 3.5.1)."""
    polar = np.pi * np.arange(1, stacks)[:, None] / stacks
    angle = 2.0 * np.pi * np.arange(slices)[None] / slices
    rings = np.stack(
        [np.sin(polar) * np.cos(angle), np.sin(polar) * np.sin(angle), np.cos(polar) + 0.0 * angle], axis=2
    )
    place = np.concatenate([[[0.0, 0.0, 1.0]], rings.reshape(-1, 3), [[0.0, 0.0, -1.0]]])
    south, faces = len(place) - 1, []
    for j in range(slices):
        k = (j + 1) % slices
        faces.append((0, 1 + j, 1 + k, 1 + k))
        for row in range(1, (stacks - 2) * slices, slices):
            faces.append((row + j, row + slices + j, row + slices + k, row + k))
        faces.append((south, south - slices + k, south - slices + j, south - slices + j))
    return Skin(place, edges_of(faces), np.array(faces))


def octasphere(level: int) -> Skin:
    """An octahedron whose triangles are divided in four `level` times, new nodes moved onto the sphere (ch. 3.5.2)."""
    place = [np.array(p, float) for p in ((1, 0, 0), (0, 1, 0), (-1, 0, 0), (0, -1, 0), (0, 0, 1), (0, 0, -1))]
    faces = [(a, (a + 1) % 4, 4) for a in range(4)] + [((a + 1) % 4, a, 5) for a in range(4)]
    return subdivide(place, faces, level)


def subdivide(place: list, faces: list, level: int) -> Skin:
    """Divide triangles (a, b, c), outward, in four `level` times at the middles of their edges, on the sphere."""
    for _ in range(level):
        middle: dict[tuple[int, int], int] = {}
        finer = []
        for face in faces:
            between = []
            for a, b in zip(face, face[1:] + face[:1], strict=True):
                edge = (min(a, b), max(a, b))
                if edge not in middle:
                    middle[edge] = len(place)
                    point = place[a] + place[b]
                    place.append(point / np.linalg.norm(point))
                between.append(middle[edge])
            (a, b, c), (ab, bc, ca) = face, between
            finer += [(a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca)]
        faces = finer
    corners = np.array(faces)[:, [0, 1, 2, 2]]
    return Skin(np.array(place), edges_of(corners.tolist()), corners)


def edges_of(faces) -> np.ndarray:
    """The edges (E,2) of faces (F,4), each once, in the order in which they come."""
    found: dict[tuple[int, int], None] = {}
    for face in faces:
        for a, b in zip(face, (*face[1:], face[0]), strict=True):
            if a != b:
                found.setdefault((min(a, b), max(a, b)))
    return np.array(list(found))


def layer_springs(skin: Skin) -> tuple[np.ndarray, dict[str, slice]]:
    """Springs (4 E + n, 2) of an outer skin, nodes 0 to n - 1, and an inner one, n to 2 n - 1; slices by KINDS."""
    # Radius springs join a node and its partner; shear springs the two ends of an edge across the layers: left ones the
    # inner first end and the outer second, right ones the other two (ch. 3.4.1).
    n, (a, b) = len(skin.place), skin.edges.T
    nodes = np.arange(n)
    parts = [(a, b), (a + n, b + n), (nodes, nodes + n), (a + n, b), (b + n, a)]
    ends = np.cumsum([0] + [len(part[0]) for part in parts])
    kinds = {kind: slice(int(ends[k]), int(ends[k + 1])) for k, kind in enumerate(KINDS)}
    return np.concatenate([np.stack(part, axis=1) for part in parts]), kinds


def barrier_pairs(skin: Skin) -> tuple[np.ndarray, np.ndarray]:
    """Outer triangles (K,3), or edges (K,2), that a barrier keeps an inner node (K,) behind."""
    # They are those with a corner next to the node's partner, or at most NEARBY from it: in an impact, nodes of a fine
    # mesh pass the faces beside their own first.
    n, faces, (a, b) = len(skin.place), skin.faces, skin.edges.T
    if faces.shape[1] > 2:
        faces = np.concatenate([faces[:, :3], faces[faces[:, 2] != faces[:, 3]][:, [2, 3, 0]]])
    near = skin.place @ skin.place.T >= np.cos(NEARBY) - 1e-9
    near[a, b] = near[b, a] = True
    node, face = np.nonzero(near[:, faces].any(axis=2))
    return faces[face], node + n


def tensions(skin: Skin) -> np.ndarray:
    """Pulls (E,) of the edges that balance a unit pressure inside the skin of unit radius; ValueError if none do."""
    # They are found by least squares. Those of radius R and pressure p are p R^2 times as much, of a line p R times.
    n, (a, b) = len(skin.place), skin.edges.T
    load = volume_of(make_compartments(skin.place, [skin.faces], 1.0).faces, skin.place)[1].ravel()
    along = skin.place[b] - skin.place[a]
    along /= np.linalg.norm(along, axis=1)[:, None]
    matrix = np.zeros((3 * n, len(a)))
    for k in range(3):
        matrix[3 * a + k, np.arange(len(a))] = along[:, k]
        matrix[3 * b + k, np.arange(len(a))] = -along[:, k]
    pull = np.linalg.lstsq(matrix, -load, rcond=None)[0]
    left = np.abs(matrix @ pull + load).max() / np.abs(load).max()
    if not left <= BALANCED:
        raise ValueError(f"no tensions of {len(a)} springs balance the pressure on {n} nodes: {left:.1e} is left")
    return pull


def even_factors(skin: Skin) -> np.ndarray:
    """Factors (E,) of mean 1 on the stiffness of edges, with which more pressure makes a ball larger and as round."""
    # Each is in proportion to the tension over the length: then all strains are equal. Song multiplies the forces on a
    # node with n neighbours by 6/n (ch. 3.5.3).
    ends = skin.place[skin.edges]
    factor = tensions(skin) / np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1)
    return factor / factor.mean()
