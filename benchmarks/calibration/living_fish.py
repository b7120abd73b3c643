"""Calibrate the finest body to living fish (CMA-ES), and put every body beside them.

python -m benchmarks.calibration.living_fish              writes fish_env/bodies/tetrahedral.json (half an hour)
python -m benchmarks.calibration.living_fish --check      living_fish.csv, living_fish.svg and gait.csv (minutes)

Searched are the material of the body of tetrahedra (at level 2; the material is the same at every level) and three
gaits, at the frequencies and speeds of a trout of 19.6 cm (Drucker & Lauder): tail sweep and speed, the sway of the
midline (the carangiform envelope of Videler & Hess 1984, scaled to the trout's sweep), the nose's sway over the tail's,
the Strouhal number, and the wave's phase. The other bodies swim the same gaits. The check also measures the best
open-loop gait of the default fish, at its own step and by RK4 at an eighth of it.
"""

import argparse
import json
import multiprocessing
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np

import fish_env.bodies
from benchmarks.calibration.midline import Midline, swim_gait, swim_midlines
from benchmarks.common.charts import pyplot, save
from benchmarks.common.search import minimise
from benchmarks.common.tables import RESULTS, provenance, write_csv
from fish_env import make_fish
from fish_env.bodies import mass_spring as tu
from fish_env.control import Gait, best_gait

COMMAND = "python -m benchmarks.calibration.living_fish"
FILE = Path(fish_env.bodies.__file__).parent / "tetrahedral.json"
PAGE = Path(__file__).parents[2] / "docs" / "validation.md"
LEVEL, SECONDS, BEATS = 2, 2.4, 2
POPULATION, GENERATIONS, SIGMA = 20, 20, 0.04


@dataclass(frozen=True)
class Trout:
    """One row of a study of the median fins of a 19.6 cm rainbow trout (J. Exp. Biol., after Drucker & Lauder)."""

    speed: float  # body lengths/s
    frequency: float  # Hz
    sweep: float  # body lengths


TROUT = tuple(Trout(u, f, cm / 19.6) for u, f, cm in ((0.5, 2.48, 1.80), (1.0, 3.18, 2.55), (2.0, 4.23, 2.85)))
STATION = np.array([0.0, *tu.calibrated()["layer_position"], 1.0])
"""Of the midline, body lengths from the nose."""
ENVELOPE = (0.02 - 0.0825 * STATION + 0.1625 * STATION**2) / 0.1
"""Half the sway of each station over the tail tip's (Videler & Hess 1984)."""
LEAST = (0.84, 0.85, 0.76)
"""Least contracted lengths of the three segments: a fish of 23 nodes that contracts farther buckles in the abrupt
manoeuvre, and magnifies a disturbance a millionfold (`benchmarks.common.problems.magnified`)."""
WAVELENGTH = 1.0  # body lengths, of the trunk's wave
START: dict = {
    "parameters": {
        "stiffness": [1.0, 400.0, 189.0],
        "taper": [1.0, 1.405, 1.226, 1.067, 0.9946, 0.3564],
        "contracted": [0.8463, 0.8574, 0.7666],
        "relaxation_time": 0.003092,
        "drag_coefficient": 1.0,
    },
    "young": [66000.0, 26040.0, 4356.0, 42390.0, 16580.0, 49790.0],
    "gaits": [
        {"frequency": 2.48, "amplitude": [0.5063, 0.3665, 0.4656], "lag": [0.0, 2.051, 3.048]},
        {"frequency": 3.18, "amplitude": [0.7853, 0.4755, 0.8759], "lag": [0.0, 1.54, 3.093]},
        {"frequency": 4.23, "amplitude": [0.4378, 0.635, 1.0], "lag": [0.0, 1.21, 2.694]},
    ],
}
"""Where the search begins: what an earlier one ended with, which began with a body fitted to a search of 23 nodes."""


def gaits_of(record: dict) -> list[Gait]:
    """The three gaits of a record of the search."""
    return [Gait(row["frequency"], tuple(row["amplitude"]), tuple(row["lag"])) for row in record["gaits"]]


def living_gaits() -> list[Gait]:
    """The gaits with which the finest body swims like the trout."""
    return gaits_of(json.loads(FILE.read_text()))


def beyond(value, limit):
    """How far a value is above a limit."""
    return np.maximum(value - limit, 0.0)


def cost(midlines: list[Midline]) -> float:
    """What the search minimises: what is beyond the bars counts, and a little of what is within them."""
    total = 0.0
    for found, real in zip(midlines, TROUT, strict=True):
        if found.failure or not np.isfinite(found.sweep):
            return 1e3
        for ratio in (max(found.speed, 0.02) / real.speed, max(found.sweep, 0.005) / real.sweep):
            off = abs(np.log(ratio))
            total += 60.0 * beyond(off, 0.05) ** 2 + 2.0 * off**2
        off = np.abs(found.amplitude[:6] - 0.5 * real.sweep * ENVELOPE[:6])
        total += 3000.0 * (beyond(off, 0.011) ** 2).sum() + 40.0 * (off**2).sum()
        total += 40.0 * (beyond(found.nose, 0.155) ** 2 + beyond(0.10, found.nose) ** 2)
        total += 10.0 * beyond(found.strouhal, 0.38) ** 2 + 2.0 * beyond(found.wobble, 0.1)
        lag = (1.0 - STATION[3:6]) / WAVELENGTH + found.phase[3:6]
        total += 0.5 * (lag**2).sum()
    return float(total)


def decoded(point) -> dict:
    """The record of a point of the search: factors' logarithms on START, and differences of the lags."""
    values, used = {}, 0

    def take(count):
        nonlocal used
        used += count
        return np.asarray(point[used - count : used])

    p, rounded = START["parameters"], lambda v: [float(f"{x:.4g}") for x in np.ravel(v)]
    section = np.exp(take(6))
    values["stiffness"] = rounded([p["stiffness"][0], p["stiffness"][1], p["stiffness"][2] * section[0]])
    taper = np.array(p["taper"][1:]) * section[1:] / np.array([1.0, 1.0, 1.0, section[0], section[0]])
    values["taper"] = [1.0, *rounded(taper)]
    values["contracted"] = rounded(np.clip(1.0 - (1.0 - np.array(p["contracted"])) * np.exp(take(3)), LEAST, 0.95))
    values["relaxation_time"] = rounded(p["relaxation_time"] * np.exp(take(1)))[0]
    values["drag_coefficient"] = p["drag_coefficient"]  # not searched: it scales thrust as it scales drag
    young = rounded(np.array(START["young"]) * np.exp(take(6)))
    gaits = []
    for row in START["gaits"]:
        amplitude = np.clip(np.array(row["amplitude"]) * np.exp(take(3)), 0.0, 1.0)
        lag = np.array([0.0, *(np.array(row["lag"][1:]) + 2.0 * take(2))])
        gaits.append({"frequency": row["frequency"], "amplitude": rounded(amplitude), "lag": rounded(lag)})
    return {"parameters": values, "young": young, "gaits": gaits}


SIZE = 6 + 3 + 1 + 6 + 15


def swum(record: dict, level=LEVEL, seconds=SECONDS) -> list[Midline]:
    """The three gaits on the body of a record."""
    fish = make_fish("tetrahedral", level=level, young=record["young"], **record["parameters"])
    return swim_midlines(fish, gaits_of(record), [row.speed for row in TROUT], seconds, BEATS)


def cost_at(point) -> float:
    """The cost at a point of the search."""
    strong = 0.0
    try:
        record = decoded(point)
        strong = beyond(max(record["gaits"][2]["amplitude"]), 0.97) ** 2
        return cost(swum(record)) + 5.0 * strong + 0.02 * float(np.sum(np.square(point)))
    except ValueError:
        return 2e3


def calibrate(generations: int, seed: int) -> None:
    """Search, and write the best."""
    with multiprocessing.get_context("spawn").Pool() as pool:
        point, cost = minimise(cost_at, np.zeros(SIZE), SIGMA, generations, seed, POPULATION,
                               partial(pool.map, chunksize=1))  # fmt: skip
    about = provenance(COMMAND) | {"cost": cost, "evaluations": POPULATION * generations, "seed": seed}
    FILE.write_text(json.dumps({"provenance": about} | decoded(point), indent=2) + "\n")


BODIES = (("tetrahedral", 2), ("tetrahedral", 3), ("mass_spring", ""), ("planar", ""), ("two_layer", ""))


def rows_of(name: str, level, found: list[Midline]) -> list[dict]:
    """A row for each of the trout's speeds."""
    return [
        {
            "body": name, "level": level, "frequency_hz": real.frequency, "speed_trout": real.speed,
            "speed": round(one.speed, 3), "sweep_trout": round(real.sweep, 4), "sweep": round(one.sweep, 4),
            "nose_over_tail": round(one.nose, 3), "strouhal": round(one.strouhal, 3), "stride": round(one.stride, 3),
            "envelope_off": round(float(np.abs(one.amplitude - 0.5 * real.sweep * ENVELOPE).max()), 4),
            **{f"amplitude_{k}": round(float(a), 4) for k, a in enumerate(one.amplitude)},
            **{f"phase_{k}": round(float(a), 3) for k, a in enumerate(one.phase)}, "failure": one.failure,
        }
        for one, real in zip(found, TROUT, strict=True)
    ]  # fmt: skip


def check() -> list[dict]:
    """Every body with the gaits of the finest one."""
    rows = []
    for name, level in BODIES:
        fish = make_fish(name, **({"level": level} if level else {}))
        rows += rows_of(name, level, swim_midlines(fish, living_gaits(), [row.speed for row in TROUT], 5.0, 4))
    return rows


GAIT = {  # of the best gait: attribute, lowest and highest of living fish, or of what a gait must reach
    "stride, BL a beat": ("stride", 0.5, np.inf),
    "Strouhal number": ("strouhal", 0.2, 0.4),
    "tail sweep, BL": ("sweep", 0.1, 0.26),
    "speed, BL/s": ("speed", 1.0, np.inf),
    "nose over tail": ("nose", 0.1, 0.14),
    "tail tips apart, over the sweep": ("wobble", 0.0, 0.1),
}


def check_best_gait() -> list[dict]:
    """A row for each quantity of the best gait: at the fish's own step, by RK4 at an eighth of it, and the range."""
    fish, gait = make_fish(), best_gait()
    swum, exact = swim_gait(fish, gait), swim_gait(fish, gait, integrator="rk4", dt=fish.time_step / 8)
    return [
        {
            "quantity": name, "ours": round(value := getattr(swum, key), 4), "reference": round(getattr(exact, key), 4),
            "lowest": low, "highest": high, "within": bool(low <= value <= high),
        }
        for name, (key, low, high) in GAIT.items()
    ]  # fmt: skip


COLUMNS = {"speed": ".2f", "sweep": ".3f", "nose_over_tail": ".2f", "strouhal": ".2f", "envelope_off": ".3f"}


def table(rows) -> str:
    """The table of the page: a row for the trout and for each body, the three speeds side by side."""
    trout = {
        "speed": [row.speed for row in TROUT], "sweep": [row.sweep for row in TROUT],
        "strouhal": [row.frequency * row.sweep / row.speed for row in TROUT],
    }  # fmt: skip

    def cells(values: dict) -> str:
        found = [", ".join(f"{v:{form}}" for v in values.get(key, ())) for key, form in COLUMNS.items()]
        return " | ".join(found)

    lines = [
        "| | speed, BL/s | tail sweep, BL | nose over tail | Strouhal | midline off, BL |", "|---|---|---|---|---|---|",
        f"| trout | {cells(trout).replace('|  |', '| 0.10 to 0.14 |', 1)} |",
    ]  # fmt: skip
    for name, level in BODIES:
        mine = [row for row in rows if (row["body"], row["level"]) == (name, level)]
        label = f"`{name}`{f', level {level}' if level else ''}"
        lines.append(f"| {label} | {cells({key: [row[key] for row in mine] for key in COLUMNS})} |")
    return "\n".join(lines)


def fill_page(rows) -> None:
    """Put the table between the marks of the page."""
    text = PAGE.read_text()
    before, rest = text.split("<!-- living -->\n", 1)
    after = rest.split("<!-- end -->", 1)[1]
    PAGE.write_text(f"{before}<!-- living -->\n\n{table(rows)}\n\n<!-- end -->{after}")


def draw(rows) -> None:
    """The envelope of the midline at the three speeds, bodies beside the living fish."""
    plt = pyplot()
    figure, panels = plt.subplots(1, 3, figsize=(11, 3.4), sharey=True, layout="constrained")
    looks = {("tetrahedral", 3): "s-", ("mass_spring", ""): "o--", ("planar", ""): "v:", ("two_layer", ""): "^-."}
    for k, (panel, real) in enumerate(zip(panels, TROUT, strict=True)):
        wanted = 0.5 * real.sweep * ENVELOPE
        panel.fill_between(STATION, beyond(wanted - 0.02, 0.0), wanted + 0.02, color="0.9", label="living fish, ± 0.02")
        panel.plot(STATION, wanted, color="0.3")
        for (name, level), look in looks.items():
            row = [r for r in rows if (r["body"], r["level"]) == (name, level)][k]
            panel.plot(STATION, [row[f"amplitude_{i}"] for i in range(7)], look, ms=4, label=f"{name} {level}".strip())
        panel.set(title=f"{real.speed:g} BL/s, {real.frequency:g} Hz", xlabel="from the nose, BL")
    panels[0].set(ylabel="half the sway, BL", ylim=(0, None))
    panels[0].legend(frameon=False, fontsize=8)
    save(figure, RESULTS / "living_fish.svg")


def main() -> None:
    """The command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--check", action="store_true", help="only measure what is shipped")
    parser.add_argument("--generations", type=int, default=GENERATIONS, help=f"of {POPULATION} bodies")
    parser.add_argument("--seed", type=int, default=1, help="of the search")
    chosen = parser.parse_args()
    if not chosen.check:
        calibrate(chosen.generations, chosen.seed)
        return
    rows = check()
    print(write_csv("living_fish.csv", rows, f"{COMMAND} --check"))
    print(write_csv("gait.csv", check_best_gait(), f"{COMMAND} --check"))
    draw(rows)
    fill_page(rows)


if __name__ == "__main__":
    main()
