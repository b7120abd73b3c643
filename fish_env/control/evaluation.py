"""Episodes on fixed seeds, measured, for any controller that turns observations and time into actions."""

from collections.abc import Callable, Iterator
from typing import Any

import numpy as np

from fish_env.checks import is_whole
from fish_env.control.environments import environment_of, make_checked_batch
from fish_env.control.gait import Gait
from fish_env.control.policy import Policy
from fish_env.envs import FishVectorEnv
from fish_env.envs.vector import make_batch
from fish_env.physics.tank_options import checked_count

FIRST_SEED = 1_000_000  # far from the seeds of training, which count up from --seed
EPISODES = 100

Controller = Callable[[np.ndarray, float], np.ndarray]
"""(observations (B,D), seconds since the start) -> actions (B,A) or (A,)"""

COUNTED = ("history", "observation_delay", "action_delay")
"""Options that count environment steps."""

NOT_SCORES = ("terms", "failure", "is_success", "variation", "privileged")
"""What an `info` has besides scores: sums, words, a copy of "success", and what the fish was."""

Scores = dict[str, np.ndarray]
"""One number for each episode, (B,): `return`, `failed` (ended by the physics), `seconds`, and the task's metrics."""


def gait_controller(gait: Gait, env: FishVectorEnv) -> Controller:
    """The open-loop gait as a controller: its contraction at the end of the coming control interval."""
    return lambda obs, time: gait.action(env.tank.fish, time + env.control_interval)[env.first_muscle_of_group]


def policy_controller(policy: Policy, env: FishVectorEnv) -> Controller:
    """A policy in an environment whose control interval may be shorter than the one it was trained with.

    In between, commanded rest lengths change linearly towards the policy's last action, as within one long interval.
    Muscles with first-order activation receive the action itself, and end where one long interval would have ended.

    Raises:
        ValueError: if the policy's interval is not a whole multiple of the environment's, or the policy does not fit
            the environment.
    """
    policy.check(env.single_observation_space, env.single_action_space)
    interval = policy.about.get("env_options", {}).get("control_interval") or env.tank.fish.control_interval
    every = round(interval / env.control_interval)
    if every < 1 or abs(every * env.control_interval - interval) > 1e-9:
        raise ValueError(
            f"the policy acts every {interval:g} s, the environment every {env.control_interval:g} s; "
            f"give a control_interval of which {interval:g} s is a whole multiple"
        )
    goal, first_order = np.zeros(0), env.tank.fish.activation_time[0] > 0.0

    def act(obs: np.ndarray, time: float) -> np.ndarray:
        nonlocal goal
        since = round(time / env.control_interval) % every
        if since == 0:
            goal = policy(obs)
        if first_order:
            return goal
        present = (2.0 * env.tank.contraction - 1.0)[:, env.first_muscle_of_group].astype(np.float32)  # as actions
        return present + (goal - present) / (every - since)

    return act


def checked_episodes(episodes: int, seed: int) -> tuple[int, int]:
    """Number of episodes and seed of the first one; ValueError for no episode, or for a seed below zero."""
    if not (is_whole(seed) and seed >= 0):
        raise ValueError(f"seed is {seed!r}; give a whole number, zero or more")
    return checked_count(episodes, "episodes"), int(seed)


def evaluation_options(options: dict[str, Any]) -> dict[str, Any]:
    """Options of an environment less those of its clock: all controllers are evaluated with the fish's own interval.

    Where delays or a history count environment steps, these remain as long as they were.
    """
    if any(np.any(options.get(name, 0)) for name in COUNTED):
        return dict(options)
    return {name: value for name, value in options.items() if name not in ("control_interval", "max_episode_steps")}


def make_eval_env(env_id: str, num_envs: int, options: dict[str, Any]) -> FishVectorEnv:
    """Create a batch in which each fish runs one episode; raises what `make_batch` does."""
    return make_batch(env_id, num_envs, autoreset_mode="SameStep", **options)


def make_policy_env(policy: Policy, num_envs: int = EPISODES, **changes) -> FishVectorEnv:
    """Create the batch a policy is evaluated in; `changes` replace options of its training, None is ignored.

    Raises:
        ValueError: for an option that is not allowed, or an environment that is not registered, or is not one of fish.
        gymnasium.error.Error: for an environment without batches.
    """
    env_id, options = environment_of(policy.about)
    changed = {name: value for name, value in changes.items() if value is not None}
    return make_checked_batch(env_id, evaluation_options(options) | changed, num_envs)


def run_episodes(
    controller: Controller, env: FishVectorEnv, first_seed: int = FIRST_SEED, options: dict[str, float] | None = None
) -> Iterator[tuple[np.ndarray, np.ndarray, dict[str, Any]]]:
    """Run one episode of every fish of the batch, seeds first_seed, first_seed + 1, ...

    After the reset and after every environment step it yields which fish have ended their episode in it, (B,) bool,
    which have ended it at all, (B,) bool, and the infos.
    """
    obs, infos = env.reset(seed=first_seed, options=options)
    done, time = np.zeros(env.num_envs, dtype=bool), 0.0
    actions = (env.num_envs, *env.single_action_space.shape)
    yield done.copy(), done.copy(), infos
    while not done.all():
        action = np.broadcast_to(controller(obs, time), actions)
        obs, _, terminated, truncated, infos = env.step(action)
        time += env.control_interval
        ended = (terminated | truncated) & ~done
        done |= ended
        yield ended, done.copy(), infos


def evaluate(
    controller: Controller, env: FishVectorEnv, first_seed: int = FIRST_SEED, options: dict[str, float] | None = None
) -> Scores:
    """Scores of one episode of every fish of the batch, begun with these seeds and reset options."""
    results: list[dict[str, float]] = [{}] * env.num_envs
    for ended, _, infos in run_episodes(controller, env, first_seed, options):
        for i in np.flatnonzero(ended).tolist():
            results[i] = episode_scores(infos["final_info"], i)
    return scores_by_name(results)


def scores_by_name(results: list[dict[str, float]]) -> Scores:
    """Scores of all fish by name, (B,) each."""
    return {name: np.array([result[name] for result in results]) for name in results[0]}


def episode_scores(infos: dict[str, Any], i: int) -> dict[str, float]:
    """The numbers of fish i in the infos of a batch."""
    scores = {"return": sum(v[i] for k, v in infos["terms"].items() if not k.startswith("_"))}
    scores["failed"] = bool(infos["failure"][i])
    for name, values in infos.items():
        if not name.startswith("_") and name not in NOT_SCORES:
            scores[name] = values[i]
    return {name: float(value) for name, value in scores.items()}


def means(scores: Scores) -> dict[str, float | None]:
    """Mean of every score over the episodes in which it is finite; None if there are none."""
    finite = {name: values[np.isfinite(values)] for name, values in scores.items()}
    found = {name: round(float(values.mean()), 4) if values.size else None for name, values in finite.items()}
    if "time_per_target" in scores:  # all targets together, not the mean of the episodes' means
        targets = scores["targets"].sum()
        found["time_per_target"] = round(float(scores["seconds"].sum() / targets), 4) if targets else None
    return found
