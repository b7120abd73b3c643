"""The charts of a report, as SVG that stands inside an HTML page. Each compares the groups that it is given."""

import io
import re
from collections.abc import Callable, Sequence
from functools import wraps
from typing import Any

import numpy as np

from agents.records import pyplot
from agents.run_measures import Episodes, Motion, spectrum

COLOURS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#000000")
"""Okabe and Ito's, which colour-blind readers can tell apart."""
RESAMPLES = 1000
HIGHEST = 12.0  # Hz: no tail beats faster

Named = Sequence[tuple[str, Any]]
"""Data to draw, by the label of the group."""


def svg(figure) -> str:
    """A figure as an element of a page: without header and metadata, which name addresses of the web."""
    out = io.StringIO()
    figure.savefig(out, format="svg", metadata={"Date": None})
    text = out.getvalue()
    text = re.sub(r"<metadata>.*?</metadata>", "", text[text.index("<svg") :], flags=re.DOTALL)
    return re.sub(r'\sxmlns(:\w+)?="[^"]*"', "", text)


def chart(draw: Callable) -> Callable[..., str]:
    """A function that draws with matplotlib's pyplot and returns a figure, as one that returns SVG."""

    @wraps(draw)
    def drawn(*arguments, **options) -> str:
        plt = pyplot()
        style: Any = {"svg.fonttype": "none", "axes.spines.top": False, "axes.spines.right": False, "font.size": 10}
        with plt.rc_context(style):
            figure = draw(plt, *arguments, **options)
            text = svg(figure)
            plt.close(figure)
        return text

    return drawn


def curve_interval(values: np.ndarray, seed: int = 0) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Interquartile mean of curves (S,P) of S seeds, and its 95 % bootstrap interval over seeds, (P,) each."""
    count = len(values)
    edges = np.linspace(0.0, 1.0, count + 1)
    weight = np.clip(np.minimum(edges[1:], 0.75) - np.maximum(edges[:-1], 0.25), 0.0, None)
    weight /= weight.sum()
    pick = np.random.default_rng(seed).integers(count, size=(RESAMPLES, count))
    resampled = np.einsum("s,rsp->rp", weight, np.sort(values[pick], axis=1))
    low, high = np.quantile(resampled, [0.025, 0.975], axis=0)
    return weight @ np.sort(values, axis=0), low, high


@chart
def learning_curves(plt, groups: Named, metric: str):
    """Score and return against environment steps; bands are intervals over seeds, thin lines are seeds."""
    figure, (left, right) = plt.subplots(1, 2, figsize=(10, 3.6), layout="constrained")
    for colour, (label, curves) in zip(COLOURS, groups, strict=False):
        curves = [curve for curve in curves if len(curve["timesteps"])]
        for axes, column in ((left, "score"), (right, "return")):
            for curve in curves:
                single = len(curves) == 1
                axes.plot(curve["timesteps"], curve[column], color=colour, lw=1.8 if single else 0.6,
                          alpha=1.0 if single else 0.5, label=label if single else None)  # fmt: skip
            if len(curves) < 2:
                continue
            first, last = (f(c["timesteps"][k] for c in curves) for f, k in ((max, 0), (min, -1)))
            steps = np.linspace(first, max(first, last), 150)
            middle, low, high = curve_interval(np.array([np.interp(steps, c["timesteps"], c[column]) for c in curves]))
            axes.plot(steps, middle, color=colour, lw=1.8, label=f"{label} ({len(curves)} seeds)")
            axes.fill_between(steps, low, high, color=colour, alpha=0.2, lw=0)
    for axes, name in ((left, metric), (right, "return")):
        axes.set(xlabel="environment steps", ylabel=f"{name}, in training")
        axes.ticklabel_format(axis="x", scilimits=(0, 0))
    legend(left)
    return figure


def legend(axes) -> None:
    """A legend, if anything has a label."""
    if axes.get_legend_handles_labels()[0]:
        axes.legend(frameon=False)


@chart
def paths(plt, groups: Named, touchable: bool):
    """Paths of the centre of mass from above, with targets or obstacles."""
    figure, axes = plt.subplots(figsize=(10, 4.2), layout="constrained")
    for colour, (label, motions) in zip(COLOURS, groups, strict=False):
        for k, found in enumerate(motions):
            axes.plot(*found.path.T, color=colour, lw=1.4, alpha=1.0 - 0.25 * k, label=None if k else label)
            axes.plot(*found.path[-1], "o", color=colour, ms=4)
            for x, y, radius in found.spheres:
                kind = {"fill": False, "ec": colour} if touchable else {"fc": "#999999", "ec": colour}
                axes.add_patch(plt.Circle((x, y), radius, lw=0.8, alpha=0.7, **kind))
    axes.plot(0.0, 0.0, "k+", ms=9)
    axes.set(xlabel="along the first command, body lengths", ylabel="to its left, body lengths")
    axes.set_aspect("equal", adjustable="datalim")
    legend(axes)
    return figure


@chart
def headings(plt, groups: Named):
    """Heading and commanded heading over time."""
    figure, axes = plt.subplots(figsize=(10, 3.2), layout="constrained")
    for colour, (label, found) in zip(COLOURS, groups, strict=False):
        axes.plot(found.time, np.degrees(found.heading), color=colour, lw=1.4, label=label)
        axes.plot(found.time, np.degrees(found.command), color=colour, lw=1.4, ls="--")
    axes.set(xlabel="time, s", ylabel="heading, degrees to the left")
    axes.plot([], [], color="#444444", ls="--", label="commanded")
    legend(axes)
    return figure


@chart
def gaits(plt, groups: Sequence[tuple[str, np.ndarray, np.ndarray]], names: Sequence[str]):
    """Contraction (T,M) of every muscle over the time (T,), a row each; groups of (label, contraction, time)."""
    figure, rows = plt.subplots(len(groups), 1, figsize=(10, 0.7 + 2.6 * len(groups)), layout="constrained",
                                squeeze=False, sharex=True)  # fmt: skip
    for axes, (label, contraction, time) in zip(rows[:, 0], groups, strict=True):
        span = (time[0], time[-1], len(names) - 0.5, -0.5)
        shown = axes.imshow(contraction.T, aspect="auto", cmap="cividis", vmin=0, vmax=1, extent=span,
                            interpolation="nearest")  # fmt: skip
        axes.set_yticks(range(len(names)), names, fontsize=8)
        axes.set(title=label if len(groups) > 1 else "")
        axes.spines[["top", "right"]].set_visible(True)
    rows[-1, 0].set(xlabel="time, s")
    figure.colorbar(shown, ax=rows[:, 0], label="contraction", fraction=0.03)
    return figure


@chart
def tails(plt, groups: Named, interval: float):
    """Deflection of the tail over time, and its spectrum."""
    figure, (left, right) = plt.subplots(1, 2, figsize=(10, 3.2), layout="constrained", width_ratios=(2, 1))
    for colour, (label, found) in zip(COLOURS, groups, strict=False):
        left.plot(found.time, found.tail, color=colour, lw=1.2, label=label)
        frequency, amplitude = spectrum(found.tail, interval)
        right.plot(frequency, amplitude, color=colour, lw=1.4)
    left.set(xlabel="time, s", ylabel="tail to the left, body lengths")
    right.set(xlabel="frequency, Hz", ylabel="amplitude, body lengths", xlim=(0, HIGHEST), ylim=(0, None))
    legend(left)
    return figure


@chart
def reward_terms(plt, groups: Named):
    """Mean of every reward term over the episodes, with its 95 % bootstrap interval over episodes."""
    names = list(dict.fromkeys(name for _, found in groups for name in found.terms))
    figure, axes = plt.subplots(figsize=(10, 0.9 + 0.5 * len(names) * max(1.0, 0.5 * len(groups))),
                                layout="constrained")  # fmt: skip
    thick = 0.8 / len(groups)
    for k, (colour, (label, found)) in enumerate(zip(COLOURS, groups, strict=False)):
        for row, name in enumerate(names):
            values = found.terms.get(name, np.zeros(1))
            low, high = bootstrap(values)
            place = row + (k - 0.5 * (len(groups) - 1)) * thick
            axes.barh(place, values.mean(), 0.9 * thick, color=colour, alpha=0.85, label=None if row else label)
            axes.plot([low, high], [place, place], color="black", lw=1.4)
    axes.set_yticks(range(len(names)), names)
    axes.invert_yaxis()
    axes.axvline(0.0, color="black", lw=0.6)
    axes.set(xlabel="sum over an episode, mean of the episodes")
    legend(axes)
    return figure


@chart
def term_course(plt, found: Motion, names: Sequence[str]):
    """The sums of the reward terms of one episode so far."""
    figure, axes = plt.subplots(figsize=(10, 3.0), layout="constrained")
    for k, name in enumerate(names):
        axes.plot(found.time[1:], np.cumsum(found.terms[:, k]), color=COLOURS[k % len(COLOURS)], lw=1.4, label=name)
    axes.set(xlabel="time, s", ylabel="sum so far")
    legend(axes)
    return figure


def bootstrap(values: np.ndarray, seed: int = 0) -> tuple[float, float]:
    """95 % bootstrap interval of the mean of values (B,)."""
    pick = np.random.default_rng(seed).integers(len(values), size=(RESAMPLES, len(values)))
    low, high = np.quantile(values[pick].mean(axis=1), [0.025, 0.975])
    return float(low), float(high)


def pooled(episodes: Sequence[Episodes]) -> Episodes:
    """The episodes of several runs together."""
    first = episodes[0]
    return Episodes(
        {name: np.concatenate([one.scores[name] for one in episodes]) for name in first.scores},
        {name: np.concatenate([one.terms[name] for one in episodes]) for name in first.terms},
        sum((one.failures for one in episodes), first.failures.__class__()),
    )
