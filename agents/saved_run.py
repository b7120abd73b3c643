"""What is read of a run that is there already: its settings, its model and its curve, checked before anything is done.

Files of a run may be cut, edited by hand or of another version of this program. Each that cannot be used is a
ValueError that names the file and says what is wrong with it; nothing has been written then.
"""

import json
import shutil
import sys
import warnings
from importlib.metadata import version
from pathlib import Path
from typing import Any

from stable_baselines3 import PPO

from agents.config import settings_of
from fish_env.checks import is_whole
from fish_env.control.files import replacing

PACKAGES = ("fish_env", "gymnasium", "numpy", "numba", "stable_baselines3", "torch")
CURVE = "timesteps,seconds,episodes,score,return"
ADVICE = "restore the file, or train again"


def versions() -> dict[str, str]:
    """The versions that a training depends on, by name."""
    return {name: version(name) for name in PACKAGES} | {"python": sys.version.split()[0]}


def read_record(path: Path) -> dict[str, Any]:
    """The content of config.json of a run: task, seed, config, commit, and what else `train` has noted.

    Raises:
        ValueError: if it is not such a record, or its settings are not those of this version.
    """
    try:
        record = json.loads(path.read_text())
        if not isinstance(record, dict):
            raise ValueError(f"it holds {record!r:.40}, not an object")
        for name, fits in (("task", str), ("seed", int), ("config", dict), ("commit", str)):
            if name not in record:
                raise ValueError(f"it has no {name!r}")
            if not isinstance(record[name], fits) or isinstance(record[name], bool):
                raise ValueError(f"{name!r} is {record[name]!r:.40}")
        if not is_whole(record.get("resumed", 0)) or not isinstance(record.get("versions", {}), dict):
            raise ValueError("'resumed' is no whole number, or 'versions' no object")
        settings_of(record["config"])
    except (ValueError, RecursionError) as error:
        raise ValueError(f"{path} cannot be used ({error}); {ADVICE}") from error
    return record


def read_model(path: Path, learner: type[PPO], env=None) -> PPO:
    """The model in a file, to be trained further in `env`; ValueError if it cannot be read, or does not fit."""
    try:
        with warnings.catch_warnings():  # else Stable-Baselines3 takes a default in place of what it cannot read
            warnings.filterwarnings("error", message="Could not deserialize")
            return learner.load(path, env, device="cpu")
    except Exception as error:  # what is in a pickle may raise anything
        text = (str(error).splitlines() or [""])[0]
        raise ValueError(f"{path} cannot be read ({type(error).__name__}: {text}); {ADVICE}") from error


def read_curve(path: Path) -> list[str]:
    """The rows of curve.csv of a run, without its head, or none without the file; ValueError for one that is cut."""
    head, *rows = path.read_text().splitlines() if path.exists() else [CURVE]
    for number, row in enumerate([head, *rows], start=1):
        try:
            if number == 1 and row != CURVE:
                raise ValueError
            if number > 1:
                steps, *others = row.split(",")
                if int(steps) < 0 or len([float(each) for each in others]) != CURVE.count(","):
                    raise ValueError
        except ValueError as error:
            raise ValueError(f"line {number} of {path} is {row!r}, not {CURVE}; delete it, or {ADVICE}") from error
    return rows


def keep_of_other_versions(folder: Path, record: dict[str, Any]) -> None:
    """If a run was trained with other versions than are installed, say which, and keep its model beside the new one."""
    before, now = record.get("versions", {}), versions()
    last = {name: str(before.get(name, "unknown")).split(", ")[-1] for name in now}
    changed = [f"{name} {last[name]} (now {now[name]})" for name in now if last[name] != now[name]]
    if changed:
        kept = folder / f"model_before_{record.get('resumed', 0) + 1}.zip"
        with replacing(kept) as partial:
            shutil.copyfile(folder / "model.zip", partial)
        print(f"Warning: the run was trained with {', '.join(changed)}. It goes on with what is installed, which may "
              f"learn otherwise; the model as it was is kept in {kept}.")  # fmt: skip


def joined_versions(record: dict[str, Any] | None) -> dict[str, str]:
    """The versions now, after those of the run that is resumed where they were others."""
    before, found = ({} if record is None else record.get("versions", {})), {}
    for name, now in versions().items():
        earlier = str(before.get(name, now))
        found[name] = earlier if earlier.split(", ")[-1] == now else f"{earlier}, {now}"
    return found
