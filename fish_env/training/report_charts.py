"""The charts of a report, as SVG that stands inside an HTML page. Each compares the groups that it is given."""

import io
import re
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from matplotlib.figure import Figure
from matplotlib.patches import Circle
from matplotlib.ticker import EngFormatter

from fish_env.control.evaluation import Scores
from fish_env.control.statistics import interquartile_mean

COLOURS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#000000")
"""Okabe and Ito's, which colour-blind readers can tell apart."""
UNITS = {
    "speed": "body lengths/s",
    "success": "share of the episodes",
    "targets": "per episode",
    "escape_distance": "body lengths",
    "return": "per episode",
}
"""Unit of each score of a training."""
STYLE: dict[Any, Any] = {"svg.fonttype": "none", "axes.spines.top": False, "axes.spines.right": False, "font.size": 10}
"""Settings of matplotlib for all charts of a page."""


class Motion(NamedTuple):
    """Motion of a fish in one episode, T + 1 states."""

    time: np.ndarray  # (T+1,) s
    path: np.ndarray  # (T+1,2) centre of mass, body lengths, from the start, the first command along +x
    contraction: np.ndarray  # (T+1,M) 0 natural, 1 full
    spheres: np.ndarray  # (K,3) places and radii, body lengths, as the path


def svg(figure: Figure) -> str:
    """A figure as an element of a page: without header and metadata, which name addresses of the web."""
    for axes in figure.axes:
        if axes.get_legend_handles_labels()[0]:
            axes.legend(frameon=False)
    out = io.StringIO()
    figure.savefig(out, format="svg", metadata={"Date": None})
    text = out.getvalue()
    text = re.sub(r"<metadata>.*?</metadata>", "", text[text.index("<svg") :], flags=re.DOTALL)
    return re.sub(r'\sxmlns(:\w+)?="[^"]*"', "", text)


def draw_learning_curves(groups: Sequence[tuple[str, list[dict[str, np.ndarray]]]], metric: str) -> str:
    """Draw score and return against environment steps: seeds as thin lines, their interquartile mean as a bold one."""
    figure = Figure(figsize=(10, 3.6), layout="constrained")
    names = [f"{name}, {UNITS[name]}" for name in (metric, "return")]
    for axes, column, name in zip(figure.subplots(1, 2), ("score", "return"), names, strict=True):
        for colour, (label, every) in zip(COLOURS, groups, strict=False):
            curves = [curve for curve in every if len(curve["timesteps"])]
            for curve in curves:
                axes.plot(curve["timesteps"], curve[column], color=colour, lw=0.6, alpha=0.5)
            if curves:
                first, last = (pick(c["timesteps"][k] for c in curves) for pick, k in ((max, 0), (min, -1)))
                steps = np.linspace(first, max(first, last), 150)
                levels = np.array([np.interp(steps, c["timesteps"], c[column]) for c in curves])
                middle = np.apply_along_axis(interquartile_mean, 0, levels)
                seeds = f" ({len(curves)} seeds)" if len(curves) > 1 else ""
                axes.plot(steps, middle, color=colour, lw=1.8, label=label + seeds)
        axes.set(xlabel="environment steps", ylabel=f"{name}, in training")
        axes.xaxis.set_major_formatter(EngFormatter())  # 2 M, without a factor beside the axis
    return svg(figure)


def draw_costs(groups: Sequence[tuple[str, list[Scores]]]) -> str:
    """Draw the cost of transport against the mean speed along the path, a dot for each episode of every run."""
    figure = Figure(figsize=(10, 3.6), layout="constrained")
    axes = figure.subplots()
    for colour, (label, runs) in zip(COLOURS, groups, strict=False):
        power, cost = (np.concatenate([run[name] for run in runs]) for name in ("power", "cost_of_transport"))
        moved = cost != 0.0  # also where it is not defined, which is not drawn
        axes.plot(power[moved] / cost[moved], cost[moved], "o", color=colour, ms=4, alpha=0.5, label=label)
    axes.set(xlabel="speed along the path, m/s", ylabel="cost of transport, J/(kg m)")
    return svg(figure)


def draw_paths(groups: Sequence[tuple[str, list[Motion]]], touchable: bool) -> str:
    """Draw paths of the centre of mass from above, with targets (touchable) or obstacles."""
    figure = Figure(figsize=(10, 4.2), layout="constrained")
    axes = figure.subplots()
    for colour, (label, motions) in zip(COLOURS, groups, strict=False):
        for k, found in enumerate(motions):
            axes.plot(*found.path.T, color=colour, lw=1.4, alpha=1.0 - 0.25 * k, label=None if k else label)
            axes.plot(*found.path[-1], "o", color=colour, ms=4)
            for x, y, radius in found.spheres:
                kind = {"fill": False, "ec": colour} if touchable else {"fc": "#999999", "ec": colour}
                axes.add_patch(Circle((x, y), radius, lw=0.8, alpha=0.7, **kind))
    axes.plot(0.0, 0.0, "k+", ms=9)
    axes.set(xlabel="along the first command, body lengths", ylabel="to its left, body lengths")
    axes.set_aspect("equal", adjustable="datalim")
    return svg(figure)


def draw_gaits(groups: Sequence[tuple[str, Motion]], order: Sequence[int], names: Sequence[str]) -> str:
    """Draw the contraction of every muscle over time, a row each, in an order with names."""
    figure = Figure(figsize=(10, 0.7 + 2.6 * len(groups)), layout="constrained")
    panels = figure.subplots(len(groups), 1, squeeze=False, sharex=True)[:, 0]
    for axes, (label, found) in zip(panels, groups, strict=True):
        span = (found.time[0], found.time[-1], len(names) - 0.5, -0.5)
        shown = axes.imshow(found.contraction.T[order], aspect="auto", cmap="cividis", vmin=0, vmax=1, extent=span,
                            interpolation="nearest")  # fmt: skip
        axes.set_yticks(range(len(names)), names, fontsize=8)
        axes.set(title=label if len(groups) > 1 else "")
    panels[-1].set(xlabel="time, s")
    figure.colorbar(shown, ax=panels, label="contraction", fraction=0.03)
    return svg(figure)
