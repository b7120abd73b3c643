"""Tables of results: CSV files in `benchmarks/results/` with the provenance of their numbers in their heads.

Here is the command line that benchmarks share, too: `publish`.
"""

import argparse
import csv
import os
import platform
import re
import sys
from collections.abc import Callable, Iterable
from datetime import date
from importlib.metadata import version
from io import StringIO
from pathlib import Path

from benchmarks.common.reference import as_text, from_text, partly, trajectories
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


def write_csv(name: str, rows: list[dict], command: str, measured: Iterable[str] | None = None) -> Path:
    """Write rows to results/name, preceded by their provenance as comment lines; return the path.

    An existing table is replaced as a whole, or stays if anything fails. Where it has rows of an earlier table, only
    the tasks that were measured get the reference trajectories of now.
    """
    text, about = StringIO(), provenance(command)
    if measured is not None:
        then = from_text(head_of(RESULTS / name).get(TRAJECTORIES, ""))
        about[TRAJECTORIES] = as_text(partly(trajectories(), then, measured))
    for key, value in about.items():
        text.write(f"# {key}: {value}\n")
    writer = csv.DictWriter(text, rows[0].keys(), lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    path = RESULTS / name
    path.parent.mkdir(parents=True, exist_ok=True)
    write_text(path, text.getvalue())
    return path


def replace_rows(name: str, rows: list[dict], tasks: Iterable[str], command: str) -> Path:
    """Write rows into results/name by the order of the tasks; rows of tasks that have none among them stay."""
    mine, order = {row["task"] for row in rows}, list(tasks)
    kept = [row for row in read_stored(name) if row["task"] not in mine]
    rows = sorted(rows + kept, key=lambda row: order.index(row["task"]))
    names = dict.fromkeys(name for row in rows for name in row)
    rows = [{name: row.get(name, "") for name in names} for row in rows]
    return write_csv(name, rows, command, mine if kept else None)


def head_of(path: Path) -> dict[str, str]:
    """The provenance of a table: its comment lines."""
    lines = (line[2:] for line in path.read_text("utf-8").splitlines() if line.startswith("# "))
    return dict(line.split(": ", 1) for line in lines if ": " in line)


def read_rows(path: Path) -> list[dict]:
    """Return the rows of a CSV file, every value as text, without the comment lines."""
    with path.open(encoding="utf-8") as file:
        return list(csv.DictReader(line for line in file if not line.startswith("#")))


def read_stored(name: str) -> list[dict]:
    """Return the rows of results/name as `read_rows` does; none if there is no such table."""
    return read_rows(RESULTS / name) if (RESULTS / name).exists() else []


def number(text: str) -> int | float | str:
    """Convert a text to the number that it is, or return the text."""
    for kind in (int, float):
        try:
            return kind(text)
        except ValueError:
            continue
    return text


def read_table(name: str, /, **wanted) -> list[dict]:
    """Return the rows of results/name, numbers as numbers: those with the wanted values."""
    rows = [{key: number(value) for key, value in row.items()} for row in read_rows(RESULTS / name)]
    return select(rows, **wanted)


def select(rows: Iterable[dict], /, **wanted) -> list[dict]:
    """Return the rows with the wanted values."""
    return [row for row in rows if all(row[key] == value for key, value in wanted.items())]


def columns(rows: Iterable[dict], *names: str) -> list[list]:
    """Return the values of each of these columns."""
    return [[row[name] for row in rows] for name in names]


def line(*cells) -> str:
    """Return a row of a Markdown table."""
    return f"| {' | '.join(map(str, cells)).lstrip()} |"


def markdown(head: Iterable[str], rows: Iterable[Iterable]) -> str:
    """Return a Markdown table."""
    head = list(head)
    return "\n".join([line(*head), "|---" * len(head) + "|", *(line(*row) for row in rows)])


def filled(page: str, tables: dict[str, str]) -> str:
    """Return a page with tables between their marks, `<!-- name -->` and `<!-- end -->`."""
    for name, table in tables.items():
        place = re.compile(rf"(?<=<!-- {name} -->\n).*?(?=<!-- end -->)", re.DOTALL)
        page = place.sub(lambda _, table=table: f"\n{table}\n\n", page)
    return page


def make_parser(description: str | None) -> argparse.ArgumentParser:
    """Return a command line that shows its description as it is written."""
    return argparse.ArgumentParser(description=description, formatter_class=argparse.RawDescriptionHelpFormatter)


def publish(description: str | None, tables: dict[str, Callable[[], list[dict]]], draw=None) -> None:
    """Be the command line of a benchmark: write its tables, then draw; with --draw, only draw from the tables.

    Args:
        description: of the benchmark, whose module is the program.
        tables: by the name of each, what measures its rows.
        draw: draws a chart, or fills in a page, from the tables; None for neither.
    """
    parser = make_parser(description)
    if draw is not None:
        parser.add_argument("--draw", action="store_true", help="draw the chart again from the tables")
    if len(tables) > 1:
        parser.add_argument("--only", choices=tables, help="measure one of the tables")
    given = parser.parse_args()
    command = f"python -m {sys.modules['__main__'].__spec__.name}"
    for name, measure in tables.items() if not getattr(given, "draw", False) else ():
        if getattr(given, "only", None) in (None, name):
            print(write_csv(name, measure(), command))
    if draw is not None:
        draw()
