"""Every body beside living fish, in the water it is calibrated for; turns and starts by strength; the best gait.

All bodies swim the three gaits of the finest one. With a part of their strength and with all of it, they turn while
they cruise, and start from rest (`performance.py`). The best gait of the default fish is measured at its own step, and
by RK4 at a 32nd of it.
"""

from dataclasses import replace
from itertools import product

import numpy as np
from tqdm import tqdm

from benchmarks.calibration.finest import living_gaits
from benchmarks.calibration.fit_search import inaccuracy
from benchmarks.calibration.midline import Midline, swim_gait, swim_midlines
from benchmarks.calibration.performance import ENVELOPE, STATION, TROUT, bear, beyond
from benchmarks.common import scenes
from benchmarks.common.charts import legend_below, panels, save
from benchmarks.common.tables import RESULTS, ROOT, filled, markdown, publish, read_table, select
from fish_env import Fish, make_fish
from fish_env.bodies import BODIES as KINDS
from fish_env.bodies.fitted import WATERS
from fish_env.control import best_gait
from fish_env.control.files import write_text

SHOWN = "reactive"  # in the chart
PAGE = ROOT / "docs" / "validation.md"
STRENGTHS = (0.4, 0.6, 0.8, 1.0)  # parts of the contraction that muscles have
STRONG = (("mass_spring", ""), ("tetrahedral", 2))  # bodies of which turns and starts are measured
BODIES = (("tetrahedral", 2), ("tetrahedral", 3), ("mass_spring", ""), ("planar", ""), ("two_layer", ""))
ON_PAGE = (("tetrahedral", 3), ("mass_spring", ""))  # of BODIES, those in the page's table


def rows_of(water: str, name: str, level, found: list[Midline]) -> list[dict]:
    """A row for each of the trout's speeds."""
    return [
        {
            "water": water, "body": name, "level": level, "frequency_hz": real.frequency, "speed_trout": real.speed,
            "speed": round(one.speed, 3), "sweep_trout": round(real.sweep, 4), "sweep": round(one.sweep, 4),
            "nose_over_tail": round(one.nose, 3), "strouhal": round(one.strouhal, 3), "stride": round(one.stride, 3),
            "envelope_off": round(float(np.abs(one.amplitude - 0.5 * real.sweep * ENVELOPE).max()), 4),
            "work": round(one.work, 3), "thrust": round(one.thrust, 3), "lost": round(one.lost, 3),
            **{f"amplitude_{k}": round(float(a), 4) for k, a in enumerate(one.amplitude)},
            **{f"phase_{k}": round(float(a), 3) for k, a in enumerate(one.phase)}, "failure": one.failure,
        }
        for one, real in zip(found, TROUT, strict=True)
    ]  # fmt: skip


def calibrated() -> list[tuple[str, tuple]]:
    """Each level of water with each of BODIES that is calibrated for it."""
    return [(water, body) for water, body in product(WATERS, BODIES) if water in KINDS[body[0]].waters]


def make(name: str, level, water: str) -> Fish:
    """A body of BODIES."""
    return make_fish(name, water=water, **({"level": level} if level else {}))


def check() -> list[dict]:
    """Every body with the gaits of the finest one."""
    rows, speeds = [], [row.speed for row in TROUT]
    for water, (name, level) in tqdm(calibrated(), "bodies"):
        fish, gaits = make(name, level, water), living_gaits(water)
        rows += rows_of(water, name, level, swim_midlines(fish, gaits, speeds, 5.0, 4, energy=True))
    return rows


def check_strength() -> list[dict]:
    """Turns while cruising and starts from rest, by the part of their contraction that muscles may have."""
    rows = []
    for water, (name, level), strength in tqdm(list(product(WATERS, STRONG, STRENGTHS)), "strength"):
        fish = make(name, level, water)
        fish = replace(fish, contracted=1.0 - strength * (1.0 - fish.contracted))
        turned, started = scenes.turn(fish, living_gaits(water)[1]), scenes.start(fish)
        kept, _, failed = bear(fish)
        rows.append({
            "water": water, "body": name, "level": level, "strength": strength,
            "strain": round(1.0 - float(fish.contracted.min()), 3), "rate": round(turned["rate"], 1),
            "radius": round(turned["radius"], 3), "angle": round(started["best angle"], 1),
            "snout": round(started["best snout"], 1), "acceleration": round(started["best acceleration"], 2),
            "kept": round(float(kept.min()), 3), "failed": failed,
            "error_percent": round(100.0 * inaccuracy(fish), 3) if name == "mass_spring" else "",
        })  # fmt: skip
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
    """A row for each quantity of the best gait: at the fish's own step, by RK4 at a 32nd of it, and the range."""
    rows = []
    for water in WATERS:
        fish, gait = make_fish(water=water), best_gait(water)
        swum, exact = swim_gait(fish, gait), swim_gait(fish, gait, integrator="rk4", dt=fish.time_step / 32)
        rows += [
            {
                "water": water, "quantity": name, "ours": round(value := getattr(swum, key), 4),
                "reference": round(getattr(exact, key), 4),
                "lowest": low, "highest": high, "within": bool(low <= value <= high),
            }
            for name, (key, low, high) in GAIT.items()
        ]  # fmt: skip
    return rows


SHOWN_QUANTITIES = {
    "speed": ("speed, BL/s", ".2f"), "sweep": ("tail sweep, BL", ".3f"), "nose_over_tail": ("nose over tail", ".2f"),
    "strouhal": ("Strouhal", ".2f"), "envelope_off": ("midline off, BL", ".3f"), "work": ("net work, J/kg/m", ".2f"),
    "thrust": ("of it thrust", ".2f"),
}  # fmt: skip
"""Of the page's table: head of the column, format."""


def table(rows: list[dict]) -> str:
    """The page's table: a row for the trout and for each body of ON_PAGE, the three speeds side by side."""
    trout = (
        ", ".join(f"{row.speed:.2f}" for row in TROUT), ", ".join(f"{row.sweep:.3f}" for row in TROUT), "0.10 to 0.14",
        ", ".join(f"{row.frequency * row.sweep / row.speed:.2f}" for row in TROUT), "", "", "-, 0.6, 0.9",
    )  # fmt: skip
    lines = [("trout", *trout)]
    for water, (name, level) in calibrated():
        if (name, level) not in ON_PAGE:
            continue
        mine = select(rows, water=water, body=name, level=level)
        cells = (", ".join(f"{row[key]:{form}}" for row in mine) for key, (_, form) in SHOWN_QUANTITIES.items())
        lines.append((f"{water}, `{name}`{f', level {level}' if level else ''}", *cells))
    return markdown(["", *(head for head, _ in SHOWN_QUANTITIES.values())], lines)


def strength_table(rows: list[dict]) -> str:
    """The page's table of turns and starts with all of the strength."""
    head = ("", "strain", "rate, °/s", "radius, BL", "angle in 0.3 s, °",
            "snout, °", "acceleration, m/s²", "least area of a section")  # fmt: skip
    lines = [
        (
            f"{row['water']}, `{row['body']}`", f"{row['strain']:.2f}", f"{row['rate']:.0f}",
            f"{row['radius']:.2f}".replace("nan", "-"),  # hardly turned
            f"{row['angle']:.0f}", f"{row['snout']:.0f}", f"{row['acceleration']:.1f}", f"{row['kept']:.2f}",
        )
        for row in rows
        if row["strength"] == 1.0
    ]  # fmt: skip
    return markdown(head, lines)


def draw() -> None:
    """Fill in the page; draw the envelope of the midline at the three speeds, bodies beside the living fish."""
    rows = read_table("living_fish.csv")
    tables = {"living": table(rows), "strength": strength_table(read_table("strength.csv"))}
    write_text(PAGE, filled(PAGE.read_text("utf-8"), tables))
    figure, axes = panels(3, 4.2, sharey=True)
    looks = {("tetrahedral", 3): "s-", ("mass_spring", ""): "o--", ("planar", ""): "v:", ("two_layer", ""): "^-."}
    for k, (panel, real) in enumerate(zip(axes, TROUT, strict=True)):
        wanted = 0.5 * real.sweep * ENVELOPE
        panel.fill_between(STATION, beyond(wanted - 0.02, 0.0), wanted + 0.02, color="0.9", label="± 0.02 BL")
        panel.plot(STATION, wanted, color="0.3", label="living fish")
        for (name, level), look in looks.items():
            found = select(rows, water=SHOWN, body=name, level=level)
            for row in found[k : k + 1]:  # none of a body that is not calibrated for this water
                sway = [row[f"amplitude_{i}"] for i in range(7)]
                panel.plot(STATION, sway, look, label=name.replace("_", "-"))
        panel.set(title=f"{real.speed:g} BL/s, {real.frequency:g} Hz", xlabel="from the nose, BL")
    axes[0].set(ylabel="half the sway, BL", ylim=(0, None))
    legend_below(figure, 6)
    save(figure, RESULTS / "living_fish.svg")


if __name__ == "__main__":
    publish(__doc__, {"living_fish.csv": check, "strength.csv": check_strength, "gait.csv": check_best_gait}, draw)
