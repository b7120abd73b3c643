"""Level of detail of a uniform sphere by its distance to the viewer (Song 2009, ch. 3.5.3)."""

from dataclasses import dataclass

import numpy as np

from fish_env.bodies.objects import FINEST, whole
from fish_env.bodies.skins import octasphere
from fish_env.checks import positive_array


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
    """How far the middle of the longest edge of a uniform sphere is below the sphere, over its radius.

    Raises:
        ValueError: for a level outside 0 to FINEST.
    """
    skin = octasphere(whole(level, "level", 0, FINEST))
    return float(1.0 - np.linalg.norm(skin.place[skin.edges].mean(axis=1), axis=1).min())


@dataclass
class LevelOfDetail:
    """Chooses the level of a uniform sphere, so that its facets are not seen; keeps its choice near a limit.

    A level is fine enough when the gap between its edges and the sphere is at most `pixels`. It becomes coarser only
    when the coarser level's gap is below `pixels` by the part `margin`: else it would flicker at a limit.
    """

    radius: float = 0.1
    """Of the sphere, m."""
    pixels: float = 1.0
    """Largest gap allowed."""
    margin: float = 0.2
    """Part, from 0 to less than 1."""
    level: int | None = None
    """The last choice; None before the first."""

    def __post_init__(self):
        positive_array(self.radius, (), "radius (m)")
        positive_array(self.pixels, (), "pixels")
        positive_array(self.margin, (), "margin", zero=True)
        if not self.margin < 1:
            raise ValueError(f"margin is {self.margin}; give a number from 0 to less than 1")
        self.gaps = [facet_gap(level) for level in range(FINEST + 1)]

    def choose(self, distance: float, focal: float) -> int:
        """The level, 0 to FINEST, at a `distance`, m, from the viewer, `focal` as in `projected_size`.

        Raises:
            ValueError: for a number that is not finite and positive.
        """
        seen = [projected_size(gap * self.radius, distance, focal) for gap in self.gaps]
        enough = next((level for level, gap in enumerate(seen) if gap <= self.pixels), FINEST)
        if self.level is not None and enough < self.level:
            spared = (1.0 - self.margin) * self.pixels
            enough = next(
                level for level in range(enough, self.level + 1) if seen[level] <= spared or level == self.level
            )
        self.level = enough
        return enough
