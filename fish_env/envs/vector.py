"""FishVectorEnv: a batch of fish as a Gymnasium `VectorEnv`, with all three autoreset modes."""

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import gymnasium as gym
import numpy as np
from gymnasium.vector import AutoresetMode, VectorEnv

from fish_env.checks import check_names
from fish_env.envs.episode import Episodes
from fish_env.envs.layout import row_of
from fish_env.envs.options import call_each, checked_picture, checked_seeds, checked_truth, set_option
from fish_env.tasks.base import CompiledTask
from fish_env.tasks.options import Keywords, keywords_of

OF_SB3 = ("step_async", "step_wait", "env_method", "env_is_wrapped", "get_images", "has_attr", "seed", "set_options")
"""Methods of a `VecEnv` of Stable-Baselines3 that a Gymnasium batch lacks."""
FOR_SB3 = "for Stable-Baselines3, make the batch by fish_env.make_sb3_vec_env(id, num_envs)"


class FishVectorEnv(Keywords, Episodes, VectorEnv):
    """A batch of fish, each in water of its own, stepped by one compiled call.

    Fish i of a batch seeded s is, bit for bit, the fish of a single environment seeded s + i.

    Args:
        num_envs: B, the number of fish.
        task: a key of `fish_env.TASKS`.
        body: a key of `fish_env.BODIES`, or a `Fish` from `fish_env.make_fish`.
        integrator: a key of `fish_env.INTEGRATORS`.
        dt: integrator step, s; None takes the fish's own.
        control_interval: time of an environment step, s, a whole multiple of dt; None takes the fish's own.
        water: "none", "drag" or "reactive", the fish's own with inertia; keywords of `fish_env.make_water`, or its
            result; None is the water the fish is made for.
        muscle_groups: "muscles", an action for each muscle, or "pairs", one for the left and one for the right side
            of each segment (the upper and lower muscle contract together: for planar scenes).
        variation: what differs from fish to fish, drawn at every reset: a number or a pair (lowest, highest) for keys
            of `fish_env.envs.VARIATIONS`, such as `{"stiffness": (0.8, 1.25), "current": (0, 0.5)}`; what was drawn is
            in `info["variation"]` of a reset and of the end of an episode.
        max_episode_steps: environment steps after which an episode is truncated; None or -1 for no limit.
        autoreset_mode: an `AutoresetMode` or its value, "NextStep", "SameStep" or "Disabled".
        render_mode: None, "rgb_array", "rgb_array_list" (`render` returns all since it was last called) or "human".
        width, height: size of a picture, pixels, 32 to 4096.
        camera: "above", from above; "side", from the fish's right, turning with it about the vertical; "follow", from
            above, turning with it so that its nose points up. All move with the fish; the shorter side of the picture
            is two body lengths.
        panel: whether a picture has numbers, a scale and a small second view; it is then at least 320 x 240.
        info_every_step: fill `info` after every reset and step: the reward terms, position and heading of the step,
            and the summary of the episode so far without what does not exist yet, such as the latency of a turn that
            is not made; else `info` is empty until its end.
        threads: over how many threads the fish are shared out; None for all processors.
        dtype: "float64" or "float32", what the physics calculates in (`Tank`).
        lanes: how many fish a kernel works on at once; None chooses.
        refine: relative change of a spring's length in a step above which shorter steps are taken; None is the fish's.
        observation: "nodes", positions and velocities of all nodes, or "sensors", what a robot could measure
            (`Layout`).
        privileged: put all nodes as they are, without noise and delay, and the factors of the fish into
            `info["privileged"]` of every step, for the critic of a learner.
        history: how many actions and observations before the present one an observation ends with.
        observation_noise: standard deviation of normal noise by part of the layout, such as `{"velocity": 0.05}`.
        action_noise: standard deviation of normal noise on the actions.
        observation_delay: environment steps after which an observation arrives: a number, or a pair (lowest, highest)
            to draw it from at every reset.
        action_delay: environment steps after which an action arrives, likewise; until then the muscles relax.
        failure_penalty: what a failure of the physics costs, body lengths.
        task_options: keywords of the task, weights of its reward included.

    Raises:
        ValueError: for anything unknown or not allowed, saying what is.
    """

    metadata = {
        "render_modes": ["human", "rgb_array", "rgb_array_list"],
        "render_fps": 30,
        "autoreset_mode": AutoresetMode.NEXT_STEP,
    }
    LIVE = (*Episodes.LIVE, "info_every_step")
    _renderer = None

    def __init__(
        self,
        num_envs: int = 1,
        *,
        autoreset_mode: AutoresetMode | str = AutoresetMode.NEXT_STEP,
        render_mode: str | None = None,
        width: int = 640,
        height: int = 480,
        camera: str = "above",
        panel: bool = True,
        info_every_step: bool = False,
        **options,
    ):
        check_render_mode(render_mode, self.metadata["render_modes"])
        self.picture = checked_picture(width, height, camera, panel)
        self.info_every_step = checked_truth(info_every_step, "info_every_step")
        super().__init__(num_envs, **options)
        mode = getattr(autoreset_mode, "value", autoreset_mode)
        check_names("unknown autoreset_mode", [each.value for each in AutoresetMode], mode)
        self.autoreset_mode = AutoresetMode(mode)
        self.render_mode = render_mode
        self.metadata = self.metadata | {"autoreset_mode": self.autoreset_mode, "render_fps": 1 / self.control_interval}
        self._pictures: list[list[np.ndarray]] = [[] for _ in range(self.num_envs)]  # not yet handed out
        self.changed: dict[str, Any] = {}  # what was set while it runs, as it was given
        own = keywords_of(type(self.task))
        if isinstance(self.task, CompiledTask):
            self.task._keywords = frozenset(own)
        self._keywords = frozenset({*own, *keywords_of(Episodes), *keywords_of(FishVectorEnv)})

    def restart(self, mask, seeds=None, options=None) -> None:
        """Begin an episode for the fish of the boolean mask (B,), reseeding those whose seed is not None."""
        if self.render_mode == "human":
            self._draw()  # an error without a display, before anything is compiled
        super().restart(mask, seeds, options)
        if self._renderer is not None:
            self._renderer.restart(mask)
            for i in np.flatnonzero(mask):
                self._pictures[i].clear()

    def reset(self, *, seed: int | Sequence[int | None] | None = None, options: dict[str, Any] | None = None):
        """Begin new episodes: all of them, or those of `options["reset_mask"]`, (B,) bool.

        Other options are keys of `reset_options`. Seeds: one number s for s, s+1, ..., or one a fish.

        Raises:
            ValueError: for an option or a mask that is not allowed, or another number of seeds; nothing has changed
                then.
            gymnasium.error.Error: and ValueError: for a seed that is no whole number, or negative; as before.
        """
        seeds = checked_seeds(seed, self.num_envs)
        if not isinstance(options, Mapping | None):
            raise ValueError(f"options is {options!r}; give a dict with keys among {', '.join(self.reset_options)}")
        options = dict(options or {})
        mask = options.pop("reset_mask", None)
        if mask is None:
            mask = np.ones(self.num_envs, dtype=bool)
        elif not isinstance(mask, np.ndarray) or mask.dtype != bool or mask.shape != (self.num_envs,) or not mask.any():
            raise ValueError(f"reset_mask is {mask!r}; give a boolean array ({self.num_envs},) with at least one True")
        self.restart(mask, seeds, options)
        self._show(mask)
        infos: dict[str, Any] = {}
        if self.info_every_step:
            for i in np.flatnonzero(mask).tolist():
                infos = self._add_info(infos, self._info(i, True), i)
        return self.observe(), self._add_state_info(infos, mask)

    def _info(self, i: int, begins: bool = False) -> dict[str, Any]:
        """What `info` says of fish i in any step and after a reset: the step and the episode so far, or little."""
        if self.info_every_step:
            info = self.step_info(i) | self.episode_info(i)
            return {name: value for name, value in info.items() if not isinstance(value, float) or value == value}
        if begins:
            return self.state_info(i)
        return {"privileged": self.observe_all(i)} if self.privileged else {}

    def _add_state_info(self, infos: dict[str, Any], mask: np.ndarray) -> dict[str, Any]:
        """Add what was drawn for the fish of the mask (B,), whose episodes begin, and what is privileged of all."""
        if mask.any() and not self.info_every_step and not np.isnan(self._drawn[mask]).all():
            for i in np.flatnonzero(mask).tolist():
                infos = self._add_info(infos, {"variation": self.drawn(i)}, i)
        if self.privileged:
            infos |= {"privileged": self.observe_all(), "_privileged": np.ones(self.num_envs, dtype=bool)}
        return infos

    def step(self, actions: np.ndarray):
        """One control interval for every fish; episodes that have ended restart as `autoreset_mode` says."""
        restarting = self._over
        if self.autoreset_mode is AutoresetMode.DISABLED and restarting.any():
            raise gym.error.ResetNeeded(
                f"fish {np.flatnonzero(restarting).tolist()} are at the end of an episode and autoreset is disabled; "
                "call env.reset(options={'reset_mask': terminated | truncated})"
            )
        if restarting.any() and np.shape(actions) == self._action_shape:  # NEXT_STEP: their action is ignored
            actions = np.array(actions)
            actions[restarting] = 0
        reward, terminated, truncated = self.advance(actions)
        if restarting.any():
            self.restart(restarting)
            reward[restarting] = 0.0
            terminated[restarting] = truncated[restarting] = False
        over, begun = terminated | truncated, restarting
        infos: dict[str, Any] = {}
        obs = self.observe()
        if self.autoreset_mode is AutoresetMode.SAME_STEP and over.any():
            for i in np.flatnonzero(over).tolist():
                info = self.episode_info(i) | (self.step_info(i) if self.info_every_step else {})
                infos = self._add_info(infos, {"final_obs": row_of(obs, i), "final_info": info}, i)
            self.restart(over)  # after it, no episode is over
            obs, begun = self.observe(), over
        over = self._over
        for i in range(self.num_envs) if self.info_every_step else np.flatnonzero(over).tolist():
            infos = self._add_info(infos, self._info(i) | (self.episode_info(i) if over[i] else {}), i)
        infos = self._add_state_info(infos, begun)
        if self.render_mode is not None:
            self._show()
        return obs, reward, terminated, truncated, infos

    @property
    def _over(self) -> np.ndarray:
        """(B,) the fish whose episodes have ended and not begun again."""
        return self._terminated | self._truncated

    def set_state(self, state, indices=None) -> np.ndarray:
        """As `Stateful.set_state`; what is shown follows."""
        obs = super().set_state(state, indices)
        mask = np.zeros(self.num_envs, dtype=bool)
        mask[slice(None) if indices is None else indices] = True
        if self._renderer is not None:
            self._renderer.restart(mask)
        if self.render_mode is not None and self._started:
            self._show(mask)
        return obs

    def _show(self, mask: np.ndarray | None = None) -> None:
        """Show all fish in the window, or keep the pictures of those of the mask (B,), as the render mode wants."""
        if self.render_mode == "human":
            self.render()
        elif self.render_mode == "rgb_array_list":
            for i, picture in enumerate(self._draw().render() or ()):
                if mask is None or mask[i]:
                    self._pictures[i].append(picture)

    def render(self) -> Any:
        """Pictures of the fish: a tuple of B arrays (H,W,3) uint8, or None after drawing to the window ("human").

        With "rgb_array_list" it is a tuple of B lists: the pictures since the last call, or since the episode began.
        """
        if self.render_mode is None:
            gym.logger.warn("render was called without a render_mode; pass render_mode='rgb_array' to gym.make_vec")
            return None
        if self.render_mode == "rgb_array_list":
            taken, self._pictures = tuple(self._pictures), [[] for _ in range(self.num_envs)]
            return taken
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
        if "tank" in self.__dict__:  # not in an environment whose options were rejected
            self.tank.close()

    def call(self, name: str, *args, **kwargs) -> tuple[Any, ...]:
        """Value of an attribute, or result of a method, for each fish, as `SyncVectorEnv.call`."""
        return tuple(call_each(self, name, range(self.num_envs), *args, **kwargs))

    def get_attr(self, name: str, *indices: Any) -> tuple[Any, ...]:
        """The attribute, once for each fish; AttributeError if there is none. Only Stable-Baselines3 gives indices."""
        if indices:
            raise TypeError(f"this {type(self).__name__} is Gymnasium's kind of batch; {FOR_SB3}")
        return self.call(name)

    if not TYPE_CHECKING:  # which would take every name for an attribute

        def __getattr__(self, name: str):
            said = f"{type(self).__name__!r} object has no attribute {name!r}{f'; {FOR_SB3}' if name in OF_SB3 else ''}"
            raise AttributeError(said, name=name, obj=self)

    def set_attr(self, name: str, values: Any) -> None:
        """Set an option of `settable` for the episodes that begin next: one value, or a list or tuple of one a fish.

        Weights of the reward count from the next step.

        Raises:
            AttributeError: for any other option, naming those that can be set.
            ValueError: for a value that is not allowed, another number of values, or values that differ: the fish of a
                batch share them.
        """
        given = list(values) if isinstance(values, list | tuple) else [values] * self.num_envs
        if len(given) != self.num_envs or not all(np.all(other == given[0]) for other in given):
            same = f"{self.num_envs} that are the same"
            raise ValueError(
                f"{name} would be {values!r}; give one value, or {same}: a pair as [pair] * {self.num_envs}"
            )
        set_option(self, name, given[0])

    @property
    def settable(self) -> tuple[str, ...]:
        """The keywords that may be set while it runs."""
        return (*self.LIVE, *getattr(self.task, "settable", ()))

    @property
    def np_random(self) -> tuple[np.random.Generator | None, ...]:
        """One random generator a fish; None before its first episode."""
        return tuple(self._generators)

    @property
    def np_random_seed(self) -> tuple[int | None, ...]:
        """The seeds they began with."""
        return tuple(self._seeds)

    def __getstate__(self):
        return super().__getstate__() | {"_renderer": None}


def check_render_mode(mode, allowed: list[str]) -> None:
    """ValueError unless a render mode is None or among those allowed."""
    if mode is not None:
        check_names("unknown render_mode", allowed, mode)


def make_batch(id: str, num_envs: int, **options) -> FishVectorEnv:
    """A registered batch of fish without wrappers: `gym.make_vec`, which may make anything, and a check."""
    # ValueError, or Gymnasium's error, for an id or an option that is not allowed.
    mode = gym.VectorizeMode.VECTOR_ENTRY_POINT
    try:
        batch = gym.make_vec(id, num_envs, vectorization_mode=mode, **options).unwrapped
    except (AttributeError, ImportError) as error:  # Gymnasium's, for no text and for no such module
        raise ValueError(f"id is {id!r}, which names no environment: {error}") from error
    if not isinstance(batch, FishVectorEnv):
        batch.close()
        raise ValueError(f"{id!r} is a {type(batch).__name__}; give an environment whose batches are a FishVectorEnv")
    return batch
