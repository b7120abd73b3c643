"""Tetrahedra, gas compartments, and non-penetration barriers between two layers.

Each maker checks its input; its errors name the invalid element.
"""

from collections import Counter
from itertools import pairwise
from typing import Any

import numpy as np

from fish_env.checks import check_names, finite_array, node_array, positive_array, representable
from fish_env.physics.records import Barriers, Compartments, Tets
from fish_env.soft.volume import volume_of

STRAINS = ("corotational", "linear", "green_lagrange")
FLAT = 1e-9  # ratio of volume to that of a cube on the longest edge, below which an element is flat


@representable("a tetrahedron")
def make_tets(position, nodes, young, poisson, relaxation_time: Any = 0.0, strain="corotational") -> Tets:
    """Tetrahedra (T,4) between nodes at rest at `position` (N,3) m (docs/physics-more.md, eq. 62-70).

    Args:
        position: (N,3) m.
        nodes: (T,4), each element's volume positive: (b - a) x (c - a) . (d - a) > 0.
        young: Young's modulus, Pa, positive: one number or (T,).
        poisson: Poisson's ratio, above -1 and below 0.5: one number or (T,).
        relaxation_time: damping over stiffness, s, zero or positive: one number or (T,).
        strain: measure of strain: "corotational", linear in a frame that rotates with each element; "linear", in a
            fixed frame, for small rotations; "green_lagrange", quadratic, for any rotation.

    Raises:
        ValueError: for a flat, inverted or repeated element or an invalid material, naming the first such element; for
            an unknown measure of strain.
    """
    check_names("strain is", STRAINS, strain)
    position = finite_array(position, (len(position), 3), "position (m)")
    nodes = node_array(nodes, 4, len(position), "tetrahedra")
    count = len(nodes)
    once = np.sort(nodes, axis=1)
    _refuse(nodes, (once[:, 1:] == once[:, :-1]).any(axis=1), "names a node twice; give four different nodes")
    kept = np.unique(once, axis=0, return_index=True)[1]
    _refuse(nodes, ~np.isin(np.arange(count), kept), "is there twice; give every element once")
    edge = position[nodes[:, 1:]] - position[nodes[:, :1]]
    volume = np.linalg.det(edge) / 6
    size = np.linalg.norm(edge, axis=2).max(axis=1, initial=0.0)
    _refuse(nodes, np.abs(volume) <= FLAT * size**3, "is flat; give nodes that do not lie in one plane")
    _refuse(nodes, volume < 0, "is inverted; exchange two of its nodes")
    young, poisson, damped = (x if np.ndim(x) else np.full(count, x) for x in (young, poisson, relaxation_time))
    young, poisson = positive_array(young, (count,), "young (Pa)"), finite_array(poisson, (count,), "poisson")
    outside = (poisson <= -1.0) | (poisson >= 0.5)
    if outside.any():
        e = int(np.argmax(outside))
        raise ValueError(f"poisson is {poisson[e]:g} in element {e}; give numbers above -1 and below 0.5")
    damped = positive_array(damped, (count,), "relaxation_time (s)", zero=True)
    inner = np.linalg.inv(edge).transpose(0, 2, 1) if count else np.zeros((0, 3, 3))
    gradient = np.ascontiguousarray(np.concatenate([-inner.sum(axis=1, keepdims=True), inner], axis=1))
    shear = 0.5 * young / (1.0 + poisson)
    dilation = young * poisson / ((1.0 + poisson) * (1.0 - 2.0 * poisson))
    return Tets(nodes, gradient, volume, shear, dilation, damped, strain == STRAINS[0], strain == STRAINS[2])


@representable("a compartment")
def make_compartments(position, surfaces, pressure, ambient: float | np.ndarray = 0.0) -> Compartments:
    """Gas compartments inside closed surfaces, at the given pressure while the body is at rest.

    Args:
        position: (N,3) m.
        surfaces: a list of the faces (K,4) of each compartment, outward, or the edges (K,2) of a ring in the xy plane,
            counter-clockwise. The space between two skins is one surface: the outer, and the inner with reversed faces.
        pressure: pressure at rest, Pa, positive: one number or (C,). For a ring, N/m.
        ambient: pressure outside, Pa: one number or (C,).

    Raises:
        ValueError: for a compartment that is open, inside out or empty; the message names it and the open edge.
    """
    position = finite_array(position, (len(position), 3), "position (m)")
    count = len(surfaces)
    faces, first = [], [0]
    for c, surface in enumerate(surfaces):
        surface = np.asarray(surface)
        width = 2 if surface.ndim == 2 and surface.shape[1] == 2 else 4
        surface = node_array(surface, width, len(position), f"faces of compartment {c}")
        _check_closed(surface, c)
        if width == 2:
            surface = np.concatenate([surface, np.full((len(surface), 2), -1)], axis=1)
        faces.append(surface)
        first.append(first[-1] + len(surface))
    faces = np.concatenate(faces).astype(np.int64) if faces else np.zeros((0, 4), np.int64)
    pressure = positive_array(np.broadcast_to(pressure, (count,)), (count,), "pressure (Pa)")
    ambient = positive_array(np.broadcast_to(ambient, (count,)), (count,), "ambient (Pa)", zero=True)
    volume = np.array([volume_of(faces[p:q], position)[0] for p, q in pairwise(first)])
    for c in np.flatnonzero(~(volume > 0)):
        raise ValueError(f"compartment {c} encloses {volume[c]:g}; give its faces counter-clockwise seen from outside")
    return Compartments(faces, np.array(first, np.int64), pressure * volume, ambient)


def fill(position, surfaces, pressure, ambient=(0.0, 0.0)) -> Compartments | None:
    """Compartments of those surfaces whose gas has a pressure, Pa (C,) each as (C,) outside; None if none has."""
    pressure = positive_array(pressure, (len(surfaces),), "pressures (Pa)", zero=True)
    kept = np.flatnonzero(pressure)
    which = [surfaces[c] for c in kept]
    return make_compartments(position, which, pressure[kept], np.array(ambient)[kept]) if which else None


@representable("a barrier")
def make_barriers(position, faces, inner, energy) -> Barriers:
    """Barriers of outer faces (K,3), or edges (K,2), against inner nodes (K,), which lie behind them at rest.

    ValueError names the first node that is not behind its face, or energy, J, that is not positive.
    """
    position = finite_array(position, (len(position), 3), "position (m)")
    faces = np.asarray(faces)
    width = faces.shape[1] if faces.ndim == 2 and faces.shape[1] in (2, 3) else 3
    faces = node_array(faces, width, len(position), "faces of the barriers")
    inner = node_array(np.reshape(inner, (-1, 1)), 1, len(position), "inner nodes")
    if len(inner) != len(faces):
        raise ValueError(f"there are {len(inner)} inner nodes for {len(faces)} faces; give one each")
    filler = [] if width == 3 else [np.full((len(faces), 1), -1)]
    nodes = np.concatenate([faces, *filler, inner], axis=1).astype(np.int64)
    p, q, i = (position[nodes[:, k]] for k in (0, 1, 3))
    if width == 3:
        volume = np.einsum("kc,kc->k", p - i, np.cross(q - i, position[nodes[:, 2]] - i)) / 6
    else:
        volume = 0.5 * ((p - i)[:, 0] * (q - i)[:, 1] - (p - i)[:, 1] * (q - i)[:, 0])
    for k in np.flatnonzero(~(volume > 0)):
        raise ValueError(
            f"barrier {k}: node {nodes[k, 3]} is not behind the face {faces[k].tolist()}; give outer faces"
        )
    energy = positive_array(np.broadcast_to(energy, (len(nodes),)), (len(nodes),), "energy of the barriers (J)")
    return Barriers(nodes, np.ascontiguousarray(volume), energy)


def _refuse(nodes, bad, what) -> None:
    if bad.any():
        e = int(np.argmax(bad))
        raise ValueError(f"tetrahedron {e}, of the nodes {nodes[e].tolist()}, {what}")


def _check_closed(surface, c) -> None:
    """Raise ValueError unless every edge of faces (K,4) has its reverse, or every node of a ring (K,2) two edges."""
    if not len(surface):
        raise ValueError(f"compartment {c} has no faces; give a closed surface")
    if surface.shape[1] == 2:
        starts, ends = (np.bincount(column, minlength=surface.max() + 1) for column in surface.T)
        for node in np.flatnonzero(starts != ends):
            raise ValueError(f"compartment {c} is open at node {node}; give a closed ring")
        return
    balance: Counter[tuple[int, int]] = Counter()
    for face in surface.tolist():
        for a, b in zip(face, face[1:] + face[:1], strict=True):
            balance[min(a, b), max(a, b)] += (a < b) - (a > b)
    for edge, count in balance.items():
        if count:
            raise ValueError(f"compartment {c} is open at the edge from node {edge[0]} to {edge[1]}; close its surface")
