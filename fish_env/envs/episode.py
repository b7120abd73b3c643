"""An episode of every fish of a batch: the one implementation, which every environment calls."""

from collections.abc import Mapping, Sequence
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium.utils.seeding import np_random
from gymnasium.vector.utils import batch_space

from fish_env.bodies import Fish, make_fish
from fish_env.checks import finite_array
from fish_env.envs import observation
from fish_env.envs.variation import VARIATIONS, checked_variation, draw, vary
from fish_env.pose import make_pose, measure
from fish_env.tank import Tank, whole_steps
from fish_env.tasks import TASKS
from fish_env.tasks.options import checked_options
from fish_env.world import World, make_water

FAILURE_PENALTY = 10.0  # body lengths: what a failure of the physics costs


class Episodes:
    """B fish, each in water of its own and in an episode of its own, stepped by one compiled call.

    Fish i of a batch seeded s is, bit for bit, the fish of a batch of one seeded s + i.
    """

    tasks = TASKS

    def __init__(
        self,
        num_envs: int = 1,
        *,
        task: str = "swim",
        body: str | Fish = "mass_spring",
        integrator: str | None = None,
        dt: float | None = None,
        control_interval: float | None = None,
        water: Mapping[str, Any] | World | None = None,
        muscle_groups: str = "muscles",
        variation: Mapping[str, Any] | None = None,
        max_episode_steps: int | None = None,
        threads: int | None = None,
        **task_options,
    ):
        if not isinstance(task, str) or task not in self.tasks:
            raise ValueError(f"unknown task {task!r}; choose from {', '.join(map(repr, self.tasks))}")
        whole = isinstance(max_episode_steps, int | np.integer) and not isinstance(max_episode_steps, bool)
        if max_episode_steps is not None and not (whole and max_episode_steps >= 1):
            raise ValueError(f"max_episode_steps is {max_episode_steps!r}; give a whole number, at least 1, or None")
        fish = body if isinstance(body, Fish) else make_fish(body)
        water = fish.water if water is None else water
        if not isinstance(water, World):
            water = _water(water)
        self.tank = Tank(fish, num_envs, integrator, dt, water, threads)
        self.control_interval = float(fish.control_interval if control_interval is None else control_interval)
        self._substeps = whole_steps(self.control_interval, self.tank.dt, "control_interval")
        try:
            self.task = self.tasks[task](**task_options)
        except TypeError as error:
            raise ValueError(f"unknown option of the environment or of task {task!r}: {error}") from error
        self.task.prepare(self.tank, self.control_interval)
        self.variation = checked_variation({} if variation is None else variation)
        self.reset_options = {**self.task.reset_options, **VARIATIONS}
        self.num_envs = self.tank.num_fish
        self.max_episode_steps = max_episode_steps
        self.groups = fish.grouping(muscle_groups)
        self.leaders = np.unique(self.groups, return_index=True)[1]  # (A,) the first muscle of each
        bound = observation.bounds(fish, self.task)
        self._limits = np.array([direction.limit for direction in self.task.directions])
        self.single_observation_space = gym.spaces.Box(-bound, bound, dtype=np.float32)
        self.single_action_space = gym.spaces.Box(-1.0, 1.0, (int(self.groups.max()) + 1,), dtype=np.float32)
        self.observation_space = batch_space(self.single_observation_space, self.num_envs)
        self.action_space = batch_space(self.single_action_space, self.num_envs)
        self._action_shape = self.action_space.shape
        self._contraction = np.zeros((self.num_envs, fish.num_muscles))
        self._pose = make_pose(self.num_envs)
        self._line = fish.line
        self._generators: list[np.random.Generator | None] = [None] * self.num_envs
        self._seeds: list[int | None] = [None] * self.num_envs
        self._elapsed = np.zeros(self.num_envs, dtype=np.int64)
        self._limit = np.full(self.num_envs, max_episode_steps or np.iinfo(np.int64).max)
        self._no_penalty = np.zeros(self.num_envs)
        self._totals = {name: np.zeros(self.num_envs) for name in (*self.task.term_names, "failure")}
        self._begun, self._started = np.zeros(self.num_envs, dtype=bool), False

    def restart(self, mask: np.ndarray, seeds: Sequence[int | None] | None = None, options: Mapping | None = None):
        """Begin an episode for the fish of the boolean mask (B,), reseeding those whose seed is not None."""
        options = checked_options({} if options is None else options, self.reset_options)
        which = np.flatnonzero(mask)
        for i in which:
            if (seeds is not None and seeds[i] is not None) or self._generators[i] is None:
                self._generators[i], self._seeds[i] = np_random(None if seeds is None else seeds[i])
        self.tank.reset(mask)
        for i in which:
            generator = self._generators[i]
            drawn = draw(self.variation, generator) | options
            vary(self.tank, i, drawn)
            self.task.start(self.tank, i, generator, drawn)
        self._elapsed[mask] = 0
        self._limit[mask] = self.max_episode_steps or np.iinfo(np.int64).max
        for total in self._totals.values():
            total[mask] = 0.0
        self._measure()
        self._begun[mask] = True
        self._started = self._begun.all()

    def advance(self, action: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """One control interval: reward (B,) float64, terminated (B,), truncated (B,)."""
        if not self._started:
            which = np.flatnonzero(~self._begun).tolist()
            raise gym.error.ResetNeeded(f"step was called before reset of the fish {which}; call env.reset() first")
        self._command(action)
        self._swim()
        self._measure()
        terms = self.task.reward(self.tank, self._pose)
        terminated = self.task.done(self.tank, self._pose).copy()
        if np.count_nonzero(self.tank.state.failure):  # rare: the quick test keeps it out of the hot path
            failed = self.tank.state.failure != 0
            terms["failure"] = failed * -FAILURE_PENALTY
            terminated = terminated | failed
        else:
            terms["failure"] = self._no_penalty
        self._terms = terms
        reward = self._no_penalty.copy()
        for name, term in terms.items():
            if term is not self._no_penalty:
                reward += term
                self._totals[name] += term
        self._elapsed += 1
        return reward, terminated, ~terminated & (self._elapsed >= self._limit)

    def stagger(self) -> None:
        """Shorten the episodes just begun to lengths spread evenly up to the limit, so that they end one by one.

        A learner then sees all parts of an episode in every batch, not all beginnings and then all ends.
        """
        if self.max_episode_steps is not None:
            self._limit[:] = 1 + np.arange(self.num_envs) * self.max_episode_steps // self.num_envs

    def observe(self) -> np.ndarray:
        """What every fish sees now, a new (B,D) float32 array."""
        tank = self.tank
        out = np.empty(self.observation_space.shape, dtype=np.float32)
        vectors = self.task.vectors(tank, self._pose)
        observation.observe(
            tank.position, tank.velocity, tank.fish.landmarks.node, tank.fish.landmarks.height,
            self._pose.centre, self._pose.axes, tank.fish.length,
            tank.rest_length, tank.fish.muscles, tank.natural, tank.span,
            vectors, self._limits, out,
        )  # fmt: skip
        return out

    def episode_info(self, i: int) -> dict[str, Any]:
        """What the episode of fish i came to: reward terms, the task's metrics, and why it failed if it did."""
        info = {
            "terms": {name: float(total[i]) for name, total in self._totals.items()},
            "seconds": float(self._elapsed[i] * self.control_interval),
            **self.task.metrics(self.tank, i, float(max(1, self._elapsed[i]) * self.control_interval)),
        }
        if self.tank.state.failure[i]:
            info["failure"] = self.tank.failure[i]
        return info

    def step_info(self, i: int) -> dict[str, Any]:
        """The last step of fish i: reward terms, position (3,) in body lengths, heading in radians."""
        forward = self._pose.axes[i, 0]
        return {
            "step_terms": {name: float(term[i]) for name, term in self._terms.items()},
            "position": self._pose.centre[i] / self.tank.fish.length,
            "heading": float(np.arctan2(forward[1], forward[0])),
        }

    def _command(self, action) -> None:
        """Turn the action (B,A) into contractions; ValueError, and nothing moves, if its shape or a number is wrong."""
        try:
            array = np.ascontiguousarray(action, dtype=np.float64)
            good = array.shape == self._action_shape and self._contract(array)
        except (TypeError, ValueError):
            good = False
        if not good:
            finite_array(action, self._action_shape, "action")  # says what is wrong

    def _contract(self, action: np.ndarray) -> bool:
        return observation.contractions(action, self.groups, self._contraction)

    def _swim(self) -> None:
        self.tank.drive(self._contraction, self._substeps)

    def _measure(self) -> None:
        fish, tank = self.tank.fish, self.tank
        measure(fish.body.mass, self._line, fish.left, fish.right, tank.position, tank.velocity, *self._pose)


def _water(keywords) -> World:
    """Water from keywords of `make_water`, or ValueError."""
    try:
        return make_water(**keywords)
    except TypeError as error:
        raise ValueError(f"water is {keywords!r}; give keywords of fish_env.make_water, or its result") from error
