"""Fit the other bodies to the default fish: bending stiffness of each section, natural frequencies, muscles.

`python -m benchmarks.calibration.bodies` fits every level of every body and writes `fish_env/bodies/<body>.json`; with
`--check` it only measures what is shipped, into `results/alike.csv`.
"""

import argparse
import json
from pathlib import Path

import numpy as np
from scipy.optimize import least_squares

import fish_env.bodies
from benchmarks.calibration.structural_match import Measures, drag_power, measures, swing
from benchmarks.common.tables import provenance, write_csv
from fish_env import make_fish

FOLDER = Path(fish_env.bodies.__file__).parent
LEVELS = {"planar": (1, 2), "tetrahedral": (1, 2, 3), "two_layer": (1,)}
"""Of each body; the body of two layers has one."""
START = {
    "planar": {"bending": [1.0] * 5, "shear": 1.0},
    "tetrahedral": {"bending": [1.0] * 5, "young": [4000.0] * 6},
    "two_layer": {"bending": [1.0] * 5, "shear": 1.0},
}
FREQUENCY_WEIGHTS = np.array([1.0, 1.0, 0.2, 0.2])  # beside a kink; a body of few joints cuts off the higher ones
SMOOTH = 0.03  # cost of changing a parameter: what fits as well with smaller changes is taken
LARGEST = 30.0  # factor by which no parameter is changed
LEAST = {"bending": [0.5] * 5, "young": [1600.0] * 5 + [8000.0]}
"""Of tetrahedra from level 2 on: what is softer folds when the fish swims; the tail fin's edge, of no width, cups."""


def residuals(found: Measures, wanted: Measures) -> np.ndarray:
    """How far off the compliance is, over what is wanted on its diagonal, and logarithms of the frequencies' ratios."""
    return np.concatenate([
        compliance_off(found, wanted)[np.triu_indices(5)],
        FREQUENCY_WEIGHTS * np.log(found.frequency / wanted.frequency),
    ])  # fmt: skip


def compliance_off(found: Measures, wanted: Measures) -> np.ndarray:
    """Difference of the compliances (5,5), over the geometric means of what is wanted on the diagonal."""
    size = np.sqrt(np.diag(wanted.kink))
    return (found.kink - wanted.kink) / np.outer(size, size)


def make(body, level, **parameters):
    """A body at a level of detail, where it has any."""
    return make_fish(body, **({"level": level} if body in ("planar", "tetrahedral") else {}), **parameters)


def fit(body: str, level: int, wanted: Measures) -> dict:
    """The parameters of a body at a level of detail that match the default fish best."""
    names = list(START[body])
    start = np.concatenate([np.ravel(START[body][name]) for name in names])

    def parameters(logs):
        values, given = start * np.exp(logs), {}
        for name in names:
            size = np.size(START[body][name])
            given[name] = values[:size].tolist() if size > 1 else float(values[0])
            values = values[size:]
        return given

    water = {"drag": 1.0} if body == "tetrahedral" else {}

    def cost(logs):
        fish = make(body, level, pull=[1.0] * 3, **water, **parameters(logs))
        return np.concatenate([residuals(measures(fish), wanted), SMOOTH * logs])

    least = LEAST if body == "tetrahedral" and level > 1 else {}
    lowest = np.concatenate([np.ravel(least.get(name, np.array(START[body][name]) / LARGEST)) for name in names])
    bounds = (np.log(lowest / start), np.log(LARGEST))
    first = np.maximum(0.0, bounds[0] + 1e-3)
    found = least_squares(cost, first, bounds=bounds, diff_step=1e-3)
    given = parameters(found.x)
    fish = make(body, level, pull=[1.0] * 3, **water, **given)
    pull = wanted.pull / measures(fish).pull
    rounded = {name: np.round(value, 1 if name == "young" else 4).tolist() for name, value in given.items()}
    if water:
        default = make_fish()
        water = {"drag": round(drag_power(default, default) / drag_power(fish, default), 4)}
    return rounded | {"pull": np.round(pull, 4).tolist()} | water


def check() -> list[dict]:
    """What the shipped bodies measure, a row each."""
    wanted, rows = measures(make_fish()), []
    cases = [("mass_spring", None), *((body, level) for body in LEVELS for level in LEVELS[body])]
    for body, level in cases:
        fish = make(body, level)
        found = measures(fish)
        row = {"body": body, "level": level or "", "nodes": fish.body.mass.size, "mass_g": 1e3 * fish.body.mass.sum()}
        measured = {
            "kink": (np.diag(found.kink), np.diag(wanted.kink)),
            "frequency": (found.frequency, wanted.frequency),
            "pull": (found.pull, wanted.pull),
        }
        for name, (now, then) in measured.items():
            for k, (a, b) in enumerate(zip(now, then, strict=True)):
                row[f"{name}_{k + 1}"], row[f"{name}_{k + 1}_off_percent"] = f"{a:.5g}", f"{100 * (a / b - 1):.2f}"
        row["compliance_off_percent"] = f"{100 * np.abs(compliance_off(found, wanted)).max():.2f}"
        row["frequency_1_at_20_mm"] = f"{swing(fish, 0.02):.3g}"  # with the tail swinging so far to each side
        rows.append(row)
        off = " ".join(f"{name} {np.round(100 * (now / then - 1), 1)} %" for name, (now, then) in measured.items())
        print(f"{body:12} {level or '':2} {off}, compliance within {row['compliance_off_percent']} %", flush=True)
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
            about = provenance("python -m benchmarks.calibration.bodies")
            (FOLDER / f"{body}.json").write_text(json.dumps({"provenance": about, "levels": levels}, indent=2) + "\n")
            print(body, levels)
    write_csv("alike.csv", check(), "python -m benchmarks.calibration.bodies --check")


if __name__ == "__main__":
    main()
