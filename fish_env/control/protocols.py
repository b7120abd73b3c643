"""Fixed conditions on which controllers are compared, none of which the shipped policies were trained under.

    rows = fish_env.protocols.evaluate_held_out("turn")

`TRAINING` is a distribution to train under for them (`robust_options`), `HELD_OUT` the test set: other bodies, sizes,
materials and muscles, a current, noise and delays, one at a time, on seeds of their own.

Learners are compared by `VERSION` of a protocol (`fish_env.training.benchmark`): tasks with a metric (`TASKS`),
levels (`LEVELS`), budgets and seeds, and a score that is 0 for random actions and 1 for the best controller known.
"""

import copy
import json
from collections.abc import Callable
from contextlib import closing
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import gymnasium as gym
import numpy as np

from fish_env.bodies import Fish, make_fish
from fish_env.control.evaluation import EPISODES, PolicyLike, evaluate, make_eval_env, make_policy_env
from fish_env.control.policy import Policy, load_policy
from fish_env.control.statistics import means
from fish_env.envs import FishVectorEnv, observation_layout
from fish_env.physics.tank_options import checked_count

FIRST_SEED = 7_000_000  # far from the seeds of training and of evaluation

SCORES = {
    "swim": "speed", "turn": "success", "left_after_right": "success", "target": "targets", "avoid": "success",
    "fast_start": "escape_distance",
}  # fmt: skip
"""The metric that is the score of each task; more is better."""

TRAINING: dict[str, Any] = {
    "variation": {
        "stiffness": (0.8, 1.25), "mass": (0.9, 1.1), "drag": (0.8, 1.25), "strength": (0.85, 1.1),
        "contraction_time": (0.8, 1.25), "length": (0.85, 1.2), "current": (0.0, 0.2),
    },
    "noise": 0.05, "action_noise": 0.05, "observation_delay": (0, 1), "action_delay": (0, 1),
}  # fmt: skip
"""A distribution to train under: keywords of the environment, and `noise`, a share of each part's typical change."""

VERSION = 1
"""Version of the protocol for learners: scores of one version can be compared."""

TASKS = {
    "swim": ("FishEnv/Swim-v0", "speed"), "turn": ("FishEnv/Turn-v0", "latency"),
    "left_after_right": ("FishEnv/LeftAfterRight-v0", "latency"),
    "fast_start": ("FishEnv/FastStart-v0", "escape_distance"),
}  # fmt: skip
"""The tasks of the protocol: id of the environment, and the metric that stands beside the score."""

BUDGETS, SEEDS = (100_000, 1_000_000), (0, 1, 2, 3, 4)
"""Environment steps of a training, and seeds."""

LEVELS: dict[str, dict[str, Any]] = {"easy": {}, "medium": TRAINING, "hard": TRAINING | {"observation": "sensors"}}
"""Keywords of the environments: as registered; noise, delays and variation; the same, seen by sensors alone. A hard
LeftAfterRight has twice the `severity`."""

HELD_OUT_EPISODES = 20
"""Episodes in each condition of `HELD_OUT_NAMES`, for learners."""

HELD_OUT_NAMES = ("body planar", "length 0.7", "length 1.4", "stiffness 0.6", "mass 1.3", "drag 1.6", "current 0.3")
"""The conditions of `HELD_OUT`, bodies and water, in which learners are tested."""


class Condition(NamedTuple):
    """What is different from the environment of the training."""

    name: str
    keywords: dict[str, Any] = {}
    noise: float = 0.0
    """Standard deviation of the noise on every part of the observation, as a share of the part's typical change."""
    delay: tuple[float, float] = (0.0, 0.0)
    """Of observations and of actions, s."""


HELD_OUT = (
    Condition("as built"),
    *(Condition(f"body {body}", {"body": body}) for body in ("planar", "two_layer", "tetrahedral")),
    *(Condition(f"{key} {value:g}", {"variation": {key: value}}) for key, values in (
        ("length", (0.7, 1.4)), ("stiffness", (0.6, 1.6)), ("mass", (0.75, 1.3)), ("drag", (0.6, 1.6)),
        ("strength", (0.75,)), ("contraction_time", (1.5,)), ("current", (0.3,)),
    ) for value in values),
    Condition("noise 0.1", noise=0.1),
    Condition("observed 0.04 s late", delay=(0.04, 0.0)),
    Condition("acts 0.04 s late", delay=(0.0, 0.04)),
)  # fmt: skip
"""The test set. Lengths, stiffnesses and so on are factors (`fish_env.envs.VARIATIONS`)."""


def noise_by_part(env_id: str, share: float, **options) -> dict[str, float]:
    """Standard deviations of noise on an environment's observations: a share of what each part typically changes by."""
    layout = observation_layout(env_id, **options)
    return {part.name: share * part.typical for part in layout.parts[: layout.num_present]}


def robust_options(env_id: str, **options) -> dict[str, Any]:
    """Keywords of an environment that is to be trained in under `TRAINING`, with other options; else ValueError."""
    others = {name: copy.deepcopy(value) for name, value in TRAINING.items() if name != "noise"}
    if given := options.keys() & {*others, "observation_noise"}:
        raise ValueError(f"TRAINING gives {', '.join(sorted(given))}; give other options, or change the result")
    return options | others | {"observation_noise": noise_by_part(env_id, TRAINING["noise"], **options)}


def level_options(task: str, level: str) -> dict[str, Any]:
    """Keywords of the environment of a task at a level of the protocol, those of its id left out."""
    options = {name: copy.deepcopy(value) for name, value in LEVELS[level].items() if name == "observation"}
    if level == "hard" and task == "left_after_right":
        options["severity"] = 2.0
    return robust_options(TASKS[task][0], **options) if "noise" in LEVELS[level] else options


def held_out_return(make: Callable[[FishVectorEnv], PolicyLike], task: str, level: str) -> float:
    """Mean return over the held-out conditions of the protocol, one at a time instead of the level's variation.

    `make` returns the policy for a batch.
    """
    returns = []
    for condition in HELD_OUT:
        if condition.name in HELD_OUT_NAMES:
            options = level_options(task, level) | {"variation": {}} | condition.keywords
            with closing(make_eval_env(TASKS[task][0], HELD_OUT_EPISODES, options)) as env:
                returns.append(evaluate(env, make(env), FIRST_SEED)["return"].mean())
    return round(float(np.mean(returns)), 4)


@cache
def references() -> dict[str, dict[str, dict[str, Any]]]:
    """By task and level: `random`, the return of random actions, `reference`, the best one known, and `by` whom."""
    return json.loads(Path(__file__).with_name("protocol.json").read_text(encoding="utf-8"))["references"]


def normalised_score(task: str, level: str, value: float) -> float:
    """A return as a score: 0 for that of random actions, 1 for the best that was known when the version began."""
    known = references()[task][level]
    return (value - known["random"]) / (known["reference"] - known["random"])


def evaluate_held_out(
    policy: str | Path | Policy, episodes: int = EPISODES, conditions: tuple[Condition, ...] = HELD_OUT
) -> list[dict[str, Any]]:
    """Scores of a policy under each condition, on seeds from FIRST_SEED.

    The environment is that of its training without the noise, delays, body and variation of it. Flat bodies are left
    out where it is one of three dimensions.

    Args:
        policy: the name of a shipped policy, a policy file, or a `Policy`.
        episodes: under each condition.
        conditions: which.

    Returns:
        A row for each condition: `condition`, `metric` (`SCORES`), `value`, its mean over the episodes, `share`, over
        that of the first condition, and `failed`, the share of episodes that the physics ended. A number that is not
        defined, such as a share of nothing, is None.

    Raises:
        FileNotFoundError: if there is no such policy.
        ValueError: for a policy of another environment than the package's, or a number of episodes that is not allowed.
    """
    loaded = policy if isinstance(policy, Policy) else load_policy(policy)
    episodes = checked_count(episodes, "episodes")
    options, rows = dict(loaded.about.get("env_options", {})), []
    registered = gym.registry[loaded.about["env_id"]].kwargs if loaded.about.get("env_id") in gym.registry else {}
    for condition in conditions:
        if (registered | options).get("dimensions") == 3 and fish_of(options, condition).flat:
            continue
        with closing(make_policy_env(loaded, episodes, **condition_options(loaded, options, condition))) as env:
            task = next((name for name, kind in env.tasks.items() if isinstance(env.task, kind)), "")
            if task not in SCORES:
                raise ValueError(f"the task is {type(env.task).__name__}; give a policy for one of {', '.join(SCORES)}")
            found = means(evaluate(env, loaded, FIRST_SEED))
        value = found[SCORES[task]]
        first = rows[0]["value"] if rows else value
        share = value / first if value is not None and first else None
        rows.append({"condition": condition.name, "metric": SCORES[task], "value": value, "share": share,
                     "failed": found["failed"]})  # fmt: skip
    return rows


def fish_of(options: dict[str, Any], condition: Condition) -> Fish:
    """The fish under a condition, for the options of a policy's training."""
    body = condition.keywords.get("body", options.get("body", "mass_spring"))
    return body if isinstance(body, Fish) else make_fish(body)


def condition_options(policy: Policy, options: dict[str, Any], condition: Condition) -> dict[str, Any]:
    """What replaces options of a policy's training under a condition."""
    late = [0, 0]
    if any(condition.delay):
        with closing(make_policy_env(policy, 1, **condition.keywords)) as env:
            late = [round(seconds / env.control_interval) for seconds in condition.delay]
    noise = noise_by_part(policy.about["env_id"], condition.noise, **options) if condition.noise else {}
    return {
        "variation": {}, "observation_noise": noise, "action_noise": 0.0, "observation_delay": late[0],
        "action_delay": late[1], **condition.keywords,
    }  # fmt: skip
