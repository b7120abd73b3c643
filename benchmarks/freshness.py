"""Is a published table older than what it measured? By the reference trajectories in its head against those of now."""

import json
from collections.abc import Iterable
from pathlib import Path
from typing import NamedTuple

import numpy as np

from benchmarks.common.reference import changed, from_text
from benchmarks.common.tables import ROOT, TRAJECTORIES, head_of

CURRENT, STALE, UNKNOWN, MISSING, NO_TABLE = "current", "stale", "cannot be told", "missing", "no table"


class Status(NamedTuple):
    """The state of a published number."""

    state: str
    commit: str
    date: str
    why: str


def header_of(path: Path) -> dict[str, str]:
    """The provenance of a table (its comment lines), a JSON file or an .npz file; empty for any other file."""
    if path.suffix == ".npz":
        with np.load(path) as file:
            return json.loads(str(file["provenance"])) if "provenance" in file else {}
    if path.suffix == ".json":
        found = json.loads(path.read_text("utf-8"))
        parts = [part for part in (found, *found.values()) if isinstance(part, dict)]  # of levels of water
        return next((part["provenance"] for part in parts if "provenance" in part), {})
    return head_of(path) if path.suffix == ".csv" else {}


def status_of(outputs: Iterable[str], follows: Iterable[str], root: Path = ROOT) -> Status:
    """Whether files are there and of the present motions; the worst of them counts.

    Args:
        outputs: files below the root. Charts and pictures have no head: they are as old as the table beside them.
        follows: patterns of the names of the trajectories that they depend on.
        root: the folder of the project.
    """
    paths = [root / name for name in outputs]
    missing = [path.name for path in paths if not path.exists()]
    if missing:
        return Status(MISSING, "", "", ", ".join(missing))
    heads = [(path, header_of(path)) for path in paths]
    found = [_status(head, follows) for path, head in heads if path.suffix == ".csv"]
    if not found:  # parameters, which are followed, and pictures
        about = next((head for _, head in heads if head), {})
        return Status(NO_TABLE, about.get("commit", ""), about.get("date", ""), "")
    return min(found, key=lambda each: (STALE, UNKNOWN, CURRENT).index(each.state))


def _status(header: dict[str, str], follows: Iterable[str]) -> Status:
    """The state of a table by its head."""
    about = header.get("commit", ""), header.get("date", "")
    if TRAJECTORIES not in header:
        return Status(UNKNOWN, *about, "its head has no reference trajectories")
    names = changed(from_text(header[TRAJECTORIES]), follows)
    more = f" and {len(names) - 3} more" if len(names) > 3 else ""
    return Status(STALE, *about, f"other now: {', '.join(names[:3])}{more}") if names else Status(CURRENT, *about, "")
