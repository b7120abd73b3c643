"""Level of detail of a uniform sphere by its distance to the viewer (Song 2009, ch. 3.5.3).

A sphere that moves can be made again at another level, which goes on in the same motion (`carry_over`).
"""

from dataclasses import dataclass

import numpy as np

from fish_env.checks import finite_array, positive_array
from fish_env.soft.objects import FINEST, Layered, whole
from fish_env.soft.skins import octasphere

NEIGHBOURS = 3  # nodes of the old level that a node of the new one lies between


def projected_size(size: float, distance: float, focal: float) -> float:
    """Pixels that a length `size`, m, covers at a `distance`, m, across the view of a pinhole camera.

    `focal` is the camera's focal length in pixels: half the picture's width over the tangent of half its angle.

    Raises:
        ValueError: for a number that is not finite and positive.
    """
    for name, value in (("size (m)", size), ("distance (m)", distance), ("focal (pixels)", focal)):
        positive_array(value, (), name)
    return float(size * focal / distance)


def facet_gap(level: int) -> float:
    """Largest gap between an edge of a uniform sphere's mesh and the sphere, over its radius; level 0 to FINEST."""
    skin = octasphere(whole(level, "level", 0, FINEST))
    return float(1.0 - np.linalg.norm(skin.place[skin.edges].mean(axis=1), axis=1).min())


@dataclass
class LevelOfDetail:
    """Chooses the level of a uniform sphere, so that its facets are not seen; keeps its choice near a limit.

    A level is fine enough when the gap between its edges and the sphere is at most `pixels`. It becomes coarser only
    when the coarser level's gap is below `pixels` by the part `margin`: else it would flicker at a limit.
    """

    radius: float = 0.1  # of the sphere, m
    pixels: float = 1.0  # largest gap allowed
    margin: float = 0.2  # part, from 0 to less than 1
    level: int | None = None  # the last choice; None before the first

    def __post_init__(self):
        positive_array(self.radius, (), "radius (m)")
        positive_array(self.pixels, (), "pixels")
        positive_array(self.margin, (), "margin", zero=True)
        if not self.margin < 1:
            raise ValueError(f"margin is {self.margin}; give a number from 0 to less than 1")
        if self.level is not None:
            whole(self.level, "level", 0, FINEST)
        self.gaps = [facet_gap(level) for level in range(FINEST + 1)]

    def choose(self, distance: float, focal: float) -> int:
        """Return the level, 0 to FINEST, at a `distance`, m, from the viewer, `focal` as in `projected_size`."""
        seen = [projected_size(gap * self.radius, distance, focal) for gap in self.gaps]
        enough = next((level for level, gap in enumerate(seen) if gap <= self.pixels), FINEST)
        if self.level is not None and enough < self.level:
            spared = (1.0 - self.margin) * self.pixels
            enough = next(
                level for level in range(enough, self.level + 1) if seen[level] <= spared or level == self.level
            )
        self.level = enough
        return enough


def carry_over(old: Layered, new: Layered, values) -> np.ndarray:
    """Interpolate positions (N,3) m or velocities (N,3) m/s of nodes to the nodes (M,3) of another level.

    Each layer's values are an affine map of its places at rest, fitted by least squares, and a remainder, which is
    interpolated between the nearest nodes at rest. So affine motion, rigid motion included, is carried over exactly,
    and a node that both levels have keeps its value. ValueError for other values, or objects of other layers.
    """
    values = finite_array(values, old.body.position.shape, "values")
    found = np.empty_like(new.body.position)
    for name in ("outer", "inner"):
        before, after = getattr(old, name), getattr(new, name)
        if bool(len(before)) != bool(len(after)):
            raise ValueError(f"one of the objects has no {name} layer; give two with the same layers")
        if not len(before):
            continue
        place, wanted = old.body.position[before], new.body.position[after]
        affine = np.linalg.lstsq(_with_one(place), values[before], rcond=None)[0]
        rest = values[before] - _with_one(place) @ affine
        apart = np.linalg.norm(wanted[:, None] - place, axis=2)
        near = np.argsort(apart, axis=1)[:, :NEIGHBOURS]
        weight = 1.0 / np.maximum(np.take_along_axis(apart, near, axis=1), 1e-9 * old.length) ** 2
        weight /= weight.sum(axis=1, keepdims=True)
        found[after] = _with_one(wanted) @ affine + np.einsum("mk,mkd->md", weight, rest[near])
    return found


def _with_one(place: np.ndarray) -> np.ndarray:
    """Places (N,3) with a column of ones, (N,4)."""
    return np.column_stack([place, np.ones(len(place))])
