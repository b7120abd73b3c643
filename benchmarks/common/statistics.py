"""Intervals of means, and numbers as tables show them."""

import numpy as np


def interval_of(values: np.ndarray) -> tuple[float, float, float]:
    """Mean of (S,) and its 95 % interval by the bootstrap, with a fixed seed."""
    draws = np.random.default_rng(0).choice(values, (2000, values.size)).mean(axis=1)
    return float(values.mean()), *map(float, np.percentile(draws, [2.5, 97.5]))


def rounded(value: float) -> float | str:
    """Format with four digits after the point; "" for a number that is not finite."""
    return round(float(value), 4) if np.isfinite(value) else ""
