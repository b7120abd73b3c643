"""A lamprey's midline imposed on a body of its proportions: the speed at which it swims, and its sweep.

The tracks of a swimming sea lamprey are `lampreydata` of github.com/tytell/fishmechr (E. D. Tytell, CC BY 4.0): 78
frames, 0.02 s apart. From them, by least squares: the length, the speed along the straight line of best fit, and the
first harmonic of the midline's angle at each place beside a polynomial of degree 4 in time.
The half width is the repository's `ammowidth`, by its size half the width; the depth is taken as the width.
"""

import numpy as np
from scipy.interpolate import CubicSpline

from benchmarks.common.tables import publish
from benchmarks.validation.waters import by_angle, draw_swims, swims
from fish_env import make_fish

LENGTH, FREQUENCY, SPEED, VISCOSITY = 0.1538, 3.82, 1.76, 1.0e-6  # m, Hz, body lengths/s, m2/s
COSINE = (0.142, 0.095, 0.099, 0.154, 0.23, 0.238, 0.094, -0.182, -0.397, -0.527, -0.509, -0.345, -0.091, 0.213, 0.5,
          0.668, 0.686, 0.579, 0.361, 0.101, -0.164)  # fmt: skip
SINE = (-0.052, -0.06, -0.048, -0.033, 0.019, 0.187, 0.36, 0.383, 0.236, 0.03, -0.225, -0.448, -0.581, -0.585, -0.46,
        -0.161, 0.109, 0.388, 0.608, 0.742, 0.822)  # fmt: skip
"""Of the angle, rad, at 21 evenly spaced places from the nose to the tail."""
SWEEP = (0.033, 0.023, 0.019, 0.017, 0.026, 0.042, 0.061, 0.079, 0.095, 0.108, 0.12, 0.13, 0.134, 0.135, 0.133, 0.128,
         0.124, 0.125, 0.13, 0.14, 0.159)  # fmt: skip
"""Peak to peak at the same places, body lengths: the first harmonic across the straight line of best fit."""
WIDTHS = (0.0, 0.0169, 0.0178, 0.0182, 0.0183, 0.0185, 0.0186, 0.0181, 0.0175, 0.0169, 0.0159, 0.0149, 0.0138, 0.0127,
          0.0112, 0.0098, 0.0082, 0.006, 0.0037, 0.0)  # fmt: skip
"""Half width at 20 evenly spaced places, body lengths."""


def outline() -> np.ndarray:
    """Place, half width and half depth (20,3): as deep as wide, but for a tail fin as deep as the trunk behind 0.8."""
    place, widths = np.linspace(0.0, 1.0, 20), np.array(WIDTHS)
    return np.stack([place, widths, np.where(place > 0.5, np.maximum(widths, 0.012), widths)], axis=1)


def angle(places, time):
    """Angle of the midline (S,) rad."""
    at = np.linspace(0.0, 1.0, len(COSINE))
    phase = 2.0 * np.pi * FREQUENCY * time
    return CubicSpline(at, COSINE)(places) * np.cos(phase) + CubicSpline(at, SINE)(places) * np.sin(phase)


def measure() -> list[dict]:
    """A row for each level of water."""
    fish = make_fish("tetrahedral", level=4, length=LENGTH, outline=outline())
    return swims(fish, VISCOSITY, by_angle(angle), 1.0 / FREQUENCY, "s", SPEED)


if __name__ == "__main__":
    publish(__doc__, {"validation/lamprey.csv": measure}, lambda: draw_swims("lamprey", "s", SWEEP))
