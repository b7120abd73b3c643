"""Episodes on fixed seeds, measured, for policies and for any function of observations and time."""

import warnings
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import closing, suppress
from pathlib import Path
from typing import Any, cast

import gymnasium as gym
import numpy as np
from gymnasium.vector import AutoresetMode

from fish_env.checks import is_whole
from fish_env.control.env_spec import environment_of, make_checked_batch, one_fish, time_limit, trained_of
from fish_env.control.gait import Gait
from fish_env.control.models import is_model, normalisation_of, trained_with
from fish_env.control.policy import Normalisation, Policy, load_policy
from fish_env.envs import FishVectorEnv
from fish_env.envs.senses import ACTED
from fish_env.envs.vector import make_batch
from fish_env.physics.tank_options import checked_count

FIRST_SEED = 1_000_000  # far from the seeds of training, which count up from --seed
EPISODES = 100

Controller = Callable[[np.ndarray, float], np.ndarray]
"""(observations (B,D), seconds since the start) -> actions (B,A) or (A,)"""

OPTIONS_IN_STEPS = ("history", "observation_delay", "action_delay")
"""Options that count environment steps."""

NOT_SCORES = ("terms", "failure", "is_success", "variation", "privileged", "step_terms", "position", "heading")
"""Entries of an `info` that are no scores: sums, words, a copy of "success", what the fish was, and its last step."""

PolicyLike = str | Path | Policy | Controller | Any
"""A shipped policy's name, a policy file, a `Policy`, a model of Stable-Baselines3, or a `Controller`."""

Scores = dict[str, np.ndarray]
"""One number for each episode, (B,): `return`, `failed` (ended by the physics), `seconds`, and the task's metrics."""


def gait_controller(gait: Gait, env: FishVectorEnv) -> Controller:
    """The open-loop gait as a controller: its contraction at the end of the coming control interval."""
    return lambda obs, time: gait.action(env.tank.fish, time + env.control_interval)[env.first_muscle_of_group]


def as_controller(policy: Any, env: FishVectorEnv) -> Controller:
    """A policy of any kind as a controller in an environment.

    Args:
        policy: the name of a shipped policy, such as "swim"; a policy file; a `Policy`; a model of Stable-Baselines3
            with the environment that it was trained in, whose `VecNormalize` is applied; or a function of observations
            (B,D) and the time, s, that gives actions (B,A) or (A,).
        env: the environment that it is to act in.

    Raises:
        FileNotFoundError: if there is no such policy.
        ValueError: for anything else, or a policy that does not fit the environment, saying why.
    """
    policy = load_policy(policy) if isinstance(policy, str | Path) else policy
    if isinstance(policy, Policy) or is_model(policy):
        return policy_controller(policy, env)
    if hasattr(policy, "predict"):
        raise ValueError(
            f"a {type(policy).__name__} does not know whether its observations are normalised; give the model"
        )
    if callable(policy):
        return cast(Controller, policy)
    raise ValueError(
        f"the policy is a {type(policy).__name__}; give the name of a shipped policy, a policy file, a Policy, a model "
        "of Stable-Baselines3, or a function of observations and time"
    )


def policy_controller(policy: Policy | Any, env: FishVectorEnv) -> Controller:
    """A policy or a model in an environment whose control interval may be shorter than that of its training.

    In between, commanded rest lengths change linearly towards the policy's last action, as within one long interval.

    Raises:
        ValueError: if the policy's interval is not a whole multiple of the environment's; if the policy does not fit
            the environment; and for a model without an environment, or with wrappers that change what it sees or does.
    """
    normalisation = None if isinstance(policy, Policy) else normalisation_of(policy)
    trained = _trained(policy, env)
    _check_trained(trained, env)
    decide = _actions_of(policy, normalisation, env)
    interval = trained.get("control_interval", env.control_interval)
    every = steps_of(interval, env)
    if not every:
        raise ValueError(
            f"the policy acts every {interval:g} s, the environment every {env.control_interval:g} s; "
            f"give a control_interval of which {interval:g} s is a whole multiple"
        )
    goal = np.zeros(0)

    def act(obs: np.ndarray, time: float) -> np.ndarray:
        nonlocal goal
        since = round(time / env.control_interval) % every
        if since == 0:
            goal = decide(obs, time)
        if every - since == 1:
            return goal
        present = (2.0 * _final_contraction(env) - 1.0)[:, env.first_muscle_of_group].astype(np.float32)  # as actions
        return present + (goal - present) / (every - since)

    return act


def _actions_of(policy: Any, normalisation: Normalisation | None, env: FishVectorEnv) -> Controller:
    """The deterministic actions of a policy or a model at the beginnings of its intervals."""
    if isinstance(policy, Policy):
        if isinstance(env.single_observation_space, gym.spaces.Dict):
            raise ValueError("the environment observes goals, which policy files do not know; give it without goal_env")
        policy.check(env.single_observation_space, env.single_action_space)
        return lambda obs, time: policy(obs)
    memory = None
    for wanted, given in (
        (policy.observation_space, env.single_observation_space),
        (policy.action_space, env.single_action_space),
    ):
        if wanted.shape != given.shape or (given.shape is None and wanted != given):  # a dict of goals has no shape
            raise ValueError(
                f"the model was trained for {wanted!s:.100}, and the environment has {given!s:.100}; give the "
                "environment the options of its training"
            )

    def act(obs: np.ndarray, time: float) -> np.ndarray:
        nonlocal memory  # of a recurrent policy
        seen = obs if normalisation is None else normalisation(obs).astype(np.float32)
        begins = np.full(env.num_envs, time == 0.0)
        actions, memory = policy.predict(seen, state=memory, episode_start=begins, deterministic=True)
        return actions

    return act


def steps_of(interval: float, env: FishVectorEnv) -> int:
    """Number of environment steps in an interval, s; 0 if it is no whole multiple of one."""
    steps = round(interval / env.control_interval)
    return steps if abs(steps * env.control_interval - interval) <= 1e-9 else 0


def _final_contraction(env: FishVectorEnv) -> np.ndarray:
    """Contractions (B,M), of what the strength of each fish allows, once all commands sent so far have arrived."""
    found = env.tank.contraction / env.tank.muscle_variation[:, :1]
    if env._memory:
        fish, past, delay = np.arange(env.num_envs), env._memory["past_action"], env._memory["delay"][:, ACTED, None]
        fastest = env.control_interval / (env.tank.fish.contraction_time * env.tank.muscle_variation[:, 1:])
        for ago in range(delay.max(), 0, -1):
            sent = past[fish, (env._elapsed - ago) % past.shape[1]][:, env.groups]
            goal = np.where(env._elapsed[:, None] >= ago, 0.5 * (sent + 1.0), 0.0)
            found += np.where(delay >= ago, np.clip(goal - found, -fastest, fastest), 0.0)  # (1)
    return found


def _trained(policy: Any, env: FishVectorEnv) -> Mapping[str, Any]:
    """Interface (`FishVectorEnv.interface`) with which a policy or a model was trained, as far as it is known.

    A file that does not say it has that of its environment, or at least an interval: the fish's own if it names none.
    """
    trained = trained_of(policy.about if isinstance(policy, Policy) else trained_with(policy))
    if trained or not isinstance(policy, Policy):
        return trained
    with suppress(ValueError, gym.error.Error), closing(make_checked_batch(*environment_of(policy.about), 1)) as own:
        return own.interface
    interval = policy.about.get("env_options", {}).get("control_interval")
    return {"control_interval": interval or env.tank.fish.control_interval}


def _check_trained(trained: Mapping[str, Any], env: FishVectorEnv) -> None:
    """ValueError if an environment has other actions, or shows other parts, than a policy was trained with."""
    here, groups = env.interface, trained.get("muscle_groups")
    if groups not in (None, here["muscle_groups"]):
        raise ValueError(
            f"the policy was trained with muscle_groups={groups!r}, and the environment has "
            f"{here['muscle_groups']!r}; give it muscle_groups={groups!r}, or train a new policy"
        )
    shown = here["observation"]
    seen = trained.get("observation", shown)
    if seen != shown:
        mine, its = (
            ", ".join(f"{name} ({size})" for name, size in one.items() if other.get(name) != size) or "none"
            for one, other in ((seen, shown), (shown, seen))
        )
        raise ValueError(
            "the policy was trained with other parts of the observation than the environment shows: only the policy "
            f"has {mine}, only the environment has {its}; give the options of its training, or train a new policy"
        )


def checked_episodes(episodes: int, seed: int) -> tuple[int, int]:
    """Number of episodes and seed of the first one; ValueError for no episode, or for a seed below zero."""
    if not (is_whole(seed) and seed >= 0):
        raise ValueError(f"seed is {seed!r}; give a whole number, zero or more")
    return checked_count(episodes, "episodes"), int(seed)


def evaluation_options(options: dict[str, Any]) -> dict[str, Any]:
    """Options of an environment less those of its clock: all controllers are evaluated with the fish's own interval.

    Where delays or a history count environment steps, these remain as long as they were.
    """
    if any(np.any(options.get(name, 0)) for name in OPTIONS_IN_STEPS):
        return dict(options)
    return {name: value for name, value in options.items() if name not in ("control_interval", "max_episode_steps")}


def make_eval_env(env_id: str, num_envs: int, options: dict[str, Any]) -> FishVectorEnv:
    """Create a batch in which each fish runs one episode; raises what `make_batch` does."""
    return make_batch(env_id, num_envs, autoreset_mode="SameStep", **options)


def environment_for(policy: Policy, changes: Mapping[str, Any]) -> tuple[str, dict[str, Any]]:
    """Id and keywords of the environment in which a policy is evaluated; `changes` of None are ignored.

    They are `evaluation_options` where the policy can act in the steps of the environment without those of its clock.

    Raises:
        ValueError: as `environment_of`.
    """
    env_id, options = environment_of(policy.about)
    changed = {name: value for name, value in changes.items() if value is not None}
    plain = evaluation_options(options)
    if plain.keys() != options.keys():
        with suppress(ValueError, gym.error.Error), closing(make_checked_batch(env_id, plain | changed, 1)) as env:
            if env.max_episode_steps and steps_of(options.get("control_interval") or env.control_interval, env):
                return env_id, plain | changed
    return env_id, options | changed


def make_policy_env(policy: str | Path | Policy, num_envs: int = EPISODES, **changes) -> FishVectorEnv:
    """Create the batch a policy is evaluated in; `changes` replace options of its training, None is ignored.

    Raises:
        FileNotFoundError: if there is no such policy.
        ValueError: for an option that is not allowed, or an environment that is not registered, or is not one of fish.
        gymnasium.error.Error: for an environment without batches.
    """
    policy = load_policy(policy) if isinstance(policy, str | Path) else policy
    return make_checked_batch(*environment_for(policy, changes), num_envs)


def run_episodes(
    env: FishVectorEnv, policy: PolicyLike, seed: int = FIRST_SEED, options: dict[str, float] | None = None
) -> Iterator[tuple[np.ndarray, np.ndarray, dict[str, Any]]]:
    """Run one episode of every fish of the batch, seeds seed, seed + 1, ...

    After the reset and after every environment step it yields which fish have ended their episode in it, (B,) bool,
    which have ended it at all, (B,) bool, and the infos.

    Raises:
        ValueError: for an environment that is no batch of fish, has no time limit, or in which episodes do not begin
            again by themselves, and what `as_controller` raises.
    """
    if not isinstance(env, FishVectorEnv) or env.autoreset_mode is AutoresetMode.DISABLED:
        raise ValueError(
            f"the environment is {env!r:.100}; give a batch of fish in which episodes begin again by themselves, such "
            "as gym.make_vec('FishEnv/Swim-v0', num_envs=100), and the policy after it: evaluate(env, policy)"
        )
    if env.max_episode_steps is None:
        raise ValueError("the environment has no time limit, and its episodes might not end; give max_episode_steps")
    controller = as_controller(policy, env)
    obs, infos = env.reset(seed=seed, options=options)
    done, time = np.zeros(env.num_envs, dtype=bool), 0.0
    actions = (env.num_envs, *env.single_action_space.shape)
    yield done.copy(), done.copy(), infos
    while not done.all():
        obs, _, terminated, truncated, infos = env.step(np.broadcast_to(controller(obs, time), actions))
        time += env.control_interval
        ended = (terminated | truncated) & ~done
        done |= ended
        yield ended, done.copy(), infos


def evaluate(
    env: FishVectorEnv | gym.Env,
    policy: PolicyLike,
    seed: int = FIRST_SEED,
    options: dict[str, float] | None = None,
    episodes: int | None = None,
) -> Scores:
    """Scores of episodes with the seeds seed, seed + 1, ...

    Args:
        env: a batch, in which every fish runs one episode; or one fish of `gym.make`, of which a batch is made.
        policy: the name of a shipped policy, a policy file, a `Policy`, a model of Stable-Baselines3, or a function of
            observations and time: what `as_controller` takes.
        seed: of the first episode.
        options: of the resets.
        episodes: how many of one fish, 100 for None; a batch has as many as it has fish.

    Raises:
        FileNotFoundError: if there is no such policy.
        ValueError: for an environment, seed, options or a number of episodes that are not allowed, and for a policy
            that does not fit the environment.

    Warns:
        UserWarning: if more than half of the episodes are ended by a failure of the physics, or if the policy is of
            another task.
    """
    policy = load_policy(policy) if isinstance(policy, str | Path) else policy
    if isinstance(env, gym.Env):
        _, id, keywords = one_fish(env)
        limit = time_limit(env)
        count, _ = checked_episodes(EPISODES if episodes is None else episodes, seed)
        with closing(make_checked_batch(id, keywords | {"max_episode_steps": limit}, count)) as batch:
            return evaluate(batch, policy, seed, options)
    if episodes is not None and isinstance(env, FishVectorEnv) and episodes != env.num_envs:
        raise ValueError(f"episodes is {episodes!r}, and the batch has {env.num_envs} fish: each runs one episode")
    if (spec := getattr(env, "spec", None)) is not None and (said := another_task(policy, spec.kwargs)):
        warnings.warn(said, UserWarning, stacklevel=2)
    results: list[dict[str, float]] = []
    failures = []
    for ended, _, infos in run_episodes(env, policy, seed, options):
        results = results or [{}] * len(ended)
        for i in np.flatnonzero(ended).tolist():
            last = infos.get("final_info", infos)  # there where episodes begin again at once
            results[i] = episode_scores(last, i)
            failures.append(last["failure"][i])
    if said := mostly_failed(failures, env.tank.dt):
        warnings.warn(said, UserWarning, stacklevel=2)
    return scores_by_name(results)


def another_task(policy: Any, keywords: Mapping[str, Any]) -> str | None:
    """Warning if a policy is of another task than that of an environment with these keywords, else None."""
    spec = gym.registry.get(policy.about.get("env_id", "")) if isinstance(policy, Policy) else None
    if spec is None or "task" not in keywords:
        return None
    own, here = (
        f"{each.get('task')!r} in {each.get('dimensions', 2)} dimensions"
        for each in (spec.kwargs | policy.about.get("env_options", {}), keywords)
    )
    return None if own == here else f"the policy was trained for {own}, and its scores are for {here}"


def mostly_failed(failures: Sequence[str], dt: float) -> str | None:
    """Warning if more than half of the episodes failed, by the failure of each, "" for none; else None."""
    failed = [failure for failure in failures if failure]
    if 2 * len(failed) <= len(failures):
        return None
    reason = Counter(failed).most_common(1)[0][0]
    return f"{len(failed)} of {len(failures)} episodes failed ({reason}); give a dt smaller than {dt:g} s"


def scores_by_name(results: list[dict[str, float]]) -> Scores:
    """Scores of all fish by name, (B,) each."""
    return {name: np.array([result[name] for result in results]) for name in results[0]}


def episode_scores(infos: dict[str, Any], i: int) -> dict[str, float]:
    """The numbers of fish i in the infos of a batch."""
    scores = {"return": sum(v[i] for k, v in infos["terms"].items() if not k.startswith("_"))}
    scores["failed"] = bool(infos["failure"][i])
    for name, values in infos.items():
        if not name.startswith(("_", "term_")) and name not in NOT_SCORES:
            scores[name] = values[i]
    return {name: float(value) for name, value in scores.items()}
