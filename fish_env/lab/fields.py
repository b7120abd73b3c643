"""Strain, activation and forces of an object as they are drawn: colours, shades and arrows. numpy only.

Colours are ones that colour-blind people can tell apart: Okabe & Ito 2008 for categories, blue to orange for strain.
"""

import numpy as np

from fish_env.bodies.room import GRAVITY
from fish_env.physics.tank import Tank

BLACK, GREY = (0, 0, 0), (120, 126, 132)
ORANGE, SKY, GREEN, BLUE, VERMILLION = (230, 159, 0), (86, 180, 233), (0, 158, 115), (0, 114, 178), (213, 94, 0)
SPECIMENS = (BLUE, VERMILLION, GREEN)  # of the objects side by side
DIVERGING = np.array([(0, 90, 160), (86, 160, 215), (225, 225, 225), (236, 150, 60), (200, 80, 0)], dtype=float)
"""From blue, shortened, over grey, at rest, to orange, stretched."""
MUSCLE = np.array([(205, 205, 205), (230, 159, 0), (200, 60, 0)], dtype=float)
"""From a relaxed to a fully contracted muscle."""

STRAIN = 0.3  # strain at the ends of the colour scale
SHADES = 11  # of tetrahedra, odd: the middle one is that of rest
ARROWS = 150  # forces that are drawn: the largest
USUAL, LONGEST = 0.2, 0.35  # lengths of the object: the arrow of the quantile, and of the largest force
QUANTILE = 0.9
LEAST = 0.02  # weights of a node on Earth: forces are not blown up beyond the scale on which this is the quantile


def colours_along(scale: np.ndarray, part) -> np.ndarray:
    """The colours (K,3) uint8 at parts (K,) in [0, 1] of a scale (C,3); what lies outside takes the end's colour."""
    place = np.clip(np.nan_to_num(np.asarray(part, dtype=float)), 0.0, 1.0) * (len(scale) - 1)
    low = np.minimum(place.astype(int), len(scale) - 2)
    rest = (place - low)[:, None]
    return np.rint(scale[low] * (1.0 - rest) + scale[low + 1] * rest).astype(np.uint8)


def part_of(strain: np.ndarray) -> np.ndarray:
    """Places of strains on the scale from shortened, 0, over rest, 0.5, to stretched, 1.

    The distance from the middle is proportional to the square root of the strain. So a strain of one percent is visible
    next to one of thirty, at the end of the scale.
    """
    strain = np.clip(np.nan_to_num(strain), -STRAIN, STRAIN)
    return 0.5 + 0.5 * np.sign(strain) * np.sqrt(np.abs(strain) / STRAIN)


def shade_of(strain: np.ndarray) -> np.ndarray:
    """Indices of the SHADES of strains."""
    return np.rint(part_of(strain) * (SHADES - 1)).astype(int)


def shades() -> np.ndarray:
    """The colours of the SHADES, (SHADES,3)."""
    return colours_along(DIVERGING, np.linspace(0.0, 1.0, SHADES))


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


def activation(tank: Tank) -> np.ndarray:
    """Contraction (B,K) of the fibres of a tank's fish, in their order: 0 natural, 1 full."""
    fibres, _, natural, span = tank._fibres
    return (natural - tank.rest_length[:, fibres]) / span
