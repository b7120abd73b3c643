"""What the comparisons share: the levels of water, midlines given by their angle, and a chart of speeds."""

from collections.abc import Callable

import numpy as np
from scipy.interpolate import CubicSpline

from benchmarks.common.charts import BLUE, GREY, ORANGE
from fish_env import World, make_water
from fish_env.bodies import Fish

PLACES = np.linspace(0.0, 1.0, 21)
"""Of what the tables hold along a body."""
FINE = np.linspace(0.0, 1.0, 401)
COLOURS = {"drag": ORANGE, "drag, friction": "#E69F00", "reactive": BLUE, "reactive, friction": "#56B4E9"}
"""Colour of each level of water. Reactive water has the drag as well."""


def waters(fish: Fish, viscosity: float) -> dict[str, World]:
    """The levels of water with the fish's own drag, with and without laminar friction, at a viscosity, m2/s."""
    drag = fish.water.quadratic / 500.0
    return {
        name: make_water(drag_coefficient=drag, inertia="reactive" in name, friction=float("friction" in name),
                         viscosity=viscosity)
        for name in COLOURS
    }  # fmt: skip


def by_angle(angle: Callable) -> Callable:
    """The midline, as `prescribe` takes it, whose angle (S,) rad at places (S,) and a time, s, is given."""

    def midline(places, time):
        at = angle(FINE, time)
        return np.stack([CubicSpline(FINE, part(at)).antiderivative()(places) for part in (np.cos, np.sin)], axis=1)

    return midline


def by_curvature(curvature: Callable) -> Callable:
    """The midline whose curvature (S,), rad a body length, at places (S,) and a time, s, is given."""
    return by_angle(lambda places, time: CubicSpline(places, curvature(places, time)).antiderivative()(places))


def along(panel, rows: list[dict], name: str) -> None:
    """Draw a quantity along the body, of every row of a table."""
    for row in rows:
        values = [row[f"{name}_{k}"] for k in range(len(PLACES))]
        panel.plot(PLACES, values, color=COLOURS[row["water"]], label=row["water"])


def bars(panel, rows: list[dict], key: str, published: float, label: str, tolerance: float = 0.1) -> None:
    """Draw a value of every level of water beside the published one, with a band of the tolerance round it."""
    panel.axhspan(published * (1 - tolerance), published * (1 + tolerance), color="0.9", lw=0)
    panel.axhline(published, color=GREY, label="published")
    panel.bar([row["water"].replace(", ", ",\n") for row in rows], [row[key] for row in rows],
              color=[COLOURS[row["water"]] for row in rows])  # fmt: skip
    panel.set(ylabel=label)
    panel.tick_params(axis="x", labelsize=8)


def off(value: float, published: float) -> float:
    """Distance from the published value, %."""
    return round(100.0 * (value / published - 1.0), 1)
