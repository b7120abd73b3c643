"""Play episodes on fixed seeds and measure them: any controller that turns observations and time into actions."""

from collections.abc import Callable, Iterator
from typing import Any

import gymnasium as gym
import numpy as np

from agents.controllers import Gait
from fish_env.envs import FishVectorEnv

FIRST_SEED = 1_000_000  # far from the seeds of training, which count up from --seed
EPISODES = 100

Controller = Callable[[np.ndarray, float], np.ndarray]
"""(observations (B,D), seconds since the start) -> actions (B,A) or (A,)"""

Scores = dict[str, np.ndarray]
"""One number an episode, (B,): `return`, `failed` (ended by the physics), `seconds`, and the task's metrics."""


def gait_controller(gait: Gait, env: FishVectorEnv) -> Controller:
    """The open-loop gait: its contraction at the end of the coming control interval, whatever the fish sees."""
    return lambda obs, time: gait.action(env.tank.fish, time + env.control_interval)[env.leaders]


def policy_controller(policy, env: FishVectorEnv) -> Controller:
    """A policy in an environment that may decide more often than the policy does.

    In between, the muscles go straight on to where it sent them, which is what they do within one interval of the
    environment that it was trained in: the motion is the same, only more of it is seen.

    Raises:
        ValueError: if the policy decides more often than the environment, or does not fit it.
    """
    policy.check(env.single_observation_space, env.single_action_space)
    interval = policy.about.get("env_options", {}).get("control_interval", env.tank.fish.control_interval)
    every = round(interval / env.control_interval)
    if every < 1 or abs(every * env.control_interval - interval) > 1e-9:
        raise ValueError(
            f"the policy decides every {interval:g} s, the environment every {env.control_interval:g} s; "
            "give an interval that goes into the policy's a whole number of times"
        )
    muscles = 6 * env.tank.fish.landmarks.node.size + env.leaders
    goal = np.zeros(0)

    def act(obs: np.ndarray, time: float) -> np.ndarray:
        nonlocal goal
        since = round(time / env.control_interval) % every
        if since == 0:
            goal = policy(obs)
        present = obs[:, muscles]  # rest lengths are seen on the scale of actions
        return present + (goal - present) / (every - since)

    return act


def measuring(options: dict[str, Any]) -> dict[str, Any]:
    """Options of an environment less those of its clock: all controllers are measured with the fish's own interval."""
    return {name: value for name, value in options.items() if name not in ("control_interval", "max_episode_steps")}


def make_eval_env(env_id: str, num_envs: int, options: dict[str, Any]) -> FishVectorEnv:
    """A batch in which each fish plays one episode."""
    return gym.make_vec(env_id, num_envs, autoreset_mode="SameStep", **options).unwrapped


def played(controller: Controller, env: FishVectorEnv, first_seed: int = FIRST_SEED, options=None) -> Iterator[tuple]:
    """Play one episode with every fish of the batch, seeds first_seed, first_seed + 1, ...

    After the reset and after every decision it yields which fish have ended their episode just now, (B,) bool, which
    have ended it at all, (B,) bool, and the infos.
    """
    obs, infos = env.reset(seed=first_seed, options=options)
    done, time = np.zeros(env.num_envs, dtype=bool), 0.0
    yield done.copy(), done.copy(), infos
    while not done.all():
        action = np.broadcast_to(controller(obs, time), env.action_space.shape)
        obs, _, terminated, truncated, infos = env.step(action)
        time += env.control_interval
        ended = (terminated | truncated) & ~done
        done |= ended
        yield ended, done.copy(), infos


def evaluate(controller: Controller, env: FishVectorEnv, first_seed: int = FIRST_SEED, options=None) -> Scores:
    """Scores of one episode of every fish of the batch."""
    results: list[dict[str, float]] = [{}] * env.num_envs
    for ended, _, infos in played(controller, env, first_seed, options):
        for i in np.flatnonzero(ended):
            results[i] = episode_scores(infos["final_info"], i)
    return gathered(results)


def gathered(results: list[dict[str, float]]) -> Scores:
    """The scores of all fish, an array a name."""
    return {name: np.array([result[name] for result in results]) for name in results[0]}


def episode_scores(infos: dict[str, Any], i: int) -> dict[str, float]:
    """The numbers of fish i in the infos of a batch."""
    scores = {"return": sum(v[i] for k, v in infos["terms"].items() if not k.startswith("_"))}
    scores["failed"] = bool(infos["failure"][i]) if "failure" in infos else False
    for name, values in infos.items():
        if not name.startswith("_") and name not in ("terms", "failure"):
            scores[name] = values[i]
    return {name: float(value) for name, value in scores.items()}


def means(scores: Scores) -> dict[str, float]:
    """Mean of every score over the episodes in which it is known; None if there are none."""
    known = {name: values[np.isfinite(values)] for name, values in scores.items()}
    found = {name: round(float(values.mean()), 4) if values.size else None for name, values in known.items()}
    if "time_per_target" in scores:  # all targets together, not the mean of the episodes' means
        targets = scores["targets"].sum()
        found["time_per_target"] = round(float(scores["seconds"].sum() / targets), 4) if targets else None
    return found
