"""What each parameter of the ring does to a fall on the floor: a small chart a parameter (Song 2009, ch. 7).

python -m benchmarks.objects.parameters           the table and the charts (about 1 min)
python -m benchmarks.objects.parameters --draw    the charts again, from the table
"""

import argparse
from dataclasses import asdict

import numpy as np

from benchmarks.common.charts import BLUE, ORANGE, pyplot, save
from benchmarks.common.tables import RESULTS, read_table, write_csv
from fish_env import Tank
from fish_env.bodies.objects import GRAVITY, RING, make_ring, room

COMMAND = "python -m benchmarks.objects.parameters"
FACTORS = (0.25, 0.35, 0.5, 0.7, 0.84, 1.0, 1.19, 1.4, 2.0, 2.8, 4.0)
OWN = {"stiffness": FACTORS[2:],
       "inner_radius": (0.7, 0.8, 0.9, 1.0, 1.1, 1.2, 1.3), "pressure": (0.0, 0.25, 0.5, 0.7, 1.0, 1.19, 1.3),
       "gap_pressure": (0.0, 0.25, 0.5, 0.7, 1.0, 1.19, 1.4), "restitution": (0.0, 0.25, 0.5, 1.0, 1.5, 2.0),
       "nodes": (0.5, 0.75, 1.0, 1.5, 2.0)}  # fmt: skip
STANDARD = {name: value for name, value in asdict(RING).items() if value is not None and name != "radius"}
STANDARD |= {"gravity": GRAVITY, "restitution": 0.5, "nodes": 12}
UNITS = {
    "mass": "kg",
    "radius": "m",
    "stiffness": "N/m",
    "time": "s",
    "pressure": "N/m",
    "energy": "J",
    "gravity": "m/s²",
}
LINES = (("least_height", BLUE, "o", "least height of the ring, over its diameter"),
         ("rebound", ORANGE, "s", "rebound of its middle, over the fall"))  # fmt: skip
SECONDS = 1.2  # s, from 0.2 m above the floor


def fall(name: str, value: float) -> dict:
    """A row: least height during the fall and its impacts, and rebound of the middle, over diameter and fall."""
    world = {"gravity": GRAVITY, "restitution": 0.5} | {k: value for k in ("gravity", "restitution") if k == name}
    changed = {} if name in world else {name: int(value) if name == "nodes" else value}
    thing = make_ring(**changed)
    tank = Tank(thing, water=room(thing.down, 0.3, **world), threads=1)
    rest, height, middle = np.ptp(thing.body.position[thing.outer, 1]), [], []
    while tank.alive[0] and tank.time[0] < SECONDS:
        tank.advance(4)
        x = tank.position[0]
        height.append(np.ptp(x[thing.outer, 1]) / rest)
        middle.append(thing.body.mass @ x[:, 1] / thing.body.mass.sum())
    row = {"parameter": name, "value": value, "failure": tank.failure[0], "least_height": np.nan, "rebound": np.nan}
    if not row["failure"]:
        low = int(np.argmin(middle[: len(middle) // 2]))
        row |= {"least_height": min(height), "rebound": (max(middle[low:]) + 0.2) / 0.2}
    return row


def measure() -> None:
    """Write the table."""
    rows = []
    for name, standard in STANDARD.items():
        for factor in OWN.get(name, FACTORS):
            rows.append(fall(name, round(factor * standard) if name == "nodes" else factor * standard))
    write_csv("song_parameters.csv", rows, COMMAND)


def draw() -> None:
    """A panel a parameter: least height (left) and rebound (right) over its value; a vertical line at the standard."""
    rows = read_table("song_parameters.csv")
    figure, axes = pyplot().subplots(4, 4, figsize=(13, 10), sharey=True, layout="constrained")
    for panel in axes.ravel()[len(STANDARD) :]:
        panel.axis("off")
    for panel, (name, standard) in zip(axes.ravel(), STANDARD.items(), strict=False):
        good = [row for row in rows if row["parameter"] == name and not row["failure"]]
        bad = [row["value"] for row in rows if row["parameter"] == name and row["failure"]]
        for what, colour, marker, label in LINES:
            panel.plot([row["value"] for row in good], [row[what] for row in good], color=colour, marker=marker,
                       markersize=3.5, linewidth=1.0, label=label)  # fmt: skip
        panel.plot(bad, [0.0] * len(bad), linestyle="", marker="x", color="black", label="fails")
        panel.axvline(standard, color="black", linewidth=0.6, linestyle=":")
        if name not in OWN or name == "stiffness":
            panel.set_xscale("log", base=2)
            panel.set_xticks([0.25 * standard, standard, 4 * standard], [f"{f * standard:.3g}" for f in (0.25, 1, 4)])
        unit = next((unit for end, unit in UNITS.items() if name.endswith(end)), "")
        panel.set_title(f"{name}{', ' * bool(unit)}{unit}", fontsize=9)
        panel.grid(alpha=0.2)
    handles, labels = axes[0, 0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=3, frameon=False)
    save(figure, RESULTS / "song_parameters.svg")


def main() -> None:
    """The command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--draw", action="store_true", help="the charts again, from the table")
    if not parser.parse_args().draw:
        measure()
    draw()
    print(f"written to {RESULTS}/song_parameters.csv and .svg")


if __name__ == "__main__":
    main()
