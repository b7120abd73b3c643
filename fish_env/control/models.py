"""Models of Stable-Baselines3 by what they can do, not by their types: nothing here loads the library."""

import re
from typing import Any

import gymnasium as gym
import numpy as np

from fish_env.control.env_spec import PASSIVE_WRAPPERS, changing_wrapper, is_wrapper
from fish_env.control.policy import Normalisation

ALLOWED_WRAPPERS = (*PASSIVE_WRAPPERS, "NormalizeReward", "TransformReward", "ClipReward")
"""Wrappers that change neither observations nor actions."""


def is_model(given: Any) -> bool:
    """Whether this is a model of Stable-Baselines3, or acts as one: it has `predict` and a `policy`."""
    return hasattr(given, "predict") and hasattr(given, "policy")


def trained_with(model: Any) -> dict[str, Any]:
    """The `interface` of the environment of a model, as "trained"; nothing if it is not of this package."""
    env = model.get_env().unwrapped
    return {"trained": env.get_attr("interface", [0])[0]} if env.has_attr("interface") else {}


def check_spaces(observations: gym.Space, actions: gym.Space, combined: bool = False) -> None:
    """ValueError unless observations are one vector, and actions go from -1 to 1, or a wrapper combines them."""
    if not isinstance(observations, gym.spaces.Box) or len(observations.shape) != 1:
        kind, shape = type(observations).__name__, observations.shape
        raise ValueError(f"observations are a {kind} of shape {shape}; train on one vector, (D,)")
    check_actions(actions, combined)


def check_actions(actions: gym.Space, combined: bool = False) -> None:
    """ValueError unless actions go from -1 to 1, or a wrapper combines them."""
    if not isinstance(actions, gym.spaces.Box):
        raise ValueError(f"actions are a {type(actions).__name__}; train on a Box")
    if not combined and not (np.all(actions.low == -1.0) and np.all(actions.high == 1.0)):
        raise ValueError(
            "actions are not from -1 to 1, as those of the environment; train without rescaling them, or export with "
            "the matrix of the wrapper that combines them"
        )


def normalisation_of(model: Any, combined: bool = False) -> Normalisation | None:
    """The normalisation of observations by `VecNormalize` of the environment that a model was trained in, or None.

    With `combined` it may have a wrapper of its own, which combines actions. ValueError without an environment, or with
    wrappers that change observations or actions otherwise.
    """
    env, found = model.get_env(), None
    if env is None:
        raise ValueError("the model has no environment, which may normalise; give it one: model.set_env(env)")
    check_actions(model.action_space, combined)
    while hasattr(env, "venv"):
        if is_wrapper(env, ("VecNormalize",)):
            if found is not None:
                raise ValueError("its environment has VecNormalize twice; train with one of them")
            if env.norm_obs and isinstance(model.observation_space, gym.spaces.Dict):
                raise ValueError("its environment has VecNormalize over a dict; train with norm_obs=False")
            if env.norm_obs:
                found = Normalisation(env.obs_rms.mean, np.sqrt(env.obs_rms.var + env.epsilon), float(env.clip_obs))
        elif not is_wrapper(env, ALLOWED_WRAPPERS) and not combined:
            _refuse(type(env).__name__)
        env = env.venv
    _check_inside(env)
    wanted, given = model.observation_space.shape, env.observation_space.shape
    if wanted != given:
        raise ValueError(f"the policy expects observations of shape {wanted}, the environment returns {given}")
    return found


def _refuse(name: str) -> None:
    raise ValueError(f"its environment has a {name}, which may change what is seen or done; leave it out")


def _check_inside(env: Any) -> None:
    """ValueError if single environments of a `VecEnv` have wrappers that may change what is seen or done."""
    # Those of other processes are known by the names that an environment prints: <Monitor<TimeLimit<FishEnv<id>>>>.
    if type(env).__module__ == "fish_env.envs.sb3":  # a batch, which has none
        return
    if is_wrapper(env, ("DummyVecEnv",)):
        found = [changing_wrapper(each, ALLOWED_WRAPPERS) for each in env.envs]
    elif is_wrapper(env, ("SubprocVecEnv",)):
        texts = env.env_method("__str__")
        chains = [re.fullmatch(r"((?:<\w+)*)<\w+(?: instance|<[^<>]+>)>+", text) for text in texts]
        names = [chain[1].split("<")[1:] if chain else [text] for chain, text in zip(chains, texts, strict=True)]
        found = [name for each in names for name in each if name not in ALLOWED_WRAPPERS]
    else:
        found = [type(env).__name__]
    for name in filter(None, found):
        _refuse(name)
