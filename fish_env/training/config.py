"""Training settings of each task: one typed record for each, saved with every run."""

import math
from dataclasses import dataclass, field, replace
from itertools import pairwise
from typing import Any

import gymnasium as gym

from fish_env.bodies import make_fish
from fish_env.checks import fits_memory, is_whole, real
from fish_env.control.environments import environment_of
from fish_env.physics.tank_options import check_scene, method_for, whole_steps


@dataclass(frozen=True)
class TrainConfig:
    """Environment and PPO settings of one task."""

    env_id: str
    env_options: dict[str, Any] = field(default_factory=dict)
    """Keywords of the environment."""
    training_options: dict[str, Any] = field(default_factory=dict)
    """Keywords that differ in training: more of the trained behaviour in every second."""
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
    symmetric: bool = True
    """True for a policy that is equivariant under the left-right reflection (`fish_env/control/equivariant.py`)."""

    def discount(self, control_interval: float) -> float:
        """The discount factor for environment steps of `control_interval` seconds."""
        return math.exp(-control_interval / self.horizon)


GIVEN = {"self", "id", "task", "num_envs", "seed", "monitor", "staggered", "autoreset_mode", "render_mode"}
"""Keywords of environments that a training or an evaluation sets itself."""

MOST = 2**53  # of any count: more are not told apart as floats, which logs hold
LAYERS = 100
SAMPLE, WEIGHT = 1024, 64  # bytes, about: a step of a fish in the buffer; a weight with what Adam keeps of it


def settings_of(record: dict[str, Any]) -> TrainConfig:
    """The settings that `config.json` of a run holds, as JSON gave them back.

    Raises:
        ValueError: if they are of another version of this program, of another kind, or not allowed.
    """
    try:
        lists: dict[str, Any] = {name: as_tuples(value) for name, value in record.items()}
        config = TrainConfig(**lists)
    except TypeError as error:
        raise ValueError(
            f"the settings {sorted(record)!s:.400} are not those of this version ({error!s:.200}); train again"
        ) from error
    check_settings(config)
    return config


def check_settings(config: TrainConfig) -> None:
    """Raise ValueError for a setting of another kind or out of its range, or for more than memory holds."""
    for name, usual in vars(TrainConfig("")).items():
        value = getattr(config, name)
        if isinstance(usual, float):
            fits, wanted = abs(real(value)) < math.inf, "a finite number"
        elif isinstance(usual, tuple) or type(usual) is int:
            numbers = value if isinstance(usual, tuple) else (value,)
            counts = isinstance(numbers, tuple) and all(is_whole(each) and 1 <= each <= MOST for each in numbers)
            fits = counts and 1 <= len(numbers) <= LAYERS
            several = "a list of whole numbers" if isinstance(usual, tuple) else "a whole number"
            wanted = f"{several}, at least 1 and at most {MOST}"
        else:
            fits, wanted = isinstance(value, type(usual)), f"a {type(usual).__name__}"
        if not fits:
            raise ValueError(f"{name} is {value!r:.100}; give {wanted}")
    samples = config.num_envs * config.rollout
    if min(config.batch_size, samples) < 2:
        raise ValueError("batch_size, or num_envs times rollout, is 1; give more, whose advantages can be normalised")
    if config.horizon <= 0:
        raise ValueError(f"horizon is {config.horizon!r}; give a positive number")
    given = sorted(GIVEN & (config.env_options.keys() | config.training_options.keys()))
    if given:
        raise ValueError(f"{', '.join(given)} cannot be options of the environment here; leave them out")
    fits_memory(samples, SAMPLE, "num_envs times rollout")
    weights = sum(a * b for a, b in pairwise((256, *config.hidden, 256)))
    fits_memory(weights, WEIGHT, f"the number of weights of layers of {config.hidden!r:.100}")


def as_tuples(value):
    """Lists as tuples, also inside of dicts: as they were before they became JSON."""
    if isinstance(value, dict):
        return {name: as_tuples(inner) for name, inner in value.items()}
    return tuple(map(as_tuples, value)) if isinstance(value, list) else value


def slower(seconds: float) -> dict[str, Any]:
    """Keywords for steps twice as long, in episodes of so many seconds: noise that lasts longer explores more."""
    return {"control_interval": 0.04, "max_episode_steps": round(seconds / 0.04)}


TURNING = {**slower(5.0), "muscle_groups": "pairs"}
"""Upper and lower muscles pull together: with single ones the fish learn to lie on their side, where no beat of the
tail turns them off the heading."""
DENSER = {**slower(3.0), "wait": (0.3, 1.0)}
"""Sooner turns in shorter episodes: more turns in every second."""

CONFIGS: dict[str, TrainConfig] = {
    "swim": TrainConfig("FishEnv/Swim-v0", hidden=(32, 32)),
    "turn": TrainConfig("FishEnv/Turn-v0", TURNING, DENSER, timesteps=4_000_000, horizon=2.0),
    "left_after_right": TrainConfig("FishEnv/LeftAfterRight-v0", TURNING, DENSER, timesteps=6_000_000, horizon=2.0),
    "target": TrainConfig("FishEnv/Target-v0", {}, {"patience": 3.0}, timesteps=6_000_000),
    "target_3d": TrainConfig("FishEnv/Target-v0", {"dimensions": 3}, {"patience": 3.0}, timesteps=8_000_000),
    "avoid": TrainConfig("FishEnv/Avoid-v0", slower(6.0), timesteps=3_500_000),
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
A policy on another body then recovers its performance (`benchmarks/learning/transfer.py` measures it)."""


def usual_settings(task: str) -> TrainConfig:
    """The settings of a key of `CONFIGS`, or the usual ones for the id of another registered environment of fish.

    Raises:
        ValueError: for anything else.
    """
    if task in CONFIGS:
        return CONFIGS[task]
    if task not in gym.registry:
        raise ValueError(
            f"unknown task {task!r}; choose from {', '.join(CONFIGS)}, or give the id of an environment of yours, with "
            "--task-module and the module that registers it"
        )
    env_id, _ = environment_of({"env_id": task})
    return TrainConfig(env_id)


def change_simulation(
    config: TrainConfig, body: str | None = None, integrator: str | None = None, dt: float | None = None
) -> TrainConfig:
    """The settings of a task with another body, another integrator or another step, s; None leaves them.

    On a flat fish the upper and the lower muscle of a pair contract together, unless `muscle_groups` is set.

    Raises:
        ValueError: for an unknown body or integrator, or a step that is not allowed.
    """
    given = {"body": body, "integrator": integrator, "dt": dt}
    chosen: dict[str, Any] = {name: value for name, value in given.items() if value is not None}
    if not chosen:
        return config
    options = config.env_options | chosen
    fish = make_fish(options.get("body", "mass_spring"))
    record, step, _ = method_for(fish, integrator, dt, None)
    check_scene(fish, fish.water, record)
    whole_steps(options.get("control_interval", fish.control_interval), step, "the control interval")
    flat = {"muscle_groups": "pairs"} if body is not None and fish.flat else {}
    return replace(config, env_options=flat | options)
