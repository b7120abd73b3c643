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
    front: np.ndarray
    """Nodes whose mean marks the front of the trunk's axis."""
    rear: np.ndarray
    """Nodes whose mean marks the rear of the trunk's axis."""
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
