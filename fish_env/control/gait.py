"""The open-loop gait: it swims the fish by timing alone (Tu 1996, ch. 5), whatever the fish sees."""

import json
from dataclasses import dataclass

import numpy as np

from fish_env.bodies import Fish
from fish_env.bodies.fitted import check_level
from fish_env.kernels.data import data

GAIT_FILE = data("fish_env.control", "gait.json")
"""The gait of the default fish, written with its provenance by `benchmarks/calibration/gait_search.py`."""


@dataclass(frozen=True)
class Gait:
    """Sinusoidal contraction of each muscle segment, left and right in antiphase (docs/physics-more.md, eq. 44).

    A segment's amplitude and the common frequency correspond to Tu's r and s; the phase is the segment's lag.
    """

    frequency: float
    """Tail beats a second, Hz."""
    amplitude: tuple[float, float, float]
    """Contraction amplitude of the three segments, 0 to 1."""
    lag: tuple[float, float, float]
    """Phase lag of the three segments, rad."""

    def __post_init__(self):
        if not (np.isfinite(self.frequency) and self.frequency > 0):
            raise ValueError(f"frequency is {self.frequency!r}; give a positive number of hertz")
        if not (len(self.amplitude) == 3 and all(0 <= a <= 1 for a in self.amplitude)):
            raise ValueError(f"amplitude is {self.amplitude!r}; give three numbers from 0 to 1")
        if not (len(self.lag) == 3 and np.isfinite(self.lag).all()):
            raise ValueError(f"lag is {self.lag!r}; give three finite angles in radians")

    def contraction(self, fish: Fish, time) -> np.ndarray:
        """Contraction of each muscle at `time` (...,) s: (..., M) in [0, 1]."""
        amplitude, lag = np.array(self.amplitude)[fish.thirds], np.array(self.lag)[fish.thirds]
        angle = 2 * np.pi * self.frequency * np.asarray(time)[..., None] - lag
        return 0.5 * amplitude * (1.0 + fish.sides * np.sin(angle))  # (44)

    def action(self, fish: Fish, time) -> np.ndarray:
        """The same as an action, (..., M) in [-1, 1]; `time` (...,) s."""
        return 2.0 * self.contraction(fish, time) - 1.0


def best_gait(water: str | None = None) -> Gait:
    """The fastest open-loop gait of the default fish in drag or in reactive water, by default the default one.

    Raises:
        ValueError: for another level of water.
    """
    found = json.loads(GAIT_FILE.read_text("utf-8"))[check_level(water)]["gait"]
    return Gait(found["frequency"], tuple(found["amplitude"]), tuple(found["lag"]))
