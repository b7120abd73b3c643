"""One training run: a folder that explains itself, a model that learns, and a report of what it learnt."""

import json
import os
import sys
import time
from contextlib import contextmanager
from dataclasses import asdict, replace
from importlib.metadata import version
from pathlib import Path

import torch
from stable_baselines3 import PPO
from stable_baselines3.common.callbacks import CallbackList

from agents.build import LEARNERS, export_policy, make_env, make_model, start_from
from agents.callbacks import Checkpoint, LearningCurve, Progress, save_whole
from agents.config import CONFIGS, RESULTS, TrainConfig, settings_of
from agents.fast_ppo import FastPPO
from agents.records import provenance
from agents.report import report
from fish_env import BODIES, make_fish

try:
    import fcntl
except ImportError:  # Windows
    fcntl = None

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
    body: str | None = None,
    start: Path | None = None,
    learner: str = "compiled",
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
        body: a key of `fish_env.BODIES` to learn on; None takes the task's.
        start: the folder of a run of the task to begin with what it learnt, on whatever body; its learning rate, noise
            and number of timesteps are those of a new run.
        learner: a key of `agents.build.LEARNERS`; both learn the same, a run may change from one to the other.
        changes: fields of `TrainConfig` to use instead of the task's (None is ignored).

    Raises:
        ValueError: for an unknown task, body or learner, a setting that is not allowed, a run to start from that does
            not fit, or a folder that holds a run already.
        FileNotFoundError: if there is nothing to resume or to start from.
        RuntimeError: if another program is training in the folder.
    """
    if learner not in LEARNERS:
        raise ValueError(f"unknown learner {learner!r}; choose from {', '.join(LEARNERS)}")
    changes = {name: value for name, value in changes.items() if value is not None}
    if resume is None:
        if task not in CONFIGS:
            raise ValueError(f"unknown task {task!r}; choose from {', '.join(CONFIGS)}")
        config, kept = replace(CONFIGS[task], **changes), None
        if body is not None:
            config = on_body(config, body)
        if start is not None:
            _kept(Path(start), task, "start from")
        if folder is not None and (Path(folder) / "model.zip").exists():
            raise ValueError(f"{folder} holds a run; go on with: python train.py {task} --resume {folder}")
    else:
        if body is not None or start is not None:
            raise ValueError("a run that goes on keeps its body and what it started from; leave both out")
        folder = Path(resume)
        kept = _kept(folder, task, "go on with")
        config = replace(settings_of(kept["config"]), **changes)
        seed = kept["seed"]
    for name, value, least in (("timesteps", config.timesteps, 1), ("num_envs", config.num_envs, 1), ("seed", seed, 0)):
        if value < least:
            raise ValueError(f"{name} is {value}; give a whole number, at least {least}")
    folder = new_folder(root, task) if folder is None else Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    with locked(folder):
        _write_config(folder, task, config, seed, kept, start)
        env = make_env(config, config.num_envs, seed)
        if resume is None:
            model = make_model(config, env, seed, folder / "tensorboard", learner)
            if start is not None:
                start_from(model, PPO.load(Path(start) / "model.zip", device="cpu"))
        else:
            model = LEARNERS[learner].load(folder / "model.zip", env, device="cpu")
        print(how_it_learns(model))
        finished = learn(model, config, folder, RESULTS[task].score)
        env.close()
        save_whole(model, folder / "model.zip")
        about = {"task": task, "env_id": config.env_id, "env_options": config.env_options}
        export_policy(model, about).save(folder / "policy.npz")
        if not finished:
            print(f"\nStopped after {model.num_timesteps:,} decisions; what was learnt is kept in {folder}.")
            print(f"Go on with:  python train.py {task} --resume {folder}")
            print(f"See it swim: python train.py play {folder / 'policy.npz'}")
            return folder
        try:
            report(folder, task, config, seed, pictures)
        except KeyboardInterrupt:
            print(f"\nStopped while measuring. What was learnt is kept; measure it with: "
                  f"python train.py {task} --resume {folder}")  # fmt: skip
    return folder


def how_it_learns(model: PPO) -> str:
    """One line for the log: which code learns, and why if it is the slower one."""
    if not isinstance(model, FastPPO):
        return "Learning with Stable-Baselines3's own code."
    if model.why_slow:
        return f"Learning with Stable-Baselines3's own code: {model.why_slow}, which the compiled kernels do not know."
    return "Learning with compiled kernels; the first time, compiling them takes some seconds."


@contextmanager
def locked(folder: Path):
    """Keep other programs from training in the folder; RuntimeError if one is at it. Ends when this program does."""
    with (folder / "lock").open("w") as file:
        if fcntl is not None:
            try:
                fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except OSError as error:
                raise RuntimeError(f"another program is training in {folder}; wait for it, or end it first") from error
        yield


def learn(model: PPO, config: TrainConfig, folder: Path, score: str) -> bool:
    """Train to the configured number of timesteps; False if Ctrl-C stopped it first."""
    checkpoint = Checkpoint(folder / "model.zip")
    callbacks = CallbackList([Progress(), LearningCurve(folder / "curve.csv", score), checkpoint])
    left = config.timesteps - model.num_timesteps
    if left <= 0:
        return True
    try:
        model.learn(left, callbacks, reset_num_timesteps=model.num_timesteps == 0, tb_log_name="ppo")
    except KeyboardInterrupt:
        model.num_timesteps = checkpoint.learnt  # what was seen since then was not learnt from
        return False
    return True


def on_body(config: TrainConfig, body: str) -> TrainConfig:
    """The settings of a task on another body; a flat fish has no use for upper and lower muscles.

    Raises:
        ValueError: for an unknown body.
    """
    if body not in BODIES:
        raise ValueError(f"unknown body {body!r}; choose from {', '.join(BODIES)}")
    flat = {"muscle_groups": "pairs"} if make_fish(body).flat else {}
    return replace(config, env_options=config.env_options | {"body": body} | flat)


def _kept(folder: Path, task: str, purpose: str) -> dict:
    """What config.json says of the run of a task in a folder."""
    if not (folder / "model.zip").is_file() or not (folder / "config.json").is_file():
        raise FileNotFoundError(f"{folder} holds no model.zip and config.json to {purpose}; give the folder of a run")
    kept = json.loads((folder / "config.json").read_text())
    if kept["task"] != task:
        raise ValueError(f"{folder} is a run of task {kept['task']!r}, not {task!r}")
    return kept


def _write_config(folder: Path, task: str, config: TrainConfig, seed: int, kept: dict | None, start) -> None:
    commit = provenance("")["commit"]
    if kept is not None and commit not in kept["commit"].split(", "):
        commit = f"{kept['commit']}, {commit}"
    command = f"python train.py {task} --seed {seed} --timesteps {config.timesteps} --num-envs {config.num_envs}"
    if "body" in config.env_options:
        command += f" --body {config.env_options['body']}"
    start = kept.get("start") if kept else start and str(start)
    if start:
        command += f" --start-from {start}"
    record = {
        "task": task,
        "seed": seed,
        "config": asdict(config),
        "command": command,
        "start": start,
        "commit": commit,
        "resumed": 0 if kept is None else kept.get("resumed", 0) + 1,
        "versions": {name: version(name) for name in PACKAGES} | {"python": sys.version.split()[0]},
        "threads": {"torch": torch.get_num_threads(), "processors": os.cpu_count()},
    }
    (folder / "config.json").write_text(json.dumps(record, indent=2) + "\n")
