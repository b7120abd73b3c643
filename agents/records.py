"""Published tables with the provenance of their numbers, and the library that draws charts of them.

The tables are the CSV files of `benchmarks/results/`, whichever command writes them: `train.py` or a benchmark.
"""

import csv
import os
import platform
import subprocess
from contextlib import suppress
from datetime import date
from importlib.metadata import version
from io import StringIO
from pathlib import Path

from fish_env.control.files import write_text

ROOT = Path(__file__).parent.parent
RESULTS = ROOT / "benchmarks" / "results"
CODE = ("fish_env", "agents", "benchmarks", "train.py", "constraints.txt", "pyproject.toml")
"""Paths that results depend on: a commit is called dirty if a change in them is not committed."""
WRITTEN = (":!benchmarks/results", ":!*/pretrained/*", ":!fish_env/control/*.json", ":!fish_env/bodies/*.json")
"""Files that commands write; changes in them do not make a commit dirty."""


def provenance(command: str) -> dict[str, str]:
    """Command, commit, date, processor and versions that a measurement was made with.

    The commit ends in "-dirty" if code that results depend on is not committed; it is "unknown" without git.
    """

    def git(*arguments):
        with suppress(OSError):  # there is no git
            done = subprocess.run(["git", *arguments], cwd=ROOT, capture_output=True, text=True, check=False)
            return done.stdout.strip()
        return ""

    commit = git("describe", "--always")
    if commit and git("status", "--porcelain", "--", *CODE, *WRITTEN):
        commit += "-dirty"
    processor = platform.processor() or platform.machine()
    if Path("/proc/cpuinfo").exists():
        lines = Path("/proc/cpuinfo").read_text().splitlines()
        processor = next((line.split(":")[1].strip() for line in lines if line.startswith("model name")), processor)
    return {
        "command": command,
        "commit": commit or "unknown",
        "date": date.today().isoformat(),
        "processor": f"{processor}, {os.cpu_count()} cores",
        "python": platform.python_version(),
        **{package: version(package) for package in ("numpy", "scipy", "numba", "gymnasium")},
    }


def write_csv(name: str, rows: list[dict], command: str, more: dict[str, str] | None = None) -> Path:
    """Write rows to benchmarks/results/name, preceded by the provenance and more as comment lines; returns the path.

    A table that is there already is replaced as a whole, or stays if anything fails.
    """
    text = StringIO()
    for key, value in (provenance(command) | (more or {})).items():
        text.write(f"# {key}: {value}\n")
    writer = csv.DictWriter(text, rows[0].keys(), lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    path = RESULTS / name
    path.parent.mkdir(parents=True, exist_ok=True)
    write_text(path, text.getvalue())
    return path


def read_rows(path: Path) -> list[dict]:
    """The rows of a CSV file, every value as text, without the comment lines."""
    with path.open() as file:
        return list(csv.DictReader(line for line in file if not line.startswith("#")))


def pyplot():
    """Matplotlib's pyplot without a display; the same numbers give the same bytes of an SVG file."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    pyplot.rcParams["svg.hashsalt"] = "fish_env"
    return pyplot
