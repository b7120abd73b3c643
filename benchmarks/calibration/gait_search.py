"""Search the best open-loop gait of the default fish (CMA-ES), from two gaits, of which the better end is taken."""

from dataclasses import asdict

import numpy as np

from benchmarks.calibration.finest import living_gaits
from benchmarks.calibration.keep import kept, publish, rounded
from benchmarks.calibration.midline import Midline, swim_gait
from benchmarks.common.search import minimise
from fish_env import make_fish
from fish_env.bodies.fitted import read_calibration
from fish_env.control import Gait, evaluate, gait_controller, make_eval_env
from fish_env.control.gait import GAIT_FILE

GAIT_SEED = 2_000_000  # of the episodes a gait is tuned on: neither those of training nor those of evaluation

TOGETHER = Gait(4.0, (1.0, 1.0, 0.7), (0.0, 0.1, 1.4))
"""A gait whose two front segments contract fully and at once."""


def search(water: str, starts: list[dict], generations: int, _fish: dict) -> dict:
    """The default fish's best open-loop gait at no more than 4 Hz, from some first guesses.

    Best is fastest in the task itself: mean distance between start and end of eight episodes of Swim-v0, whatever its
    direction. The cruise it settles into, undisturbed, must be within the bars.
    """
    fish = make_fish("mass_spring", water=water)
    env = make_eval_env("FishEnv/Swim-v0", 8, {"muscle_groups": "pairs", "water": water})

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
        start = np.array([1.0, *guess["amplitude"], *(np.array(guess["lag"][1:]) / (2 * np.pi))])
        ends.append(minimise(slowness, start, 0.1, generations, seed=1))
    found = gait(min(ends, key=lambda end: end[1])[0])
    return rounded({"frequency": found.frequency, "amplitude": list(found.amplitude), "lag": list(found.lag)})


def calibrate(water: str, generations=60) -> None:
    """Ship the best gait."""
    fish = read_calibration("mass_spring", water)["parameters"]
    starts = [asdict(gait) for gait in (living_gaits(water)[-1], TOGETHER)]
    publish(GAIT_FILE, water, {"gait": kept("gait", search, water, starts, generations, fish)})


def bars(swum: Midline) -> list[tuple[float, float, float]]:
    """(value, lowest, highest) of what a gait must reach, with a margin of a hundredth."""
    if swum.failure:
        return [(10.0, 0.0, 0.0)]
    return [(swum.stride, 0.51, np.inf), (swum.strouhal, 0.21, 0.34), (swum.sweep, 0.105, 0.255),
            (swum.wobble, 0.0, 0.1), (swum.nose, 0.0, 0.24)]  # fmt: skip
