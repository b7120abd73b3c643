"""An environment runner for Ray RLlib that steps a whole batch of fish at once. Needs the extra [cluster].

    PPOConfig().environment("FishEnv/Swim-v0").env_runners(env_runner_cls=FishEnvRunner, num_envs_per_env_runner=256)

RLlib's own runner calls Python a few times for every environment and step. This one keeps a rollout in arrays and makes
RLlib's episodes of them when it is over. Connectors between environment and module, and callbacks of single steps, are
not called: the module sees the observations as the fish have them, and its actions are clipped to the action space.
"""

import gc
import uuid
from collections.abc import Iterator
from time import perf_counter
from typing import Any, NamedTuple

import numpy as np
from gymnasium.spaces import Box

try:
    import torch
    from ray.rllib.core.columns import Columns
    from ray.rllib.env.single_agent_env_runner import SingleAgentEnvRunner
    from ray.rllib.env.single_agent_episode import SingleAgentEpisode
    from ray.rllib.utils.metrics import WEIGHTS_SEQ_NO
except ImportError as error:
    raise ImportError('fish_env.envs.rllib needs Ray RLlib and torch: pip install "fish_env[cluster]"') from error

from fish_env.envs.vector import make_batch

FISH = "fish"
"""The key of `result["env_runners"]` under which the metrics of the task are found, as means over episodes."""


class Rollout(NamedTuple):
    """Observations, actions and rewards of B fish in T environment steps."""

    obs: np.ndarray  # (T,B,D) float32, before each step
    after: dict[tuple[int, int], np.ndarray]  # (D,), what was seen at the end of an episode, by step and fish
    last: np.ndarray  # (B,D), after the last step
    actions: np.ndarray  # (T,B,A) float32, as the module drew them
    rewards: np.ndarray  # (T,B) float32
    terminated: np.ndarray  # (T,B) bool
    truncated: np.ndarray  # (T,B) bool
    extra: dict[str, np.ndarray]  # (T,B,...), what else the module returned


class FishEnvRunner(SingleAgentEnvRunner):
    """A rollout of a batch of fish (`FishVectorEnv`), in arrays. The keywords of the environment are `env_config`.

    `env_config` may have `staggered` as well: whether the first episodes are shortened so that the fish do not all end
    theirs together (True without it). A runner has `num_envs_per_env_runner` fish.
    """

    def make_env(self) -> None:
        """Make the batch of fish.

        Raises:
            ValueError: for an environment that is not one of fish, or an option that is not allowed.
        """
        if self.env is not None:
            self.env.close()
        options = dict(self.config.env_config)
        self._staggered = options.pop("staggered", True)
        if not isinstance(self.config.env, str):
            raise ValueError(f"the environment is {self.config.env!r}; give the id of one of fish: 'FishEnv/Swim-v0'")
        options.setdefault("threads", 1)  # a runner has one processor
        try:
            self.env = make_batch(self.config.env, self.config.num_envs_per_env_runner, **options)
        except TypeError as error:
            raise ValueError(
                f"{self.config.env!r} does not take {sorted(options)} ({error}); give an environment of fish"
            ) from error
        if not isinstance(self.env.single_observation_space, Box):
            raise ValueError("the environment observes goals, which this runner does not know; leave out goal_env")
        self.num_envs = self.env.num_envs
        self._needs_initial_reset = True

    def make_module(self) -> None:
        """Make the policy; in a process of its own, the garbage collector leaves alone what is there by then."""
        super().make_module()
        if self.worker_index:
            gc.freeze()

    def _sample(
        self, *, num_timesteps=None, num_episodes=None, explore, random_actions=False, force_reset=False
    ) -> list[SingleAgentEpisode]:
        """Episodes, or parts of them, of at least so many steps or so many ended episodes."""
        if num_timesteps is None:
            return self._sample_episodes(num_episodes, explore, random_actions)
        if force_reset or self._needs_initial_reset:
            self._begin()
        rollout = self._roll(-(-num_timesteps // self.num_envs), explore, random_actions)
        return self._episodes(rollout)

    def _sample_episodes(self, num_episodes: int, explore: bool, random_actions: bool) -> list[SingleAgentEpisode]:
        """Whole episodes, of fish that begin together; the runner begins again afterwards."""
        self._begin(staggered=False)
        found: list[SingleAgentEpisode] = []
        parts: list[SingleAgentEpisode] = []
        while len(found) < num_episodes:
            parts += self._episodes(self._roll(1, explore, random_actions))
            whole = {part.id_ for part in parts if part.is_done}
            for name in whole:
                pieces = [part for part in parts if part.id_ == name]
                for piece in pieces[1:]:
                    pieces[0].concat_episode(piece)
                found.append(pieces[0])
            parts = [part for part in parts if part.id_ not in whole]
        self._needs_initial_reset = True
        return found[:num_episodes]

    def _begin(self, staggered: bool | None = None) -> None:
        self.env.reset(seed=self._seed if self._needs_initial_reset else None)
        if self._staggered if staggered is None else staggered:
            self.env.stagger()
        self._needs_initial_reset = False
        self._names = [uuid.uuid4().hex for _ in range(self.num_envs)]
        self._lengths, self._returns = np.zeros(self.num_envs, dtype=int), np.zeros(self.num_envs)
        self._handed_over = np.zeros(self.num_envs, dtype=int)  # steps of the episodes that are under way
        self._begun = np.full(self.num_envs, perf_counter())

    def _act(self, obs: np.ndarray, explore: bool, random_actions: bool) -> dict[str, np.ndarray]:
        """Outputs of the module for the observations (B,D), with the actions that are drawn from them."""
        if random_actions:
            return {Columns.ACTIONS: self.env.action_space.sample()}
        with torch.inference_mode():
            batch = {Columns.OBS: torch.from_numpy(obs)}
            forward = self.module.forward_exploration if explore else self.module.forward_inference
            given = forward(batch)
            inputs = given[Columns.ACTION_DIST_INPUTS]
            if not explore:
                kind = self.module.get_inference_action_dist_cls()
                return {Columns.ACTIONS: kind.from_logits(inputs).to_deterministic().sample().numpy()}
            drawn = self.module.get_exploration_action_dist_cls().from_logits(inputs)
            actions = drawn.sample()
            return {
                Columns.ACTIONS: actions.numpy(),
                Columns.ACTION_DIST_INPUTS: inputs.numpy(),
                Columns.ACTION_LOGP: drawn.logp(actions).numpy(),
            }

    def _roll(self, steps: int, explore: bool, random_actions: bool) -> Rollout:
        """Step all fish so many times."""
        env, seen, done_by = self.env, [], []
        after: dict[tuple[int, int], np.ndarray] = {}
        obs = env.observe()
        low, high = env.single_action_space.low, env.single_action_space.high
        for t in range(steps):
            given = self._act(obs, explore, random_actions)
            reward, terminated, truncated = env.advance(np.clip(given[Columns.ACTIONS], low, high))
            seen.append((obs, reward, terminated, truncated))
            done_by.append(given)
            obs = env.observe()
            self._lengths += 1
            self._returns += reward
            ended = terminated | truncated
            if ended.any():
                for i in np.flatnonzero(ended).tolist():
                    after[t, i] = obs[i]
                    self._report(i)
                env.restart(ended)
                obs = env.observe()
        columns = {name: np.stack([given[name] for given in done_by]) for name in done_by[0]}
        arrays = [np.stack(column) for column in zip(*seen, strict=True)]
        arrays[1] = arrays[1].astype(np.float32)
        return Rollout(arrays[0], after, obs, columns.pop(Columns.ACTIONS), *arrays[1:], extra=columns)

    def _report(self, i: int) -> None:
        """Log the summary of the episode of fish i."""
        now = perf_counter()
        self._log_episode_metrics(int(self._lengths[i]), float(self._returns[i]), now - self._begun[i])
        window = max(1, self.config.metrics_num_episodes_for_smoothing // (self.config.num_env_runners or 1))
        info = self.env.episode_info(i)
        for name, value in info.items():
            if isinstance(value, int | float) and np.isfinite(value):
                self.metrics.log_value((FISH, name), float(value), window=window)
        self.metrics.log_value((FISH, "failed"), float(info["failure"] != ""), window=window)
        self._lengths[i], self._returns[i], self._begun[i] = 0, 0.0, now

    def _episodes(self, rollout: Rollout) -> list[SingleAgentEpisode]:
        """RLlib's episodes of a rollout: one for each fish, and one more for each end of an episode within it."""
        found = [self._episode(rollout, *part) for part in self._parts(rollout)]
        count = len(rollout.rewards) * self.num_envs
        self._log_env_steps(metric=self._metrics_num_env_steps_sampled, num_steps=count)
        self._increase_sampled_metrics(count, len(rollout.after))
        return found

    def _parts(self, rollout: Rollout) -> Iterator[tuple[int, int, int]]:
        """Fish, first step and step after the last of each part of an episode."""
        steps = len(rollout.rewards)
        ends = rollout.terminated | rollout.truncated
        for i in range(self.num_envs):
            first = 0
            for t in np.flatnonzero(ends[:, i]).tolist():
                yield i, first, t + 1
                first = t + 1
            if first < steps:
                yield i, first, steps

    def _episode(self, rollout: Rollout, i: int, first: int, end: int) -> SingleAgentEpisode:
        part, last = slice(first, end), end - 1
        over = (last, i) in rollout.after
        seen = rollout.obs[end, i] if not over and end < len(rollout.obs) else rollout.last[i]
        seen = rollout.after.get((last, i), seen)
        extra: dict[str, Any] = {name: column[part, i] for name, column in rollout.extra.items()}
        extra[WEIGHTS_SEQ_NO] = np.full(end - first, self._weights_seq_no)
        episode = SingleAgentEpisode(
            id_=self._names[i],
            observations=np.concatenate([rollout.obs[part, i], seen[None]]),
            actions=rollout.actions[part, i],
            rewards=rollout.rewards[part, i],
            infos=[{}] * (end - first + 1),
            terminated=bool(rollout.terminated[last, i]),
            truncated=bool(rollout.truncated[last, i]),
            extra_model_outputs=extra,
            observation_space=self.env.single_observation_space,
            action_space=self.env.single_action_space,
            t_started=int(self._handed_over[i]),
            len_lookback_buffer=0,
        )
        self._handed_over[i] += end - first
        if over:
            self._names[i], self._handed_over[i] = uuid.uuid4().hex, 0
        return episode
