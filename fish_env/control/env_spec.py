"""The environment that a policy or a recording names, checked before it is made: anybody may have written the file.

Gymnasium imports the module of an id such as "module:Name-v0". That is for ids that a user types; a file can only name
what a package, imported by the user, has registered.
"""

import re
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from typing import Any

import gymnasium as gym
from gymnasium.envs.registration import load_env_creator
from gymnasium.wrappers import TimeLimit

from fish_env.checks import real
from fish_env.envs import FishEnv, FishVectorEnv
from fish_env.envs.vector import make_batch
from fish_env.physics.tank_options import LONGEST, SHORTEST

ID = re.compile(r"([\w-]{1,100}/)?[\w.-]{1,100}", re.ASCII)
MAKER_OPTIONS = ("self", "id", "num_envs", "vectorization_mode", "vector_kwargs", "wrappers", "autoreset_mode",
                 "render_mode", "disable_env_checker")  # fmt: skip
"""Keywords that are not of the environment, but of those who make it."""
PASSIVE_WRAPPERS = (
    "TimeLimit", "OrderEnforcing", "PassiveEnvChecker", "RecordEpisodeStatistics", "RecordVideo", "HumanRendering",
    "RenderCollection", "Monitor", "VecMonitor", "VecCheckNan", "VecVideoRecorder",
)  # fmt: skip
"""Wrappers of Gymnasium and of Stable-Baselines3 that change neither observations, nor actions, nor rewards."""
MAX_SUBSTEPS = 100_000
"""Steps of the integrator in one environment step: about a second. Those of the bodies are at most 24."""


def check_environment(about: Mapping[str, Any]) -> None:
    """ValueError unless `env_id` is a plain id and `env_options`, if there are any, are keywords of an environment."""
    env_id, options = about.get("env_id"), about.get("env_options", {})
    if not isinstance(env_id, str) or not ID.fullmatch(env_id):
        raise ValueError(
            f"env_id is {env_id!r}; a file may only name a registered environment, such as 'FishEnv/Swim-v0', and no "
            "module: import the package that registers it first, and name it by its id alone"
        )
    if not isinstance(options, Mapping) or not all(isinstance(k, str) and k.isidentifier() for k in options):
        raise ValueError(f"env_options is {options!r}; give keywords of the environment, a dictionary")
    for name in MAKER_OPTIONS:
        if name in options:
            raise ValueError(f"env_options has {name!r}; give keywords of the environment alone")
    for each in (options, trained_of(about)):
        interval = each.get("control_interval")
        if interval is not None and not SHORTEST <= real(interval) <= LONGEST:
            raise ValueError(f"control_interval is {interval!r}; give seconds from {SHORTEST:g} to {LONGEST:g}")


def trained_of(about: Mapping[str, Any]) -> dict[str, Any]:
    """The `interface` (`FishVectorEnv`) of its training that a policy names, empty for none; else ValueError."""
    trained = about.get("trained", {})
    kinds = {name: type(value) for name, value in trained.items()} if isinstance(trained, dict) else None
    if kinds not in ({}, {"control_interval": float, "muscle_groups": str, "observation": dict}):
        raise ValueError(f"trained is {trained!r:.200}; give the `interface` of the environment of the training")
    return trained


def environment_of(about: Mapping[str, Any]) -> tuple[str, dict[str, Any]]:
    """The id and the keywords of a registered environment of fish, or ValueError; nothing is made."""
    check_environment(about)
    env_id = about["env_id"]
    spec = gym.registry.get(env_id)
    if spec is None:  # `gym.spec` would import
        raise ValueError(f"the environment {env_id} is not registered; import the package that registers it first")
    for entry in (spec.entry_point, spec.vector_entry_point):
        with constructor_errors(env_id):
            maker = load_env_creator(entry) if isinstance(entry, str) else entry
        if isinstance(maker, type) and not issubclass(maker, FishEnv | FishVectorEnv):  # other makers are functions
            raise ValueError(f"{env_id} is not an environment of fish; give one of a fish")
    return env_id, dict(about.get("env_options", {}))


def make_checked_env(env_id: str, options: Mapping[str, Any], render_mode: str | None = None) -> gym.Env:
    """Create the environment of one fish that `environment_of` has checked; else ValueError or Gymnasium's error."""
    with constructor_errors(env_id):
        env = gym.make(env_id, disable_env_checker=True, render_mode=render_mode, **options)
    bare = env.unwrapped
    if not isinstance(bare, FishEnv):
        env.close()
        raise ValueError(f"{env_id} is not an environment of fish; give one of a fish")
    _check_substeps(bare.fish)
    return env


def make_checked_batch(env_id: str, options: Mapping[str, Any], num_envs: int) -> FishVectorEnv:
    """Create a batch in which each fish runs one episode; otherwise as `make_checked_env`."""
    with constructor_errors(env_id):
        env = make_batch(env_id, num_envs, autoreset_mode="SameStep", **options)
    _check_substeps(env)
    return env


def one_fish(env: gym.Env) -> tuple[FishEnv, str, dict[str, Any]]:
    """The bare environment of one fish, its id and its keywords; ValueError if others made it or wrappers change it."""
    bare = getattr(env, "unwrapped", env)
    if not isinstance(bare, FishEnv):
        raise ValueError(f"the environment is a {type(bare).__name__}; give one fish: gym.make('FishEnv/Swim-v0')")
    if env.spec is None or bare.spec is None:
        raise ValueError("the environment was not made by gym.make alone; make it by its id")
    if changing := changing_wrapper(env):
        raise ValueError(
            f"the environment has a wrapper {changing}, which may change what the fish sees or does; give it without, "
            f"or with {', '.join(PASSIVE_WRAPPERS)} alone"
        )
    keywords = bare.spec.kwargs | bare.fish.changed
    return bare, env.spec.id, {name: value for name, value in keywords.items() if name != "render_mode"}


def time_limit(env: gym.Env) -> int | None:
    """The smallest limit of its `TimeLimit` wrappers, which may have been set since `gym.make`; None for none."""
    found = []
    while isinstance(env, gym.Wrapper):
        found += [env._max_episode_steps] if isinstance(env, TimeLimit) else []
        env = env.env
    return min(found, default=None)


def is_wrapper(wrapper: object, names: tuple[str, ...] = PASSIVE_WRAPPERS) -> bool:
    """Return True for a wrapper of Gymnasium or Stable-Baselines3 of these names, and for no subclass of one."""
    kind = type(wrapper)
    return kind.__name__ in names and kind.__module__.startswith(("gymnasium.wrappers.", "stable_baselines3.common."))


def changing_wrapper(env: gym.Env, names: tuple[str, ...] = PASSIVE_WRAPPERS) -> str | None:
    """Name of the outermost wrapper of an environment that is none of these; None if it has no other."""
    while isinstance(env, gym.Wrapper):
        if not is_wrapper(env, names):
            return type(env).__name__
        env = env.env
    return None


def _check_substeps(fish: FishVectorEnv) -> None:
    """ValueError if a single environment step would take very long; it cannot be interrupted."""
    if fish._substeps > MAX_SUBSTEPS:
        fish.close()
        raise ValueError(
            f"an environment step has {fish._substeps:,} steps of dt = {fish.tank.dt:g} s; give a dt with at most "
            f"{MAX_SUBSTEPS:,}"
        )


@contextmanager
def constructor_errors(env_id: str) -> Iterator[None]:
    """Raise ValueError for what constructors raise for keywords that they do not have, and for missing modules."""
    try:
        yield
    except (ValueError, gym.error.Error):
        raise
    except (TypeError, AttributeError, ImportError, LookupError, ArithmeticError, RecursionError) as error:
        raise ValueError(f"{env_id} cannot be made: {error}") from error
