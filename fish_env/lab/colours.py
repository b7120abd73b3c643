"""Colours that colour-blind people can tell apart: Okabe & Ito 2008 for categories, blue to orange for strain."""

import numpy as np

BLACK, ORANGE, SKY, GREEN, YELLOW, BLUE, VERMILLION, PURPLE = (
    (0, 0, 0), (230, 159, 0), (86, 180, 233), (0, 158, 115), (240, 228, 66), (0, 114, 178), (213, 94, 0),
    (204, 121, 167),
)  # fmt: skip
SPECIMENS = (BLUE, VERMILLION, GREEN)
"""Colours of the objects side by side."""
GREY = (120, 126, 132)

DIVERGING = np.array([(0, 90, 160), (86, 160, 215), (225, 225, 225), (236, 150, 60), (200, 80, 0)], dtype=float)
"""From blue, shortened, over grey, at rest, to orange, stretched."""
MUSCLE = np.array([(205, 205, 205), (230, 159, 0), (200, 60, 0)], dtype=float)
"""From a relaxed to a fully contracted muscle."""


def along(scale: np.ndarray, part) -> np.ndarray:
    """The colours (K,3) uint8 at parts (K,) in [0, 1] of a scale (C,3); what lies outside takes the end's colour."""
    place = np.clip(np.nan_to_num(np.asarray(part, dtype=float)), 0.0, 1.0) * (len(scale) - 1)
    low = np.minimum(place.astype(int), len(scale) - 2)
    rest = (place - low)[:, None]
    return np.rint(scale[low] * (1.0 - rest) + scale[low + 1] * rest).astype(np.uint8)


def hexadecimal(colour) -> str:
    """A colour as a page writes it, `#0072b2`."""
    return "#" + "".join(f"{int(part):02x}" for part in colour)
