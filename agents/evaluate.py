"""Play episodes on fixed seeds and measure them: any controller that turns observations and time into actions."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import gymnasium as gym
import numpy as np

from agents.controllers import Gait
from fish_env.envs import FishVectorEnv

FIRST_SEED = 1_000_000  # far from the seeds of training, which count up from --seed

Controller = Callable[[np.ndarray, float], np.ndarray]
"""(observations (B,D), seconds since the start) -> actions (B,A) or (A,)"""


@dataclass(frozen=True)
class Scores:
    """One number an episode."""

    speed: np.ndarray
    """Mean speed along the commanded heading, body lengths per second."""
    own_speed: np.ndarray
    """Distance between start and end over time, whatever the direction, body lengths per second."""
    total: np.ndarray
    """Sum of rewards."""
    failures: int
    """Episodes ended by the physics."""


def gait_controller(gait: Gait, env: FishVectorEnv) -> Controller:
    """The open-loop gait: its contraction at the end of the coming control interval, whatever the fish sees."""
    fish, groups = env.tank.fish, env.groups
    first = np.array([np.flatnonzero(groups == g)[0] for g in range(groups.max() + 1)])  # a muscle of each group
    return lambda obs, time: gait.action(fish, time + env.control_interval)[first]


def policy_controller(policy) -> Controller:
    """A policy as a controller: the time is not looked at."""
    return lambda obs, time: policy(obs)


def make_eval_env(env_id: str, num_envs: int, options: dict[str, Any]) -> FishVectorEnv:
    """A batch in which each fish plays one episode."""
    return gym.make_vec(env_id, num_envs, autoreset_mode="SameStep", **options).unwrapped


def evaluate(controller: Controller, env: FishVectorEnv, first_seed: int = FIRST_SEED) -> Scores:
    """Play one episode with every fish of the batch, seeds first_seed, first_seed + 1, ..."""
    obs, _ = env.reset(seed=first_seed)
    done = np.zeros(env.num_envs, dtype=bool)
    results: list[dict[str, Any]] = [{}] * env.num_envs
    time = 0.0
    while not done.all():
        action = np.broadcast_to(controller(obs, time), env.action_space.shape)
        obs, _, terminated, truncated, infos = env.step(action)
        time += env.control_interval
        for i in np.flatnonzero((terminated | truncated) & ~done):
            results[i] = {key: value[i] for key, value in infos["final_info"].items() if not isinstance(value, dict)}
            results[i]["total"] = sum(v[i] for k, v in infos["final_info"]["terms"].items() if not k.startswith("_"))
            done[i] = True
    speed, sideways, total = (np.array([r[key] for r in results]) for key in ("speed", "sideways", "total"))
    return Scores(speed, np.hypot(speed, sideways), total, sum(bool(r.get("failure")) for r in results))
