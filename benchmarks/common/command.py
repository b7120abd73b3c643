"""Command line that the benchmarks with a chart share."""

import argparse
from collections.abc import Callable


def measure_and_draw(description: str | None, measure: Callable[[], None], draw: Callable[[], None]) -> None:
    """Write the tables and draw the chart; with --draw, draw it again from the tables."""
    parser = argparse.ArgumentParser(description=description, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--draw", action="store_true", help="draw the chart again from the tables")
    if not parser.parse_args().draw:
        measure()
    draw()
