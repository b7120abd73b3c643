"""Read and check the settings, the model and the curve of a saved run before anything is changed.

A file that cannot be used raises a ValueError, which names the file and the reason; nothing has been written then.
"""

import json
import sys
from importlib.metadata import version
from pathlib import Path
from typing import Any
from zipfile import ZipFile

from stable_baselines3 import PPO

from fish_env.training.config import settings_of, usual_settings

PACKAGES = ("fish_env", "gymnasium", "numpy", "numba", "stable_baselines3", "torch")
CURVE = "timesteps,seconds,episodes,score,return"
ADVICE = "restore the file, or train again"
FIELDS = {"task": str, "seed": int, "config": dict, "commit": str, "resumed": int, "versions": dict,
          "start": str | None, "command": str}  # fmt: skip
OPTIONAL = {"resumed": 0, "versions": {}, "start": None, "command": ""}
"""Fields of config.json that may be missing, with their values then."""


def versions() -> dict[str, str]:
    """The versions that a training depends on, by name; PackageNotFoundError if one is not installed."""
    return {name: version(name) for name in PACKAGES} | {"python": sys.version.split()[0]}


def read_record(path: Path) -> dict[str, Any]:
    """The content of config.json of a run: task, seed, config, commit, and what else `train` has noted.

    Raises:
        ValueError: if it is not such a record, or its settings are not those of this version.
    """
    try:
        record = {**OPTIONAL, **json.loads(path.read_text())}
        for name, kind in FIELDS.items():
            if name not in record or not isinstance(record[name], kind):
                raise ValueError(f"{name!r} is {record.get(name)!r:.40}")
        env_id, task = settings_of(record["config"]).env_id, record["task"]
        if env_id != usual_settings(task).env_id:  # another one could be of any module
            raise ValueError(f"the environment {env_id!r:.40} is not that of a task {task!r:.40} here")
    except (ValueError, TypeError, OSError, RecursionError) as error:
        raise ValueError(f"{path} cannot be used ({error}); {ADVICE}") from error
    return record


def restore(model: PPO, path: Path) -> PPO:
    """Give a fresh learner the parameters, the state of the optimizer and the counts in a file of a run; returns it.

    Raises:
        ValueError: if the file cannot be read, or if it is of another policy than that of the learner.
    """
    try:
        with ZipFile(path) as file:
            counts = json.loads(file.read("data"))
        model.set_parameters(str(path), device="cpu")
        model.num_timesteps, model._n_updates = counts["num_timesteps"], counts["_n_updates"]
    except Exception as error:  # what was damaged may raise anything
        raise ValueError(f"{path} cannot be read ({type(error).__name__}: {error!s:.300}); {ADVICE}") from error
    return model


def read_curve(path: Path) -> list[str]:
    """The rows of curve.csv of a run, without its head, or none without the file; ValueError for one that is cut."""
    try:
        head, *rows = path.read_text().splitlines() if path.exists() else [CURVE]
        if head != CURVE:
            raise ValueError(f"its head is {head!r:.100}, not {CURVE}")
        for row in rows:
            steps, *others = row.split(",")
            if len([int(steps), *map(float, others)]) != len(CURVE.split(",")):
                raise ValueError(f"it has a row {row!r:.100}")
    except (ValueError, OSError) as error:
        raise ValueError(f"{path} cannot be read ({error}); delete it, or {ADVICE}") from error
    return rows


def warn_of_other_versions(record: dict[str, Any]) -> None:
    """If a run was trained with other versions than are installed, print them."""
    now = versions()
    last = {name: record["versions"].get(name, "unknown").split(", ")[-1] for name in now}
    changed = [f"{name} {last[name]} (now {now[name]})" for name in now if last[name] != now[name]]
    if changed:
        print(f"Warning: the run was trained with {', '.join(changed)}. Training continues with the installed "
              "versions, and its results may differ.")  # fmt: skip


def append_version(before: str | None, now: str) -> str:
    """The versions or commits that a run was trained with before, and the present one if it is another."""
    return now if before is None else before if before.split(", ")[-1] == now else f"{before}, {now}"
