"""Tables of results: reading and writing the CSV files of `benchmarks/results/`."""

from agents.records import RESULTS, ROOT, provenance, read_rows, write_csv

IMAGES = ROOT / "docs" / "images"

__all__ = ["IMAGES", "RESULTS", "ROOT", "provenance", "read_rows", "read_table", "write_csv"]


def number(text: str) -> int | float | str:
    """The number that a text is, or the text."""
    for kind in (int, float):
        try:
            return kind(text)
        except ValueError:
            continue
    return text


def read_table(name: str) -> list[dict]:
    """The rows of results/name, numbers as numbers."""
    return [{key: number(value) for key, value in row.items()} for row in read_rows(RESULTS / name)]
