"""What a level of detail of the uniform sphere costs, and from which distance to the viewer on it is enough.

python -m benchmarks.objects.detail     results/song_detail.csv (some seconds)
"""

import argparse
import time
from statistics import median

import numpy as np

from benchmarks.common.tables import write_csv
from fish_env import Tank
from fish_env.bodies.detail import LevelOfDetail, facet_gap
from fish_env.bodies.objects import FINEST, make_uniform_sphere, room

COMMAND = "python -m benchmarks.objects.detail"
RADIUS, FOCAL = 0.1, 800.0  # m; pixels: a picture 924 pixels wide that shows 60 degrees
REPEATS, SECONDS = 11, 0.1  # timings, and simulated s of each


def nearest(level: int) -> float:
    """The distance, m, from which on no finer level is chosen, by bisection."""
    low, high = 1e-3, 1e3
    while high / low > 1.0001:
        middle = (low * high) ** 0.5
        fine = LevelOfDetail(radius=RADIUS).choose(middle, FOCAL) > level
        low, high = (middle, high) if fine else (low, middle)
    return high


def costs(levels) -> list[dict]:
    """A row a level: size, gap, distance, and processor ms for a simulated second at its own step, timed in turn."""
    tanks, taken = {}, {level: [] for level in levels}
    for level in levels:
        thing = make_uniform_sphere(level)
        tanks[level] = Tank(thing, water=room(thing.down, 0.3, 0.5), threads=1)
    for _ in range(REPEATS + 1):
        for level, tank in tanks.items():
            steps = round(SECONDS / tank.dt)
            begin = time.process_time()
            tank.advance(steps)
            taken[level].append(1e3 * (time.process_time() - begin) / (steps * tank.dt))
    return [
        {
            "level": level, "nodes": tank.fish.body.mass.size, "springs": len(tank.fish.body.springs.nodes),
            "gap_over_radius": f"{facet_gap(level):.4g}", "from_m": f"{nearest(level):.4g}" if level < FINEST else 0,
            "step_ms": f"{1e3 * tank.dt:.4g}", "ms_per_s": f"{median(taken[level][1:]):.4g}",
            "alive": bool(np.all(tank.alive)),
        }
        for level, tank in tanks.items()
    ]  # fmt: skip


def main() -> None:
    """Write the table."""
    argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter).parse_args()
    rows = costs(range(FINEST + 1))
    print(write_csv("song_detail.csv", rows, COMMAND))
    for row in rows:
        print(row)


if __name__ == "__main__":
    main()
