"""Calibrate the finest body, its water and three gaits to living fish (CMA-ES): `performance.py` says what is compared.

The material is the same at every level of the body of tetrahedra; it is searched at level 1. Searched are logarithms of
factors on START, which is near what an earlier search ended with.
"""

import multiprocessing
from functools import partial

import numpy as np

from benchmarks.calibration.keep import PACKAGE, kept, publish, rounded
from benchmarks.calibration.performance import TROUT, perform, residuals
from benchmarks.common.search import minimise
from fish_env import Fish, make_fish
from fish_env.bodies.fitted import read_calibration
from fish_env.control import Gait

LEVEL, GENERATIONS, POPULATION, SPREAD = 1, 10, 20, 0.02
"""Of the search; the last is the standard deviation of its first points."""
NEAR = 0.01  # weight of the distance from the start: of parameters that nothing depends on, the first are kept
CONTRACTED = 0.6, 0.95
"""Least and largest contracted length of a muscle."""
FRICTION = 1.0, 4.0
"""Skin friction of a swimming fish over that of a flat plate."""

START: dict[str, dict] = {
    "reactive": {
        "parameters": {
            "stiffness": [1.0, 575.3, 904.9],
            "taper": [1.0, 2.006, 4.015, 0.8571, 0.8985, 0.8726],
            "contracted": [0.6367, 0.8133, 0.7167],
            "lengthening": 0.6,
            "relaxation_time": 0.0001605,
            "contraction_time": 0.06,
            "drag_coefficient": 2.48,
            "friction": 1.283,
            "law": "cross_flow",
            "thinning": 42.54,
            "added_mass": [0.91, 0.92],
            "outline": "trout",
            "time_step": 0.02 / 20,
        },
        "young": [164000.0, 131500.0, 80390.0, 209700.0, 278400.0, 4623000.0],
        "gaits": [
            {"frequency": 2.48, "amplitude": [0.2789, 0.08696, 0.6199], "lag": [0.0, 1.905, 3.05]},
            {"frequency": 3.18, "amplitude": [0.434, 0.3764, 0.7453], "lag": [0.0, 1.995, 3.066]},
            {"frequency": 4.23, "amplitude": [0.231, 0.3724, 0.6243], "lag": [0.0, 1.421, 2.671]},
        ],
    },
}


def gaits_of(record: dict) -> list[Gait]:
    """The three gaits of a record of the search."""
    return [Gait(row["frequency"], tuple(row["amplitude"]), tuple(row["lag"])) for row in record["gaits"]]


def living_gaits(water: str | None = None) -> list[Gait]:
    """The gaits with which the finest body swims like the trout in a level of water, by default the default one."""
    return gaits_of(read_calibration("tetrahedral", water))


def fish_of(record: dict, water: str, level: int) -> Fish:
    """The body of a record of the search."""
    return make_fish("tetrahedral", level=level, young=record["young"], water=water, **record["parameters"])


FREE = {"stiffness": slice(1, 3), "taper": slice(1, 6), "contracted": slice(3), "relaxation_time": slice(1),
        "drag_coefficient": slice(1), "friction": slice(1), "thinning": slice(1)}  # fmt: skip
"""Parts of the parameters that are searched, beside Young's moduli and the gaits."""
SIZE = sum(len(range(6)[part]) for part in FREE.values()) + 6 + 5 * len(TROUT)


def decoded(point: np.ndarray, start: dict) -> dict:
    """The record at a point of the search: factors' logarithms on a record, and half the differences of its lags."""
    rest = list(np.asarray(point, dtype=float))

    def scaled(values, part=slice(None)) -> np.ndarray:
        found = np.array(values, dtype=float, ndmin=1)
        where = range(found.size)[part]
        found[list(where)] *= np.exp([rest.pop(0) for _ in where])
        return found

    parameters = dict(start["parameters"])
    for name, part in FREE.items():
        if name == "contracted":
            values = np.clip(1.0 - scaled(1.0 - np.array(parameters[name]), part), *CONTRACTED)
        else:
            values = scaled(parameters[name], part)
        parameters[name] = rounded(values) if np.ndim(parameters[name]) else rounded(values)[0]
    young, gaits = rounded(scaled(start["young"])), []
    for row in start["gaits"]:
        amplitude = np.clip(scaled(row["amplitude"]), 0.0, 1.0)
        lag = [0.0, *(lag + 2.0 * rest.pop(0) for lag in row["lag"][1:])]
        gaits.append({"frequency": row["frequency"], "amplitude": rounded(amplitude), "lag": rounded(lag)})
    return {"parameters": parameters, "young": young, "gaits": gaits}


def cost(point: np.ndarray, start: dict, water: str, level: int) -> float:
    """What the search minimises; a large number where there is no such body, or it cannot swim."""
    try:
        record = decoded(point, start)
        with np.errstate(all="ignore"):
            found = residuals(perform(fish_of(record, water, level), gaits_of(record)))
    except (ValueError, ArithmeticError):
        return 1e4
    friction = record["parameters"]["friction"]
    outside = 3.0 * (friction - np.clip(friction, *FRICTION))
    total = float((found**2).sum() + outside**2 + ((NEAR * np.asarray(point)) ** 2).sum())
    return total if np.isfinite(total) else 1e4


def search(start: dict, water: str, seed: int) -> dict:
    """The record that a search from a record finds, with its "cost"."""
    with multiprocessing.get_context("spawn").Pool() as pool:
        at = partial(cost, start=start, water=water, level=LEVEL)
        point, least = minimise(at, np.zeros(SIZE), SPREAD, GENERATIONS, seed, POPULATION,
                                partial(pool.map, chunksize=1))  # fmt: skip
    return decoded(point, start) | {"cost": least}


def calibrate(water: str, seed=1) -> None:
    """Ship what the search finds."""
    record = kept("finest", search, START[water], water, seed)
    print(f"finest body: squares of {record['cost']:.3f}", flush=True)
    publish(PACKAGE / "bodies" / "tetrahedral.json", water, record | {"seed": seed})
