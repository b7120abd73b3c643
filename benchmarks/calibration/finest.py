"""Calibrate the finest body, its water and three gaits to living fish: `performance.py` says what is compared.

Nonlinear least squares (scipy's) in the logarithms of factors on START. The material is the same at every level of the
body of tetrahedra: the search is mostly at level 1, and ends at level 2.
"""

import multiprocessing
from functools import partial

import numpy as np
from scipy.optimize import least_squares

from benchmarks.calibration.keep import PACKAGE, kept, publish, rounded
from benchmarks.calibration.performance import TROUT, perform, residuals
from fish_env import make_fish
from fish_env.bodies import Fish
from fish_env.bodies.fitted import read_calibration
from fish_env.control import Gait

SEARCHES = ((1, 16), (2, 4))
"""Level and steps of one search after another."""
SPREAD, DIFFERENCE, ENOUGH = 0.02, 4e-3, 2e-3
"""Of the logarithms: standard deviation of where a search begins, differences of the Jacobian; least gain of a step."""
NEAR = 0.05  # weight of the distance from the start: of parameters that nothing depends on, the first are kept
NOWHERE, RESIDUALS = 10.0, 45  # residual where there is no fish, and how many there are
STEEP = 150.0  # the largest derivative: at the edge of failure, differences are no slopes
FAR = 1.6  # the most that a logarithm may change
CONTRACTED = 0.6, 0.95
"""Least and largest contracted length of a muscle."""
FRICTION = 1.0, 4.0
"""Skin friction of a swimming fish over that of a flat plate: its boundary layer is thinner."""
ADDED_MASS = 0.91, 0.92
"""Lateral and vertical added mass of an ellipsoid as slender as a trout, over that of slender-body theory."""

START: dict[str, dict] = {}


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
        "drag_coefficient": slice(1), "friction": slice(1)}  # fmt: skip
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


def bounds(start: dict) -> tuple[np.ndarray, np.ndarray]:
    """Lowest and highest point of a search from a record."""
    low, high, place = np.full(SIZE, -FAR), np.full(SIZE, FAR), 0
    for name, part in FREE.items():
        count = len(range(6)[part])
        if name == "friction":
            low[place], high[place] = np.log(np.array(FRICTION) / start["parameters"]["friction"]) + (-1e-6, 1e-6)
        if name == "contracted":
            span = np.log((1.0 - np.array(CONTRACTED[::-1])) / (1.0 - np.array(start["parameters"][name]))[:, None])
            low[place : place + count], high[place : place + count] = span.T + np.array([[-1e-6], [1e-6]])
        place += count
    return low, high


def slopes(at, pool, point: np.ndarray) -> np.ndarray:
    """Derivatives of `at` by forward differences, each in one of the processes of a pool; steep ones are limited."""
    moved = point + DIFFERENCE * np.eye(point.size)
    here, *there = pool.map(at, [point, *moved], chunksize=1)
    return np.clip((np.array(there) - here).T / DIFFERENCE, -STEEP, STEEP)


def misfit(point: np.ndarray, start: dict, water: str, level: int) -> np.ndarray:
    """What least squares are taken of at a point; NOWHERE where there is no such body, or it cannot swim."""
    try:
        record = decoded(point, start)
        with np.errstate(all="ignore"):
            found = residuals(perform(fish_of(record, water, level), gaits_of(record)))
    except (ValueError, ArithmeticError):
        found = np.full(RESIDUALS, NOWHERE)
    return np.concatenate([np.nan_to_num(found, nan=NOWHERE), NEAR * np.asarray(point)])


def improve(start: dict, water: str, level: int, steps: int, seed: int) -> dict:
    """The record that least squares from a record find, with its "cost": half the squares."""
    begin = SPREAD * np.random.default_rng(seed).standard_normal(SIZE)
    low, high = bounds(start)
    with multiprocessing.get_context("spawn").Pool() as pool:
        at = partial(misfit, start=start, water=water, level=level)
        found = least_squares(
            at, np.clip(begin, low, high), partial(slopes, at, pool), bounds=(low, high), ftol=ENOUGH, xtol=1e-4,
            gtol=None, max_nfev=steps,
        )  # fmt: skip
    return decoded(found.x, start) | {"cost": float(found.cost)}


def calibrate(water: str, seed=1) -> None:
    """Ship what the searches find, one after another."""
    record = START[water]
    for level, steps in SEARCHES:
        record = kept("finest", improve, record, water, level, steps, seed)
        print(f"finest body, level {level}: half the squares {record['cost']:.3f}", flush=True)
    publish(PACKAGE / "bodies" / "tetrahedral.json", water, record | {"seed": seed})
