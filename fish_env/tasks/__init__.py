"""What a fish is asked to do: the Task protocol and the TASKS table. Only a task has opinions."""

from collections.abc import Mapping, Sequence
from typing import Any, Protocol

import numpy as np

from fish_env.pose import Pose
from fish_env.tank import Tank
from fish_env.tasks.swim import SwimTask

__all__ = ["TASKS", "SwimTask", "Task"]


class Task(Protocol):
    """A batched task: every method sees all B fish of a tank at once.

    A task keeps what it must remember in arrays with a row a fish, and draws random numbers only from the generators
    it is handed, so that fish i of a batch is the same fish alone.
    """

    num_vectors: int
    """How many directions the observation ends with, 3 numbers each."""
    vector_names: tuple[str, ...]
    """Their names, for the table of observations."""
    vector_limit: float
    """Bound of their components in the observation space."""
    term_names: tuple[str, ...]
    """Names of the terms of its reward."""
    reset_options: Mapping[str, str]
    """Keys that `reset(options=...)` accepts, with their meaning."""

    def start(self, tank: Tank, fish: np.ndarray, generators: Sequence[np.random.Generator], options: Mapping) -> None:
        """Begin an episode for the fish numbered in `fish` (K,), freshly reset, one generator each."""

    def vectors(self, tank: Tank, pose: Pose) -> np.ndarray:
        """World vectors (B, num_vectors, 3) that tell each fish what is asked; it sees them in its own frame."""

    def reward(self, tank: Tank, pose: Pose, interval: float) -> dict[str, np.ndarray]:
        """Named terms (B,) of the reward for the last control interval; the reward is their sum."""

    def done(self, tank: Tank, pose: Pose) -> np.ndarray:
        """(B,) True where the task itself ends the episode."""

    def metrics(self, tank: Tank, fish: int, seconds: float) -> dict[str, Any]:
        """What an episode of `seconds` achieved, for the `info` of its last step."""


TASKS: dict[str, type[Task]] = {"swim": SwimTask}
