"""Fit the other bodies to the default fish: bending stiffness of each section, natural frequencies, muscles.

`python -m benchmarks.calibrate_bodies` fits every level of every body and writes `fish_env/bodies/<body>.json`; with
`--check` it only measures what is shipped, into `results/alike.csv`.
"""

import argparse
import json
from pathlib import Path

import numpy as np
from scipy.optimize import least_squares

import fish_env.bodies
from benchmarks.alike import Measures, measures
from benchmarks.provenance import provenance, write_csv
from fish_env import make_fish

FOLDER = Path(fish_env.bodies.__file__).parent
LEVELS = {"planar": (1, 2, 3, 4), "tetrahedral": (1, 2, 3), "two_layer": (1,)}
START = {
    "planar": {"bending": [1.0] * 5, "shear": 1.0},
    "tetrahedral": {"bending": [1.0] * 5, "young": [4000.0] * 6},
    "two_layer": {"bending": [1.0] * 5, "shear": 1.0},
}
FREQUENCY_WEIGHTS = np.array([1.0, 1.0, 0.2, 0.2])  # beside a kink; a body of few joints cuts off the higher ones
SMOOTH = 0.03  # price of changing a parameter: what fits as well with smaller changes is taken
LARGEST = 30.0  # factor by which no parameter is changed


def residuals(found: Measures, wanted: Measures) -> np.ndarray:
    """Logarithms of what is found over what is wanted: five kinks, four frequencies."""
    return np.concatenate([
        np.log(found.kink / wanted.kink),
        FREQUENCY_WEIGHTS * np.log(found.frequency / wanted.frequency),
    ])  # fmt: skip


def fit(body: str, level: int, wanted: Measures) -> dict:
    """The parameters of a body at a level of detail that make it most alike the default fish."""
    names = list(START[body])
    start = np.concatenate([np.ravel(START[body][name]) for name in names])

    def parameters(logs):
        values, given = start * np.exp(logs), {}
        for name in names:
            size = np.size(START[body][name])
            given[name] = values[:size].tolist() if size > 1 else float(values[0])
            values = values[size:]
        return given

    def cost(logs):
        fish = make_fish(body, level=level, pull=[1.0] * 3, **parameters(logs))
        return np.concatenate([residuals(measures(fish), wanted), SMOOTH * logs])

    found = least_squares(cost, np.zeros(start.size), bounds=(-np.log(LARGEST), np.log(LARGEST)), diff_step=1e-3)
    given = parameters(found.x)
    pull = wanted.pull / measures(make_fish(body, level=level, pull=[1.0] * 3, **given)).pull
    rounded = {name: np.round(value, 1 if name == "young" else 4).tolist() for name, value in given.items()}
    return rounded | {"pull": np.round(pull, 4).tolist()}


def check() -> list[dict]:
    """What the shipped bodies measure, a row each."""
    wanted, rows = measures(make_fish()), []
    cases = [("mass_spring", None), *((body, level) for body in LEVELS for level in LEVELS[body])]
    for body, level in cases:
        fish = make_fish(body) if level is None else make_fish(body, level=level)
        found = measures(fish)
        row = {"body": body, "level": level or "", "nodes": fish.body.mass.size, "mass_g": 1e3 * fish.body.mass.sum()}
        for name, now, then in zip(Measures._fields, found, wanted, strict=True):
            for k, (a, b) in enumerate(zip(np.atleast_1d(now), np.atleast_1d(then), strict=True)):
                row[f"{name}_{k}"], row[f"{name}_{k}_off_percent"] = f"{a:.5g}", f"{100 * (a / b - 1):.2f}"
        rows.append(row)
        off = [100 * (np.atleast_1d(a) / b - 1) for a, b in zip(found, wanted, strict=True)]
        print(f"{body:12} {level or '':2}", *(f"{name} {np.round(o, 1)} %" for name, o in zip(Measures._fields, off)))  # noqa: B905
    return rows


def main() -> None:
    """Fit, or check."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--check", action="store_true", help="only measure what is shipped")
    parser.add_argument("--body", choices=LEVELS, help="fit this one only")
    chosen = parser.parse_args()
    if not chosen.check:
        wanted = measures(make_fish())
        for body in [chosen.body] if chosen.body else list(LEVELS):
            levels = {str(level): fit(body, level, wanted) for level in LEVELS[body]}
            about = provenance("python -m benchmarks.calibrate_bodies")
            (FOLDER / f"{body}.json").write_text(json.dumps({"provenance": about, "levels": levels}, indent=2) + "\n")
            print(body, levels)
    write_csv("alike.csv", check(), "python -m benchmarks.calibrate_bodies --check")


if __name__ == "__main__":
    main()
