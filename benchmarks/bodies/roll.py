"""By how much every body rolls when it swims strongly, after a small disturbance; the finest one stays upright.

python -m benchmarks.bodies.roll     table and results/roll.csv (a minute; level 3 of the tetrahedra is left out)
"""

import argparse

import numpy as np

from benchmarks.bodies.fidelity import every_fish
from benchmarks.common.roll import roll, strong_gaits
from benchmarks.common.tables import write_csv

COMMAND = "python -m benchmarks.bodies.roll"
SLOW = 3  # level of the tetrahedra that is left out


def measure() -> list[dict]:
    """A row for each body and gait."""
    rows, gaits = [], strong_gaits()
    for (name, level), fish in every_fish().items():
        if fish.flat or level == SLOW:
            continue
        for gait, angle in zip(gaits, np.degrees(roll(fish)), strict=True):
            rows.append({
                "body": name, "level": level, "frequency_hz": f"{gait.frequency:.3g}",
                **{f"amplitude_{k}": f"{a:.3g}" for k, a in enumerate(gait.amplitude)},
                **{f"lag_{k}": f"{a:.3g}" for k, a in enumerate(gait.lag)}, "roll_degrees": f"{angle:.3g}",
            })  # fmt: skip
    return rows


def main() -> None:
    """The command line."""
    argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter).parse_args()
    rows = measure()
    for body in dict.fromkeys((row["body"], row["level"]) for row in rows):
        angles = [float(row["roll_degrees"]) for row in rows if (row["body"], row["level"]) == body]
        print(f"{body[0]:12}{body[1]!s:3} median {np.median(angles):5.1f}, largest {max(angles):5.1f} degrees")
    print(write_csv("roll.csv", rows, COMMAND))


if __name__ == "__main__":
    main()
