"""Tables of results: CSV files in `benchmarks/results/` with the reference trajectories of the day in their heads."""

from pathlib import Path

from agents import records
from agents.records import RESULTS, ROOT, provenance, read_rows
from benchmarks.common.reference import as_text, trajectories

IMAGES = ROOT / "docs" / "images"
TRAJECTORIES = "reference trajectories"

__all__ = ["IMAGES", "RESULTS", "ROOT", "TRAJECTORIES", "provenance", "read_rows", "read_table", "write_csv"]


def write_csv(name: str, rows: list[dict], command: str) -> Path:
    """Write rows to results/name, preceded by their provenance and the reference trajectories; return the path."""
    return records.write_csv(name, rows, command, {TRAJECTORIES: as_text(trajectories())})


def number(text: str) -> int | float | str:
    """Convert a text to the number that it is, or return the text."""
    for kind in (int, float):
        try:
            return kind(text)
        except ValueError:
            continue
    return text


def read_table(name: str) -> list[dict]:
    """Return the rows of results/name, numbers as numbers."""
    return [{key: number(value) for key, value in row.items()} for row in read_rows(RESULTS / name)]
