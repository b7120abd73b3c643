"""The record a body builder returns: a `Body` and what an animal adds to it."""

from dataclasses import dataclass

import numpy as np

from fish_env.body import Body, World


@dataclass(frozen=True, eq=False)
class Fish:
    """A body with muscles, a head and a tail. The x axis points forward, y to the left, z up."""

    name: str
    body: Body
    length: float
    """Nose to tail tip, m."""
    muscles: np.ndarray
    """(M,) which springs are muscles."""
    sides: np.ndarray
    """(M,) +1 for a muscle of the left side, -1 for one of the right."""
    segments: np.ndarray
    """(M,) muscle segment, 0 the foremost."""
    contracted: np.ndarray
    """(M,) rest length at full contraction, as a fraction of the natural length."""
    contraction_time: float
    """Shortest time from natural length to full contraction, s."""
    time_step: float
    """Step of its own integrator, s."""
    control_interval: float
    """Default time between two decisions, s."""
    water: World
    """The water it is made for; an environment that is not told otherwise fills its tank with it."""
    nose: int
    tail: np.ndarray
    """(2,) upper and lower tip of the caudal fin."""
    left: np.ndarray
    """Nodes of the trunk's left side; `right` are their mirror images, in the same order."""
    right: np.ndarray
    mirror: np.ndarray
    """(N,) the node that each node becomes when left and right are exchanged."""
    integrator: str = "leapfrog_chebyshev"
    """The method it is moved with unless told otherwise: a key of INTEGRATORS."""

    def __post_init__(self):
        for name in ("length", "contraction_time", "time_step", "control_interval"):
            value = getattr(self, name)
            if not (np.isfinite(value) and value > 0):
                raise ValueError(f"{name} is {value!r}; give a positive, finite number")
        if np.any(self.contracted <= 0) or np.any(self.contracted >= 1):
            raise ValueError(f"contracted is {self.contracted}; give fractions between 0 and 1")

    @property
    def line(self) -> np.ndarray:
        """(N,) weights whose sum with the positions points forward: the slope of the mass-weighted line of best fit.

        That line sways half as far as the trunk with every beat, so it says better where the fish is heading.
        """
        along = self.body.position[:, 0] - self.body.mass @ self.body.position[:, 0] / self.body.mass.sum()
        return self.body.mass * along / (self.body.mass @ along**2)

    @property
    def num_muscles(self) -> int:
        return len(self.muscles)

    def grouping(self, groups: str) -> np.ndarray:
        """Which action drives which muscle, (M,): "muscles" one each, "pairs" one for each segment's left and right.

        With "pairs" the upper and lower muscle of a side contract together, so that a fish that starts level stays
        level: six actions for the three segments, left and right in turn from the front.
        """
        if groups == "muscles":
            return np.arange(self.num_muscles)
        if groups == "pairs":
            return 2 * self.segments + (self.sides < 0)
        raise ValueError(f"unknown muscle grouping {groups!r}; choose 'muscles' (one action each) or 'pairs'")
