"""FishEnv: one fish, the Gymnasium `Env`. It is the vector environment with one fish in it."""

import copy
import sys
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium.wrappers import TimeLimit

from fish_env.bodies import Fish
from fish_env.checks import finite_array
from fish_env.envs.layout import Layout
from fish_env.envs.options import OwnSpec, checked_seed
from fish_env.envs.vector import FishVectorEnv, check_render_mode
from fish_env.physics.tank import Tank
from fish_env.physics.tank_options import checked_count


class FishEnv(OwnSpec, gym.Env):
    """One fish in water. Keywords are those of `FishVectorEnv`; the time limit is `gym.make`'s `TimeLimit`.

    The page of each task, with its tables of actions, observations and rewards, is in docs/envs/.
    """

    metadata = {"render_modes": ["human", "rgb_array"], "render_fps": 30}
    vector_class = FishVectorEnv

    def __init__(self, render_mode: str | None = None, **options):
        if "autoreset_mode" in options:
            raise ValueError("autoreset_mode is for batches (gym.make_vec); one fish waits for reset")
        if "num_envs" in options:
            raise ValueError("num_envs is for batches (gym.make_vec); gym.make makes one fish")
        check_render_mode(render_mode, self.metadata["render_modes"])  # lists are Gymnasium's `RenderCollection`
        options.setdefault("threads", 1)
        self.fish = self.vector_class(1, render_mode=render_mode, **options)
        self.render_mode = render_mode
        self.metadata = self.metadata | {"render_fps": self.fish.metadata["render_fps"]}
        self.observation_space = self.fish.single_observation_space
        self.action_space = self.fish.single_action_space
        self._own = frozenset(vars(self))  # attributes that are no subclass's

    @property
    def tank(self) -> Tank[Fish]:
        """The physics: a `Tank` with one fish."""
        return self.fish.tank

    @property
    def layout(self) -> Layout:
        """The named parts of the observation: `obs[env.unwrapped.layout["velocity"].slice]`."""
        return self.fish.layout

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None):
        """Begin an episode. `options` are keys of `env.unwrapped.fish.reset_options`.

        Raises:
            ValueError: for an option that is unknown or out of range, or a time limit that has been set to what is not
                allowed; nothing has changed then.
            gymnasium.error.Error: and ValueError: for a seed that is no whole number, or negative; as before.
        """
        self.fish.checked_reset(options)  # before the generator is another
        self._limit = time_limit(self)
        super().reset(seed=checked_seed(seed))
        self.fish._generators[0] = self.np_random
        self.fish.restart(np.ones(1, dtype=bool), None, options)
        if self.render_mode == "human":
            self.render()
        return self.fish.observe()[0], self.fish._info(0)

    def step(self, action: np.ndarray):
        """One control interval: observation, reward, terminated, truncated, info."""
        fish = self.fish
        if type(action) is not np.ndarray:
            action = finite_array(action, self.action_space.shape, "action")
        fish._take_action(action[None])
        terminated, truncated = fish._terminated.item(), fish._truncated.item()
        info = fish._info(0)
        if terminated or truncated or fish._elapsed[0] == self._limit:
            info |= self.episode_info()
        if self.render_mode == "human":
            self.render()
        return fish._observation[0].copy(), fish._reward.item(), terminated, truncated, info

    def episode_info(self) -> dict[str, Any]:
        """Summary of the episode so far: reward terms, the task's metrics, seconds, the failure if any.

        The last step of an episode returns it in `info`, also under a `TimeLimit` through which `reset` was called.
        """
        return self.fish.episode_info(0)

    def set_wrapper_attr(self, name: str, value: Any, *, force: bool = True) -> bool:
        """Set an option of `env.unwrapped.fish.settable` for the episodes that begin next, or a subclass's attribute.

        Raises:
            AttributeError: for any other name, naming the options that can be set.
            ValueError: for a value that is not allowed.
        """
        if name in vars(self).keys() - self._own and not name.startswith("_"):
            return super().set_wrapper_attr(name, value, force=force)
        if name == "max_episode_steps":
            raise AttributeError("the time limit of one fish is its wrapper's: give '_max_episode_steps' instead")
        self.fish.set_attr(name, [value])
        if self.spec is not None:
            self.spec.kwargs[name] = copy.deepcopy(value)  # what a recording says
        return True

    def render(self):
        """A picture (H,W,3) uint8, or None after drawing to the window ("human")."""
        frames = self.fish.render()
        return None if frames is None else frames[0]

    def close(self):
        """Close the window."""
        self.fish.close()


def time_limit(env: gym.Env) -> int | None:
    """After how many steps a `TimeLimit` truncates the episode that is being begun; None if there is none.

    Gymnasium does not tell an environment what is wrapped round it, so the wrapper is looked for among the callers of
    its `reset`; of several, the shortest counts. ValueError for a limit that is no whole number, at least 1.
    """
    limits, frame = [], sys._getframe(1)
    while frame is not None:
        if frame.f_code.co_name == "reset" and frame.f_code.co_varnames[:1] == ("self",):
            caller = frame.f_locals["self"]
            if isinstance(caller, TimeLimit) and caller.unwrapped is env:
                limits.append(checked_count(caller._max_episode_steps, "max_episode_steps"))
        frame = frame.f_back
    return min(limits, default=None)
