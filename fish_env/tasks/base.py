"""Base class of the tasks: their rewards are kernels, so that an environment step is one compiled call."""

from functools import cache
from typing import Any

import numpy as np

from fish_env.kernels.compile import njit
from fish_env.kernels.simd import Kind, Pack, Vectors
from fish_env.physics.pose import Pose, packed_pose
from fish_env.physics.tank import Tank
from fish_env.tasks.options import Direction


@cache
def make_calls(look, reward):
    """Compiled loops over all fish of a task's kernels, for Python: `look` and `reward`."""

    @njit
    def look_all(tank, pose, task, out):
        for b in range(pose.centre.size):
            look(tank, pose, task, b, out.vectors)

    @njit
    def reward_all(tank, pose, task, terms):
        for b in range(pose.centre.size):
            reward(tank, pose, task, b, terms)

    return look_all, reward_all


class CompiledTask:
    """A task whose `vectors` and `reward` are made of two kernels, which treat one fish b of the tank at a time.

    A subclass defines

    - `look(tank, pose, task, b, out)`: writes the world vectors that fish b is told to out[b, k], of `vectors`;
    - `score(tank, pose, task, b, terms)`: writes the terms of its reward to terms[t, b], in the order of `term_names`,
      sets task.over[b] where it ends the episode, and advances to the next environment step;
    - in `prepare`, `self.pack`, a `Pack` of what they read and write, `over` (B,) among it.

    The environments put both into their one compiled call, unless a subclass overrides `reward` or `vectors` in Python.
    """

    look: Any = None
    score: Any = None
    directions: tuple[Direction, ...]
    term_names: tuple[str, ...]
    pack: Any

    @property
    def kernels(self):
        """(look, score), or None where a subclass has written `vectors`, `reward` or `done` in Python."""
        cls = type(self)
        ours = all(getattr(cls, name) is getattr(CompiledTask, name) for name in ("vectors", "reward", "done"))
        return (cls.look, cls.score) if ours else None

    def vectors(self, tank: Tank, pose: Pose) -> np.ndarray:
        """World vectors (B, directions, 3) of the task."""
        out = np.zeros((tank.num_fish, len(self.directions), 3))
        look, _ = make_calls(type(self).look, type(self).score)
        look(tank.pack, packed_pose(pose), self.pack, Pack("out", vectors=Vectors(out, Kind(1))))
        return out

    def reward(self, tank: Tank, pose: Pose) -> dict[str, np.ndarray]:
        """Named terms (B,) of the reward for the last control interval."""
        terms = np.zeros((len(self.term_names), tank.num_fish))
        _, score = make_calls(type(self).look, type(self).score)
        score(tank.pack, packed_pose(pose), self.pack, terms)
        return dict(zip(self.term_names, terms, strict=True))

    def done(self, tank: Tank, pose: Pose) -> np.ndarray:
        """(B,) True where the task itself ends the episode."""
        return self.pack.over
