"""Training settings of each task, saved with every run, and what a training can be asked for."""

import math
import shlex
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, fields, replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import gymnasium as gym

from fish_env.bodies import make_fish
from fish_env.checks import fits_memory, is_whole, real


@dataclass(frozen=True)
class TrainConfig:
    """Environment and PPO settings of one task."""

    env_id: str
    env_options: dict[str, Any] = field(default_factory=dict)
    """Keywords of the environment."""
    training_options: dict[str, Any] = field(default_factory=dict)
    """Keywords that differ in training: more of the trained behaviour in every second, or other weights."""
    timesteps: int = 2_000_000
    """Environment steps to train for, all fish together."""
    num_envs: int = 256
    """Fish trained side by side."""
    rollout: int = 32
    """Environment steps of each fish between two updates."""
    batch_size: int = 2048
    epochs: int = 5
    learning_rate: float = 1e-3
    """At the start; it falls linearly to a tenth."""
    horizon: float = 1.0
    """Time over which rewards are discounted by 1/e, s: the discount of a step is exp(-control interval / horizon)."""
    gae_lambda: float = 0.95
    clip_range: float = 0.2
    entropy_weight: float = 0.0
    initial_log_std: float = -0.5
    hidden: tuple[int, ...] = (64, 64)
    twist: bool = True
    """False commands the upper and the lower muscle of a pair alike: a fish that starts level stays level."""
    symmetric: bool = True
    """True for a policy that is equivariant under the left-right reflection (`fish_env/control/equivariant.py`)."""

    def discount(self, control_interval: float) -> float:
        """The discount factor for environment steps of `control_interval` seconds."""
        return math.exp(-control_interval / self.horizon)


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
    """The folder of a trained run of the task to start from, on whatever body; learning rate and number of timesteps
    are those of a new run."""
    env_options: Mapping[str, Any] = field(default_factory=dict)
    """Keywords of the environment, in training and in evaluations, beside the task's or instead of them. On a flat
    body the upper and the lower muscle of a pair contract together, unless `muscle_groups` is given."""
    changes: Mapping[str, Any] = field(default_factory=dict)
    """Fields of `TrainConfig` to use instead of the task's."""
    pictures: bool = True
    """Write the page of the run and print the table with the baselines; else only evaluate the policy."""
    torch_threads: int | None = None
    """Threads of the updates; None leaves torch as it is."""
    stopped: Callable[[], bool] = bool
    """Returns True to stop as by Ctrl-C: where C calls Python, an exception may be lost."""
    module: str = ""
    """The module of a user that has registered the task, for commands that are printed."""

    def training(self, *options: object) -> str:
        """The command that trains the task with these options."""
        return shlex.join(map(str, ("fish_env", "train", self.module + ":" * bool(self.module) + self.task, *options)))

    def watching(self, folder: Path) -> str:
        """The command that plays the policy of a run."""
        imported = ("--task-module", self.module) if self.module else ()
        return shlex.join(map(str, ("fish_env", "play", folder, *imported)))


RESERVED_OPTIONS = {"self", "id", "task", "num_envs", "seed", "monitor", "staggered", "autoreset_mode", "render_mode"}
"""Keywords of environments that a training or an evaluation sets itself."""

SEEDS = 2**32  # numpy's and Stable-Baselines3's are below
MAX_COUNT = 2**53  # of any count: more are not told apart as floats, which logs hold
MAX_LAYERS = 100
SAMPLE, WEIGHT = 1024, 64  # bytes, about: a step of a fish in the buffer; a weight with what Adam keeps of it

DENSER = {"max_episode_steps": 150, "wait": (0.3, 1.0)}
"""Sooner turns in shorter episodes: more turns in every second. Alignment counts more: the largest return is slow."""
TURNS = {"timesteps": 6_000_000, "horizon": 2.0, "twist": False}
"""Muscles that may twist the fish let it learn to lie on its side, where no beat of the tail turns it."""

CONFIGS: dict[str, TrainConfig] = {
    "swim": TrainConfig("FishEnv/Swim-v0", hidden=(32, 32)),
    "turn": TrainConfig("FishEnv/Turn-v0", {}, DENSER | {"alignment_weight": 20.0}, **TURNS),
    "left_after_right": TrainConfig("FishEnv/LeftAfterRight-v0", {}, DENSER | {"alignment_weight": 10.0}, **TURNS),
    "target": TrainConfig("FishEnv/Target-v0", {}, {"patience": 3.0}, timesteps=6_000_000),
    "target_3d": TrainConfig("FishEnv/Target3D-v0", {}, {"patience": 3.0}, timesteps=8_000_000),
    "avoid": TrainConfig("FishEnv/Avoid-v0", {}, {"alignment_weight": 5.0}, timesteps=6_000_000),
    "fast_start": TrainConfig("FishEnv/FastStart-v0", timesteps=6_000_000, horizon=2.0),
}
"""A task of the package, or one of its forms, by its name in the command line."""

SCORES = {
    "swim": "speed", "turn": "success", "left_after_right": "success", "target": "targets", "target_3d": "success",
    "avoid": "success", "fast_start": "escape_distance",
}  # fmt: skip
"""The metric that ranks the seeds of a task; more is better. Other environments have "return"."""

PARENT = "FISH_ENV_TRAIN_ALL"
"""The environment variable by which runs know the program that began them: they end when it is gone."""

FINE_TUNING = {"timesteps": 98_304, "num_envs": 64, "rollout": 16, "batch_size": 512, "learning_rate": 2e-3}
"""Settings that differ when a policy starts from a trained one: 96 small updates at a high rate, not twelve large ones.
For a policy on another body."""


def settings_for(request: Request, resumed: Mapping[str, Any] | None = None) -> tuple[TrainConfig, int]:
    """Settings and seed of the requested run; `resumed` is config.json of the run that is to be resumed.

    ValueError for an unknown task or body, or a setting that is unknown or not allowed.
    """
    known = [each.name for each in fields(TrainConfig) if each.name != "env_id"]
    for name in request.changes:
        if name not in known:
            raise ValueError(f"unknown setting {name!r}; choose from {', '.join(known)}")
    if "initial_log_std" in request.changes and (request.start or request.resume):
        raise ValueError("the noise of a trained policy goes on; initial_log_std is for a new one")
    if resumed is None:
        usual, seed = usual_settings(request.task), 0 if request.seed is None else request.seed
        denser = {name: value for name, value in usual.training_options.items() if name not in request.env_options}
        options, tuned = {**usual.env_options, **request.env_options}, {} if request.start is None else FINE_TUNING
        given: dict[str, Any] = {"env_options": options, "training_options": denser, **tuned, **request.changes}
        config = replace(usual, **given)
    else:
        if request.env_options or request.start is not None:
            raise ValueError(
                "a run that is resumed has its environment and its starting point already; leave --env-kwargs, "
                "--body, --integrator, --dt and --start-from out"
            )
        config, seed = replace(settings_of(resumed["config"]), **request.changes), resumed["seed"]
        if request.seed not in (None, seed):
            raise ValueError(f"the run was begun with --seed {seed}, not {request.seed}; leave --seed out to resume it")
    if not is_whole(seed) or not 0 <= seed < SEEDS:
        raise ValueError(f"seed is {seed!r}; give a whole number, at least 0 and below {SEEDS}")
    check_settings(config)
    body = config.env_options.get("body")
    if resumed is None and body is not None and make_fish(body).flat:
        config = replace(config, env_options={"muscle_groups": "pairs"} | config.env_options)
    return config, seed


def usual_settings(task: str) -> TrainConfig:
    """The settings of a key of `CONFIGS`, or the usual ones for another registered environment; else ValueError."""
    if task not in CONFIGS and task not in gym.registry:
        raise ValueError(
            f"unknown task {task!r}; choose from {', '.join(CONFIGS)}, or give the id of an environment of yours, with "
            "--task-module and the module that registers it"
        )
    return CONFIGS.get(task, TrainConfig(task))


def settings_of(record: dict[str, Any]) -> TrainConfig:
    """The settings in `config.json` of a run; ValueError if they are of another version or kind, or not allowed."""
    values: dict[str, Any] = {name: as_tuples(value) for name, value in record.items()}
    try:
        config = TrainConfig(**values)
    except TypeError as error:
        raise ValueError(f"the settings are not those of this version ({error!s:.200}); train again") from error
    check_settings(config)
    return config


def check_settings(config: TrainConfig) -> None:
    """Raise ValueError for a setting of another kind or out of its range, or for more than memory holds."""
    for name, usual in vars(TrainConfig("")).items():
        value = getattr(config, name)
        if isinstance(usual, float):
            fits, wanted = abs(real(value)) < math.inf, "a finite number"
        elif isinstance(usual, tuple):
            counts = isinstance(value, tuple) and 1 <= len(value) <= MAX_LAYERS
            fits, wanted = counts and all(is_whole(each) and 1 <= each <= MAX_COUNT for each in value), "whole numbers"
        elif type(usual) is int:
            fits = is_whole(value) and 1 <= value <= MAX_COUNT
            wanted = f"a whole number, at least 1 and at most {MAX_COUNT}"
        else:
            fits, wanted = isinstance(value, type(usual)), f"a {type(usual).__name__}"
        if not fits:
            raise ValueError(f"{name} is {value!r:.100}; give {wanted}")
    samples = config.num_envs * config.rollout
    if min(config.batch_size, samples) < 2:
        raise ValueError("batch_size, or num_envs times rollout, is 1; give more, whose advantages can be normalised")
    if config.horizon <= 0:
        raise ValueError(f"horizon is {config.horizon!r}; give a positive number")
    check_options(config.env_options | config.training_options)
    fits_memory(samples, SAMPLE, "num_envs times rollout")
    weights = sum(a * b for a, b in pairwise((256, *config.hidden, 256)))
    fits_memory(weights, WEIGHT, f"the number of weights of layers of {config.hidden!r:.100}")


def check_options(options: Mapping[str, Any]) -> None:
    """Raise ValueError for keywords of an environment that a training or an evaluation sets itself."""
    if given := sorted(RESERVED_OPTIONS & options.keys()):
        raise ValueError(f"{', '.join(given)} cannot be options of the environment here; leave them out")


def as_tuples(value):
    """Lists as tuples, also inside of dicts: as they were before they became JSON."""
    if isinstance(value, dict):
        return {name: as_tuples(inner) for name, inner in value.items()}
    return tuple(map(as_tuples, value)) if isinstance(value, list) else value
