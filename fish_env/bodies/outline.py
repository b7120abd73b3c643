"""Outlines: half widths and half depths along a fish, from which every body takes its shape and its masses.

Between two stations both are straight. Named outlines are in `outlines.json`, where every number has its source.
"""

import json
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from fish_env.checks import finite_array
from fish_env.kernels.data import data

FEWEST = 4  # stations
PEDUNCLE = (0.72, 0.95)  # places between which the narrowest station before the tail fin is looked for


@dataclass(frozen=True, eq=False)
class Outline:
    """Half widths and half depths of a body at stations along it, in body lengths or, of `outline_of`, in metres."""

    place: np.ndarray
    """(S,) from 0, the nose, backward to the tail tips, increasing."""
    widths: np.ndarray
    """(S,) half the widths (along y)."""
    depths: np.ndarray
    """(S,) half the depths (along z)."""
    elliptic: bool
    """True if the cross-sections are ellipses, False if they are rectangles."""

    def half_width(self, s) -> np.ndarray:
        """Half the width at places s, of any shape, in the units of the outline."""
        return np.interp(s, self.place, self.widths)

    def half_depth(self, s) -> np.ndarray:
        """Half the depth at places s."""
        return np.interp(s, self.place, self.depths)

    def area(self, s) -> np.ndarray:
        """Area of the cross-sections at places s."""
        return self.fullness * self.half_width(s) * self.half_depth(s)  # (72)

    @property
    def stations(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Places, half widths and half depths, (S,) each."""
        return self.place, self.widths, self.depths

    @property
    def fullness(self) -> float:
        """Area of a cross-section over the product of its half axes."""
        return np.pi if self.elliptic else 4.0

    @property
    def flatness(self) -> float:
        """Square of a half axis over the mean square of the distances from its middle."""
        return 4.0 if self.elliptic else 3.0

    @property
    def side(self) -> float:
        """Half a side, over the half axis along it, of the rectangle of the same area and the same proportions."""
        return float(np.sqrt(self.fullness / 4.0))


def read_outline(given) -> Outline:
    """Make an outline, in body lengths, of what a user gave: a name, or a table (S,3).

    The columns of a table are place, half width and half depth, in body lengths. Its cross-sections are ellipses. An
    `Outline` is returned as it is.

    Raises:
        ValueError: for an unknown name, fewer than four stations, numbers that are not finite or negative, places that
            do not increase from 0 to 1, a station between nose and tail that has no width or no depth, or a tail fin
            without depth.
    """
    if isinstance(given, Outline):
        return given
    if isinstance(given, str):
        known = json.loads(data("fish_env.bodies", "outlines.json").read_text("utf-8"))
        if given not in known:
            names = ", ".join(map(repr, known))
            raise ValueError(f"unknown outline {given!r}; choose {names} or give a table of stations, shape (S, 3)")
        given = known[given]["stations"]
    count = len(given) if isinstance(given, Sequence) or np.ndim(given) else 0
    if 0 < count < FEWEST:
        raise ValueError(f"outline has {count} stations; give {FEWEST} or more, from the nose to the tail")
    place, widths, depths = finite_array(given, (max(count, FEWEST), 3), "outline").T.copy()
    if place[0] != 0.0 or place[-1] != 1.0 or np.any(np.diff(place) <= 0.0):
        raise ValueError(f"outline has the places {place.tolist()}; give increasing ones, from 0 (nose) to 1 (tail)")
    for name, column in (("half width", widths), ("half depth", depths)):
        for i in np.flatnonzero(column < 0.0):
            raise ValueError(f"outline has the {name} {column[i]} at place {place[i]}; its sides must not cross")
        for i in np.flatnonzero(column[1:-1] == 0.0) + 1:
            raise ValueError(f"outline has no {name} at place {place[i]}; there must be a volume from nose to tail")
    if depths[-1] == 0.0:
        raise ValueError("outline has no half depth at place 1; give that of the tail fin's tips")
    return Outline(place, widths, depths, elliptic=True)


def layers_for(outline: Outline, standard) -> tuple[float, ...]:
    """Positions of the five layers of nodes of a fish with this outline, body lengths behind the nose."""
    # They are the standard ones, (5,), but the last stands at the narrowest station before the tail fin, so that bodies
    # have a peduncle; an outline that is not narrower there than on both sides keeps all five.
    first, last = PEDUNCLE
    inside = np.flatnonzero((outline.place > first) & (outline.place < last))
    if inside.size:
        narrowest = inside[np.argmin(outline.depths[inside])]
        if outline.depths[narrowest] < min(outline.half_depth(first), outline.depths[-1]):
            return (*standard[:4], float(outline.place[narrowest]))
    return tuple(standard)


def outline_of(p) -> Outline:
    """The outline, in m, of a fish with these `MassSpringParameters`: that given, else straight between its layers."""
    # Lateral added mass is pi times the density of water times the square of `half_depth`, a metre of body; vertical
    # added mass has `half_width` instead.
    if p.outline is not None:
        return Outline(*(p.length * part for part in p.outline.stations), elliptic=p.outline.elliptic)
    place = np.array([0.0, *p.layer_position, 1.0])
    widths, depths = np.array([0.0, *p.half_width, 0.0]), np.array([0.0, *p.half_depth, p.tail_half_span])
    return Outline(p.length * place, p.length * widths, p.length * depths, elliptic=False)


def layers_of(p) -> np.ndarray:
    """x, half width and half depth, (3,7) m, of the layers of nodes of a fish with these parameters, from the nose."""
    place, width, depth = np.array([
        [0.0, *p.layer_position, 1.0],
        [0.0, *p.half_width, 0.0],
        [0.0, *p.half_depth, p.tail_half_span],
    ])  # fmt: skip
    return p.length * np.array([0.0 - place, width, depth])


def stations_of(p) -> tuple[np.ndarray, np.ndarray]:
    """Stations of the outline and of the layers together, (R,) m behind the nose; and where they are between layers."""
    # The second, (R,), counts layers: 0 is the nose, 6 the tail tips.
    layers = p.length * np.array([0.0, *p.layer_position, 1.0])
    place = np.union1d(outline_of(p).place, layers)
    section = np.searchsorted(layers[1:-1], place, side="right")
    return place, section + (place - layers[section]) / np.diff(layers)[section]


def sides_of(p) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Half sides, m, of the rectangles of which a mesh is made: where they are between layers, width and depth."""
    # They have the area and the proportions of the cross-sections, but nose and tail end in a point and an upright
    # edge. Along the tail fin, the sides tend to the half axes, so that its tips are those of the outline.
    whole = outline_of(p)
    place, layer = stations_of(p)
    side = whole.side + (1.0 - whole.side) * np.clip(layer - 5.0, 0.0, 1.0)
    width, depth = side * whole.half_width(place), side * whole.half_depth(place)
    width[[0, -1]] = depth[0] = 0.0
    return layer, width, depth
