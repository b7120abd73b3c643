"""Every body beside living fish, with the gaits of the finest one; and the best open-loop gait.

python -m benchmarks.calibration.living_fish      living_fish.csv, living_fish.svg and gait.csv (minutes)

Tail sweep and speed, the sway of the midline, the nose's sway over the tail's, the Strouhal number, work, turns and
starts (`performance.py`). The best gait of the default fish is measured at its own step, and by RK4 at an eighth of it.
"""

import argparse
from pathlib import Path

import numpy as np

from benchmarks.calibration.finest import living_gaits
from benchmarks.calibration.midline import Midline, swim_gait, swim_midlines
from benchmarks.calibration.performance import ENVELOPE, STATION, TROUT, beyond
from benchmarks.common.charts import pyplot, save
from benchmarks.common.tables import RESULTS, write_csv
from fish_env import make_fish
from fish_env.control import best_gait

COMMAND = "python -m benchmarks.calibration.living_fish"
PAGE = Path(__file__).parents[2] / "docs" / "validation.md"
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
    argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter).parse_args()
    rows = check()
    print(write_csv("living_fish.csv", rows, COMMAND))
    print(write_csv("gait.csv", check_best_gait(), COMMAND))
    draw(rows)
    fill_page(rows)


if __name__ == "__main__":
    main()
