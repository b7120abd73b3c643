"""Charts: one style, colours told apart by colour-blind readers (Okabe & Ito), and SVG files without a date."""

from pathlib import Path

import numpy as np

from fish_env.control.chart import STYLE, WORDS

BLUE, ORANGE, GREEN, PINK, GREY = "#0072B2", "#D55E00", "#009E73", "#CC79A7", "#999999"
WIDTH = 9.0  # inches of every chart: text of 10.5 pt is 11 pixels high where the chart is 700 wide
SETTINGS = {
    "svg.hashsalt": "fish_env", "svg.fonttype": "none", "figure.constrained_layout.use": True,
    "figure.constrained_layout.w_pad": 0.08, "figure.constrained_layout.h_pad": 0.06, "font.size": 10.5,
    "axes.titlesize": "medium", "figure.labelsize": "medium", "legend.fontsize": "medium", "legend.frameon": False,
    "axes.grid": True, "axes.axisbelow": True, "grid.alpha": 0.2, "lines.markersize": 5.0,
}  # fmt: skip
METHOD_STYLE = STYLE | {  # colour and marker, one marker a family
    "explicit_euler": ("#999999", "x"),
    "linearly_implicit": ("#009E73", "^"),
    "linearly_implicit_projected": ("#66C2A5", "v"),
    "linearly_implicit_water": ("#1B9E77", "<"),
}


def pyplot():
    """Matplotlib's pyplot without a display; the same numbers give the same bytes of an SVG file."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    pyplot.rcParams.update(SETTINGS)
    return pyplot


def words(name: str) -> str:
    """The name of a method as it is read; of a task, without underscores."""
    return WORDS.get(name, name.replace("_", " "))


def panels(columns: int, height: float, rows=1, **options):
    """A figure with panels, of a height in inches, in one array. `options` as for matplotlib's `subplots`."""
    figure, axes = pyplot().subplots(rows, columns, figsize=(WIDTH, height), **options)
    return figure, np.ravel(axes)


def legend_below(figure, columns: int, **options) -> None:
    """Put one legend of all panels below them. `options` as for matplotlib's `legend`."""
    found: dict = {}
    for panel in figure.axes:
        found |= dict(zip(*reversed(panel.get_legend_handles_labels()), strict=True))
    figure.legend(found.values(), found, loc="outside lower center", ncols=columns, **options)


def own_legend(panel, columns=1) -> None:
    """Put the legend of a panel below its axis."""
    panel.legend(loc="upper center", bbox_to_anchor=(0.5, 0.0), borderaxespad=3.6, ncols=columns)


def save(figure, path: Path) -> None:
    """Write a figure without a date and close it; numbers on logarithmic axes have no small exponents."""
    from matplotlib.ticker import LogFormatter, LogLocator

    for axis in [axis for panel in figure.axes for axis in (panel.xaxis, panel.yaxis)]:
        if isinstance(axis.get_major_formatter(), LogFormatter):
            axis.set_major_formatter("{x:g}")
            axis.set_minor_formatter("")
            low, high = axis.get_view_interval()
            if high < 60 * low:
                axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    figure.savefig(path, metadata={"Date": None})
    pyplot().close(figure)
