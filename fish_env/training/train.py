"""One training run: a folder with its settings, a model that is trained, and a report of the trained policy."""

import json
import os
import shlex
import sys
import tempfile
from collections.abc import Callable, Mapping
from contextlib import closing
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

import torch
from stable_baselines3 import PPO
from stable_baselines3.common.callbacks import CallbackList

from fish_env.checks import is_whole
from fish_env.control.files import writable_folder, write_text
from fish_env.training.build import export_policy, make_env, make_model, start_from
from fish_env.training.callbacks import Checkpoint, EndsIf, LearningCurve, Progress, check_finite, save_model
from fish_env.training.checkout import present_commit
from fish_env.training.config import (
    FINE_TUNING,
    PARENT,
    SCORES,
    TrainConfig,
    change_simulation,
    check_settings,
    settings_of,
    usual_settings,
)
from fish_env.training.report import report
from fish_env.training.run_folder import check_installed, lock_folder, new_folder
from fish_env.training.saved_run import (
    append_version,
    read_curve,
    read_record,
    restore,
    versions,
    warn_of_other_versions,
)

SEEDS = 2**32  # numpy's and Stable-Baselines3's are below
MOST_THREADS = 1024
ELSEWHERE = (os.environ.get("TMPDIR", "/tmp"), os.path.expanduser("~"), os.getcwd(), "/var/tmp", "/dev/shm")
"""Folders that may take a model that its own does not."""


@dataclass(frozen=True)
class Request:
    """Arguments of `train`."""

    task: str
    """A key of `CONFIGS`, or the id of another registered environment of fish."""
    seed: int | None = None
    """Seed of the learner; fish i starts from seed + i. None is 0, or the seed of the run that is resumed."""
    root: Path = Path("runs")
    """Folder in which the folder of the run is created."""
    folder: Path | None = None
    """Folder to save the run in, instead of a new one under `root`."""
    resume: Path | None = None
    """The folder of an earlier run to resume, until its number of timesteps (or the one given) is reached."""
    start: Path | None = None
    """The folder of a trained run of the task to start from, on whatever body; learning rate, noise and number of
    timesteps are those of a new run."""
    body: str | None = None
    """A key of `fish_env.BODIES` to train on; None takes the task's."""
    integrator: str | None = None
    """A key of `fish_env.INTEGRATORS` to train with; None takes the body's own."""
    dt: float | None = None
    """Step of the integrator, s; None takes its default step on that body."""
    env_options: Mapping[str, Any] = field(default_factory=dict)
    """Keywords of the environment, in training and in evaluations, beside the task's or instead of them."""
    pictures: bool = True
    """Write the page of the run and print the table with the baselines; else only evaluate the policy."""
    changes: Mapping[str, Any] = field(default_factory=dict)
    """Fields of `TrainConfig` to use instead of the task's; None is ignored."""
    torch_threads: int | None = None
    """Threads of the updates; None leaves torch as it is."""
    stopped: Callable[[], bool] = bool
    """Returns True to stop as by Ctrl-C: where C calls Python, an exception may be lost."""


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
        if not 1 <= request.torch_threads <= MOST_THREADS:
            raise ValueError(f"torch_threads is {request.torch_threads}; give 1 to {MOST_THREADS}")
        torch.set_num_threads(request.torch_threads)
    task, resumed = request.task, None
    if request.resume is not None:
        resumed = _saved_run(Path(request.resume), task, "resume")
    config, seed = _settings(request, resumed)
    start = None if request.start is None else _start(Path(request.start), task)
    with closing(make_env(config, config.num_envs, seed)) as env, lock_folder(_folder(request)) as folder:
        model = _model(request, config, seed, env, folder, start)
        read_curve(folder / "curve.csv")
        if resumed is not None:
            warn_of_other_versions(resumed)
        _write_config(folder, request, config, seed, resumed)
        finished = learn(model, config, folder, SCORES.get(task, "return"), request.stopped)
        about = {"task": task, "env_id": config.env_id, "env_options": config.env_options}
        try:
            _save(model, folder, about)
        except KeyboardInterrupt:  # it came just then, and the command line hears no second one
            _save(model, folder, about)
            finished = False
        if not finished:
            print(f"\nStopped after {model.num_timesteps:,} environment steps; the model is saved in {folder}.")
            print(f"Resume:   fish_env train {task} --resume {folder}")
            print(f"Watch it: fish_env play {folder}")
            raise Stopped
        try:
            report(folder, config, request.pictures)
        except KeyboardInterrupt:
            print(f"\nStopped while evaluating. The model is saved; evaluate it with: "
                  f"fish_env train {task} --resume {folder}")  # fmt: skip
            raise Stopped from None
    return folder


def _save(model: PPO, folder: Path, about: dict) -> None:
    """Save the model and its policy, each whole or not at all; RuntimeError, saying where they are, if not in folder.

    If the disk does not take them, a person is asked for another place, or to try again; without one, or after the end
    of the input, they go to the first of ELSEWHERE that takes them.
    """
    check_finite(model)  # before any file is replaced
    place, others = folder, iter(ELSEWHERE)
    person = sys.stdin is not None and sys.stdin.isatty()
    while True:
        try:
            if place != folder:
                place = Path(tempfile.mkdtemp(prefix="fish_env-", dir=writable_folder(place)))  # replaces no other run
            save_model(model, place / "model.zip")
            export_policy(model, about).save(place / "policy.npz")
            break
        except (OSError, ValueError) as error:
            reason = error.strerror or error if isinstance(error, OSError) else error
        failed = f"the model after {model.num_timesteps:,} environment steps could not be saved in {place} ({reason})"
        try:
            answer = input(f"{failed}. Free some space and press Enter, or name another folder: ") if person else None
        except EOFError:
            answer, person = None, False
        place = folder if answer == "" else Path(next(others, "") if answer is None else answer)
        if answer is None and place == Path():
            raise RuntimeError(f"{failed}, nor elsewhere; free some space there and resume, or train again")
    if place != folder:
        raise RuntimeError(
            f"{folder} did not take the model after {model.num_timesteps:,} environment steps; its files "
            f"are saved in {place}: free some space, copy them to {folder} and resume"
        )


def _settings(request: Request, resumed: dict | None) -> tuple[TrainConfig, int]:
    """Settings and seed of the requested run, after a check; `resumed` is the config.json of a saved run."""
    task, changes = request.task, {name: value for name, value in request.changes.items() if value is not None}
    known = [name for name in vars(TrainConfig("")) if name != "env_id"]
    for name in changes:
        if name not in known:
            raise ValueError(f"unknown setting {name!r}; choose from {', '.join(known)}")
    if resumed is None:
        usual = usual_settings(task)
        given = {} if request.start is None else FINE_TUNING
        options = {**usual.env_options, **request.env_options}
        denser = {name: value for name, value in usual.training_options.items() if name not in request.env_options}
        config = replace(usual, **{"env_options": options, "training_options": denser} | given | changes)
        check_settings(config)
        asked = {"body": request.body, "integrator": request.integrator, "dt": request.dt}
        chosen = {name: config.env_options.get(name) if value is None else value for name, value in asked.items()}
        config = change_simulation(config, **chosen)
        seed = 0 if request.seed is None else request.seed
    else:
        if request.env_options or any(
            each is not None for each in (request.body, request.integrator, request.dt, request.start)
        ):
            raise ValueError(
                "a run that is resumed has its environment and its starting point already; leave --env-kwargs, "
                "--body, --integrator, --dt and --start-from out"
            )
        config, seed = replace(settings_of(resumed["config"]), **changes), resumed["seed"]
        if request.seed not in (None, seed):
            raise ValueError(f"the run was begun with --seed {seed}, not {request.seed}; leave --seed out to resume it")
    if not is_whole(seed) or not 0 <= seed < SEEDS:
        raise ValueError(f"seed is {seed!r}; give a whole number, at least 0 and below {SEEDS}")
    check_settings(config)
    return config, seed


def _folder(request: Request) -> Path:
    """The folder of the run, made if it is missing; ValueError if it holds another run or cannot be written to."""
    if request.resume is not None:
        return writable_folder(Path(request.resume))
    if request.folder is None:
        return new_folder(Path(request.root), request.task)
    folder = Path(request.folder)
    if os.path.lexists(folder / "model.zip"):
        raise ValueError(f"{folder} holds a run; resume it with: fish_env train {request.task} --resume {folder}")
    return writable_folder(folder)


def _model(request: Request, config: TrainConfig, seed: int, env, folder: Path, start: PPO | None) -> PPO:
    """The learner: a fresh one, one that starts from that of another run, or that of the run to resume."""
    model = make_model(config, env, seed, folder / "tensorboard")
    if start is not None:
        start_from(model, start)
    if request.resume is not None:
        restore(model, folder / "model.zip")
        if request.changes.get("timesteps") and model.num_timesteps > config.timesteps:
            raise ValueError(
                f"{folder} was trained for {model.num_timesteps:,} environment steps already; give --timesteps of at "
                "least as many"
            )
    return model


def learn(model: PPO, config: TrainConfig, folder: Path, score: str, stopped: Callable[[], bool]) -> bool:
    """Train to the configured number of timesteps; False if Ctrl-C, `stopped` or a full disk stopped it first."""
    checkpoint = Checkpoint(folder / "model.zip")
    callbacks = [Progress(score), LearningCurve(folder / "curve.csv", score), checkpoint, EndsIf(stopped)]
    if os.environ.get(PARENT, "").isdigit():  # `train.py all`, which may be killed
        callbacks.append(EndsIf(lambda: os.getppid() != int(os.environ[PARENT])))
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


def _saved_run(folder: Path, task: str, purpose: str) -> dict:
    """The content of config.json of the run of a task in a folder."""
    if not (folder / "model.zip").is_file() or not (folder / "config.json").is_file():
        raise FileNotFoundError(f"{folder} holds no model.zip and config.json to {purpose}; give the folder of a run")
    saved = read_record(folder / "config.json")
    if saved["task"] != task:
        raise ValueError(f"{folder} is a run of task {saved['task']!r}, not {task!r}")
    return saved


def _start(folder: Path, task: str) -> PPO:
    """The learner of the trained run of a task in a folder, to start another one from."""
    config = settings_of(_saved_run(folder, task, "start from")["config"])
    with closing(make_env(config, 2, 0)) as env:
        return restore(make_model(config, env, 0), folder / "model.zip")


def _write_config(folder: Path, request: Request, config: TrainConfig, seed: int, resumed: dict | None) -> None:
    """Write config.json: task, seed, settings, command, commit and versions, with those of the run that is resumed."""
    before = resumed or {"resumed": -1, "commit": None, "versions": {}, "start": request.start and str(request.start)}
    chosen = {"seed": seed, "timesteps": config.timesteps, "num-envs": config.num_envs}
    chosen |= {name: config.env_options[name] for name in ("body", "integrator", "dt") if name in config.env_options}
    chosen |= {"start-from": before["start"]} if before["start"] else {}
    options = " ".join(f"--{name} {value}" for name, value in chosen.items()) + _changes(request.task, config, before)
    record = {
        "task": request.task,
        "seed": seed,
        "config": asdict(config),
        "command": f"fish_env train {request.task} {options}",
        "start": before["start"],
        "commit": append_version(before["commit"], present_commit()),
        "resumed": before["resumed"] + 1,
        "versions": {name: append_version(before["versions"].get(name), now) for name, now in versions().items()},
        "threads": {"torch": torch.get_num_threads(), "processors": os.cpu_count()},
    }
    write_text(folder / "config.json", json.dumps(record, indent=2) + "\n")


def _changes(task: str, config: TrainConfig, record: dict) -> str:
    """The options of the command line for the settings that are not the usual ones of the task."""
    simulation = [config.env_options.get(name) for name in ("body", "integrator", "dt")]
    usual = vars(change_simulation(usual_settings(task), *simulation)) | (FINE_TUNING if record["start"] else {})
    apart = ("env_options", "training_options", "timesteps", "num_envs")
    settings = {name: value for name, value in vars(config).items() if name not in apart and value != usual[name]}
    same = usual["env_options"]
    keywords = {n: value for n, value in config.env_options.items() if n not in same or value != same[n]}
    text = ""
    for option, changed in (("env-kwargs", keywords), ("hyperparameters", settings)):
        words = [shlex.quote(f"{name}={json.dumps(value)}") for name, value in changed.items()]
        text += f" --{option} {' '.join(words)}" if words else ""
    return text
