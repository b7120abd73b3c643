"""What the comparisons share: the levels of water, midlines given by their angle, and a chart of speeds."""

from collections.abc import Callable

import numpy as np
from scipy.interpolate import CubicSpline

from benchmarks.common.charts import BLUE, GREY, ORANGE, legend_below, panels, save
from benchmarks.common.tables import RESULTS, read_table
from fish_env import Fish, World, prescribe
from fish_env.physics.world import change_water

PLACES = np.linspace(0.0, 1.0, 21)
"""Of what the tables hold along a body."""
FINE = np.linspace(0.0, 1.0, 401)
COLOURS = {"drag": ORANGE, "drag, friction": "#E69F00", "reactive": BLUE, "reactive, friction": "#56B4E9"}
"""Colour of each level of water. Reactive water has the drag as well."""


def waters(fish: Fish, viscosity: float) -> dict[str, World]:
    """The fish's own water with and without its inertia and its friction, at a viscosity, m2/s."""
    return {
        name: change_water(fish.water, inertia="reactive" in name,
                           **({"viscosity": viscosity} if "friction" in name else {"friction": 0.0}))
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


def swims(fish: Fish, viscosity: float, midline: Callable, period: float, unit: str, published: float) -> list[dict]:
    """A row for each level of water of a fish that is swum by a midline of a period, s.

    Speeds, also the published one, are body lengths a `unit`: "s", or "beat".
    """
    rows, span = [], period if unit == "beat" else 1.0
    for name, water in waters(fish, viscosity).items():
        swum = prescribe(fish, midline, period, water=water)
        speed = swum.relative_speed * span
        power = {"power_w_kg": round(swum.power.mean() / fish.body.mass.sum(), 4)} if unit == "s" else {}
        rows.append({
            "water": name, f"speed_bl_{unit}": round(speed, 3), "published": published,
            "off_percent": off(speed, published), "strouhal": round(swum.strouhal, 3), **power,
            **{f"sweep_{k}": round(sweep, 4) for k, sweep in enumerate(swum.sweep[::2])},
        })  # fmt: skip
    return rows


def draw_swims(name: str, unit: str, sweep=None) -> None:
    """Draw sweep along the body and speed, of every level of water, and the measured sweep, body lengths."""
    rows = read_table(f"validation/{name}.csv")
    figure, (left, right) = panels(2, 4.2)
    if sweep is not None:
        left.plot(PLACES, sweep, color=GREY, lw=3, label=name)
    along(left, rows, "sweep")
    left.set(xlabel="from the nose, BL", ylabel="sweep, BL", ylim=(0, None))
    label = {"s": "speed, BL/s (band: 10 %)", "beat": "speed, BL a beat (band: 10 %)"}[unit]
    bars(right, rows, f"speed_bl_{unit}", rows[0]["published"], label)
    legend_below(figure, 6)
    save(figure, RESULTS / "validation" / f"{name}.svg")


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


def off(value: float, published: float) -> float:
    """Distance from the published value, %."""
    return round(100.0 * (value / published - 1.0), 1)
