"""Sections of a fish, along which the inertia of the water acts, and the check that a surface faces outward."""

import numpy as np

from fish_env.checks import finite_array, is_whole, node_array, positive_array, representable
from fish_env.physics.records import Sections

CURVED = 1.0 / 6.0  # part of the parabola in the slope at the tail, the rest being the last section's
FINE = 4000  # intervals of the integrals along the body


@representable("a section")
def make_sections(position, mass, groups, edges, outline, flat=False, fin=1) -> Sections:
    """Sections along which the inertia of the water acts (docs/physics.md, eq. 14-20).

    Args:
        position: (N,3) m, the head forward of the tail.
        mass: (N,) kg.
        groups: a list of the nodes of each section, from the head on; at least four of them, with a node each.
        edges: nodes along the upper and the lower edge of the trunk, (2,U), which show where up is.
        outline: stations of the body: distance from the nose (S,) m, half width (S,) m and half depth (S,) m, linear
            between them.
        flat: True for a flat body, whose edges are one and whose sections are upright.
        fin: number of the last sections that belong to a tail fin, which hardly has a mass.

    Raises:
        ValueError: for fewer than four sections, a section without nodes, or sections that are not in order.
    """
    position, count = finite_array(position, (len(position), 3), "position (m)"), len(groups)
    mass = positive_array(mass, (len(position),), "mass (kg)")
    if count < 4:
        raise ValueError(f"there are {count} sections; give at least four")
    if not (is_whole(fin) and 0 <= fin < count):
        raise ValueError(f"fin is {fin!r}; give a whole number of sections, from 0 to {count - 1}")
    groups = [node_array(np.reshape(group, (-1, 1)), 1, len(mass), "sections")[:, 0] for group in groups]
    for k, group in enumerate(groups):
        if not group.size or np.unique(group).size != group.size:
            raise ValueError(f"section {k} has the nodes {group.tolist()}; give at least one, and each once")
    upper, lower = node_array(np.transpose(edges), 2, len(mass), "edges of the sections").T.copy()
    share = [mass[group] / mass[group].sum() for group in groups]
    place = np.array([-part @ position[group, 0] for part, group in zip(share, groups, strict=True)])
    if not (np.diff(place) > 0).all():
        raise ValueError(f"the sections lie at x = {-place} m; give them from the head to the tail")
    at, width, depth = (finite_array(row, np.shape(outline[0]), "outline (m)") for row in outline)
    fine = np.linspace(at[0], at[-1], FINE + 1)
    part = np.full(fine.size, (at[-1] - at[0]) / FINE)
    part[[0, -1]] *= 0.5
    tents = np.array([np.interp(fine, place, row) for row in np.eye(count)])
    lateral, vertical = (tents @ (np.pi * np.interp(fine, at, row) ** 2 * part) for row in (depth, width))
    between = np.concatenate([at[:1], 0.5 * (place[1:] + place[:-1]), at[-1:]])
    narrowing = np.maximum(0.0, -np.diff(np.pi * np.interp(between, at, width) ** 2))
    height = float(at[-1]) if flat else 0.0
    rise = float((position[upper] - position[lower])[:, 2].sum()) + height
    if not rise > 0:
        raise ValueError("the upper edge of the sections is not above the lower one; exchange them")
    return Sections(
        np.concatenate(groups), np.cumsum([0, *map(len, groups)]), np.concatenate(share), upper, lower,
        height, slopes(place), lateral, vertical, float(np.pi * depth[-1] ** 2), narrowing, fin,
        float(mass.sum() * (at[-1] - at[0]) / rise),
    )  # fmt: skip


def slopes(place: np.ndarray) -> np.ndarray:
    """Weights (K,3) of the three nearest of places (K,) m in the slope at each, 1/m."""
    # Inside, they are those of a parabola. At the tail, the last section alone would delay a swimming wave and a
    # parabola would advance it: CURVED of one with the rest of the other gives waves of 0.8 to 1.2 body lengths the
    # thrust that they have, and cannot become singular where the tail folds.
    found = np.zeros((place.size, 3))
    for k in range(place.size):
        begin = min(max(k - 1, 0), place.size - 3)
        a, b, c = place[begin : begin + 3] - place[k]
        found[k] = [-(b + c) / ((a - b) * (a - c)), -(a + c) / ((b - a) * (b - c)), -(a + b) / ((c - a) * (c - b))]
    first, last = place[1] - place[0], place[-1] - place[-2]
    found[0] = [-1.0 / first, 1.0 / first, 0.0]
    found[-1] = CURVED * found[-1] + (1.0 - CURVED) * np.array([0.0, -1.0 / last, 1.0 / last])
    return found


def check_outward(position, corners) -> None:
    """Raise ValueError if the faces (F,4) close a surface that is inside out: the water would pull instead of push."""
    edges = {(int(a), int(b)) for face in corners for a, b in zip(face, np.roll(face, -1), strict=True) if a != b}
    if not edges or any((b, a) not in edges for a, b in edges):
        return  # an open surface has no inside
    p, q, r, s = (position[corners] - position[corners[0, 0]]).swapaxes(0, 1)
    if np.einsum("fk,fk->", p + q + r + s, np.cross(r - p, s - q)) <= 0.0:  # (76)
        raise ValueError("the faces enclose a negative volume; give their nodes counter-clockwise seen from outside")
