"""Straight bodies towed through water: their drag coefficient on the wetted surface, beside coasting fish.

Bluegill sunfish that coast have 0.015 ± 0.007 at a Reynolds number of 41,000 by their length (Gellman, Tandler, de la
Cruz & Ellerby, abstract P1-45 of a meeting of the Society for Integrative and Comparative Biology).
"""

import numpy as np

from benchmarks.common.charts import GREY, legend_below, panels, save
from benchmarks.common.tables import RESULTS, columns, publish, read_table
from benchmarks.validation.waters import COLOURS, waters
from fish_env import Fish, make_fish, prescribe
from fish_env.physics.world import BLASIUS

DENSITY, VISCOSITY = 1000.0, 1.0e-6  # kg/m3, m2/s
REYNOLDS = (10_000.0, 41_000.0, 160_000.0)
COEFFICIENT, SPREAD, AT = 0.015, 0.007, 41_000.0
BODIES: dict[str, dict] = {
    "default": {"body": "mass_spring"}, "trout": {"body": "tetrahedral", "level": 3, "outline": "trout"},
}  # fmt: skip


def surface(fish: Fish) -> float:
    """Area of the body's faces, m2."""
    p, q, r, s = fish.body.position[fish.body.faces.nodes.T]
    return float(0.5 * np.linalg.norm(np.cross(r - p, s - q), axis=1).sum())


def measure() -> list[dict]:
    """A row for each fish, water and Reynolds number."""
    rows = []
    for name, options in BODIES.items():
        fish = make_fish(**options)
        levels = waters(fish, VISCOSITY)
        for reynolds in REYNOLDS:
            speed = reynolds * VISCOSITY / fish.length
            for level in ("drag", "drag, friction"):
                pull = -prescribe(fish, np.zeros((1, 4)), 1.0, water=levels[level], speed=speed).force[0, 0]
                coefficient = pull / (0.5 * DENSITY * speed**2 * surface(fish))
                rows.append({"fish": name, "water": level, "reynolds": reynolds, "coefficient": round(coefficient, 5)})
    return rows


def draw() -> None:
    """The coefficient against the Reynolds number."""
    figure, axes = panels(2, 4.2, sharey=True)
    for panel, name in zip(axes, BODIES, strict=True):
        for level in ("drag", "drag, friction"):
            own = read_table("validation/coasting.csv", fish=name, water=level)
            panel.plot(*columns(own, "reynolds", "coefficient"), "o-", color=COLOURS[level], label=level)
        panel.plot(REYNOLDS, BLASIUS / np.sqrt(REYNOLDS), ":", color=GREY, label="laminar flat plate")
        panel.errorbar([AT], [COEFFICIENT], [SPREAD], fmt="kD", capsize=4, label="bluegill, coasting")
        panel.set(title=name, xscale="log", xlabel="Reynolds number", ylim=(0, 0.03))
    axes[0].set_ylabel("drag coefficient, wetted surface")
    legend_below(figure, 4)
    save(figure, RESULTS / "validation" / "coasting.svg")


if __name__ == "__main__":
    publish(__doc__, {"validation/coasting.csv": measure}, draw)
