"""Measure the best open-loop gait of the default fish beside what living fish do.

python -m benchmarks.calibration.check     table and results/gait.csv (seconds)
"""

import argparse

import numpy as np

from benchmarks.calibration.midline import swim_gait
from benchmarks.common.tables import write_csv
from fish_env import make_fish
from fish_env.control import best_gait

RANGES = {  # name: attribute, lowest and highest of living fish, or of what a gait must reach
    "stride, BL a beat": ("stride", 0.5, np.inf),
    "Strouhal number": ("strouhal", 0.2, 0.4),
    "tail sweep, BL": ("sweep", 0.1, 0.26),
    "speed, BL/s": ("speed", 1.0, np.inf),
    "nose over tail": ("nose", 0.1, 0.14),
    "tail tips apart, over the sweep": ("wobble", 0.0, 0.1),
}


def check() -> list[dict]:
    """A row for each quantity: at the fish's own step, by RK4 at an eighth of it, and the range."""
    fish, gait = make_fish(), best_gait()
    swum, exact = swim_gait(fish, gait), swim_gait(fish, gait, integrator="rk4", dt=fish.time_step / 8)
    return [
        {
            "quantity": name, "ours": round(value := getattr(swum, key), 4), "reference": round(getattr(exact, key), 4),
            "lowest": low, "highest": high, "within": bool(low <= value <= high),
        }
        for name, (key, low, high) in RANGES.items()
    ]  # fmt: skip


def main() -> None:
    """The command line."""
    argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter).parse_args()
    rows = check()
    for row in rows:
        print(f"{row['quantity']:32}{row['ours']:9.3f}   by RK4 {row['reference']:9.3f}   "
              f"{row['lowest']:g} to {row['highest']:g} {'' if row['within'] else 'outside'}")  # fmt: skip
    print(write_csv("gait.csv", rows, "python -m benchmarks.calibration.check"))


if __name__ == "__main__":
    main()
