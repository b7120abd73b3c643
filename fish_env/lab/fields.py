"""Strain, activation and forces of an object as they are drawn: colours, shades and arrows. numpy only."""

import numpy as np

from fish_env.bodies.room import GRAVITY
from fish_env.lab import colours
from fish_env.lab.specimen import Specimen

STRAIN = 0.3  # strain at the ends of the colour scale
SHADES = 11  # of tetrahedra, odd: the middle one is that of rest
ARROWS = 150  # forces that are drawn: the largest
USUAL, LONGEST = 0.2, 0.35  # lengths of the object: the arrow of the quantile, and of the largest force
QUANTILE = 0.9
LEAST = 0.02  # weights of a node on Earth: forces are not blown up beyond the scale on which this is the quantile


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
    return colours.along(colours.DIVERGING, np.linspace(0.0, 1.0, SHADES))


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


def activation(specimen: Specimen, fibres: np.ndarray) -> np.ndarray:
    """Contraction (K,) of the muscles' fibres (K,): 0 natural, 1 full."""
    tank = specimen.tank
    natural, span = np.zeros(tank.rest_length.shape[1]), np.ones(tank.rest_length.shape[1])
    natural[tank._fibres[0]], span[tank._fibres[0]] = tank._fibres[2], tank._fibres[3]
    return (natural - tank.rest_length[0])[fibres] / span[fibres]
