"""Base class of the tasks: their rewards are kernels, so that an environment step is one compiled call."""

from collections.abc import Mapping
from functools import cache
from typing import Any

import numpy as np

from fish_env.kernels.compile import njit
from fish_env.kernels.simd import Kind, Pack, Vectors
from fish_env.physics.pose import Pose, packed_pose
from fish_env.physics.tank import Tank
from fish_env.tasks.options import Direction, Keywords, Option


@cache
def make_calls(write_vectors, write_terms):
    """Compiled loops over all fish of the kernels of a task, for Python."""

    @njit
    def write_all_vectors(tank, pose, task, out):
        for b in range(pose.centre.size):
            write_vectors(tank, pose, task, b, out.vectors)

    @njit
    def write_all_terms(tank, pose, task, terms):
        for b in range(pose.centre.size):
            write_terms(tank, pose, task, b, terms)

    return write_all_vectors, write_all_terms


class CompiledTask(Keywords):
    """A task whose `vectors` and `reward` are made of two kernels, which treat one fish b of the tank at a time.

    A subclass defines

    - `write_vectors(tank, pose, task, b, out)`: writes the world vectors of fish b to out[b, k];
    - `write_terms(tank, pose, task, b, terms)`: writes the terms of its reward to terms[t, b], in the order of
      `term_names`, sets task.over[b] where it ends the episode, and advances to the next environment step;
    - in `prepare`, `self.pack`, a `Pack` of what they read and write, `over` (B,) among it.

    The environments put both into their one compiled call, unless a subclass overrides `reward` or `vectors` in Python.

    A class may have `weights`, its keywords that weight terms of the reward, each an `Option` with a default. They
    become attributes, and floats of the pack by `weight_values`. The environment may set a weight while the task
    runs, from the next step on; in a running task, none of its keywords can be assigned.

    Raises:
        TypeError: for a keyword that is none of `weights`.
        ValueError: for a weight out of range, saying what is allowed.
    """

    weights: Mapping[str, Option] = {}
    write_vectors: Any = None
    write_terms: Any = None
    directions: tuple[Direction, ...]
    term_names: tuple[str, ...]
    pack: Any

    def __init__(self, **weights):
        for name in weights:
            if name not in self.weights:
                raise TypeError(f"{type(self).__name__}.__init__() got an unexpected keyword argument {name!r}")
        for name, option in self.weights.items():
            setattr(self, name, option.checked(name, weights.get(name, option.default)))

    def weight_values(self) -> dict[str, float]:
        """The weights of the reward, by name."""
        return {name: getattr(self, name) for name in self.weights}

    @property
    def kernels(self):
        """Both kernels, or None where a subclass has written `vectors`, `reward` or `done` in Python."""
        cls = type(self)
        ours = all(getattr(cls, name) is getattr(CompiledTask, name) for name in ("vectors", "reward", "done"))
        return (cls.write_vectors, cls.write_terms) if ours else None

    def vectors(self, tank: Tank, pose: Pose) -> np.ndarray:
        """World vectors (B, directions, 3) of the task."""
        out = np.zeros((tank.num_fish, len(self.directions), 3))
        write, _ = make_calls(type(self).write_vectors, type(self).write_terms)
        write(tank.pack, packed_pose(pose), self.pack, Pack("out", vectors=Vectors(out, Kind(1))))
        return out

    def reward(self, tank: Tank, pose: Pose) -> dict[str, np.ndarray]:
        """Named terms (B,) of the reward for the last control interval."""
        terms = np.zeros((len(self.term_names), tank.num_fish))
        _, write = make_calls(type(self).write_vectors, type(self).write_terms)
        write(tank.pack, packed_pose(pose), self.pack, terms)
        return dict(zip(self.term_names, terms, strict=True))

    def done(self, tank: Tank, pose: Pose) -> np.ndarray:
        """(B,) True where the task itself ends the episode."""
        return self.pack.over
