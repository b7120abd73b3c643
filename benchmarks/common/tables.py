"""Tables of results: CSV files in `benchmarks/results/` with the provenance of their numbers in their heads."""

import csv
import os
import platform
from datetime import date
from importlib.metadata import version
from io import StringIO
from pathlib import Path

from benchmarks.common.reference import as_text, trajectories
from fish_env.control.files import write_text
from fish_env.training.checkout import ROOT, present_commit

RESULTS = ROOT / "benchmarks" / "results"
IMAGES = ROOT / "docs" / "images"
TRAJECTORIES = "reference trajectories"


def provenance(command: str) -> dict[str, str]:
    """Command, commit, date, processor, versions and reference trajectories of a measurement."""
    processor = platform.processor() or platform.machine()
    if Path("/proc/cpuinfo").exists():
        lines = Path("/proc/cpuinfo").read_text().splitlines()
        processor = next((line.split(":")[1].strip() for line in lines if line.startswith("model name")), processor)
    return {
        "command": command,
        "commit": present_commit(),
        "date": date.today().isoformat(),
        "processor": f"{processor}, {os.cpu_count()} cores",
        "python": platform.python_version(),
        **{package: version(package) for package in ("numpy", "scipy", "numba", "gymnasium")},
        TRAJECTORIES: as_text(trajectories()),
    }


def write_csv(name: str, rows: list[dict], command: str) -> Path:
    """Write rows to results/name, preceded by their provenance as comment lines; return the path.

    An existing table is replaced as a whole, or stays if anything fails.
    """
    text = StringIO()
    for key, value in provenance(command).items():
        text.write(f"# {key}: {value}\n")
    writer = csv.DictWriter(text, rows[0].keys(), lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    path = RESULTS / name
    path.parent.mkdir(parents=True, exist_ok=True)
    write_text(path, text.getvalue())
    return path


def read_rows(path: Path) -> list[dict]:
    """Return the rows of a CSV file, every value as text, without the comment lines."""
    with path.open() as file:
        return list(csv.DictReader(line for line in file if not line.startswith("#")))


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
