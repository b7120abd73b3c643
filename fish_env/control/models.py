"""Models of Stable-Baselines3 by what they can do, not by their types: nothing here loads the library."""

from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium import wrappers

from fish_env.control.policy import Normalisation

HARMLESS = ("VecMonitor", "VecCheckNan", "VecVideoRecorder")
"""Wrappers of Stable-Baselines3 that change neither observations nor actions."""
CHANGING = {
    "ObservationWrapper": gym.ObservationWrapper,
    "ActionWrapper": gym.ActionWrapper,
    "FrameStackObservation": wrappers.FrameStackObservation,
    "DelayObservation": wrappers.DelayObservation,
}
"""Wrappers of Gymnasium that change one or the other."""


def is_model(given: Any) -> bool:
    """Whether this is a model of Stable-Baselines3, or acts as one: it has `predict` and a `policy`."""
    return hasattr(given, "predict") and hasattr(given, "policy")


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
    """How `VecNormalize` of a model's environment normalises observations; None if it does not.

    Args:
        model: of Stable-Baselines3, with the environment that it was trained in.
        combined: the environment may have a wrapper of its own, which combines actions.

    Raises:
        ValueError: without an environment, or with wrappers that change observations or actions otherwise.
    """
    env, found = model.get_env(), None
    if env is None:
        raise ValueError("the model has no environment, which may normalise; give it one: model.set_env(env)")
    check_actions(model.action_space, combined)
    for name, kind in CHANGING.items():
        if any(env.env_is_wrapped(kind)):
            raise ValueError(f"its environment has a {name}, which changes what the policy sees or does; leave it out")
    while hasattr(env, "venv"):
        name, known = type(env).__name__, type(env).__module__.startswith("stable_baselines3.")
        if known and name == "VecNormalize":
            if found is not None:
                raise ValueError("its environment has VecNormalize twice; train with one of them")
            if env.norm_obs and isinstance(model.observation_space, gym.spaces.Dict):
                raise ValueError("its environment has VecNormalize over a dict; train with norm_obs=False")
            if env.norm_obs:
                found = Normalisation(env.obs_rms.mean, np.sqrt(env.obs_rms.var + env.epsilon), float(env.clip_obs))
        elif not (known and name in HARMLESS) and not combined:
            raise ValueError(f"its environment has a {name}, which may change what is seen or done; leave it out")
        env = env.venv
    wanted, given = model.observation_space.shape, env.observation_space.shape
    if wanted != given:
        raise ValueError(f"the policy expects observations of shape {wanted}, the environment returns {given}")
    return found
