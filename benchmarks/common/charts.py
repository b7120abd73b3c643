"""Charts: one style, colours told apart by colour-blind readers (Okabe & Ito), and SVG files without a date."""

from pathlib import Path

import numpy as np

from fish_env.control.chart import STYLE

BLUE, ORANGE, GREY = "#0072B2", "#D55E00", "#999999"
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

    pyplot.rcParams["svg.hashsalt"] = "fish_env"
    return pyplot


def panels(columns: int, size=(11.0, 4.2), rows=1, **options):
    """A figure with panels, each with a faint grid, in one array. `options` as for matplotlib's `subplots`."""
    figure, axes = pyplot().subplots(rows, columns, figsize=size, layout="constrained", **options)
    for panel in np.ravel(axes):
        panel.grid(alpha=0.2)
    return figure, np.ravel(axes)


def legend_below(figure, panel, columns: int, **options) -> None:
    """Put the legend of a panel below all of them. `options` as for matplotlib's `legend`."""
    figure.legend(
        *panel.get_legend_handles_labels(), loc="outside lower center", ncols=columns, frameon=False, **options
    )


def save(figure, path: Path, **options) -> None:
    """Write a figure without a date and close it. `options` as for matplotlib's `savefig`."""
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, metadata={"Date": None}, **options)
    pyplot().close(figure)
