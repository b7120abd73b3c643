"""An episode of every fish of a batch: the one implementation, which every environment calls."""

import copy
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium.utils.seeding import np_random
from gymnasium.vector.utils import batch_space

from fish_env.bodies import Fish
from fish_env.checks import ReadOnly, UnknownOptionError, check_names, finite_array, fits_memory, frozen, own, similar
from fish_env.envs.layout import Layout, bytes_of_episode
from fish_env.envs.observation import make_rows, make_sensors, observe_nodes, observe_sensors
from fish_env.envs.options import checked_limit, checked_seed, checked_truth, fish_for
from fish_env.envs.senses import check_delays, checked_noise, checked_senses, draw_delays, make_memory, pack_memory
from fish_env.envs.state import Stateful
from fish_env.envs.step import (
    FAILURE_PENALTY,
    compile_measure_and_observe,
    compile_observe,
    contract_all,
    make_arrays,
    make_step,
    recall_all,
)
from fish_env.envs.variation import VARIATIONS, checked_variation, draw, factors_of, vary
from fish_env.kernels.simd import Kind, Pack, Vectors
from fish_env.physics.forces.control import MASS
from fish_env.physics.linearise import Jacobians
from fish_env.physics.pose import make_pose, packed_pose
from fish_env.physics.records import World
from fish_env.physics.tank import Tank
from fish_env.physics.tank_options import bytes_of, checked_count, step_within, whole_steps
from fish_env.physics.world import checked_water
from fish_env.tasks import TASKS, Task
from fish_env.tasks.base import CompiledTask
from fish_env.tasks.options import check_options, keywords_of, weight
from fish_env.tasks.start import check_pose


class Episodes(Stateful, ReadOnly):
    """B fish, each in water of its own and in an episode of its own, stepped by one compiled call.

    Fish i of a batch seeded s is, bit for bit, the fish of a batch of one seeded s + i.
    """

    READ_ONLY = ("tank", "task", "num_envs", "control_interval", "groups", "variation")
    LIVE: tuple[str, ...] = ("max_episode_steps", "variation", "failure_penalty")
    """Keywords that may be set while it runs, besides those of the task; a subclass may add attributes of its own."""
    tasks = TASKS
    single_observation_space: gym.spaces.Box | gym.spaces.Dict
    single_action_space: gym.spaces.Box
    _measure_and_observe: Callable[..., Any]
    _step: Callable[..., bool] | None

    def __init__(
        self,
        num_envs: int = 1,
        *,
        task: str = "swim",
        body: str | Fish = "mass_spring",
        integrator: str | None = None,
        dt: float | None = None,
        control_interval: float | None = None,
        water: str | Mapping[str, Any] | World | None = None,
        muscle_groups: str = "muscles",
        variation: Mapping[str, Any] | None = None,
        max_episode_steps: int | None = None,
        threads: int | None = None,
        dtype: str = "float64",
        lanes: str | int | None = None,
        refine: float | None = None,
        observation: str = "nodes",
        privileged: bool = False,
        history: int = 0,
        observation_noise: Mapping[str, float] | None = None,
        action_noise: float = 0.0,
        observation_delay: int | tuple[int, int] = 0,
        action_delay: int | tuple[int, int] = 0,
        failure_penalty: float = FAILURE_PENALTY,
        **task_options,
    ):
        self.task, self._task_options = self._make_task(task, task_options), copy.deepcopy(task_options)
        self._senses = checked_senses(observation_noise, action_noise, observation_delay, action_delay, history)
        self.max_episode_steps = max_episode_steps
        fish = body if isinstance(body, Fish) else fish_for(body, water)
        water = fish.water if water is None else checked_water(water, fish.water)
        num_envs = checked_count(num_envs, "num_envs")
        remembered = 2 * self._senses.history + self._senses.observation_delay[1]
        fits_memory(num_envs, bytes_of(fish.body) + bytes_of_episode(fish, remembered), "num_envs")
        interval = fish.control_interval if control_interval is None else control_interval
        dt = step_within(fish, integrator, interval) if dt is None else dt
        self.tank = Tank(fish, num_envs, integrator, dt, water, threads, dtype, lanes, refine)
        self._substeps = whole_steps(interval, self.tank.dt, "control_interval")
        self.control_interval = float(interval)
        self.task.prepare(self.tank, self.control_interval)
        self.variation = checked_variation({} if variation is None else variation)
        check_pose(fish, self.variation)
        self.reset_options = {**self.task.reset_options, **VARIATIONS}
        self.num_envs = num_envs
        self.groups = frozen(fish.grouping(muscle_groups))
        self.first_muscle_of_group = frozen(np.unique(self.groups, return_index=True)[1])  # (A,) the first of each
        self.layout = Layout(fish, self.task.directions, observation, self._senses.history, self.groups)
        self._senses = checked_noise(self._senses, self.layout)
        self.privileged = checked_truth(privileged, "privileged")
        self._make_spaces()
        self._action_shape = self.action_space.shape
        self._generators: list[np.random.Generator | None] = [None] * self.num_envs
        self._seeds: list[int | None] = [None] * self.num_envs
        self._names = (*self.task.term_names, "failure")
        self._nodes = Layout(fish, self.task.directions)
        self._made = self._make_arrays(self.num_envs)
        arrays, self._memory, self._pose, beside = self._made.values()
        self._arrays, (self._vectors, self._privileged, self._drawn) = arrays, beside.values()
        self.failure_penalty = failure_penalty
        self._action, self._observation = arrays["action"], arrays["observation"]
        self._contraction, self._elapsed, self._limit = arrays["contraction"], arrays["elapsed"], arrays["limit"]
        self._reward = arrays["reward"]
        self._terminated, self._truncated = arrays["terminated"], arrays["truncated"]
        self._limit[:] = self.max_episode_steps or np.iinfo(np.int64).max
        self._begun, self._started = np.zeros(self.num_envs, dtype=bool), False
        self._compile()

    def _make_spaces(self) -> None:
        """Make the spaces of one fish and of all; observations are a dict if the task has `goals`."""
        bound = self.layout.bounds()
        self.single_observation_space = gym.spaces.Box(-bound, bound, dtype=np.float32)
        self._goals = getattr(self.task, "goals", None)
        if self._goals is not None:
            goals: Any = self.task
            goal = gym.spaces.Box(-goals.farthest, goals.farthest, (3,), dtype=np.float32)
            self.compute_reward = goals.compute_reward  # others have none, as checkers expect
            self.single_observation_space = gym.spaces.Dict(
                {"observation": self.single_observation_space, "achieved_goal": goal, "desired_goal": goal}
            )
        self.single_action_space = gym.spaces.Box(-1.0, 1.0, (int(self.groups.max()) + 1,), dtype=np.float32)
        self.observation_space = batch_space(self.single_observation_space, self.num_envs)
        self.action_space = batch_space(self.single_action_space, self.num_envs)

    def _make_arrays(self, count: int) -> dict[str, Any]:
        """Arrays of the episodes of so many fish."""
        actions = int(self.groups.max()) + 1
        return {
            "episode": make_arrays(count, len(self.task.term_names), self.groups, self.layout.size),
            "memory": make_memory(self._senses, self.layout, count, actions) if self._senses.remember else {},
            "pose": make_pose(count),
            "beside": {
                "vectors": np.zeros((count, len(self.task.directions), 3)),
                "privileged": np.zeros((count if self.privileged else 0, self._nodes.size), dtype=np.float32),
                "drawn": np.full((count, len(VARIATIONS)), np.nan),  # of every variation, NaN for the original
            },
        }

    @property
    def max_episode_steps(self) -> int | None:
        """Environment steps after which an episode is truncated; another number counts for those that begin next."""
        return self._max_episode_steps

    @max_episode_steps.setter
    def max_episode_steps(self, steps: int | None) -> None:
        limit = checked_limit(steps)
        check_delays(self._senses, limit)
        self._max_episode_steps = limit

    @property
    def failure_penalty(self) -> float:
        """What a failure of the physics costs, body lengths; another number counts from the next step."""
        return float(self._arrays["failure_penalty"][0])

    @failure_penalty.setter
    def failure_penalty(self, penalty: float) -> None:
        option = weight(FAILURE_PENALTY, "weight of a failure of the physics, body lengths")
        self._arrays["failure_penalty"][0] = option.checked("failure_penalty", penalty)

    def _make_task(self, task, options) -> Task:
        """The task of a name with its options, or ValueError."""
        check_names("unknown task", self.tasks, task)
        try:
            return self.tasks[task](**options)
        except TypeError as error:
            allowed = keywords_of(self.tasks[task])
            names = allowed | keywords_of(type(self)) | keywords_of(Episodes)
            close = "".join(similar(name, names) for name in options if name not in allowed)
            message = f"unknown option of the environment or of task {task!r}: {error}{close}; "
            raise UnknownOptionError(message + f"the task has {', '.join(allowed)}") from error

    def _compile(self) -> None:
        """Describe the arrays to kernels, and choose the compiled calls."""
        tank, engine = self.tank, self.tank._engine
        task = self.task if isinstance(self.task, CompiledTask) and self.task.kernels is not None else None
        self._kernels = None if task is None else task.kernels
        fields = {} if task is None else {"task": task.pack}
        fields |= {
            "tank": tank.pack,
            "pose": packed_pose(self._pose),
            "order": np.arange(self.num_envs) if engine is None else engine.order,
            "episode": Pack("episode", vectors=Vectors(self._vectors, Kind(1)), **self._arrays),
            "rows": make_rows(self.layout, self._observation),
        }
        sensors = self.layout.observation == "sensors"
        if sensors:
            fields["sensors"] = make_sensors(tank.fish, tank.world)
        if self._memory:
            fields["memory"] = pack_memory(self._senses, self._memory)
        if self.privileged:
            fields["privileged"] = make_rows(self._nodes, self._privileged)
        self._sensing = (observe_sensors if sensors else observe_nodes, bool(self._memory), self.privileged)
        moved = [{}] if engine is None else [{"queue": engine.queue, "block": block} for block in engine.blocks]
        self._envs = [Pack("env", **fields, **each) for each in moved]  # one a thread
        self._env = self._envs[0]
        self._measure_and_observe = compile_measure_and_observe(self._kernels, self._sensing)
        self._step = None
        if engine is not None:
            self._step = make_step(engine.names, engine.method.make_run, self._kernels, self._sensing, self._env.type)
        self._engine = engine  # last: an interruption leaves it to `_follow_tank`

    def _follow_tank(self) -> None:
        """Take the engine that the tank has now: `grab`, `fix`, `move` and `release` of the tank make another."""
        if self._engine is not self.tank._engine:
            self._compile()

    def __getstate__(self):
        return self.__dict__ | dict.fromkeys(("_env", "_envs", "_engine", "_rows", "_measure_and_observe", "_step"))

    def __setstate__(self, state: dict[str, Any]):
        self.__dict__ |= own(state, state["_vectors"])
        self._compile()

    @property
    def interface(self) -> dict[str, Any]:
        """Control interval, s, muscle groups and sizes of the observed parts, for which a policy is trained here."""
        return {
            "control_interval": self.control_interval,
            "muscle_groups": "muscles" if np.array_equal(self.groups, np.arange(self.groups.size)) else "pairs",
            "observation": {part.name: part.size for part in self.layout},
        }

    def restart(self, mask: np.ndarray, seeds: Sequence[int | None] | None = None, options: Mapping | None = None):
        """Begin an episode for the fish of the boolean mask (B,), reseeding those whose seed is not None."""
        options = self.checked_reset(options)
        which = np.flatnonzero(mask).tolist()
        generators = self._generators_of(which, [None] * self.num_envs if seeds is None else seeds)
        self.tank.reset(mask)
        for i, generator in zip(which, generators, strict=True):
            drawn = draw(self.variation, generator) | options
            vary(self.tank, i, drawn)
            self._drawn[i] = [drawn.get(name, np.nan) for name in VARIATIONS]
            self.task.start(self.tank, i, generator, drawn)
            if self._memory:
                draw_delays(self._senses, self._memory, i, generator)
        self._elapsed[mask] = 0
        self._limit[mask] = self.max_episode_steps or np.iinfo(np.int64).max
        self._arrays["totals"][:, mask] = self._arrays["path"][mask] = 0.0
        self._terminated[mask] = self._truncated[mask] = False
        self._begun[mask] = True
        self._started = self._begun.all()
        self._measure(mask)

    def checked_reset(self, options: Mapping | None) -> dict[str, float]:
        """The options of a reset as numbers; ValueError for what these fish cannot begin with."""
        checked = check_options({} if options is None else options, self.reset_options)
        check_pose(self.tank.fish, checked)
        return checked

    def _generators_of(self, which: list[int], seeds: Sequence[int | None]) -> list[np.random.Generator]:
        """The generators of these fish: their own, or new ones where a seed is given or there is none yet."""
        wanted = {i: checked_seed(seeds[i]) for i in which if seeds[i] is not None or self._generators[i] is None}
        new = {i: np_random(seed) for i, seed in wanted.items()}
        for i, (generator, seed) in new.items():  # none of them if a seed is rejected
            self._generators[i], self._seeds[i] = generator, seed
        return [generator for generator in (self._generators[i] for i in which) if generator is not None]

    def advance(self, action: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """One control interval: reward (B,) float64, terminated (B,), truncated (B,), as copies; then `observe`."""
        self._take_action(action)
        return self._reward.copy(), self._terminated.copy(), self._truncated.copy()

    def _take_action(self, action) -> None:
        """One control interval, into the arrays of the episode."""
        if not self._started:
            which = np.flatnonzero(~self._begun).tolist()
            raise gym.error.ResetNeeded(
                f"step was called before reset, or after an error in a step, of fish {which}; call env.reset() first"
            )
        if type(action) is not np.ndarray or action.shape != self._action_shape or action.dtype.kind not in "fiub":
            action = finite_array(action, self._action_shape, "action")
        self._action[...] = action
        if not self._move():
            finite_array(action, self._action_shape, "action")

    def linearise(self, action: np.ndarray) -> Jacobians:
        """Derivatives of the fish's states after a step with these actions, (B,A), as `Tank.linearise`; nothing moves.

        They leave out noise and delays. An action beyond [-1, 1] is clipped, and its column is zero.
        """
        action = finite_array(action, self._action_shape, "action")
        clipped, of_group = np.clip(action, -1.0, 1.0), np.eye(action.shape[1])[self.groups]
        found = self.tank.linearise(0.5 * (clipped + 1.0)[:, self.groups], self._substeps)
        return found._replace(command=0.5 * (found.command @ of_group) * (clipped == action)[:, None])

    def _move(self) -> bool:
        """Command, move, measure, reward and observe the fish; False, and nothing has moved, for a bad action."""
        self._follow_tank()
        engine, step = self.tank._engine, self._step
        if engine is None or step is None or self.tank.conditioned:  # what is prescribed is imposed by `Tank`
            if not contract_all(self._env):
                return False
            if self._memory:
                recall_all(self._env)
            self.tank.drive(self._contraction, self._substeps)
            self._measure_and_observe(self._env, 0, self.num_envs, True)
        elif self.tank._chunks == 1:
            engine.sort()
            if not self._move_chunk(0, 0, self.num_envs, step):
                return False
        else:
            if not contract_all(self._env):
                return False
            self.tank.share_out(self._move_chunk, step)
        if self._kernels is None:
            self._begun[:] = self._started = False  # after an error in the task, the fish have moved and no more
            self._reward_and_observe()
            self._begun[:] = self._started = True
        return True

    def _move_chunk(self, chunk: int, first: int, last: int, step: Callable[..., bool]) -> bool:
        """The fish between two places in the order in which they are moved, in the memory of one thread."""
        return step(self._envs[chunk].address, first, last, self._substeps, self.control_interval)

    def _reward_and_observe(self) -> None:
        """Reward by a task that is written in Python, and observe."""
        arrays, tank = self._arrays, self.tank
        terms, names = self.task.reward(tank, self._pose), self._names[:-1]
        if not isinstance(terms, Mapping) or set(terms) != set(names):
            given = list(terms) if isinstance(terms, Mapping) else repr(terms)
            raise ValueError(f"the reward of the task has the terms {given}; give its term_names, {list(names)}")
        failed = tank.state.failure != 0
        for t, name in enumerate(names):
            arrays["terms"][t] = finite_array(terms[name], (self.num_envs,), f"term {name!r} of the reward")
        arrays["terms"][-1] = failed * -self.failure_penalty
        arrays["totals"] += arrays["terms"]
        arrays["reward"][:] = arrays["terms"].sum(axis=0)
        self._elapsed += 1
        done = self.task.done(tank, self._pose)
        if not isinstance(done, np.ndarray) or done.dtype != bool or done.shape != failed.shape:
            raise ValueError(f"done of the task is {done!r:.100}; give a boolean array ({self.num_envs},)")
        over = done | failed
        arrays["terminated"][:] = over
        arrays["truncated"][:] = ~over & (self._elapsed >= self._limit)
        self._observe()

    def _observe(self) -> None:
        vectors = self.task.vectors(self.tank, self._pose)
        self._vectors[:] = finite_array(vectors, self._vectors.shape, "vectors of the task")
        compile_observe(self._sensing)(self._env)

    def _measure(self, mask: np.ndarray | None = None) -> None:
        """Bring poses and observations of the fish of a mask (B,), or of all, up to date with their positions."""
        self._follow_tank()
        places = [(0, self.num_envs)]
        if mask is not None and not mask.all():
            places = [(p, p + 1) for p in np.flatnonzero(mask[self._env.order])]
        for first, last in places:
            if self._step is None:
                self._measure_and_observe(self._env, first, last, False)
            else:
                self._step(self._env.address, first, last, -1, 0.0)
        if self._kernels is None:
            self._observe()

    def stagger(self) -> None:
        """Shorten the episodes just begun to lengths spread evenly up to the limit, so that they end one by one.

        A learner then sees all parts of an episode in every batch, not all beginnings and then all ends.
        """
        if self.max_episode_steps is not None:
            self._limit[:] = 1 + np.arange(self.num_envs) * self.max_episode_steps // self.num_envs

    def observe(self) -> Any:
        """Observations at the end of the last step, or after a restart: a new (B,D) float32 array, or a dict of arrays.

        It is a dict, with the goals, if the task has `goals`.
        """
        obs = self._observation.copy()
        return obs if self._goals is None else {"observation": obs, **self._goals(self.tank)}

    def episode_info(self, i: int) -> dict[str, Any]:
        """Summary of the episode of fish i: reward terms, the task's metrics, and its failure, "" for none.

        Raises:
            gymnasium.error.ResetNeeded: before its first reset.
        """
        if not self._begun[i]:
            raise gym.error.ResetNeeded(f"fish {i} has no episode before reset; call env.reset() first")
        failed = self.tank.state.failure[i] != 0
        seconds = float(max(1, self._elapsed[i]) * self.control_interval)
        info = {
            "terms": {name: float(total[i]) for name, total in zip(self._names, self._arrays["totals"], strict=True)},
            "seconds": float(self._elapsed[i] * self.control_interval),
            **self._energy(i, seconds),
            **self.task.metrics(self.tank, i, seconds),
            "failure": self.tank.failure[i] if failed else "",
            **self.state_info(i),
        }
        return info | ({"is_success": info["success"]} if "success" in info else {})  # as Stable-Baselines3 reads it

    def _energy(self, i: int, seconds: float) -> dict[str, float]:
        """Work of the muscles of fish i over its mass, J/kg, over the time, W/kg, and over its path, J/(kg m)."""
        tank, path = self.tank, float(self._arrays["path"][i])
        work = float(tank.work[i] / (tank.fish.body.mass.sum() * tank.variation[i, MASS]))
        return {"work": work, "power": work / seconds, "cost_of_transport": work / path if path > 0.0 else np.nan}

    def state_info(self, i: int) -> dict[str, Any]:
        """Info of fish i beside its observation: what was drawn of `variation`, and the privileged observation (P,).

        The latter has all nodes as they are now, as `Layout` lists them, and then `FACTORS` of the fish.
        """
        drawn = self.drawn(i)
        info = {"variation": drawn} if drawn else {}
        return info | ({"privileged": self.observe_all(i)} if self.privileged else {})

    def observe_all(self, i: int | slice = slice(None)) -> np.ndarray:
        """The privileged observation (P,) of fish i, or (B,P) of all, with the present factors."""
        return np.concatenate([self._privileged[i], factors_of(self.tank, i)], axis=-1, dtype=np.float32)

    def drawn(self, i: int) -> dict[str, float]:
        """What was drawn of `variation`, or set by options, for the episode of fish i."""
        return {name: float(value) for name, value in zip(VARIATIONS, self._drawn[i], strict=True) if value == value}

    def step_info(self, i: int) -> dict[str, Any]:
        """The last step of fish i: reward terms (0 before one), position (3,) in body lengths, heading in radians."""
        forward = self._pose.axes[i, 0]
        found = self._arrays["terms"][:, i].tolist() if self._elapsed[i] > 0 else [0.0] * len(self._names)
        terms = dict(zip(self._names, found, strict=True))
        return {
            **{f"term_{name}": term for name, term in terms.items()},
            "step_terms": terms,
            "position": self._pose.centre[i] / self.tank.fish.length,
            "heading": float(np.arctan2(forward[1], forward[0])),
        }
