"""All muscles of one side of a trout: force, speed and power at the base of the tail fin.

Johnsrude & Webb (1985, J. Exp. Biol. 119:71) stimulated the muscles of one side of trout of 17.8 cm and 60.5 g, and
measured at the hypural bones. Here the front of the trunk is fixed, and the base of the tail fin moves freely, pulls a
dashpot, or is held in its place. There is no water. Bodies have a trout's outline.
"""

import numpy as np

from benchmarks.common.charts import BLUE, GREY, ORANGE, legend_below, panels, save
from benchmarks.common.scenes import contract
from benchmarks.common.tables import RESULTS, columns, publish, read_table
from fish_env import make_fish

LENGTH, MASS = 0.178, 0.0605  # m, kg
MEASURED = {"force_n": 2.2, "speed_m_s": 1.11, "power_w": 0.64}
BODIES: dict[str, dict] = {"mass_spring": {}, "tetrahedral": {"level": 1}}
DASHPOTS = (0.0, *np.geomspace(0.01, 3.0, 20), np.inf)  # N s/m


def measure() -> list[dict]:
    """A row for each body and dashpot."""
    rows = []
    for name, options in BODIES.items():
        fish = make_fish(name, length=LENGTH, outline="trout", **options)
        for dashpot in DASHPOTS:
            force, speed = contract(fish, dashpot)
            rows.append({
                "body": name, "dashpot_n_s_m": round(float(dashpot), 4), "force_n": round(force, 5),
                "speed_m_s": round(speed, 5), "power_w": round(force * speed, 5),
                "mass_g": round(1e3 * fish.body.mass.sum(), 2),
            })  # fmt: skip
    return rows


def draw() -> None:
    """Speed and power against force."""
    figure, axes = panels(2, 4.2)
    for name, colour in zip(BODIES, (BLUE, ORANGE), strict=True):
        own = [row for row in read_table("validation/strength.csv", body=name) if row["power_w"] > 0.0]
        for panel, key in zip(axes, ("speed_m_s", "power_w"), strict=True):
            panel.plot(*columns(own, "force_n", key), ".-", color=colour, label=name.replace("_", "-"))
    for panel, key, label in zip(axes, ("speed_m_s", "power_w"), ("speed, m/s", "power, W"), strict=True):
        panel.axvline(MEASURED["force_n"], color=GREY, lw=1)
        panel.axhline(MEASURED[key], color=GREY, lw=1, label="most of a trout")
        panel.set(xlabel="force at the base of the tail fin, N", ylabel=label, xscale="log", yscale="log")
    legend_below(figure, 3)
    save(figure, RESULTS / "validation" / "strength.svg")


if __name__ == "__main__":
    publish(__doc__, {"validation/strength.csv": measure}, draw)
