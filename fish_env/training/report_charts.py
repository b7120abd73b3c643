"""The charts of a report, as SVG that stands inside an HTML page. Each compares the groups that it is given.

A chart is as wide as a phone's screen, where 12 points are 12 pixels; a wider page has several in a row.
"""

import io
import re
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Circle
from matplotlib.ticker import EngFormatter, MaxNLocator

from fish_env.control.statistics import interquartile_mean
from fish_env.training.run_folder import TERM

COLOURS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#000000")
"""Okabe and Ito's, which colour-blind readers can tell apart."""
UNITS = {
    **dict.fromkeys(("success", "settled", "avoided", "passed", "reached", "failed", "speed_lost", "peak_strain"), "%"),
    **dict.fromkeys(("return", "targets", "missed"), "per episode"),
    **dict.fromkeys(("latency", "time_per_target", "time_to_target"), "s"),
    **dict.fromkeys(("speed", "sideways", "commanded_speed", "speed_error", "speed_200ms"), "BL/s"),
    **dict.fromkeys(("radius", "clearance", "escape_distance", "distance_200ms"), "BL"),
    **dict.fromkeys(("heading_error", "overshoot"), "°"),
    **dict.fromkeys((f"{name}_{ms}ms" for name in ("angle", "snout") for ms in (100, 200, 300)), "°"),
    "turning_rate": "°/s", "work": "J/kg", "power": "W/kg", "cost_of_transport": "J/(kg m)",
    "peak_acceleration": "m/s²",
}  # fmt: skip
"""Unit of each metric; BL is a body length. A share is multiplied by 100 where it is shown."""
STYLE: dict[Any, Any] = {"svg.fonttype": "none", "axes.spines.top": False, "axes.spines.right": False, "font.size": 12,
                         "axes.titlesize": 12, "axes.titlelocation": "left", "axes.titleweight": "bold"}  # fmt: skip
"""Settings of matplotlib for all charts of a page."""
WIDTH = 4.5  # inches: 324 points


class Motion(NamedTuple):
    """Motion of a fish in one episode, T + 1 states."""

    time: np.ndarray  # (T+1,) s
    path: np.ndarray  # (T+1,2) centre of mass, body lengths, from the start, the first command along +x
    contraction: np.ndarray  # (T+1,M) 0 natural, 1 full
    spheres: np.ndarray  # (K,3) places and radii, body lengths, as the path


def shown(metric: str) -> tuple[str, float]:
    """Name and unit of a metric as a reader sees them, and the factor by which it is multiplied for that."""
    unit = UNITS.get(metric, "")
    return ", ".join(part for part in (metric.replace("_", " "), unit) if part), 100.0 if unit == "%" else 1.0


def panel(height: float) -> tuple[Figure, Axes]:
    """A figure of a height in inches, and its axes."""
    figure = Figure(figsize=(WIDTH, height), layout="constrained")
    return figure, figure.subplots()


def svg(figure: Figure) -> str:
    """A figure as an element of a page: without header and metadata, which name addresses of the web."""
    out = io.StringIO()
    figure.savefig(out, format="svg", metadata={"Date": None})
    text = out.getvalue()
    text = re.sub(r"<metadata>.*?</metadata>", "", text[text.index("<svg") :], flags=re.DOTALL)
    return re.sub(r'\sxmlns(:\w+)?="[^"]*"', "", text)


def draw_learning_curves(groups: Sequence[list[dict[str, np.ndarray]]], metric: str) -> list[str]:
    """Draw score, return and the terms of the reward that are not always zero, each against environment steps.

    Seeds are thin lines, and their interquartile mean is a bold one.
    """
    terms = dict.fromkeys(name for curves in groups for curve in curves for name in curve if name.startswith(TERM))
    names = {"return": shown("return"), **{name: (f"reward {name.replace('_', ' ')}", 1.0) for name in terms}}
    pictures = []
    for column, (title, times) in (({} if metric == "return" else {"score": shown(metric)}) | names).items():
        lines = [
            [(c["timesteps"], times * c[column]) for c in curves if column in c and len(c[column])] for curves in groups
        ]
        if column in terms and not any(values.any() for every in lines for _, values in every):
            continue
        figure, axes = panel(3.0)
        for colour, every in zip(COLOURS, lines, strict=False):
            for steps, values in every:
                axes.plot(steps, values, color=colour, lw=0.8, alpha=0.5, marker="." if len(steps) < 20 else "")
            if every:
                first, last = max(steps[0] for steps, _ in every), min(steps[-1] for steps, _ in every)
                between = np.linspace(first, max(first, last), 150)
                levels = np.array([np.interp(between, *line) for line in every])
                axes.plot(between, interquartile_mean(levels.T), color=colour, lw=2.0)
        for (low, high), change in ((axes.get_xlim(), axes.set_xlim), (axes.get_ylim(), axes.set_ylim)):
            change(1.05 * min(0.0, low), 1.05 * max(0.0, high))  # a small change looks small
        axes.set(xlabel="environment steps", title=title)
        axes.xaxis.set_major_formatter(EngFormatter())  # 2 M, without a factor beside the axis
        axes.xaxis.set_major_locator(MaxNLocator(5))
        pictures.append(svg(figure))
    return pictures


def draw_paths(groups: Sequence[list[Motion]], touchable: bool) -> str:
    """Draw paths of the centre of mass from above, with targets (touchable) or the places of obstacles."""
    figure, axes = panel(3.6)
    for colour, motions in zip(COLOURS, groups, strict=False):
        for k, found in enumerate(motions):
            axes.plot(*found.path.T, color=colour, lw=1.4, alpha=1.0 - 0.25 * k)
            axes.plot(*found.path[-1], "o", color=colour, ms=4)
            for x, y, radius in found.spheres:
                kind = {"fill": False, "ec": colour} if touchable else {"fc": "#dddddd", "ec": "none", "zorder": 0}
                axes.add_patch(Circle((x, y), radius, **kind))
    axes.plot(0.0, 0.0, "k+", ms=9)
    axes.set(xlabel="along the first command, BL", ylabel="to its left, BL")
    axes.set_aspect("equal", adjustable="datalim")
    return svg(figure)


def draw_gait(found: Motion, order: Sequence[int], names: Sequence[str]) -> str:
    """Draw the contraction of every muscle over time, a row each, in an order with names."""
    figure, axes = panel(1.2 + 0.2 * len(names))
    span = (found.time[0], found.time[-1], len(names) - 0.5, -0.5)
    image = axes.imshow(found.contraction.T[order], aspect="auto", cmap="cividis", vmin=0, vmax=1, extent=span,
                        interpolation="nearest")  # fmt: skip
    axes.set_yticks(range(len(names)), names)
    axes.set(xlabel="time, s")
    figure.colorbar(image, ax=axes, label="contraction", location="top", aspect=40)
    return svg(figure)
