"""A native Stable-Baselines3 `VecEnv`: the batch of fish with `dones` and a list of dicts. Needs the extra [train]."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from gymnasium.vector import AutoresetMode

try:
    from stable_baselines3.common.vec_env import VecEnv, VecMonitor
except ImportError as error:
    raise ImportError('fish_env.envs.sb3 needs Stable-Baselines3: pip install "fish_env[train]"') from error

from fish_env.envs.layout import row_of
from fish_env.envs.options import call_each, checked_seed, found_in
from fish_env.envs.state import FishState
from fish_env.envs.vector import FishVectorEnv, check_render_mode
from fish_env.tasks.options import Keywords

__all__ = ["FishVecEnv", "VecEnv", "VecMonitor"]


class FishVecEnv(Keywords, VecEnv):
    """`FishVectorEnv` as Stable-Baselines3 wants it. Episodes restart in the step in which they end."""

    def __init__(self, fish: FishVectorEnv, staggered: bool = False):
        check_render_mode(fish.render_mode, ["human", "rgb_array"])
        self.fish, self.staggered = fish, staggered
        fish._set_read_only(autoreset_mode=AutoresetMode.SAME_STEP)
        super().__init__(fish.num_envs, fish.single_observation_space, fish.single_action_space)
        self.metadata, self.settable, self._keywords = fish.metadata, fish.settable, fish._keywords

    def reset(self) -> Any:
        """Restart all episodes with the seeds and options set before, and return the observations."""
        options = self._options[0] or {}
        if any((other or {}) != options for other in self._options):
            raise ValueError("fish of one batch share their reset options; set_options takes one dict for all")
        self.fish.restart(np.ones(self.num_envs, dtype=bool), self._seeds, options)
        if self.staggered:
            self.fish.stagger()
        self.reset_infos = [self.fish._info(i, True) for i in range(self.num_envs)]
        self._reset_seeds()
        self._reset_options()
        self.fish._show()
        return self.fish.observe()

    def seed(self, seed: int | None = None) -> Sequence[int | None]:
        """Let fish i begin from seed + i at the next reset; None for any. ValueError for a seed that is not allowed."""
        return super().seed(checked_seed(seed))

    def step_async(self, actions: np.ndarray) -> None:
        """Keep the actions for `step_wait`."""
        self._actions = actions

    def step_wait(self):
        """One control interval: observations, rewards float32, dones, infos."""
        reward, terminated, truncated = self.fish.advance(self._actions)
        obs = self.fish.observe()
        done = terminated | truncated
        infos: list[dict[str, Any]] = [self.fish._info(i) for i in range(self.num_envs)]
        if done.any():
            ended = np.flatnonzero(done).tolist()
            for i in ended:
                infos[i] |= self.fish.episode_info(i)
                infos[i]["terminal_observation"] = row_of(obs, i)
                infos[i]["TimeLimit.truncated"] = bool(truncated[i])
            self.fish.restart(done)
            for i in ended:
                self.reset_infos[i] = self.fish._info(i, True)
            obs = self.fish.observe()
        self.fish._show()
        return obs, reward.astype(np.float32), done, infos

    def get_state(self, indices=None) -> FishState:
        """As `FishVectorEnv.get_state`; monitors and other wrappers have sums of their own, which are no part of it."""
        return self.fish.get_state(indices)

    def set_state(self, state: FishState | Sequence[FishState], indices=None) -> np.ndarray:
        """As `FishVectorEnv.set_state`: the observations of all fish."""
        return self.fish.set_state(state, indices)

    def close(self) -> None:
        """Close the window and the threads."""
        self.fish.close()

    def get_images(self) -> Sequence[np.ndarray | None]:
        """A picture of each fish."""
        return self.fish.render() or [None] * self.num_envs

    def get_attr(self, attr_name: str, indices=None) -> list[Any]:
        """The attribute for each selected fish, of methods those of the batch; AttributeError if there is none."""
        which, found = list(self._get_indices(indices)), found_in(self.fish, attr_name)
        return [found] * len(which) if callable(found) else call_each(self.fish, attr_name, which)

    def set_attr(self, attr_name: str, value: Any, indices=None) -> None:
        """Set an option of `FishVectorEnv.settable` for the episodes that begin next, for all fish: they share it.

        Raises:
            AttributeError: for any other option, naming those that can be set.
            ValueError: for a value that is not allowed, or unless all fish are selected.
        """
        if set(self._get_indices(indices)) != set(range(self.num_envs)):
            raise ValueError("fish of one batch share their attributes; set it for all (indices=None)")
        self.fish.set_attr(attr_name, [value] * self.num_envs)

    def env_method(self, method_name: str, *method_args, indices=None, **method_kwargs) -> list[Any]:
        """Result of a method for each selected fish; ValueError for a method that acts on all, unless all are selected.

        `reset`, `render`, `episode_info`, `step_info`, `get_state` and `set_state` act on the selected fish only.
        """
        return call_each(self.fish, method_name, self._get_indices(indices), *method_args, **method_kwargs)

    def env_is_wrapped(self, wrapper_class, indices=None) -> list[bool]:
        """No fish of a batch is wrapped."""
        return [False] * len(list(self._get_indices(indices)))
