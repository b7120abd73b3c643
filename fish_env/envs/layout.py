"""The layout of the observation: which numbers stand where, in what unit and range, by name. It is defined only here.

An observation is one float32 row of named parts, one after the other. "nodes": positions and velocities of the
landmarks, rest lengths of the muscles and the vertical. "sensors": what a robot could measure. Then a vector for each
`Direction` of the task, and the actions and observations of the steps before, if there is a history.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import gymnasium as gym
import numpy as np

from fish_env.bodies import Fish
from fish_env.checks import check_names
from fish_env.tasks import Direction

LAYOUT_VERSION = 1
"""Version of the layout. It is raised whenever a part moves, or changes its meaning, its unit or its frame."""

OBSERVATIONS = ("nodes", "sensors")
"""What a fish may observe."""
POSITION, VELOCITY, REST_LENGTH, VERTICAL, DIRECTIONS = range(5)
"""The places of the parts of "nodes" in `Layout.parts`; the task's directions follow, from DIRECTIONS on."""

TYPICAL_POSITION = 0.1  # body lengths: how far a node moves from its place in the body while the fish swims
TYPICAL_VELOCITY = 1.0  # body lengths per second
TYPICAL_TILT = 0.3  # rad: it then counts as much as a node that has moved
TYPICAL_RATE = 5.0  # rad/s: the head sways at such rates while the fish swims
TYPICAL_CURVATURE = 1.0  # 1/body length
TYPICAL_STRAIN = 0.05  # of a muscle
DYNAMIC_PRESSURE = 500.0  # Pa s2/m2: half the density of water; the scale is that of a body length a second

AXES = ("forward", "left", "up")
REFLECTED = (1.0, -1.0, 1.0)  # signs of a vector under the left-right reflection
ROTATION_REFLECTED = (-1.0, 1.0, -1.0)  # and of an angular velocity
MUSCLE_UNIT, FRAME = "-1 relaxed, 1 contracted", "in the body frame"


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
    signs: tuple[float, ...]
    """Signs of the numbers of a row, such as a vector, under the left-right reflection."""
    partner: np.ndarray
    """The row that each row becomes under it."""

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
        observation: "nodes" or "sensors".
        parts: all parts, a tuple of `Part`.
        size: D, how many numbers an observation has.
        present: how many of them are of the present, and not of the history; `num_present` are its parts.
    """

    version = LAYOUT_VERSION

    def __init__(
        self, fish: Fish, directions: Sequence[Direction], observation: str = "nodes", history: int = 0, groups=None
    ):
        """Lay out what a fish observes in a task with these directions, and so many actions and observations before.

        `groups` (M,) are the actions that drive the muscles; None for one each. ValueError for an unknown observation,
        or if two parts would have the same name.
        """
        check_names("unknown observation", OBSERVATIONS, observation)
        make, self.observation = PartMaker(fish), observation
        parts = list((make_parts if observation == "nodes" else make_sensor_parts)(make, fish, directions))
        self.num_present, self.present = len(parts), make.start
        groups = np.arange(fish.num_muscles) if groups is None else groups
        mirrored = groups[fish.mirrored_muscles[np.unique(groups, return_index=True)[1]]]
        for k in range(1, history + 1):
            labels = [f"past {k}: action {a}" for a in range(len(mirrored))]
            parts.append(make(f"past {k}: action", MUSCLE_UNIT, 1.0, 1.0, labels, partner=mirrored))
            parts.extend(make.again(part, f"past {k}: ") for part in parts[: self.num_present])
        self.parts: tuple[Part, ...] = tuple(parts)
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
        place, sign = [], []
        for part in self.parts:
            width = len(part.signs)
            place.append(part.start + (width * part.partner[:, None] + np.arange(width)).ravel())
            sign.append(np.tile(part.signs, len(part.partner)))
        return np.concatenate(place), np.concatenate(sign)


def row_of(obs: Any, i: int) -> Any:
    """A copy of the observation of fish i, from an array or a dict of arrays."""
    return {name: array[i].copy() for name, array in obs.items()} if isinstance(obs, dict) else obs[i].copy()


def bytes_of_episode(fish: Fish, remembered: int = 0) -> int:
    """Approximate memory of the episode of one fish, bytes: observation, bounds, generator, and copies of them."""
    # `remembered` is how many observations it remembers, those of its history and its delay.
    numbers = 6 * fish.landmarks.node.size + fish.num_muscles + 16
    return (18 + 22 * remembered) * numbers + 3000  # measured with every task: 14 a number, and up to 2,900


class PartMaker:
    """Makes parts of the observation of a fish, one after the other."""

    def __init__(self, fish: Fish):
        self.start, self.fish = 0, fish

    def __call__(self, name, unit, limit, typical, labels, rest=None, signs=(1.0,), partner=None) -> Part:
        """A part with a row of `len(signs)` numbers for each element of `partner`; the row itself without it."""
        rest = np.zeros(len(labels)) if rest is None else rest
        rows = rest.size // len(signs)
        shape = (rows, len(signs)) if len(signs) > 1 and partner is not None else (rest.size,)
        begin, self.start = self.start, self.start + rest.size
        partner = np.arange(rows) if partner is None else partner
        return Part(name, begin, shape, unit, limit, typical, tuple(labels), rest, signs, partner)

    def again(self, part: Part, prefix: str) -> Part:
        """The same part once more, its names with a prefix."""
        begin, self.start = self.start, self.start + part.size
        return replace(part, name=prefix + part.name, start=begin, labels=tuple(prefix + each for each in part.labels))

    def vector(self, name, unit, limit, typical, rest=None, signs=REFLECTED) -> Part:
        """A vector in the body frame."""
        return self(name, unit, limit, typical, [f"{name}, {axis}" for axis in AXES], rest, signs)

    def nodes(self, name, unit, limit, typical, rest=None) -> Part:
        """A vector for each landmark."""
        mirror = self.fish.landmarks.mirror
        labels = [f"{name} of node {i}, {axis}" for i in range(mirror.size) for axis in AXES]
        return self(name, unit, limit, typical, labels, rest, REFLECTED, mirror)

    def muscles(self, name, unit, limit, typical) -> Part:
        """A number for each muscle."""
        fish = self.fish
        labels = [
            f"{name} of muscle {spring} ({'left' if side > 0 else 'right'}, segment {segment})"
            for spring, side, segment in zip(fish.muscles, fish.sides, fish.segments, strict=True)
        ]
        return self(name, unit, limit, typical, labels, partner=fish.mirrored_muscles)


def make_parts(make: PartMaker, fish: Fish, directions: Sequence[Direction]) -> Iterator[Part]:
    """The parts of "nodes", in order. This is where the order and the scales are decided."""
    centred = fish.points(fish.body.position) - fish.body.mass @ fish.body.position / fish.body.mass.sum()
    yield make.nodes("position", "body lengths", 10.0, TYPICAL_POSITION, centred.ravel() / fish.length)
    yield make.nodes("velocity", "body lengths/s", 1000.0, TYPICAL_VELOCITY)
    yield make.muscles("rest length", MUSCLE_UNIT, 1.0, 1.0)
    yield make.vector("vertical", FRAME, 1.0, TYPICAL_TILT, np.array([0.0, 0.0, 1.0]))
    yield from (make.vector(*direction) for direction in directions)


def make_sensor_parts(make: PartMaker, fish: Fish, directions: Sequence[Direction]) -> Iterator[Part]:
    """The parts of "sensors", in the order in which `observe_sensors` writes them."""
    yield make.vector("body velocity", "body lengths/s, in the body frame", 1000.0, TYPICAL_VELOCITY)
    yield make.vector("angular velocity", "rad/s, in the body frame", 1000.0, TYPICAL_RATE, signs=ROTATION_REFLECTED)
    yield make.vector("vertical", FRAME, 1.0, TYPICAL_TILT, np.array([0.0, 0.0, 1.0]))
    labels = [f"curvature at station {s}, positive to the left" for s in range(1, stations(fish)[1].size - 2)]
    yield make("curvature", "1/body length", 1000.0, TYPICAL_CURVATURE, labels, signs=(-1.0,))
    yield make.muscles("muscle length", "over natural length, less 1", 10.0, TYPICAL_STRAIN)
    faces = np.arange(len(pressure_faces(fish)))  # left and right in turn
    labels = [f"pressure, segment {face // 2}, {('left', 'right')[face % 2]}" for face in faces]
    scale = DYNAMIC_PRESSURE * fish.length**2
    yield make("pressure", "Pa", 1000.0 * scale, scale, labels, partner=faces ^ 1)
    yield from (make.vector(*direction) for direction in directions)


def stations(fish: Fish) -> tuple[np.ndarray, np.ndarray]:
    """Landmarks from the nose to the tail (L,), and the index of the first of each station, and their end (S+1,)."""
    # The landmarks of a station lie within a hundredth of a body length along the fish at rest.
    along = -fish.points(fish.body.position)[:, 0] / fish.length
    order = np.argsort(along, kind="stable")
    return order, np.flatnonzero(np.diff(along[order], prepend=-np.inf, append=np.inf) > 0.01)


def pressure_faces(fish: Fish) -> np.ndarray:
    """Faces between the landmarks on which pressure is measured, (2G,4): left and right of each segment in turn."""
    points, marks = fish.points(fish.body.position), fish.landmarks
    muscles, centres = points[marks.muscles].mean(axis=1), points[marks.faces].mean(axis=1)
    wanted = [muscles[(fish.segments == s) & (fish.sides == side)].mean(axis=0)
              for s in range(fish.segments.max() + 1) for side in (1, -1)]  # fmt: skip
    if not len(marks.faces):
        return marks.faces
    return marks.faces[[int(np.argmin(((centres - each) ** 2).sum(axis=1))) for each in wanted]]


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
