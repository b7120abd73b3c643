"""A computed eel's midline imposed on its body: the speed at which it swims.

Shape, midline and viscosity are those of Kern & Koumoutsakos (2006, J. Exp. Biol. 209:4841), who solve the
Navier-Stokes equations: length and period are 1, the viscosity is 1.4e-4. Their speed, 0.40, is quoted from memory.
Their abstract says that eels swim 0.26 to 0.5 body lengths a beat.
"""

import numpy as np

from benchmarks.common.tables import publish
from benchmarks.validation.waters import draw_swims, swims
from fish_env import make_fish

SPEED, VISCOSITY = 0.40, 1.4e-4  # body lengths a beat; squared body lengths a beat
LENGTH, PERIOD = 0.3, 1.0  # m, s: any will do, because the viscosity follows them
PLACES = np.array(
    [0.0, 0.01, 0.02, 0.04, 0.07, 0.1, 0.15, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.85, 0.9, 0.95, 0.975, 1]
)


def outline() -> np.ndarray:
    """Place, half width and half depth of the sections, which are ellipses, (19,3)."""
    s, head, tail, fin = PLACES, 0.04, 0.01, 0.95
    width = np.select(
        [s < head, s < fin],
        [np.sqrt(np.maximum(2.0 * head * s - s**2, 0.0)), head - (head - tail) * ((s - head) / (fin - head)) ** 2],
        tail * (1.0 - s) / (1.0 - fin),
    )
    return np.stack([s, width, 0.08 * np.sqrt(1.0 - (s / 0.51 - 1.0) ** 2)], axis=1)


def midline(places, time):
    """Offset of the midline (S,), body lengths."""
    return 4.0 / 33.0 * (places + 0.03125) * np.sin(2.0 * np.pi * (places - time / PERIOD))


def measure() -> list[dict]:
    """A row for each level of water."""
    fish = make_fish("tetrahedral", level=4, length=LENGTH, outline=outline())
    return swims(fish, VISCOSITY * LENGTH**2 / PERIOD, midline, PERIOD, "beat", SPEED)


if __name__ == "__main__":
    publish(__doc__, {"validation/eel.csv": measure}, lambda: draw_swims("eel", "beat"))
