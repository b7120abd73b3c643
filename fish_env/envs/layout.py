"""The layout of the observation: which numbers stand where, in what unit and range, by name. It is defined only here.

An observation is one float32 row of named parts, one after the other: positions and velocities of the landmarks, rest
lengths of the muscles, the vertical, and a vector for each `Direction` of the task.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import gymnasium as gym
import numpy as np

from fish_env.bodies import Fish
from fish_env.tasks import Direction

LAYOUT_VERSION = 1
"""Version of the layout. It is raised whenever a part moves, or changes its meaning, its unit or its frame."""

POSITION, VELOCITY, REST_LENGTH, VERTICAL, DIRECTIONS = range(5)
"""The places of the parts in `Layout.parts`; the task's directions are the last ones, from DIRECTIONS on."""

TYPICAL_POSITION = 0.1  # body lengths: how far a node moves from its place in the body while the fish swims
TYPICAL_VELOCITY = 1.0  # body lengths per second
TYPICAL_TILT = 0.3  # rad: it then counts as much as a node that has moved

AXES = ("forward", "left", "up")
REFLECTED = (1.0, -1.0, 1.0)  # signs of a vector under the left-right reflection
MUSCLE_UNIT, FRAME = "-1 natural, 1 contracted", "in the body frame"


@dataclass(frozen=True, eq=False)
class Part:
    """Consecutive numbers of the observation that form one quantity."""

    name: str
    start: int
    """Index of the first number."""
    shape: tuple[int, ...]
    """(L,3) for landmarks, (M,) for muscles, (3,) for a direction; vectors are forward, left and up."""
    unit: str
    limit: float
    """Bound of every number: the range is [-limit, limit]."""
    typical: float
    """A typical change of a number: what a learner divides it by."""
    labels: tuple[str, ...]
    """Description of each number."""
    rest: np.ndarray
    """(size,) the numbers of a fish in its rest shape, level and relaxed: what a learner subtracts."""
    one_per: str = ""
    """"landmark" or "muscle" if the first axis counts these, "" for a single vector."""

    @property
    def size(self) -> int:
        """Number of elements."""
        return self.rest.size

    @property
    def slice(self) -> slice:
        """Position in the observation: `obs[..., part.slice]`."""
        return slice(self.start, self.start + self.size)


class Layout:
    """The parts of an observation in their order: `layout["velocity"].slice`, `layout.read(obs, "velocity")`.

    Attributes:
        version: `LAYOUT_VERSION`, which policy files carry.
        parts: all parts, a tuple of `Part`.
        size: D, how many numbers an observation has.
    """

    version = LAYOUT_VERSION

    def __init__(self, fish: Fish, directions: Sequence[Direction]):
        """Lay out what a fish sees in a task with these directions.

        Raises:
            ValueError: if two parts would have the same name.
        """
        self._fish = fish
        self.parts: tuple[Part, ...] = tuple(make_parts(fish, directions))
        names = [part.name for part in self.parts]
        if len(set(names)) < len(names):
            raise ValueError(f"the parts of the observation are {names}; give every direction a name of its own")
        self._by_name = dict(zip(names, self.parts, strict=True))
        self.size = self.parts[-1].slice.stop

    def __getitem__(self, name: str) -> Part:
        try:
            return self._by_name[name]
        except KeyError:
            raise KeyError(f"the observation has no part {name!r}; its parts are {', '.join(self._by_name)}") from None

    def __iter__(self) -> Iterator[Part]:
        return iter(self.parts)

    def __contains__(self, name: object) -> bool:
        return name in self._by_name

    def read(self, obs: np.ndarray, name: str) -> np.ndarray:
        """The part `name` of observations (...,D) in its own shape: (...,L,3), (...,M) or (...,3)."""
        part = self[name]
        return obs[..., part.slice].reshape(*obs.shape[:-1], *part.shape)

    def table(self) -> list[tuple[str, str, float]]:
        """Meaning, unit and bound of every number of the observation, in order."""
        return [(label, part.unit, part.limit) for part in self.parts for label in part.labels]

    def bounds(self) -> np.ndarray:
        """The bound of every number, (D,) float32."""
        return np.concatenate([np.full(part.size, part.limit, dtype=np.float32) for part in self.parts])

    def scaling(self) -> tuple[np.ndarray, np.ndarray]:
        """Offset and scale, both (D,), with which (obs - offset) / scale is of the order of one."""
        scale = np.concatenate([np.full(part.size, part.typical) for part in self.parts])
        return np.concatenate([part.rest for part in self.parts]), scale

    def reflection(self) -> tuple[np.ndarray, np.ndarray]:
        """Indices and signs (D,) that exchange left and right: the reflected observation is `obs[place] * sign`."""
        partner = {"landmark": self._fish.landmarks.mirror, "muscle": self._fish.mirrored_muscles, "": np.zeros(1, int)}
        place, sign = [], []
        for part in self.parts:
            rows = partner[part.one_per]
            width = part.size // len(rows)
            place.append(part.start + (width * rows[:, None] + np.arange(width)).ravel())
            sign.append(np.tile(REFLECTED if width == len(AXES) else (1.0,), len(rows)))
        return np.concatenate(place), np.concatenate(sign)


def bytes_of_episode(fish: Fish) -> int:
    """Approximate memory of the episode of one fish, bytes: observation, bounds, generator, and copies of them."""
    numbers = 6 * fish.landmarks.node.size + fish.num_muscles + 16
    return 18 * numbers + 3000  # measured with every task: 14 a number, and up to 2,900


def make_parts(fish: Fish, directions: Sequence[Direction]) -> Iterator[Part]:
    """The parts of what a fish sees, in order. This is where the order and the scales are decided."""
    nodes, body = range(fish.landmarks.node.size), fish.body
    centred = fish.points(body.position) - body.mass @ body.position / body.mass.sum()
    still, upright = np.zeros(3 * len(nodes)), np.array([0.0, 0.0, 1.0])
    start = 0

    def part(name, unit, limit, typical, labels, rest, one_per=""):
        nonlocal start
        shape = {"landmark": (len(nodes), 3), "muscle": (fish.num_muscles,), "": (3,)}[one_per]
        begin, start = start, start + rest.size
        return Part(name, begin, shape, unit, limit, typical, tuple(labels), rest, one_per)

    labels = [f"position of node {i}, {axis}" for i in nodes for axis in AXES]
    yield part("position", "body lengths", 10.0, TYPICAL_POSITION, labels, centred.ravel() / fish.length, "landmark")
    labels = [f"velocity of node {i}, {axis}" for i in nodes for axis in AXES]
    yield part("velocity", "body lengths/s", 1000.0, TYPICAL_VELOCITY, labels, still, "landmark")
    labels = [
        f"rest length of muscle {spring} ({'left' if side > 0 else 'right'}, segment {segment})"
        for spring, side, segment in zip(fish.muscles, fish.sides, fish.segments, strict=True)
    ]
    yield part("rest length", MUSCLE_UNIT, 1.0, 1.0, labels, np.zeros(fish.num_muscles), "muscle")
    yield part("vertical", FRAME, 1.0, TYPICAL_TILT, [f"vertical, {axis}" for axis in AXES], upright)
    for direction in directions:
        labels = [f"{direction.name}, {axis}" for axis in AXES]
        yield part(direction.name, direction.unit, direction.limit, direction.typical, labels, np.zeros(3))


def observation_layout(id: str, **options) -> Layout:
    """The layout of the observation of a registered environment: `observation_layout("FishEnv/Swim-v0", speed=1.0)`.

    Args:
        id: an environment of this package.
        options: keywords of the environment.

    Raises:
        gymnasium.error.Error: for an id that is not registered.
        ValueError: for an option that is not allowed, an environment of another package, or an id that is no text or
            names a module that does not exist.
    """
    if not isinstance(id, str):
        raise ValueError(f"id is {id!r}; give the name of an environment, such as 'FishEnv/Swim-v0'")
    try:
        env = gym.make(id, **options)
    except (AttributeError, ImportError) as error:  # for a module that does not exist, or is none
        raise ValueError(f"id is {id!r}, which names no environment: {error}") from error
    layout = getattr(env.unwrapped, "layout", None)
    env.close()
    if not isinstance(layout, Layout):
        raise ValueError(
            f"{id} has no observation layout; give an environment of this package, such as FishEnv/Swim-v0"
        )
    return layout
