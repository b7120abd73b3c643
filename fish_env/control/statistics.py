"""Policies compared: means over seeds and episodes with 95 % intervals.

Interquartile means over runs, as Agarwal et al., "Deep reinforcement learning at the edge of the statistical precipice"
(2021), recommend; of a multiple of four runs they are those of their library rliable.

Intervals are those of the bootstrap, but a share of one policy's episodes has its Wilson score interval. Over several
seeds it has the bootstrap's, widened to Wilson's for the episodes of one seed, as all seeds run the same episodes.
"""

import inspect
import json
import math
from collections.abc import Mapping, Sequence
from contextlib import closing, nullcontext
from pathlib import Path
from typing import Any, NamedTuple, cast

import gymnasium as gym
import numpy as np

from fish_env.control.env_spec import make_checked_batch
from fish_env.control.evaluation import EPISODES, FIRST_SEED, PolicyLike, Scores, environment_for, evaluate
from fish_env.control.policy import Policy, load_policy
from fish_env.envs import FishVectorEnv
from fish_env.envs.episode import Episodes
from fish_env.tasks import TASKS
from fish_env.tasks.options import keywords_of

RESAMPLES = 2000
NORMAL = 1.959964  # standard deviations within which 95 % of a normal distribution lie
SHARES = frozenset({"success", "settled", "avoided", "avoided_possible", "passed", "reached", "failed"})
"""Metrics that are shares: of episodes where each is 0 or 1, or means of shares within episodes."""
SIGNED = frozenset({"turn"})
"""Metrics whose sign is a side: their means say nothing, and tables leave them out."""
INTERFACE_OPTIONS = {
    "observation", "history", "muscle_groups", "privileged", "control_interval", "max_episode_steps", "info_every_step",
    "threads", "lanes", "width", "height", "camera", "panel",
}  # fmt: skip
"""Keywords of what a policy sees, how it acts, pictures and speed: policies that differ in them meet the same episodes.
"""


class Interval(NamedTuple):
    """A mean and the ends of its 95 % interval; NaN where a metric is undefined in all episodes."""

    value: float
    low: float
    high: float

    def __format__(self, digits: str) -> str:
        value, low, high = (format(number, digits or ".3g") for number in self)
        return "-" if math.isnan(self.value) else value if low == value == high else f"{value} ({low} to {high})"

    def __str__(self) -> str:
        return format(self)


class Comparison(NamedTuple):
    """A metric of two policies."""

    policy: Interval
    other: Interval
    difference: Interval
    """Of the first less the second: the interval is without 0 where they differ by more than chance."""


def quotient_of(scores: Scores, metric: str) -> np.ndarray:
    """Parts of the numerator and of the denominator of a metric's mean, one for each episode, (2,N)."""
    if metric == "time_per_target":
        return np.stack([scores["seconds"], scores["targets"]])
    finite = np.isfinite(scores[metric])
    return np.stack([np.where(finite, scores[metric], 0.0), finite])


def seed_mean(scores: Scores, metric: str) -> float:
    """Mean of a metric over a seed's episodes in which it is finite; time per target over all targets together."""
    above, below = quotient_of(scores, metric).sum(axis=1)
    return float(above / below) if below else np.nan


def means(scores: Scores) -> dict[str, float | None]:
    """Means of all scores over the episodes in which they are finite; None if there are none."""
    found = {name: seed_mean(scores, name) for name in scores}
    return {name: round(mean, 4) if np.isfinite(mean) else None for name, mean in found.items()}


def interquartile_mean(values: np.ndarray) -> np.ndarray:
    """Means of the middle halves of the finite values along the last axis; values on the edges count in part."""
    values = np.sort(np.where(np.isfinite(values), values, np.nan))  # NaN last
    finite = np.isfinite(values)
    count, place = finite.sum(axis=-1, keepdims=True), np.arange(values.shape[-1])
    with np.errstate(invalid="ignore", divide="ignore"):
        weight = np.clip(np.minimum((place + 1) / count, 0.75) - np.maximum(place / count, 0.25), 0.0, None)
        return np.sum(weight * values, axis=-1, where=finite) / np.sum(weight, axis=-1, where=finite)


def wilson(share: float, trials: int) -> tuple[float, float]:
    """Ends of the 95 % score interval of a share of so many trials (Wilson 1927)."""
    wider = NORMAL**2 / trials
    middle, half = share + wider / 2, math.sqrt(wider * (share * (1 - share) + wider / 4))
    return min(share, max(0.0, (middle - half) / (1 + wider))), max(share, min(1.0, (middle + half) / (1 + wider)))


def trials_of(scores: list[Scores], metric: str) -> int:
    """Number of episodes of one seed that a share is of; 0 for a metric that is no share of episodes."""
    values = np.array([one[metric] for one in scores] if metric in SHARES else [[np.nan]])
    finite = np.isfinite(values)
    return int(finite[0].sum()) if np.isin(values[finite], (0.0, 1.0)).all() else 0


def interval(scores: list[Scores], metric: str, generator: np.random.Generator) -> Interval:
    """Interquartile mean over seeds of their means, and its 95 % interval.

    Each resample of the bootstrap draws seeds with replacement, and episodes, the same for all seeds, since all seeds
    were evaluated on the same ones. A method without seeds only draws episodes.
    """
    return _interval(scores, metric, resampled_means([scores], metric, generator)[:, 0])


def summary(scores: Scores) -> dict[str, Any]:
    """The means of one policy's scores, and the 95 % intervals of the shares among them, both by metric."""
    shares = [name for name in scores if name in SHARES and np.isfinite(scores[name]).any()]
    ends = {name: interval([scores], name, np.random.default_rng(0))[1:] for name in shares}
    return {"means": means(scores), "intervals": {name: [round(end, 3) for end in ends[name]] for name in shares}}


def _interval(scores: list[Scores], metric: str, draws: np.ndarray) -> Interval:
    """The interquartile mean of a metric over seeds, with its interval by resamples and, of a share, by `wilson`."""
    value, trials, (low, high) = mean_over_seeds(scores, metric), trials_of(scores, metric), _ends(draws)
    if trials:
        below, above = wilson(value, trials)
        low, high = (below, above) if len(scores) == 1 else (min(low, below), max(high, above))
    return Interval(value, low, high)


def _ends(draws: np.ndarray) -> tuple[float, float]:
    """Ends of the 95 % interval of resamples."""
    draws = draws[np.isfinite(draws)]
    low, high = np.quantile(draws, [0.025, 0.975]) if draws.size else (np.nan, np.nan)
    return float(low), float(high)


def difference(first: Interval, second: Interval, draws: np.ndarray, shares: bool) -> Interval:
    """Difference of two means with its interval, by their resamples (R,2).

    That of shares is by both intervals and the correlation of the resamples (Zou & Donner 2008).
    """
    value = first.value - second.value
    if not shares:
        return Interval(value, *_ends(draws[:, 0] - draws[:, 1]))
    draws = draws[np.isfinite(draws).all(axis=1)]
    correlation = np.corrcoef(draws.T)[0, 1] if draws.std(axis=0).all() else 0.0
    one, other = np.subtract(first.value, first[1:]), np.subtract(second.value, second[:0:-1])
    below, above = np.sqrt(np.maximum(0.0, one**2 + other**2 + 2.0 * correlation * one * other)).tolist()
    return Interval(value, value - below, value + above)


def mean_over_seeds(scores: list[Scores], metric: str) -> float:
    """Interquartile mean over seeds of their means."""
    return float(interquartile_mean(np.array([seed_mean(s, metric) for s in scores])))


def resampled_means(groups: list[list[Scores]], metric: str, generator: np.random.Generator) -> np.ndarray:
    """Resampled interquartile means of groups of seeds, (RESAMPLES,G): each draws its seeds, all the same episodes."""
    parts = [np.stack([quotient_of(one, metric) for one in scores], axis=1) for scores in groups]
    count, sums = len(groups[0][0]["return"]), [np.empty((RESAMPLES, 2, len(scores))) for scores in groups]
    for k in range(RESAMPLES):
        pick = generator.integers(count, size=count)
        for each, found in zip(parts, sums, strict=True):
            seeds = generator.integers(each.shape[1], size=each.shape[1])
            found[k] = each.take(pick, axis=2).sum(axis=2)[:, seeds]
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.stack([interquartile_mean(found[:, 0] / found[:, 1]) for found in sums], axis=1)


def compare(
    policy: PolicyLike | Sequence[PolicyLike],
    other: PolicyLike | Sequence[PolicyLike],
    env: FishVectorEnv | gym.Env | None = None,
    seed: int = FIRST_SEED,
    options: dict[str, float] | None = None,
    episodes: int | None = None,
    **changes,
) -> dict[str, Comparison]:
    """Compare two policies, or two lists of policies that were trained with different seeds, on the same episodes.

    Args:
        policy: what `evaluate` takes, or a list of them.
        other: likewise.
        env: as for `evaluate`; None for episodes in the environment that the first policy was trained in, or the
            second if the first is no policy file. `INTERFACE_OPTIONS` there are those of their own trainings.
        seed: of the first episode.
        options: of the resets.
        episodes: how many, 100 for None; a batch has as many as it has fish.
        changes: keywords of the environment instead of those of the trainings; None is ignored.

    Returns:
        For every metric its mean and interval for both, and for their difference: interquartile means over the policies
        of a list of their means over episodes, with the 95 % intervals of this module. The resamples are seeded.

    Raises:
        FileNotFoundError: if there is no such policy.
        ValueError: without an environment; for policies that were trained with other options, unless they are changed;
            for changes of a given environment; and what `evaluate` raises.
    """
    groups, found, count = [_loaded(policy), _loaded(other)], {}, EPISODES if episodes is None else episodes
    every = [one for group in groups for one in group]
    if env is not None and changes:
        raise ValueError(f"an environment is given, and {', '.join(changes)} too; make it with them")
    made = same_environments(every, changes) if env is None else [None] * len(every)
    results: list[Scores] = []
    for one, own in zip(every, made, strict=True):
        with closing(make_checked_batch(*own, count)) if own else nullcontext(cast(FishVectorEnv, env)) as batch:
            results.append(evaluate(batch, one, seed, options, episodes))
    scores = [results[: len(groups[0])], results[len(groups[0]) :]]
    for metric in scores[0][0]:
        draws = resampled_means(scores, metric, np.random.default_rng(0))
        first, second = (_interval(group, metric, draws[:, g]) for g, group in enumerate(scores))
        shares = all(trials_of(group, metric) for group in scores)
        found[metric] = Comparison(first, second, difference(first, second, draws, shares))
    return found


def same_environments(policies: Sequence[PolicyLike], changes: Mapping[str, Any]) -> list[tuple[str, dict[str, Any]]]:
    """Id and keywords of the environment of each policy, which have the same episodes.

    Policies of one id have the keywords of their own trainings, which may differ in `INTERFACE_OPTIONS`. Others run
    where the first one was trained.

    Raises:
        ValueError: if no policy names an environment, or if they were trained with other keywords.
    """
    named = next((one for one in policies if isinstance(one, Policy)), None)
    if named is None:
        raise ValueError("neither policy is a file that names its environment; give env, a batch of fish")
    env_id, first = environment_for(named, changes)
    own = [one if isinstance(one, Policy) and one.about["env_id"] == env_id else named for one in policies]
    found = [first if one is named else environment_for(one, changes)[1] for one in own]
    usual = {name: each.default for name, each in inspect.signature(Episodes.__init__).parameters.items()}
    kwargs = gym.registry[env_id].kwargs
    usual |= keywords_of(TASKS.get(kwargs.get("task", ""), object)) | kwargs
    late = any(np.any(options.get(name, 0)) for options in found for name in ("observation_delay", "action_delay"))
    apart = INTERFACE_OPTIONS - ({"control_interval"} if late else set())
    for options in found:
        texts = {name: [json.dumps(each.get(name, usual.get(name)), sort_keys=True, default=repr)
                        for each in (first, options)] for name in sorted(first.keys() | options.keys())}  # fmt: skip
        other = {name: each for name, each in texts.items() if name not in apart
                 and json.loads(each[0]) != json.loads(each[1])}  # fmt: skip
        if other:
            said = ", ".join(f"{name} ({' and '.join(each)})" for name, each in other.items())
            raise ValueError(
                f"the policies were trained in environments that differ in {said}; give env, or what is to be the same "
                "in both, as a keyword or by --env-kwargs"
            )
    if len({(options.get("max_episode_steps"), options.get("control_interval")) for options in found}) > 1:
        lengths = set()
        for options in found:
            with closing(make_checked_batch(env_id, options, 1)) as batch:
                lengths.add(f"{(batch.max_episode_steps or np.inf) * batch.control_interval:g} s")
        if len(lengths) > 1:
            raise ValueError(f"the episodes last {' and '.join(sorted(lengths))}; give max_episode_steps for both")
    return [(env_id, options) for options in found]


def _loaded(given: PolicyLike | Sequence[PolicyLike]) -> list[PolicyLike]:
    """The policies of a list, or one alone, files read."""
    every = list(given) if isinstance(given, list | tuple) else [given]
    if not every:
        raise ValueError("a list of policies is empty; give at least one policy")
    return [load_policy(one) if isinstance(one, str | Path) else one for one in every]
