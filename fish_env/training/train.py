"""One training run: a folder with its settings, a model that is trained, and a report of the trained policy."""

import json
import os
import tempfile
from contextlib import closing
from dataclasses import asdict
from pathlib import Path
from typing import Any

import torch
from stable_baselines3 import PPO
from stable_baselines3.common.callbacks import CallbackList
from stable_baselines3.common.vec_env import VecEnv

from fish_env.control.equivariant import export_policy
from fish_env.control.files import write_text
from fish_env.training.build import load_model, make_env, make_model, start_from
from fish_env.training.callbacks import Checkpoint, LearningCurve, Progress, StopIf, check_finite, save_model
from fish_env.training.checkout import present_commit
from fish_env.training.config import PARENT, SCORES, Request, TrainConfig, settings_for
from fish_env.training.report import report
from fish_env.training.run_folder import append_version, check_installed, open_folder, read_curve, read_record, versions

MAX_THREADS = 1024
FALLBACK_FOLDERS = (tempfile.gettempdir(), os.path.expanduser("~"), os.getcwd(), "/dev/shm")
"""Folders that may take a model that its own does not."""


class Stopped(KeyboardInterrupt):
    """Ctrl-C, after everything was saved."""


def train(request: Request) -> Path:
    """Train, evaluate and report; returns the folder of the run.

    The request is checked, and the folder is tried, before anything is computed or changed.

    Raises:
        ImportError: if a package that is needed, or this one, is not installed.
        ValueError: for an unknown task or body, a setting that is not allowed, a run to start from that does
            not fit, files of a saved run that cannot be used, a folder that holds a run already, or one that cannot be
            written to.
        FileNotFoundError: if there is nothing to resume or to start from.
        RuntimeError: if another program is training in the folder, or if the trained model cannot be saved.
        Stopped: after Ctrl-C, when the model is saved and it was said how to resume.
    """
    check_installed()
    if request.torch_threads is not None:
        if not 1 <= request.torch_threads <= MAX_THREADS:
            raise ValueError(f"torch_threads is {request.torch_threads}; give 1 to {MAX_THREADS}")
        torch.set_num_threads(request.torch_threads)
    resumed = None if request.resume is None else read_record(request.resume, request.task)
    if request.start is not None:
        read_record(request.start, request.task)
    config, seed = settings_for(request, resumed)
    with closing(make_env(config, config.num_envs, seed)) as env, open_folder(request) as folder:
        model = _model(request, config, seed, env, folder)
        _write_config(folder, request, config, seed, resumed)
        finished = learn(model, config, folder, request)
        about = {"task": request.task, "env_id": config.env_id, "env_options": config.env_options}
        try:
            _save(model, folder, about)
        except KeyboardInterrupt:  # it came just then, and the command line hears no second one
            _save(model, folder, about)
            finished = False
        resume, watch = request.training("--resume", folder), f"Watch it: {request.watching(folder)}"
        if not finished:
            print(f"\nStopped after {model.num_timesteps:,} environment steps; the model is saved in {folder}.")
            print(f"Resume:   {resume}\n{watch}")
            raise Stopped
        try:
            report(folder, config, request.pictures)
        except KeyboardInterrupt:
            print(f"\nStopped while evaluating. The model is saved; evaluate it with: {resume}")
            raise Stopped from None
        if request.pictures:
            print(watch)
    return folder


def _model(request: Request, config: TrainConfig, seed: int, env: VecEnv, folder: Path) -> PPO:
    """The learner: a fresh one, one that starts from that of another run, or that of the run to resume."""
    if request.resume is None:
        model = make_model(config, env, seed, folder)
        if request.start is not None:
            start_from(model, load_model(Path(request.start)))
        return model
    read_curve(folder)
    model = load_model(folder, config, env)
    if request.changes.get("timesteps") and model.num_timesteps > config.timesteps:
        raise ValueError(
            f"{folder} was trained for {model.num_timesteps:,} environment steps already; give --timesteps of at "
            "least as many"
        )
    return model


def learn(model: PPO, config: TrainConfig, folder: Path, request: Request) -> bool:
    """Train to the configured number of timesteps; False if Ctrl-C, `stopped` or a full disk stopped it first."""
    checkpoint, score = Checkpoint(folder / "model.zip", model.num_timesteps), SCORES.get(request.task, "return")
    callbacks = [Progress(score), LearningCurve(folder, score), checkpoint, StopIf(request.stopped)]
    if os.environ.get(PARENT, "").isdigit():  # `train.py all`, which may be killed
        callbacks.append(StopIf(lambda: os.getppid() != int(os.environ[PARENT])))
    left = config.timesteps - model.num_timesteps
    if left <= 0:
        return True
    try:
        model.learn(left, CallbackList(callbacks), reset_num_timesteps=model.num_timesteps == 0, tb_log_name="ppo")
    except (KeyboardInterrupt, OSError) as error:
        model.num_timesteps = checkpoint.trained_steps  # steps since then have not been trained on
        if isinstance(error, OSError):
            print(f"\nThe training stops: {folder} could not be written to ({error.strerror or error}).")
        return False
    return True


def _save(model: PPO, folder: Path, about: dict[str, Any]) -> None:
    """Save the model and its policy, each whole or not at all, in the folder or else in one of `FALLBACK_FOLDERS`.

    ValueError for parameters that are not finite, before any file is replaced; RuntimeError, which says where they are,
    if the folder does not take them.
    """
    check_finite(model)
    reasons = []
    for place in (folder, *map(Path, FALLBACK_FOLDERS)):
        try:
            if place != folder:
                place = Path(tempfile.mkdtemp(prefix="fish_env-", dir=place))  # replaces no other run
            save_model(model, place / "model.zip")
            export_policy(model, about).save(place / "policy.npz")
            break
        except OSError as error:
            reasons.append(error.strerror or str(error))
    else:
        place = None
    if reasons:
        what = f"{folder} did not take the model after {model.num_timesteps:,} environment steps ({reasons[0]})"
        if place is None:
            raise RuntimeError(f"{what}, nor did others; free some space there and resume, or train again")
        raise RuntimeError(f"{what}; its files are saved in {place}: free some space, copy them to {folder} and resume")


def _write_config(folder: Path, request: Request, config: TrainConfig, seed: int, resumed: dict | None) -> None:
    """Write config.json: task, seed, settings, command, commit and versions, with those of the run that is resumed."""
    start, command, now = request.start and str(request.start), _command(request, config, seed), versions()
    before = {"resumed": -1, "commit": None, "versions": {}, "start": start}
    if resumed is not None:
        before, command = resumed, f"{resumed['command']} && {command}"
        last = {name: resumed["versions"].get(name, "unknown").split(", ")[-1] for name in now}
        if changed := [f"{name} {last[name]} (now {now[name]})" for name in now if last[name] != now[name]]:
            print(f"Warning: the run was trained with {', '.join(changed)}. Training continues with the installed "
                  "versions, and its results may differ.")  # fmt: skip
    record = {
        "task": request.task,
        "seed": seed,
        "config": asdict(config),
        "command": command,
        "start": before["start"],
        "commit": append_version(before["commit"], present_commit()),
        "resumed": before["resumed"] + 1,
        "versions": {name: append_version(before["versions"].get(name), one) for name, one in now.items()},
        "threads": {"torch": torch.get_num_threads(), "processors": os.cpu_count()},
    }
    write_text(folder / "config.json", json.dumps(record, indent=2) + "\n")


def _command(request: Request, config: TrainConfig, seed: int) -> str:
    """The command line of a request."""
    options: dict[str, Any] = {"seed": seed, "timesteps": config.timesteps, "num-envs": config.num_envs}
    options |= {"start-from": request.start} if request.start else {}
    options |= {"resume": request.resume} if request.resume else {}
    words = [word for name in options for word in (f"--{name}", options[name])]
    settings = {name: value for name, value in request.changes.items() if name not in ("timesteps", "num_envs")}
    for name, changed in (("env-kwargs", request.env_options), ("hyperparameters", settings)):
        if changed:
            words += [f"--{name}", *(f"{key}={json.dumps(value)}" for key, value in changed.items())]
    return request.training(*words)
