"""Means over seeds and their intervals: interquartile means with bootstrap intervals."""

import numpy as np

from fish_env.control import Scores

RESAMPLES = 2000


def seed_mean(scores: Scores, metric: str) -> float:
    """Mean of a metric over a seed's episodes in which it is finite; time per target over all targets together."""
    if metric == "time_per_target":
        return float(scores["seconds"].sum() / scores["targets"].sum()) if scores["targets"].sum() else np.nan
    values = scores[metric]
    return float(values[np.isfinite(values)].mean()) if np.isfinite(values).any() else np.nan


def interquartile_mean(values: np.ndarray) -> float:
    """Mean of the middle half; values on the edges count in part."""
    values = np.sort(values[np.isfinite(values)])
    if not values.size:
        return np.nan
    edges = np.linspace(0.0, 1.0, values.size + 1)
    weight = np.clip(np.minimum(edges[1:], 0.75) - np.maximum(edges[:-1], 0.25), 0.0, None)
    return float(weight @ values / weight.sum())


def interval(scores: list[Scores], metric: str, generator: np.random.Generator) -> tuple[float, float, float]:
    """Interquartile mean over seeds of their means, and its 95 % bootstrap interval.

    Each resample draws seeds with replacement, and episodes, the same for all seeds, since all seeds were evaluated on
    the same ones. A method without seeds only draws episodes.
    """
    needed = [{name: s[name] for name in {metric, "seconds", "targets"} & s.keys()} for s in scores]
    count, found = len(scores[0]["return"]), np.empty(RESAMPLES)
    for k in range(RESAMPLES):
        means, pick = [], generator.integers(count, size=count)
        for s in generator.integers(len(needed), size=len(needed)):
            means.append(seed_mean({name: values[pick] for name, values in needed[s].items()}, metric))
        found[k] = interquartile_mean(np.array(means))
    found = found[np.isfinite(found)]
    low, high = np.quantile(found, [0.025, 0.975]) if found.size else (np.nan, np.nan)
    return interquartile_mean(np.array([seed_mean(s, metric) for s in needed])), float(low), float(high)
