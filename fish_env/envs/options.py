"""Arguments of an environment: keywords and seeds that are checked, and options that are set while it runs."""

import copy
from collections.abc import Iterable, Sequence
from typing import Any

import gymnasium as gym
import numpy as np

from fish_env.bodies import BODIES, make_fish
from fish_env.checks import check_names, is_whole, similar
from fish_env.envs.layout import row_of
from fish_env.envs.variation import checked_variation
from fish_env.physics.fish import Fish
from fish_env.physics.tank_options import MOST_STEPS
from fish_env.tasks.base import CompiledTask
from fish_env.tasks.start import check_pose

OF_ONE = {"observation_space": "single_observation_space", "action_space": "single_action_space"}
"""Attributes of a single environment that a batch has under another name."""


class SeedError(gym.error.Error, ValueError):
    """A seed that is not allowed: Gymnasium's own error for it, and a ValueError as for everything else."""


def checked_seed(seed) -> int | None:
    """`seed` as an int or None; SeedError unless it is a whole number, zero or more; a truth value is 0 or 1."""
    if seed is not None and not ((is_whole(seed) or isinstance(seed, bool)) and seed >= 0):
        raise SeedError(f"seed is {seed!r}; give a whole number, zero or more, or None")
    return None if seed is None else int(seed)


def checked_seeds(seed, count: int) -> list[int | None]:
    """A seed for each of so many fish: s, s+1, ... of one number s, or those of a sequence; else SeedError."""
    if isinstance(seed, Sequence | np.ndarray) and getattr(seed, "ndim", 1) == 1:
        if len(seed) != count:
            raise SeedError(f"seed is {seed!r}; give one whole number, zero or more, or {count}, one for each fish")
        return [checked_seed(each) for each in seed]
    first = checked_seed(seed)
    return [None if first is None else first + i for i in range(count)]


def checked_limit(steps) -> int | None:
    """A time limit as an int, at least 1; None for None and for -1, Gymnasium's word for no limit; else ValueError."""
    if steps is None or (is_whole(steps) and steps == -1):
        return None
    if not (is_whole(steps) and 1 <= steps <= MOST_STEPS):
        raise ValueError(f"max_episode_steps is {steps!r}; give a whole number from 1 to {MOST_STEPS}, or None or -1")
    return int(steps)


def checked_truth(value, name: str) -> bool:
    """`value` as a bool, or ValueError."""
    if not isinstance(value, bool | np.bool_):
        raise ValueError(f"{name} is {value!r}; give True or False")
    return bool(value)


CAMERAS = ("above", "side", "follow")
"""What a picture is seen by: from above, from the fish's right, or from above and turning with the fish."""
SMALLEST, SMALLEST_PANEL, LARGEST = 32, (320, 240), 4096  # pixels


def checked_picture(width, height, camera, panel) -> dict[str, Any]:
    """The look of a picture; ValueError for a size or a camera that is not allowed."""
    if not all(is_whole(side) and SMALLEST <= side <= LARGEST for side in (width, height)):
        raise ValueError(
            f"width, height are {width!r}, {height!r}; give whole numbers of pixels from {SMALLEST} to {LARGEST}"
        )
    check_names("unknown camera", CAMERAS, camera)
    if checked_truth(panel, "panel") and (width < SMALLEST_PANEL[0] or height < SMALLEST_PANEL[1]):
        raise ValueError(
            f"a picture of {width} x {height} is too small for the panel of numbers; give panel=False, or a width and "
            f"height of at least {SMALLEST_PANEL[0]} and {SMALLEST_PANEL[1]}"
        )
    return {"width": int(width), "height": int(height), "camera": camera, "panel": bool(panel)}


def fish_for(body: str, water: Any) -> Fish:
    """The fish of a name in BODIES, calibrated for the water if that is a level for which it is."""
    calibrated = isinstance(body, str) and body in BODIES and isinstance(water, str) and water in BODIES[body].waters
    return make_fish(body, water=water) if calibrated else make_fish(body)


def check_settable(name: str, settable: tuple[str, ...]) -> None:
    """AttributeError, naming those that can be set while an environment runs, for any other option."""
    if name not in settable:
        raise AttributeError(
            f"{name!r} cannot be set while it runs{similar(name, settable)}; make a new environment, or "
            f"choose from {settable}"
        )


def set_option(env, name: str, value: Any) -> None:
    """Give an option of a batch another value, which counts from the episodes that begin next; `changed` notes it."""
    # Weights of the reward, `failure_penalty` and `info_every_step` count from the next step. AttributeError for an
    # option that cannot be set while it runs, ValueError for a value that is not allowed.
    task = env.task
    check_settable(name, env.settable)
    if name not in env.LIVE:
        made = type(task)(**{**env._task_options, name: value})
        if made.directions != task.directions:
            raise ValueError(f"{name} = {value!r} would change the observation; create a new environment")
        env._task_options[name] = getattr(made, name)
        object.__setattr__(task, name, getattr(made, name))
        if isinstance(task, CompiledTask) and name in task.weights:
            task.pack.set(**{name: getattr(task, name)})
    elif name == "variation":
        variation = checked_variation({} if value is None else value)
        check_pose(env.tank.fish, variation)
        env._set_read_only(variation=variation)
    else:
        env._set_read_only(**{name: checked_truth(value, name) if name == "info_every_step" else value})
    env.changed[name] = copy.deepcopy(value)


def found_in(env, name: str) -> Any:
    """The attribute of a batch, or of its task, that a single environment has by this name; AttributeError without."""
    return getattr(env.task if name in getattr(env.task, "settable", ()) else env, OF_ONE.get(name, name))


def call_each(env, name: str, which: Iterable[int], *args, **kwargs) -> list[Any]:
    """Value of an attribute, or result of a method, for each of some fish of a batch; AttributeError without it."""
    # `reset`, `render`, `episode_info`, `step_info`, `get_state` and `set_state` are called for these fish alone. Any
    # other method is called for the batch: ValueError unless all fish are selected.
    which = list(which)
    if name == "reset":
        return reset_each(env, which, *args, **kwargs)
    found: Any = found_in(env, name)
    if name == "compute_reward":  # for each of them the same, as of `SyncVectorEnv`
        return [found(*args, **kwargs) for _ in which]
    if name in ("episode_info", "step_info", "state_info"):
        return [found(i, *args, **kwargs) for i in which]
    if name == "get_state":
        return [found([i], *args, **kwargs) for i in which]
    if name == "set_state":
        obs = found(*args, **kwargs, indices=which)
        return [row_of(obs, i) for i in which]
    if callable(found):
        if name != "render" and set(which) != set(range(env.num_envs)):
            raise ValueError(f"{name} acts on all fish of a batch; call it for all of them")
        found = found(*args, **kwargs)
    if found is None or name not in ("render", "np_random", "np_random_seed"):
        return [found] * len(which)
    return [found[i] for i in which]


def reset_each(env, which: list[int], *, seed: int | None = None, options: dict | None = None) -> list[Any]:
    """Begin an episode of some fish, with the same seed: the observation of each, and its `info`."""
    mask = np.zeros(env.num_envs, dtype=bool)
    mask[which] = True
    seeds = None if seed is None else [seed] * env.num_envs
    obs, _ = env.reset(seed=seeds, options={**(options or {}), "reset_mask": mask})
    return [(row_of(obs, i), env._info(i, True)) for i in which]
