"""Learners for `fish_env benchmark agents.learners:sac --tasks swim left_after_right`.

Their settings stand in agents/zoo/, in rl_zoo3's format.
All see observations that `VecNormalize` scales, and command the two muscles of a pair alike, by one action.
"""

from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from sb3_contrib import TQC, RecurrentPPO
from stable_baselines3 import SAC
from stable_baselines3.common.vec_env import VecNormalize

from fish_env.control import Controller
from fish_env.training.benchmark import Trial
from fish_env.training.build import falling

SETTINGS = Path(__file__).with_name("zoo")
REPLACED = ("n_timesteps", "n_envs", "env_kwargs", "normalize", "policy")


def settings(name: str, trial: Trial) -> dict[str, Any]:
    """The settings of a learner in the environment of a trial; ValueError without any."""
    found = yaml.safe_load((SETTINGS / f"{name}.yml").read_text(encoding="utf-8"))
    if trial.env_id not in found:
        raise ValueError(f"agents/zoo/{name}.yml has no settings for {trial.env_id}; it has {', '.join(found)}")
    return found[trial.env_id]


def learn(name: str, algorithm: Callable, trial: Trial) -> Controller:
    """Train, and return the policy as a function of observations and time."""
    found = settings(name, trial)
    env = VecNormalize(trial.make_env(found["n_envs"], **found["env_kwargs"]), gamma=found["gamma"])
    groups = env.get_attr("groups", [0])[0]
    keywords = {key: value for key, value in found.items() if key not in REPLACED}
    if str(keywords["learning_rate"]).startswith("lin_"):
        keywords["learning_rate"] = falling(float(keywords["learning_rate"][4:]))
    model = algorithm(found["policy"], env, seed=trial.seed, device="cpu", **keywords)
    model.learn(trial.steps, trial.curve)
    memory = None  # of a recurrent policy

    def act(obs: np.ndarray, time: float) -> np.ndarray:
        nonlocal memory
        begins, memory = np.full(len(obs), time == 0.0), None if time == 0.0 else memory
        actions, memory = model.predict(env.normalize_obs(obs), memory, begins, deterministic=True)
        return actions[:, groups]

    return act


sac = partial(learn, "sac", SAC)
tqc = partial(learn, "tqc", TQC)
recurrent_ppo = partial(learn, "recurrent_ppo", RecurrentPPO)
