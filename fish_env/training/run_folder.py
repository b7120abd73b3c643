"""The folder of a run: made and locked before anything is written, and its settings and its curve read again."""

import csv
import json
import os
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from importlib import import_module
from importlib.metadata import version
from pathlib import Path
from typing import Any

from fish_env.control.files import writable_folder
from fish_env.training.config import Request, settings_of, usual_settings

try:
    import fcntl
except ImportError:  # Windows
    fcntl = None

PACKAGES = ("fish_env", "gymnasium", "numpy", "numba", "stable_baselines3", "torch")
CURVE, TERM = ("timesteps", "seconds", "episodes", "score", "return"), "term_"
"""Columns of curve.csv, and the beginning of the names of those for the terms of the reward, which follow."""
OPTIONAL = {"resumed": 0, "versions": {}, "start": None, "command": "", "commit": "unknown"}
"""Fields of config.json that may be missing, with their values then."""


def check_installed() -> None:
    """Raise ImportError if a package that a training needs is not installed, or this one is not."""
    versions()
    for name in ("tensorboard", "matplotlib"):  # the others are imported by now
        import_module(name)


def versions() -> dict[str, str]:
    """The versions that a training depends on, by name; PackageNotFoundError if one is not installed."""
    return {name: version(name) for name in PACKAGES} | {"python": sys.version.split()[0]}


@contextmanager
def open_folder(request: Request) -> Iterator[Path]:
    """The folder of the requested run, made if it is missing, and locked until the context or the program ends.

    ValueError if it holds another run or cannot be written to, RuntimeError if another program is training in it.
    """
    if request.resume is not None:
        folder = writable_folder(request.resume)
    elif request.folder is None:
        folder = _new_folder(request)
    else:
        folder = Path(request.folder)
        if os.path.lexists(folder / "model.zip"):
            raise ValueError(f"{folder} holds a run; resume it with: {request.training('--resume', folder)}")
        writable_folder(folder)
    with (folder / "lock").open("a", encoding="utf-8") as file:
        if fcntl is not None:
            try:
                fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except OSError as error:
                raise RuntimeError(f"another program is training in {folder}; wait for it, or end it first") from error
        yield folder


def _new_folder(request: Request) -> Path:
    """An empty runs/<task>/<time>/, never one that exists; ValueError if it cannot be made."""
    place, stamp, k = writable_folder(Path(request.root) / request.task), time.strftime("%Y-%m-%d_%H-%M-%S"), 1
    while True:
        folder = place / (stamp if k == 1 else f"{stamp}_{k}")
        with suppress(FileExistsError):
            folder.mkdir()
            return folder
        k += 1


def read_record(folder: Path, task: str | None = None) -> dict[str, Any]:
    """The content of config.json of a run: task, seed, config, commit, and what else `train` has noted.

    FileNotFoundError if a task is given, which it must be of, and the folder holds no run. ValueError if it is not such
    a record, its settings are not those of this version, or it is of another task.
    """
    path = Path(folder) / "config.json"
    if task is not None and not (path.is_file() and path.with_name("model.zip").is_file()):
        raise FileNotFoundError(f"{folder} holds no model.zip and config.json; give the folder of a run")
    try:
        record = {**OPTIONAL, **json.loads(path.read_text("utf-8"))}
        if not isinstance(record["task"], str) or not isinstance(record["seed"], int):
            raise ValueError(f"task is {record['task']!r:.40} and seed {record['seed']!r:.40}")
        env_id = settings_of(record["config"]).env_id
        if env_id != usual_settings(record["task"]).env_id:  # another one could be of any module
            raise ValueError(f"the environment {env_id!r:.40} is not that of a task {record['task']!r:.40} here")
    except (ValueError, TypeError, AttributeError, LookupError, OSError, RecursionError) as error:
        raise ValueError(f"{path} cannot be used ({error}); restore the file, or train again") from error
    if task not in (None, record["task"]):
        raise ValueError(f"{folder} is a run of task {record['task']!r}, not {task!r}")
    return record


def read_curve(folder: Path) -> list[dict[str, float]]:
    """Rows of curve.csv of a run, `CURVE` and terms of the reward; none without it, ValueError for another table."""
    path = Path(folder) / "curve.csv"
    try:
        with path.open(newline="", encoding="utf-8") as file:
            head, *rows = csv.reader(file)
        count, terms = len(CURVE), (name.startswith(TERM) for name in head[len(CURVE) :])
        if tuple(head[:count]) != CURVE or not all(terms) or any(len(row) != len(head) for row in rows):
            raise ValueError(f"its head is {head!r:.100}, or a row is cut")
        return [dict(zip(head, map(float, row), strict=True)) for row in rows]
    except FileNotFoundError:
        return []
    except (ValueError, OSError) as error:
        raise ValueError(f"{path} cannot be read ({error}); delete it, restore it, or train again") from error


def append_version(before: str | None, now: str) -> str:
    """The versions or commits that a run was trained with before, and the present one if it is another."""
    return now if before is None else before if before.split(", ")[-1] == now else f"{before}, {now}"
