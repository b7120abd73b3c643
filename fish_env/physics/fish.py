"""Records that a body builder returns: a `Body` with its default integrator and step, and the parts of a fish."""

from dataclasses import dataclass, field
from typing import Any, NamedTuple, TypeVar

import numpy as np

from fish_env.checks import real
from fish_env.physics.records import Body, World
from fish_env.physics.world import VACUUM

NOTHING = np.zeros(0, dtype=np.int64)
GIVEN_LATER: Any = None  # `__post_init__` sets the default, so that the attribute is never None


@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class ElasticObject:
    """A body, its surroundings and its integrator, without muscles. x points to the right or forward, z up."""

    name: str
    body: Body
    length: float
    """Size, m."""
    time_step: float
    """Step of its default integrator, s."""
    refine: float = np.inf
    """Relative change of a spring's length within a step above which the default integrator takes shorter steps."""
    control_interval: float
    """Default length of an environment step, or time between two pictures, s."""
    water: World = VACUUM
    """The world it is made for, the default of its environments."""
    integrator: str = "leapfrog_chebyshev"
    """Default integrator, a key of INTEGRATORS."""
    muscles: np.ndarray = field(default_factory=NOTHING.copy)
    """(M,) spring of each muscle; for a muscle of several fibres, the first."""
    contracted: np.ndarray = field(default_factory=lambda: np.zeros(0))
    """(M,) rest length at full contraction, as a fraction of the natural length."""
    contraction_time: float = 1.0
    """Shortest time from natural length to full contraction, s."""
    lengthening: float = 0.0
    """Growth of a muscle's rest length as its antagonist contracts, over its shrinkage as it contracts itself."""
    fibres: np.ndarray = GIVEN_LATER
    """(K,) all springs that the muscles drive; None: one spring per muscle."""
    drives: np.ndarray = GIVEN_LATER
    """(K,2) the muscles whose mean contraction drives each fibre; the same one twice for most."""

    def __post_init__(self):
        for name in ("length", "contraction_time", "time_step", "control_interval"):
            value = getattr(self, name)
            if not 0.0 < real(value) < np.inf:
                raise ValueError(f"{name} is {value!r}; give a positive, finite number")
        if not 0.0 <= real(self.lengthening) < 1.0:
            raise ValueError(f"lengthening is {self.lengthening!r}; give a number from 0 to below 1")
        if np.any(self.contracted <= 0) or np.any(self.contracted >= 1):
            raise ValueError(f"contracted is {self.contracted}; give fractions between 0 and 1")
        if self.fibres is None:
            object.__setattr__(self, "fibres", self.muscles)
            object.__setattr__(self, "drives", np.repeat(np.arange(self.num_muscles)[:, None], 2, axis=1))

    def __repr__(self) -> str:
        body = self.body
        return (
            f"<{type(self).__name__} {self.name!r}: {body.mass.size} nodes, {len(body.springs.nodes)} springs, "
            f"{self.num_muscles} muscles, length {self.length:g} m, mass {body.mass.sum():.3g} kg>"
        )

    @property
    def num_muscles(self) -> int:
        return len(self.muscles)

    @property
    def flat(self) -> bool:
        """True if the body moves in the xy plane only."""
        return not self.body.inverse_mass[:, 2].any()


Elastic = TypeVar("Elastic", bound=ElasticObject, covariant=True)
"""Type of the object in a tank: `Tank[Fish]` is a tank of fish."""


class Landmarks(NamedTuple):
    """L points that represent a fish, independent of its body type, in observations and in pictures."""

    node: np.ndarray  # (L,) node of each landmark
    height: np.ndarray  # (L,) m above that node: zero except for a flat fish
    mass: np.ndarray  # (L,) kg that each represents
    faces: np.ndarray  # (F,4) surface between them, counter-clockwise from outside; a triangle's third given twice
    muscles: np.ndarray  # (M,2) the two ends of each muscle
    mirror: np.ndarray  # (L,) the landmark each becomes when left and right are exchanged


@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class Fish(ElasticObject):
    """A body with muscles, a head and a tail. The x axis points forward, y to the left, z up."""

    sides: np.ndarray
    """(M,) +1 for a muscle of the left side, -1 for one of the right."""
    segments: np.ndarray
    """(M,) muscle segment, 0 the foremost."""
    nose: int
    tail: np.ndarray
    """(2,) upper and lower tip of the caudal fin."""
    left: np.ndarray
    """Nodes of the trunk's left side; `right` are their mirror images, in the same order."""
    right: np.ndarray
    mirror: np.ndarray
    """(N,) the node that each node becomes when left and right are exchanged."""
    landmarks: Landmarks = GIVEN_LATER
    """None: the nodes themselves, between the body's faces."""

    def __post_init__(self):
        super().__post_init__()
        if self.landmarks is None:
            body, nodes = self.body, np.arange(self.body.mass.size)
            ends = body.springs.nodes[self.muscles]
            marks = Landmarks(nodes, np.zeros(nodes.size), body.mass, body.faces.nodes, ends, np.asarray(self.mirror))
            object.__setattr__(self, "landmarks", marks)

    @property
    def line(self) -> np.ndarray:
        """(N,) weights whose sum with the positions points forward: the slope of the mass-weighted line of best fit.

        That line oscillates half as far as the trunk with every beat, so it is the better measure of the heading.
        """
        along = self.body.position[:, 0] - self.body.mass @ self.body.position[:, 0] / self.body.mass.sum()
        return self.body.mass * along / (self.body.mass @ along**2)

    def points(self, x) -> np.ndarray:
        """Positions of the landmarks, (...,L,3) m, of nodes at x (...,N,3)."""
        return x[..., self.landmarks.node, :] + self.landmarks.height[:, None] * (0.0, 0.0, 1.0)

    @property
    def thirds(self) -> np.ndarray:
        """(M,) 0, 1 or 2: the muscle segment; of more or fewer than three, thirds act as one."""
        return 3 * self.segments // (self.segments.max() + 1)

    @property
    def heights(self) -> np.ndarray:
        """Height of each muscle at rest, (M,) m."""
        return self.points(self.body.position)[self.landmarks.muscles, 2].mean(axis=1)

    @property
    def mirrored_muscles(self) -> np.ndarray:
        """(M,) the muscle that each muscle becomes when left and right are exchanged."""
        pairs = self.landmarks.muscles
        number = {frozenset(pair): m for m, pair in enumerate(pairs.tolist())}
        return np.array([number[frozenset(pair)] for pair in self.landmarks.mirror[pairs].tolist()])

    def grouping(self, groups: str) -> np.ndarray:
        """Action that drives each muscle, (M,): "muscles" one each, "pairs" one for each segment's left and right.

        With "pairs" the upper and lower muscle of a side contract together, so that a fish that starts level stays
        level: six actions for the three segments, left and right in turn from the front.
        """
        if groups == "muscles":
            return np.arange(self.num_muscles)
        if groups == "pairs":
            return 2 * self.segments + (self.sides < 0)
        raise ValueError(f"unknown muscle grouping {groups!r}; choose 'muscles' (one action each) or 'pairs'")
