"""Sizes: a fish of another length than 0.2 m has the same tissue, and slower or faster muscles.

Density, Young's modulus, contracted lengths and relaxation times are the same at every length L. So the stiffness of a
spring grows as L, while masses grow as L^3 and its natural frequencies fall as 1/L (docs/physics-more.md, eq. 73).
"""

import math
import warnings

REFERENCE_LENGTH = 0.2  # m; stiffness and times of the parameters are those of a fish of this length
MEANT = (0.05, 0.6)  # m: about the trout of Webb et al. (1984), 0.055 to 0.56 m
ALLOWED = (0.02, 1.0)  # m: shorter fish feel the viscosity of water; longer ones were not measured
SLOWNESS = 0.52  # exponent of the time of a muscle's cycle in the fish's length (Altringham & Johnston 1990)


def slowness(ratio: float) -> float:
    """Return by what the time that a contraction takes is longer in a fish that is longer by a ratio."""
    return ratio**SLOWNESS  # (74)


def step_parts(length: float) -> int:
    """Return in how many parts a step is cut for a fish of a length, m, since small ones vibrate faster."""
    return max(1, math.ceil(REFERENCE_LENGTH / length - 1e-9))


def check_length(length: float) -> None:
    """Warn of a length, m, at which the model is not meant to be used; ValueError for one outside `ALLOWED`."""
    (least, most), (low, high) = ALLOWED, MEANT
    if not least <= length <= most:
        raise ValueError(f"length is {length:g} m; give {least:g} to {most:g} m, best {low:g} to {high:g} m")
    if not low <= length <= high:
        warnings.warn(
            f"a fish of {length:g} m is outside the range in which the model is meant, {low:g} to {high:g} m: its "
            "water has no viscosity, and the speed of its muscles is extrapolated",
            stacklevel=5,
        )
