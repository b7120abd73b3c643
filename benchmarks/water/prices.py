"""Price of each level of water: a step of fish that swim, over that of the fish that is calibrated for drag.

What is compared runs in turn within one process, and is counted in processor time. Ratios are medians of those of each
round, over tanks that are made several times.
"""

import numpy as np

from benchmarks.common.tables import publish
from benchmarks.common.timing import Swim, costs, swimming
from benchmarks.water.levels import PRICED, fish_in
from fish_env.control.chart import steps_of

ROUNDS = 21


def prices(count: int, dtype: str) -> list[dict]:
    """A row for each of PRICED."""
    fish, rows = [fish_in(*case) for case in PRICED], []
    found = costs(lambda: [Swim(swimming(each, count, dtype=dtype)) for each in fish], ROUNDS)
    for (name, level), each, cost in zip(PRICED, fish, found, strict=True):
        quarters = np.round(cost.ratio * steps_of(fish[0]) / steps_of(each), 3).tolist()
        rows.append({
            "fish": name, "count": count, "dtype": dtype, "water": level,
            "us_per_step": round(float(cost.time[1]) / steps_of(each), 4),
            "over_drag": quarters[1], "lower_quartile": quarters[0], "upper_quartile": quarters[2],
        })  # fmt: skip
    return rows


def measure() -> list[dict]:
    """The rows of one fish and of 256."""
    return [row for count in (256, 1) for dtype in ("float64", "float32") for row in prices(count, dtype)]


if __name__ == "__main__":
    publish(__doc__, {"water_prices.csv": measure})
