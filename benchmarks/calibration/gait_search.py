"""Search the best open-loop gait of the default fish (CMA-ES) and write it where the package reads it.

python -m benchmarks.calibration.gait_search     from two gaits, of which the better end is taken (4 min)
"""

import argparse
import json

import numpy as np

from benchmarks.calibration.living_fish import living_gaits
from benchmarks.calibration.midline import Midline, swim_gait
from benchmarks.common.search import minimise
from benchmarks.common.tables import provenance
from fish_env import make_fish
from fish_env.control import Gait, evaluate, gait_controller, make_eval_env
from fish_env.control.gait import GAIT_FILE

GAIT_SEED = 2_000_000  # of the episodes a gait is tuned on: neither those of training nor those of evaluation
DIGITS = 4  # significant figures of a calibrated parameter
COMMAND = "python -m benchmarks.calibration.gait_search"

TOGETHER = Gait(4.0, (1.0, 1.0, 0.7), (0.0, 0.1, 1.4))
"""A gait whose two front segments contract fully and at once."""


def write_gait(starts, command, generations=60) -> None:
    """Find the default fish's best open-loop gait at no more than 4 Hz, from some first guesses, and write it.

    Best is fastest in the task itself: mean distance between start and end of eight episodes of Swim-v0, whatever its
    direction. The cruise it settles into, undisturbed, must be within the bars.
    """
    fish = make_fish("mass_spring")
    env = make_eval_env("FishEnv/Swim-v0", 8, {"muscle_groups": "pairs"})

    def gait(point):
        u = np.clip(point, 0, 1)
        return Gait(2.0 + 2.0 * u[0], tuple(u[1:4]), (0.0, *(2 * np.pi * point[4:6])))

    def slowness(point):
        found = gait(point)
        scores = evaluate(env, gait_controller(found, env), GAIT_SEED)
        speed = np.hypot(scores["speed"], scores["sideways"]).mean()
        outside = float(np.sum((point[:4] - np.clip(point[:4], 0, 1)) ** 2))
        measured = bars(swim_gait(fish, found))
        missed = sum(max(0.0, low - value) + max(0.0, value - high) for value, low, high in measured)
        return -speed + 20 * missed + 10 * outside

    ends = []
    for guess in starts:
        start = np.array([1.0, *guess.amplitude, *(np.array(guess.lag[1:]) / (2 * np.pi))])
        ends.append(minimise(slowness, start, 0.1, generations, seed=1))
    found = gait(min(ends, key=lambda end: end[1])[0])
    rounded = {"frequency": round(found.frequency, 3)} | {
        name: [float(f"{value:.{DIGITS}g}") for value in getattr(found, name)] for name in ("amplitude", "lag")
    }
    GAIT_FILE.parent.mkdir(parents=True, exist_ok=True)
    GAIT_FILE.write_text(json.dumps({"provenance": provenance(command), "gait": rounded}, indent=2) + "\n")


def bars(swum: Midline) -> list[tuple[float, float, float]]:
    """(value, lowest, highest) of what a gait must reach, with a margin of a hundredth."""
    if swum.failure:
        return [(10.0, 0.0, 0.0)]
    return [(swum.stride, 0.51, np.inf), (swum.strouhal, 0.21, 0.41), (swum.sweep, 0.105, 0.255),
            (swum.wobble, 0.0, 0.1)]  # fmt: skip


def main() -> None:
    """The command line."""
    argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter).parse_args()
    write_gait((living_gaits()[-1], TOGETHER), COMMAND)


if __name__ == "__main__":
    main()
