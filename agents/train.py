"""One training run: a folder that explains itself, a model that learns, and a report of what it learnt."""

import json
import os
import sys
import time
from dataclasses import asdict, replace
from importlib.metadata import version
from pathlib import Path

import torch
from stable_baselines3 import PPO
from stable_baselines3.common.callbacks import CallbackList

from agents.build import export_policy, make_env, make_model
from agents.callbacks import Checkpoint, LearningCurve, Progress, save_whole
from agents.config import CONFIGS, RESULTS, TrainConfig
from agents.report import report
from benchmarks.provenance import provenance

PACKAGES = ("fish_env", "gymnasium", "numpy", "numba", "stable_baselines3", "torch")


def new_folder(root: Path, task: str) -> Path:
    """An empty runs/<task>/<time>/, never one that exists."""
    stamp = time.strftime("%Y-%m-%d_%H-%M-%S")
    for suffix in ("", *(f"_{k}" for k in range(2, 100))):
        folder = root / task / (stamp + suffix)
        try:
            folder.mkdir(parents=True)
            return folder
        except FileExistsError:
            continue
    raise FileExistsError(f"{root / task / stamp} and 98 like it exist")


def train(
    task: str,
    seed: int = 0,
    root: Path = Path("runs"),
    resume: Path | None = None,
    folder: Path | None = None,
    pictures: bool = True,
    **changes,
) -> Path:
    """Train, evaluate and report; returns the run's folder.

    Args:
        task: a key of `CONFIGS`.
        seed: of the learner; fish i starts from seed + i.
        root: where the run's folder is made.
        resume: the folder of an earlier run to go on with, until its number of timesteps (or the one given) is reached.
        folder: where to keep the run, instead of a new folder under `root`.
        pictures: make the pictures, the video and the table beside the baselines; else only measure the policy.
        changes: fields of `TrainConfig` to use instead of the task's (None is ignored).

    Raises:
        ValueError: for an unknown task or a setting that is not allowed.
        FileNotFoundError: if there is nothing to resume.
    """
    changes = {name: value for name, value in changes.items() if value is not None}
    if resume is None:
        if task not in CONFIGS:
            raise ValueError(f"unknown task {task!r}; choose from {', '.join(CONFIGS)}")
        config = replace(CONFIGS[task], **changes)
        folder = new_folder(root, task) if folder is None else Path(folder)
        folder.mkdir(parents=True, exist_ok=True)
    else:
        folder = Path(resume)
        config, seed = _resumable(folder, task, changes)
    for name in ("timesteps", "num_envs"):
        if getattr(config, name) < 1:
            raise ValueError(f"{name} is {getattr(config, name)}; give a whole number, at least 1")
    _write_config(folder, task, config, seed)
    env = make_env(config, config.num_envs, seed)
    if resume is None:
        model = make_model(config, env, seed, folder / "tensorboard")
    else:
        model = PPO.load(folder / "model.zip", env, device="cpu")
    finished = learn(model, config, folder, RESULTS[task].score)
    env.close()
    save_whole(model, folder / "model.zip")
    export_policy(model, {"task": task, "env_id": config.env_id, "env_options": config.env_options}).save(
        folder / "policy.npz"
    )
    if not finished:
        print(f"\nStopped after {model.num_timesteps:,} decisions; what was learnt is kept in {folder}.")
        print(f"Go on with:  python train.py {task} --resume {folder}")
        print(f"See it swim: python train.py play {folder / 'policy.npz'}")
        return folder
    report(folder, task, config, seed, pictures)
    return folder


def learn(model: PPO, config: TrainConfig, folder: Path, score: str) -> bool:
    """Train to the configured number of timesteps; False if Ctrl-C stopped it first."""
    callbacks = CallbackList([Progress(), LearningCurve(folder / "curve.csv", score), Checkpoint(folder / "model.zip")])
    left = config.timesteps - model.num_timesteps
    if left <= 0:
        return True
    try:
        model.learn(left, callbacks, reset_num_timesteps=model.num_timesteps == 0, tb_log_name="ppo")
    except KeyboardInterrupt:
        return False
    return True


def _resumable(folder: Path, task: str, changes: dict) -> tuple[TrainConfig, int]:
    if not (folder / "model.zip").is_file() or not (folder / "config.json").is_file():
        raise FileNotFoundError(f"{folder} holds no model.zip and config.json to go on with; give the folder of a run")
    kept = json.loads((folder / "config.json").read_text())
    if kept["task"] != task:
        raise ValueError(f"{folder} is a run of task {kept['task']!r}, not {task!r}")
    settings = kept["config"] | {"hidden": tuple(kept["config"]["hidden"])}
    return replace(TrainConfig(**settings), **changes), kept["seed"]


def _write_config(folder: Path, task: str, config: TrainConfig, seed: int) -> None:
    record = {
        "task": task,
        "seed": seed,
        "config": asdict(config),
        "command": f"python train.py {task} --seed {seed} --timesteps {config.timesteps} --num-envs {config.num_envs}",
        "commit": provenance("")["commit"],
        "versions": {name: version(name) for name in PACKAGES} | {"python": sys.version.split()[0]},
        "threads": {"torch": torch.get_num_threads(), "processors": os.cpu_count()},
    }
    (folder / "config.json").write_text(json.dumps(record, indent=2) + "\n")
