"""FishVectorEnv: B fish, one episode each. The one implementation of an episode; the other environments call it."""

from collections.abc import Mapping, Sequence
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium.utils.seeding import np_random
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space

from fish_env.bodies import Fish, make_fish
from fish_env.body import World, finite_array, make_water
from fish_env.envs import observation
from fish_env.pose import make_pose, measure
from fish_env.tank import Tank, whole_steps
from fish_env.tasks import TASKS

FAILURE_PENALTY = 10.0  # body lengths: what a failure of the physics costs


class FishVectorEnv(VectorEnv):
    """A batch of fish, each in water of its own, stepped by one compiled call.

    Fish i of a batch seeded s is, bit for bit, the fish of a single environment seeded s + i.

    Args:
        num_envs: B, the number of fish.
        task: a key of `fish_env.TASKS`.
        body: a key of `fish_env.BODIES`, or a `Fish` from `fish_env.make_fish`.
        integrator: a key of `fish_env.INTEGRATORS`.
        dt: integrator step, s; None takes the fish's own.
        control_interval: time between two decisions, s, a whole multiple of dt; None takes the fish's own.
        water: keywords of `fish_env.make_water`, or its result; None is the water the fish is made for.
        muscle_groups: "muscles", an action for each muscle, or "pairs", one for the left and one for the right side
            of each segment (the upper and lower muscle contract together: for planar scenes).
        max_episode_steps: decisions after which an episode is truncated; None for no limit.
        autoreset_mode: an `AutoresetMode` or its value, "NextStep", "SameStep" or "Disabled".
        render_mode: None, "rgb_array" or "human".
        info_every_step: put the reward terms, position and heading of every step into `info`; else `info` is empty
            until the end of an episode.
        threads: over how many threads the fish are shared out; None for all processors.
        task_options: keywords of the task.

    Raises:
        ValueError: for anything unknown or not allowed, saying what is.
    """

    metadata = {"render_modes": ["human", "rgb_array"], "render_fps": 30, "autoreset_mode": AutoresetMode.NEXT_STEP}

    tasks = TASKS

    def __init__(
        self,
        num_envs: int = 1,
        *,
        task: str = "swim",
        body: str | Fish = "mass_spring",
        integrator: str = "semi_implicit",
        dt: float | None = None,
        control_interval: float | None = None,
        water: Mapping[str, Any] | World | None = None,
        muscle_groups: str = "muscles",
        max_episode_steps: int | None = None,
        autoreset_mode: AutoresetMode | str = AutoresetMode.NEXT_STEP,
        render_mode: str | None = None,
        info_every_step: bool = False,
        threads: int | None = None,
        **task_options,
    ):
        if task not in self.tasks:
            raise ValueError(f"unknown task {task!r}; choose from {', '.join(map(repr, self.tasks))}")
        if render_mode is not None and render_mode not in self.metadata["render_modes"]:
            raise ValueError(f"unknown render_mode {render_mode!r}; choose None, 'human' or 'rgb_array'")
        if max_episode_steps is not None and not (isinstance(max_episode_steps, int) and max_episode_steps >= 1):
            raise ValueError(f"max_episode_steps is {max_episode_steps!r}; give a whole number, at least 1, or None")
        fish = body if isinstance(body, Fish) else make_fish(body)
        if not isinstance(water, World):
            water = fish.water if water is None else make_water(**water)
        self.tank = Tank(fish, num_envs, integrator, dt, water, threads)
        self.control_interval = float(fish.control_interval if control_interval is None else control_interval)
        self._substeps = whole_steps(self.control_interval, self.tank.dt, "control_interval")
        try:
            self.task = self.tasks[task](**task_options)
        except TypeError as error:
            raise ValueError(f"unknown option of the environment or of task {task!r}: {error}") from error
        self.num_envs = self.tank.num_fish
        self.max_episode_steps = max_episode_steps
        self.autoreset_mode = AutoresetMode(autoreset_mode)
        self.render_mode = render_mode
        self.info_every_step = info_every_step
        self.metadata = self.metadata | {
            "autoreset_mode": self.autoreset_mode,
            "render_fps": round(1 / self.control_interval),
        }
        self.groups = fish.grouping(muscle_groups)
        bound = observation.bounds(fish, self.task)
        self.single_observation_space = gym.spaces.Box(-bound, bound, dtype=np.float32)
        self.single_action_space = gym.spaces.Box(-1.0, 1.0, (int(self.groups.max()) + 1,), dtype=np.float32)
        self.observation_space = batch_space(self.single_observation_space, self.num_envs)
        self.action_space = batch_space(self.single_action_space, self.num_envs)
        self._action_shape = self.action_space.shape
        self._contraction = np.zeros((self.num_envs, fish.num_muscles))
        self._pose = make_pose(self.num_envs)
        self._generators: list[np.random.Generator | None] = [None] * self.num_envs
        self._seeds: list[int | None] = [None] * self.num_envs
        self._elapsed = np.zeros(self.num_envs, dtype=np.int64)
        self._over = np.zeros(self.num_envs, dtype=bool)
        self._no_penalty = np.zeros(self.num_envs)
        self._totals = {name: np.zeros(self.num_envs) for name in (*self.task.term_names, "failure")}
        self._started = False
        self._renderer = None

    # -- an episode, for all fish at once: what single.py and sb3.py build on ---------------------------------------

    def restart(self, mask: np.ndarray, seeds: Sequence[int | None] | None = None, options: Mapping | None = None):
        """Begin an episode for the fish of the boolean mask (B,), reseeding those whose seed is not None."""
        options = dict(options or {})
        for name in options:
            if name not in self.task.reset_options:
                allowed = "; ".join(f"{key!r}, {text}" for key, text in self.task.reset_options.items())
                raise ValueError(f"unknown reset option {name!r}; choose from {allowed}")
        which = np.flatnonzero(mask)
        for i in which:
            if (seeds is not None and seeds[i] is not None) or self._generators[i] is None:
                self._generators[i], self._seeds[i] = np_random(None if seeds is None else seeds[i])
        self.tank.reset(mask)
        self.task.start(self.tank, which, [self._generators[i] for i in which], options)
        self._elapsed[mask] = 0
        self._over[mask] = False
        for total in self._totals.values():
            total[mask] = 0.0
        self._measure()
        self._started = True
        if self._renderer is not None:
            self._renderer.restart(mask)

    def advance(self, action: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """One control interval: reward (B,) float64, terminated (B,), truncated (B,)."""
        if not self._started:
            raise gym.error.ResetNeeded("step was called before reset; call env.reset() first")
        self._command(action)
        self._swim()
        self._measure()
        terms = self.task.reward(self.tank, self._pose, self.control_interval)
        terminated = self.task.done(self.tank, self._pose)
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
        if self.max_episode_steps is None:
            return reward, terminated, np.zeros(self.num_envs, dtype=bool)
        return reward, terminated, ~terminated & (self._elapsed >= self.max_episode_steps)

    def observe(self) -> np.ndarray:
        """What every fish sees now, a new (B,D) float32 array."""
        tank = self.tank
        out = np.empty(self.observation_space.shape, dtype=np.float32)
        vectors = self.task.vectors(tank, self._pose)
        observation.observe(
            tank.position, tank.velocity, self._pose.centre, self._pose.axes, tank.fish.length,
            tank.rest_length, tank.fish.muscles, tank.natural, tank.span,
            vectors, self.task.vector_limit, out,
        )  # fmt: skip
        return out

    def episode_info(self, i: int) -> dict[str, Any]:
        """What the episode of fish i came to: reward terms, the task's metrics, and why it failed if it did."""
        info = {
            "terms": {name: float(total[i]) for name, total in self._totals.items()},
            "seconds": float(self._elapsed[i] * self.control_interval),
            **self.task.metrics(self.tank, i, max(1, self._elapsed[i]) * self.control_interval),
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
        measure(fish.body.mass, fish.front, fish.rear, fish.left, fish.right, tank.position, tank.velocity, *self._pose)

    # -- the Gymnasium vector interface -----------------------------------------------------------------------------

    def reset(self, *, seed: int | Sequence[int | None] | None = None, options: dict[str, Any] | None = None):
        """Begin new episodes: all of them, or those of `options["reset_mask"]`, (B,) bool.

        Other options are the task's (`task.reset_options`). Seeds: one number s for s, s+1, ..., or one a fish.
        """
        if isinstance(seed, int | np.integer):
            seed = [int(seed) + i for i in range(self.num_envs)]
        if seed is not None and len(seed) != self.num_envs:
            raise ValueError(f"{len(seed)} seeds were given for {self.num_envs} fish; give one each, or one number")
        options = dict(options or {})
        mask = options.pop("reset_mask", None)
        if mask is None:
            mask = np.ones(self.num_envs, dtype=bool)
        elif not (
            isinstance(mask, np.ndarray) and mask.dtype == bool and mask.shape == (self.num_envs,) and mask.any()
        ):
            raise ValueError(f"reset_mask is {mask!r}; give a boolean array ({self.num_envs},) with at least one True")
        self.restart(mask, seed, options)
        return self.observe(), {}

    def step(self, actions: np.ndarray):
        """One control interval for every fish; episodes that have ended begin anew as `autoreset_mode` says."""
        restarting = self._over.copy()
        if self.autoreset_mode is AutoresetMode.DISABLED and restarting.any():
            raise gym.error.ResetNeeded(
                f"fish {np.flatnonzero(restarting).tolist()} are at the end of an episode and autoreset is disabled; "
                "call env.reset(options={'reset_mask': terminated | truncated})"
            )
        reward, terminated, truncated = self.advance(actions)
        infos: dict[str, Any] = {}
        if restarting.any():  # NEXT_STEP: their action is ignored
            self.restart(restarting)
            reward[restarting] = 0.0
            terminated[restarting] = truncated[restarting] = False
        self._over = terminated | truncated
        if self.info_every_step:
            for i in np.flatnonzero(~restarting):
                infos = self._add_info(infos, self.step_info(i), i)
        obs = self.observe()
        if self._over.any():
            infos = self._end_episodes(infos, obs)
            if self.autoreset_mode is AutoresetMode.SAME_STEP:
                self.restart(self._over.copy())
                obs = self.observe()
        if self.render_mode == "human":
            self.render()
        return obs, reward, terminated, truncated, infos

    def _end_episodes(self, infos, obs):
        for i in np.flatnonzero(self._over):
            info = self.episode_info(i)
            if self.autoreset_mode is AutoresetMode.SAME_STEP:
                info = {"final_obs": obs[i].copy(), "final_info": info}
            infos = self._add_info(infos, info, i)
        return infos

    def render(self):
        """Pictures of the fish: a tuple of B arrays (H,W,3) uint8, or None after drawing to the window ("human")."""
        if self.render_mode is None:
            gym.logger.warn("render was called without a render_mode; pass render_mode='rgb_array' to gym.make_vec")
            return None
        return self._draw().render()

    def _draw(self):
        if self._renderer is None:
            from fish_env.render import Renderer  # pygame is loaded only when something is drawn

            self._renderer = Renderer(self)
        return self._renderer

    def close_extras(self, **kwargs):
        """Close the window and the threads."""
        if self._renderer is not None:
            self._renderer.close()
            self._renderer = None
        self.tank.close()

    @property
    def np_random(self) -> tuple[np.random.Generator, ...]:
        """One random generator a fish."""
        return tuple(self._generators)

    @property
    def np_random_seed(self) -> tuple[int | None, ...]:
        """The seeds they began with."""
        return tuple(self._seeds)

    def __getstate__(self):
        return self.__dict__ | {"_renderer": None}
