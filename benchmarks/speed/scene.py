"""The scene that every peer computes: masses and springs of the default fish in vacuum, deformed and moving.

Each peer moves it by symplectic Euler (velocity first, then position with the new velocity) at one step, so that all
have the same numbers to compute and may be compared, first in where the masses arrive and then in how fast.
"""

from typing import NamedTuple, Protocol

import numpy as np

import fish_env

STEP = 0.0003  # s: 0.4 of the largest stable step for small motion of this body at rest
CHECKED = 1000  # steps after which positions are compared
TOLERANCE = {"float64": 1e-12, "float32": 1e-6}  # of the body length: rounding adds up to less
STRETCH, SHAKE, TURN = 0.01, 0.1, 3.0  # of the start: BL, BL/s and rad/s


class Scene(NamedTuple):
    """B fish of N masses and E springs, and how they start."""

    position: np.ndarray  # (B,N,3) m, about the origin
    velocity: np.ndarray  # (B,N,3) m/s
    mass: np.ndarray  # (N,) kg
    nodes: np.ndarray  # (E,2)
    stiffness: np.ndarray  # (E,) N/m
    damping: np.ndarray  # (E,) N s/m
    rest_length: np.ndarray  # (E,) m
    length: float  # body length, m


class Peer(Protocol):
    """What moves a scene; `advance` takes a multiple of `chunk` steps of STEP."""

    name: str
    package: str  # and its version
    precision: str
    chunk: int
    scene: Scene

    def start(self) -> None:
        """Put all fish to the start of the scene."""

    def advance(self, steps: int) -> None:
        """Take so many steps."""

    def position(self) -> np.ndarray:
        """Where the masses are, (B,N,3) m."""


def make_scene(num_fish: int) -> Scene:
    """The default fish's springs, every fish started differently; fish 0 is the same in a batch of any size."""
    fish = fish_env.make_fish("mass_spring")
    body, springs, length = fish.body, fish.body.springs, fish.length
    noise = np.random.default_rng(0).standard_normal((num_fish, 2, body.mass.size, 3))
    position = body.position - body.position.mean(axis=0) + STRETCH * length * noise[:, 0]
    velocity = SHAKE * length * noise[:, 1] + np.cross([0.0, 0.0, TURN], position)
    return Scene(
        position, velocity, body.mass, springs.nodes, springs.stiffness, springs.damping, springs.rest_length, length
    )


class Ours:
    """This package's `Tank` in vacuum."""

    name = "fish_env"
    package = f"fish_env {fish_env.__version__}"
    chunk = 1

    def __init__(self, scene: Scene, precision: str = "float64"):
        self.precision, self.scene = precision, scene
        options = {} if precision == "float64" else {"dtype": precision}
        self.tank = fish_env.Tank(
            fish_env.make_fish("mass_spring"), len(scene.position), "symplectic_euler", STEP, threads=1, **options
        )

    def start(self) -> None:
        self.tank.reset()
        self.tank.position[:] = self.scene.position
        self.tank.velocity[:] = self.scene.velocity

    def advance(self, steps: int) -> None:
        self.tank.advance(steps)

    def position(self) -> np.ndarray:
        return self.tank.position


def ours(num_fish: int) -> list[Peer]:
    """Ours in double precision, and for a batch also in single."""
    scene = make_scene(num_fish)
    return [Ours(scene, precision) for precision in ("float64", "float32")[: 1 if num_fish == 1 else 2]]


def disagreement(peer: Peer, steps: int = CHECKED) -> float:
    """Largest distance along an axis between where a peer and ours (float64) have a mass after these steps, in BL.

    Raises:
        ValueError: if it is above the TOLERANCE of the peer's precision: it computes something else than ours.
    """
    own = Ours(peer.scene)
    for each in (own, peer):
        each.start()
        each.advance(steps)
    value = float(np.abs(peer.position() - own.position()).max() / peer.scene.length)
    allowed = TOLERANCE[peer.precision]
    if not value <= allowed:
        raise ValueError(f"{peer.name} is {value:.1e} BL from fish_env after {steps} steps, more than {allowed:.0e}")
    return value
