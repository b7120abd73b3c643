"""Price of each level of water: a step of fish that swim, over that of the fish that is calibrated for drag.

    taskset -c 1 python -m benchmarks.water.prices      one fish and 256, float64 and float32, on one core (1 min)

What is compared runs in turn within one process, and is counted in processor time. Ratios are medians of those of each
round, over tanks that are made several times.
"""

import argparse
from dataclasses import replace
from functools import partial

import numpy as np

from benchmarks.common.problems import BEAT, steps_of, swimming
from benchmarks.common.tables import write_csv
from benchmarks.common.timing import interleaved
from benchmarks.water.levels import PRICED
from fish_env import Tank, make_fish
from fish_env.bodies import Fish
from fish_env.physics.world import VACUUM, change_water

COMMAND = "python -m benchmarks.water.prices"
SETS, ROUNDS = 3, 21
SAMPLE = 30_000  # steps of a fish in a round, about


def fish_in(name: str, level: str) -> Fish:
    """The fish that is calibrated for a level, in a level."""
    fish = make_fish(water=name)
    inert = change_water(fish.water, inertia=True)
    worlds = {"none": VACUUM, "drag": fish.water, "reactive": inert} | {name: fish.water}
    return replace(fish, water=worlds[level])


class Swim:
    """Beats of a gait, of all fish of a tank, begun each time from the same state after a first beat."""

    def __init__(self, fish: Fish, count: int, dtype: str):
        self.tank, self.steps = Tank(fish, count, water=fish.water, threads=1, dtype=dtype), steps_of(fish)
        self.goals = np.repeat(swimming(fish, BEAT)[:, None], count, axis=1)
        self.beats = max(1, round(SAMPLE / (count * self.steps * BEAT)))
        self.run(1)
        self.state = self.tank.get_state()

    def start(self) -> None:
        """Return to where all began."""
        self.tank.set_state(self.state)

    def run(self, beats: int) -> None:
        """Swim on."""
        for goal in np.tile(self.goals, (beats, 1, 1)):
            self.tank.drive(goal, self.steps)
        assert self.tank.alive.all(), self.tank.failure

    def timed(self) -> tuple:
        """What `interleaved` times: preparation, run, number of steps of a fish."""
        count = self.beats * BEAT * self.steps * self.tank.num_fish
        return self.start, partial(self.run, self.beats), count


def prices(count: int, dtype: str) -> list[dict]:
    """A row for each of PRICED."""
    found = [interleaved([Swim(fish_in(*case), count, dtype).timed() for case in PRICED], ROUNDS) for _ in range(SETS)]
    rows = []
    for k, (name, level) in enumerate(PRICED):
        time, ratio = (np.median([getattr(cost[k], key) for cost in found], axis=0) for key in ("time", "ratio"))
        rows.append({
            "fish": name, "count": count, "dtype": dtype, "water": level, "us_per_step": round(float(time[1]), 4),
            "over_drag": round(float(ratio[1]), 3), "lower_quartile": round(float(ratio[0]), 3),
            "upper_quartile": round(float(ratio[2]), 3),
        })  # fmt: skip
    return rows


def main() -> None:
    """Write the table."""
    argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter).parse_args()
    rows = [row for count in (256, 1) for dtype in ("float64", "float32") for row in prices(count, dtype)]
    print(write_csv("water_prices.csv", rows, COMMAND))


if __name__ == "__main__":
    main()
