"""Charts: one style, colours told apart by colour-blind readers (Okabe & Ito), and SVG files without a date.

Benchmarks with a chart share their command line, too: `measure_and_draw`.
"""

import argparse
from collections.abc import Callable
from pathlib import Path

BLUE, ORANGE, GREY = "#0072B2", "#D55E00", "#999999"
METHOD_STYLE = {  # colour and marker, one marker a family
    "explicit_euler": ("#999999", "x"),
    "symplectic_euler": ("#E69F00", "o"),
    "midpoint": ("#56B4E9", "o"),
    "rk4": ("#0072B2", "o"),
    "semi_implicit": ("#D55E00", "s"),
    "linearly_implicit": ("#009E73", "^"),
    "linearly_implicit_projected": ("#66C2A5", "v"),
    "linearly_implicit_water": ("#1B9E77", "<"),
    "rosenbrock": ("#CC79A7", "D"),
    "leapfrog_chebyshev": ("#000000", "*"),
}


def pyplot():
    """Matplotlib's pyplot without a display; the same numbers give the same bytes of an SVG file."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    pyplot.rcParams["svg.hashsalt"] = "fish_env"
    return pyplot


def panels(columns: int, size=(11.0, 4.2), **options):
    """A figure with a row of panels, each with a faint grid. `options` as for matplotlib's `subplots`."""
    figure, axes = pyplot().subplots(1, columns, figsize=size, layout="constrained", **options)
    for panel in axes:
        panel.grid(alpha=0.2)
    return figure, axes


def save(figure, path: Path, **options) -> None:
    """Write a figure without a date and close it. `options` as for matplotlib's `savefig`."""
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, metadata={"Date": None}, **options)
    pyplot().close(figure)


def measure_and_draw(description: str | None, measure: Callable[[], None], draw: Callable[[], None]) -> None:
    """Write the tables and draw the chart; with --draw, draw it again from the tables."""
    parser = argparse.ArgumentParser(description=description, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--draw", action="store_true", help="draw the chart again from the tables")
    if not parser.parse_args().draw:
        measure()
    draw()
