"""Tasks of the fish: the Task protocol and the TASKS table. Only tasks define goals and rewards."""

from collections.abc import Mapping
from typing import Any, Protocol

import numpy as np

from fish_env.bodies import Fish
from fish_env.physics.pose import Pose
from fish_env.physics.tank import Tank
from fish_env.tasks.avoid import AvoidTask
from fish_env.tasks.fast_start import FastStartTask
from fish_env.tasks.left_after_right import LeftAfterRightTask
from fish_env.tasks.options import Direction, Option
from fish_env.tasks.start import POSE_OPTIONS, place
from fish_env.tasks.swim import SwimTask
from fish_env.tasks.target import TargetTask
from fish_env.tasks.turn import TurnTask

__all__ = ["POSE_OPTIONS", "TASKS", "Direction", "Option", "SwimTask", "Task", "place"]


class Task(Protocol):
    """A batched task: it sees all B fish of a tank at once, and begins episodes one fish at a time.

    A task keeps what it must remember in arrays with a row a fish, and draws random numbers only from the generator
    it is handed, so that fish i of a batch is the same as a single fish. `prepare` makes the arrays, as attributes or
    in tuples, lists, dictionaries or packs that are attributes: the states of the environments hold them all.

    A task that puts something into the water may also have a method `spheres(i)`: what a picture of fish i should show,
    an array (S,4) of centres, m, and radii, body lengths. Its attribute `touchable` says whether they are targets.
    Of `vectors`, pictures show the first, as an arrow. `settable`, a tuple of names, says which of its keywords
    may be set while it runs: attributes of the same name, which `start` reads.
    """

    episode_steps: int
    """Environment steps after which `gym.make` truncates an episode of this task."""

    @property
    def directions(self) -> tuple[Direction, ...]:
        """The vectors that the observation ends with, 3 numbers each; an attribute."""
        ...

    @property
    def term_names(self) -> tuple[str, ...]:
        """Names of the terms of its reward; an attribute."""
        ...

    @property
    def reset_options(self) -> Mapping[str, Option]:
        """Keys that `reset(options=...)` accepts, with their ranges and meaning; an attribute."""
        ...

    def prepare(self, tank: Tank[Fish], interval: float) -> None:
        """Make the arrays for the fish of a tank, environment steps of `interval` seconds."""
        ...

    def start(self, tank: Tank[Fish], i: int, generator: np.random.Generator, options: Mapping[str, float]) -> None:
        """Begin an episode for fish i, freshly reset."""
        ...

    def vectors(self, tank: Tank[Fish], pose: Pose) -> np.ndarray:
        """World vectors (B, directions, 3) of the task; each fish observes them in its own frame."""
        ...

    def reward(self, tank: Tank[Fish], pose: Pose) -> dict[str, np.ndarray]:
        """Named terms (B,) of the reward for the last control interval; the reward is their sum."""
        ...

    def done(self, tank: Tank[Fish], pose: Pose) -> np.ndarray:
        """(B,) True where the task itself ends the episode."""
        ...

    def metrics(self, tank: Tank[Fish], i: int, seconds: float) -> dict[str, Any]:
        """Metrics of an episode of `seconds`, for the `info` of its last step."""
        ...


TASKS: dict[str, type[Task]] = {
    "swim": SwimTask,
    "turn": TurnTask,
    "left_after_right": LeftAfterRightTask,
    "target": TargetTask,
    "avoid": AvoidTask,
    "fast_start": FastStartTask,
}
