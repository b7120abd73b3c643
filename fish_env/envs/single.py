"""FishEnv: one fish, the Gymnasium `Env`. It is the vector environment with one fish in it."""

import sys
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium.wrappers import TimeLimit

from fish_env.bodies import Fish
from fish_env.checks import finite_array
from fish_env.envs.layout import Layout, row_of
from fish_env.envs.options import check_settable, checked_seed
from fish_env.envs.senses import check_delays
from fish_env.envs.state import FishState
from fish_env.envs.vector import FishVectorEnv, check_render_mode
from fish_env.physics.linearise import Jacobians
from fish_env.physics.tank import Tank
from fish_env.physics.tank_options import checked_count
from fish_env.tasks.options import Keywords


class FishEnv(Keywords, gym.Env):
    """One fish in water. Keywords are those of `FishVectorEnv`; the time limit is `gym.make`'s `TimeLimit`.

    The page of each task, with its tables of actions, observations and rewards, is in docs/envs/.
    """

    metadata = {"render_modes": ["human", "rgb_array"], "render_fps": 30}
    vector_class = FishVectorEnv

    def __init__(self, render_mode: str | None = None, **options):
        if given := {"autoreset_mode", "num_envs", "n_envs"} & options.keys():
            raise ValueError(f"{given.pop()} is for batches (gym.make_vec); gym.make makes one fish")
        check_render_mode(render_mode, self.metadata["render_modes"])  # lists are Gymnasium's `RenderCollection`
        options.setdefault("threads", 1)
        self.fish = self.vector_class(1, render_mode=render_mode, **options)
        self.render_mode = render_mode
        self.metadata = self.metadata | {"render_fps": self.fish.metadata["render_fps"]}
        self.observation_space = self.fish.single_observation_space
        self.action_space = self.fish.single_action_space
        if self.fish._goals is not None:
            self.compute_reward = self.fish.compute_reward
        self.settable = tuple(name for name in self.fish.settable if name != "max_episode_steps")  # the wrapper's
        self._own = frozenset(vars(self))  # attributes that are no subclass's
        self._keywords = self.fish._keywords

    @property
    def tank(self) -> Tank[Fish]:
        """The physics: a `Tank` with one fish."""
        return self.fish.tank

    @property
    def layout(self) -> Layout:
        """The named parts of the observation: `obs[env.unwrapped.layout["velocity"].slice]`."""
        return self.fish.layout

    @property
    def interface(self) -> dict[str, Any]:
        """As `FishVectorEnv.interface`."""
        return self.fish.interface

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None):
        """Begin an episode. `options` are keys of `env.unwrapped.fish.reset_options`.

        Raises:
            ValueError: for an option that is unknown or out of range, or a time limit that has been set to what is not
                allowed; nothing has changed then.
            gymnasium.error.Error: and ValueError: for a seed that is no whole number, or negative; as before.
        """
        self._limits = limits_of(self)
        self.fish.checked_reset(options)  # before the generator is another
        self._time_limit()
        super().reset(seed=checked_seed(seed))
        self.fish._generators[0] = self.np_random
        self.fish.restart(np.ones(1, dtype=bool), None, options)
        if self.render_mode == "human":
            self.render()
        return row_of(self.fish.observe(), 0), self.fish._info(0, True)

    def step(self, action: np.ndarray):
        """One control interval: observation, reward, terminated, truncated, info."""
        fish = self.fish
        if type(action) is not np.ndarray:
            action = finite_array(action, self.action_space.shape, "action")
        fish._take_action(action[None])
        terminated, truncated = fish._terminated.item(), fish._truncated.item()
        info = fish._info(0) if fish.info_every_step or fish.privileged else {}  # a call less in most steps
        if terminated or truncated or any(each._elapsed_steps + 1 >= each._max_episode_steps for each in self._limits):
            info |= self.episode_info()
        if self.render_mode == "human":
            self.render()
        obs = fish._observation[0].copy() if fish._goals is None else row_of(fish.observe(), 0)
        return obs, fish._reward.item(), terminated, truncated, info

    def _time_limit(self) -> int | None:
        """Steps after which a `TimeLimit` truncates, None without one; ValueError for a limit that is not allowed."""
        limits = [checked_count(each._max_episode_steps, "max_episode_steps") for each in self._limits]
        limit = min(limits, default=None)
        check_delays(self.fish._senses, limit)
        return limit

    def get_state(self) -> FishState:
        """All that decides what happens next, as `FishVectorEnv.get_state`, the limit of a `TimeLimit` included."""
        self.fish._generators[0] = self.np_random  # which may be another by now
        state, limit = self.fish.get_state(), self._time_limit()
        if limit is not None:
            arrays = state.arrays
            least = np.minimum(arrays["episode.limit"], limit, out=arrays["episode.limit"])
            arrays["episode.truncated"] |= ~arrays["episode.terminated"] & (arrays["episode.elapsed"] >= least)
        return state

    def set_state(self, state: FishState) -> Any:
        """Go on from a state of one fish, as `FishVectorEnv.set_state`; every `TimeLimit` counts its steps from there.

        The episode is truncated at the limit of the state, or of the `TimeLimit` if that is shorter.

        Returns:
            The observation, (D,) float32, or a dict of the task's `goals`.

        Raises:
            ValueError: for a state of another task, body, layout or format, or of several fish; nothing has changed.
            gymnasium.error.ResetNeeded: before the first `reset`.
        """
        if not self.fish._started:
            raise gym.error.ResetNeeded("set_state was called before reset; call env.reset() first")
        self.fish._generators[0] = self.np_random
        obs = row_of(self.fish.set_state(state), 0)
        for wrapper in self._limits:
            wrapper._elapsed_steps = int(self.fish._elapsed[0])
        return obs

    def linearise(self, action: np.ndarray) -> Jacobians:
        """Derivatives (S,S) and (S,A) of the fish's state after a step, as `FishVectorEnv.linearise`; nothing moves."""
        return Jacobians(*(each[0] for each in self.fish.linearise(np.asarray(action)[None])))

    def episode_info(self) -> dict[str, Any]:
        """Summary of the episode so far: reward terms, the task's metrics, seconds, the failure if any.

        The last step of an episode returns it in `info`, also under a `TimeLimit` through which `reset` was called.
        """
        return self.fish.episode_info(0)

    def get_wrapper_attr(self, name: str) -> Any:
        """The value of an option of `settable`, or of an attribute; AttributeError for others."""
        if name in self.settable:
            return self.fish.get_attr(name)[0]
        return super().get_wrapper_attr(name)

    def set_wrapper_attr(self, name: str, value: Any, *, force: bool = True) -> bool:
        """Set an option of `settable` for the episodes that begin next, or a subclass's attribute.

        AttributeError for any other name, naming those that can be set; ValueError for a value that is not allowed.
        """
        if name in vars(self).keys() - self._own and not name.startswith("_"):
            return super().set_wrapper_attr(name, value, force=force)
        if name == "max_episode_steps":
            raise AttributeError("the time limit of one fish is its wrapper's: give '_max_episode_steps' instead")
        check_settable(name, self.settable)
        self.fish.set_attr(name, [value])
        return True

    def render(self):
        """A picture (H,W,3) uint8, or None after drawing to the window ("human")."""
        frames = self.fish.render()
        return None if frames is None else frames[0]

    def close(self):
        """Close the window."""
        self.fish.close()


def limits_of(env: gym.Env) -> list[Any]:
    """The time limits round an environment through which its `reset` is called, which is being called."""
    # Gymnasium does not tell an environment what is wrapped round it, so they are looked for among the callers.
    found, frame = [], sys._getframe(1)
    while frame is not None:
        caller = frame.f_locals.get("self") if frame.f_code.co_name == "reset" else None
        if isinstance(caller, TimeLimit) and caller.unwrapped is env:
            found.append(caller)
        frame = frame.f_back
    return found
