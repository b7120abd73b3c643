"""Read and check the settings, the model and the curve of a saved run before anything is changed.

Files of a run may be truncated, edited by hand or written by another version of this program. A file that cannot be
used raises a ValueError, which names the file and the reason; nothing has been written then.
"""

import json
import os
import sys
from importlib.metadata import version
from io import BytesIO
from pathlib import Path
from pickletools import genops
from typing import Any
from zipfile import ZIP_DEFLATED, ZIP_STORED, ZipFile

import torch
from stable_baselines3 import PPO

from fish_env.checks import is_whole
from fish_env.training.config import settings_of, usual_settings

PACKAGES = ("fish_env", "gymnasium", "numpy", "numba", "stable_baselines3", "torch")
CURVE = "timesteps,seconds,episodes,score,return"
ADVICE = "restore the file, or train again"
RECORD, ROWS, COUNTS = 2**20, 2**26, 2**25  # bytes that config.json, curve.csv and the counts in model.zip may have
FIELDS = {"task": str, "seed": int, "config": dict, "commit": str, "resumed": int, "versions": dict,
          "start": str | None, "command": str}  # fmt: skip
OPTIONAL = {"resumed": 0, "versions": {}, "start": None, "command": ""}
"""Fields of config.json that may be missing, with their values then."""
TENSORS = {"collections OrderedDict", "torch._utils _rebuild_tensor_v2", "torch FloatStorage", "torch LongStorage"}
"""All that a policy and its optimizer are saved with. Torch knows more, with which a small file takes any memory."""


def versions() -> dict[str, str]:
    """The versions that a training depends on, by name; PackageNotFoundError if one is not installed."""
    return {name: version(name) for name in PACKAGES} | {"python": sys.version.split()[0]}


def not_through_link(path: str, flags: int) -> int:
    """An opener for `open`, by which no file is written that a link in a folder of a run leads to."""
    return os.open(path, flags | getattr(os, "O_NOFOLLOW", 0), 0o666)


def check_name(folder: Path) -> None:
    """Raise ValueError for a name that is not UTF-8: it could not be printed, nor written into a page."""
    try:
        str(folder).encode()
    except UnicodeEncodeError as error:
        raise ValueError(f"the name of the folder {str(folder)!r} is not UTF-8; give it another name") from error


def read_text(path: Path, most: int) -> str:
    """The text of a file of at most so many bytes; ValueError with the reason if it cannot be read."""
    if not path.is_file():
        raise ValueError("it is not a file")
    try:
        with path.open("rb") as file:
            data = file.read(most + 1)
    except OSError as error:
        raise ValueError(error.strerror) from error
    if len(data) > most:
        raise ValueError(f"it has more than {most} bytes")
    return data.decode()


def read_record(path: Path) -> dict[str, Any]:
    """The content of config.json of a run: task, seed, config, commit, and what else `train` has noted.

    Raises:
        ValueError: if it is not such a record, or its settings are not those of this version.
    """
    try:
        record = json.loads(read_text(path, RECORD))
        if not isinstance(record, dict):
            raise ValueError(f"it holds {record!r:.40}, not an object")
        record = OPTIONAL | record
        for name, kind in FIELDS.items():
            if name not in record:
                raise ValueError(f"it has no {name!r}")
            if not isinstance(record[name], kind) or isinstance(record[name], bool):
                raise ValueError(f"{name!r} is {record[name]!r:.40}")
        if not 0 <= record["resumed"] < 10**9 or not all(isinstance(text, str) for text in record["versions"].values()):
            raise ValueError("'resumed' is out of range, or 'versions' holds what is no text")
        env_id, task = settings_of(record["config"]).env_id, record["task"]
        if env_id != usual_settings(task).env_id:  # another one could be of any module
            raise ValueError(f"the environment {env_id!r:.40} is not that of a task {task!r:.40} here")
    except (ValueError, RecursionError) as error:
        raise ValueError(f"{path} cannot be used ({error}); {ADVICE}") from error
    return record


def restore(model: PPO, path: Path) -> PPO:
    """Give a fresh learner the parameters, the numbers of the optimizer and the counts in a file of a run; returns it.

    Of the file only tensors and plain numbers are read: what else `PPO.save` puts there, of which a learner is made
    from the settings, may execute anything when it is read.

    Raises:
        ValueError: if the file cannot be read, or if it is of another policy than that of the learner.
    """
    policy, optimizer = model.policy, model.policy.optimizer
    wanted = policy.state_dict()
    most = 2**20 + 3 * sum(value.nbytes for value in wanted.values())
    limits = {"data": COUNTS, "policy.pth": most, "policy.optimizer.pth": most}
    try:
        counts, *saved = _read_parts(path, limits)
        steps, updates = map(json.loads(counts).get, ("num_timesteps", "_n_updates"))
        if not all(is_whole(count) and 0 <= count < 2**53 for count in (steps, updates)):
            raise ValueError(f"its counts are {steps!r:.40} and {updates!r:.40}")
        parameters, memory = (_load_tensors(data) for data in saved)
        found = _check_tensors(parameters, wanted)
        trained = {name for name, _ in policy.named_parameters()}
        for name in wanted.keys() - trained:  # they follow from the fish
            if not torch.allclose(found[name], wanted[name]):
                raise ValueError(f"{name} differs from that of the fish")
        state = {}
        for k, parameter in enumerate(p for group in optimizer.param_groups for p in group["params"]):
            kept = {"step": torch.zeros(()), "exp_avg": parameter, "exp_avg_sq": parameter}
            if memory["state"]:  # else there was no update yet
                state[k] = _check_tensors(memory["state"][k], kept)
        policy.load_state_dict(found)
        optimizer.load_state_dict({"state": state, "param_groups": optimizer.state_dict()["param_groups"]})
    except Exception as error:  # what was damaged may raise anything
        text = (str(error).splitlines() or [""])[0]
        raise ValueError(f"{path} cannot be read ({type(error).__name__}: {text:.200}); {ADVICE}") from error
    model.num_timesteps, model._n_updates = steps, updates
    return model


def _read_parts(path: Path, limits: dict[str, int]) -> list[bytes]:
    """Parts of a zip archive, by their names; ValueError for one with more bytes than its limit, unpacked or not."""
    if not path.is_file() or path.stat().st_size > 2**20 + sum(limits.values()):
        raise ValueError("it is not a file, or it is larger than a model of these settings")
    with ZipFile(path) as archive:
        parts = []
        for name, most in limits.items():
            if archive.getinfo(name).compress_type not in (ZIP_STORED, ZIP_DEFLATED):
                raise ValueError(f"{name} is packed by another method")  # of which one step may unpack any size
            with archive.open(name) as part:
                parts.append(part.read(most + 1))
            if len(parts[-1]) > most:
                raise ValueError(f"{name} is larger than that of these settings")
    return parts


def _load_tensors(data: bytes) -> Any:
    """Object that torch saved, if it is only tensors in dictionaries and takes no more memory than its bytes."""
    with ZipFile(BytesIO(data)) as archive:
        whole = archive.infolist()
        packed = any(info.compress_type != ZIP_STORED for info in whole)
        if packed or not data.startswith(b"PK\3\4") or sum(info.file_size for info in whole) > len(data):
            raise ValueError("torch has not saved it")
        for info in whole:
            if info.filename.endswith(".pkl"):
                for operation, argument, _ in genops(archive.read(info)):
                    if operation.name == "GLOBAL" and argument not in TENSORS:
                        raise ValueError(f"it holds {argument!r:.100}")
    return torch.load(BytesIO(data), map_location="cpu", weights_only=True)


def _check_tensors(found: dict[str, torch.Tensor], wanted: dict[str, torch.Tensor]) -> dict[str, torch.Tensor]:
    """The tensors found, if they are finite and have the names, shapes and types of those wanted; else ValueError."""
    if found.keys() != wanted.keys():
        raise ValueError(f"its tensors are not those of these settings; missing: {sorted(wanted.keys() - found)}")
    for name, value in wanted.items():
        given = found[name]
        if not isinstance(given, torch.Tensor) or (given.shape, given.dtype) != (value.shape, value.dtype):
            raise ValueError(f"{name} is not of shape {tuple(value.shape)} and {value.dtype}")
        if not given.isfinite().all():
            raise ValueError(f"{name} holds numbers that are not finite")
    return {name: found[name] for name in wanted}


def read_curve(path: Path) -> list[str]:
    """The rows of curve.csv of a run, without its head, or none without the file; ValueError for one that is cut."""
    try:
        head, *rows = read_text(path, ROWS).splitlines() if os.path.lexists(path) else [CURVE]
    except ValueError as error:
        raise ValueError(f"{path} cannot be read ({error}); delete it, or {ADVICE}") from error
    for number, row in enumerate([head, *rows], start=1):
        try:
            if number == 1 and row != CURVE:
                raise ValueError
            if number > 1:
                steps, *others = row.split(",")
                if not 0 <= int(steps) < 2**53 or len([float(each) for each in others]) != CURVE.count(","):
                    raise ValueError
        except ValueError as error:
            raise ValueError(f"line {number} of {path} is {row!r:.100}, not {CURVE}; delete it, or {ADVICE}") from error
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
