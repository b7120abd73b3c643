"""Ablations: a task trained with one choice of the training undone at a time.

    python -m benchmarks.learning.ablations                 of LeftAfterRight-v0 (two minutes a choice and seed)
    python -m benchmarks.learning.ablations --task turn     the weight of the overshoot in Turn-v0 (six minutes)

A row of results/ablations_<task>.csv is written as soon as it is known; rows that are there already stay, each with
its commit, so that it can be interrupted and resumed.
"""

import os

os.environ.setdefault("OMP_NUM_THREADS", "1")

import argparse
from contextlib import ExitStack
from dataclasses import replace
from unittest.mock import patch

import numpy as np
import torch
from tqdm import tqdm

from agents import build
from agents.config import CONFIGS, TrainConfig
from benchmarks.common.tables import RESULTS, provenance, read_rows, write_csv
from fish_env.control import EPISODES, evaluate, evaluation_options, make_eval_env, means, policy_controller
from fish_env.envs import FishVectorEnv
from fish_env.tasks import rewards
from fish_env.tasks.turn import TurnTask
from fish_env.tasks.turns import CommandedTurns

COMMAND = "python -m benchmarks.learning.ablations"
BASE = CONFIGS["left_after_right"]


def cosine(axes, heading):
    """Alignment by the cosine, less 1: flat where the heading is nearly right."""
    return (axes[:, 0] * heading).sum(axis=1) - 1.0


def fine(options: dict) -> dict:
    """The same episodes with the fish's own control interval, 20 ms."""
    changed = {name: value for name, value in options.items() if name != "control_interval"}
    return changed | {"max_episode_steps": 2 * options["max_episode_steps"]}


FINE = {"env_options": fine(BASE.env_options), "training_options": fine(BASE.training_options)}
PAIRS = {"env_options": BASE.env_options | {"muscle_groups": "pairs"}}
LEFT_AFTER_RIGHT: dict[str, tuple[dict, list]] = {
    "none undone": ({}, []),
    "a policy that is not symmetric": ({"symmetric": False}, []),
    "decisions every 20 ms, as many": (FINE, []),
    "decisions every 20 ms, twice as many": (FINE | {"timesteps": 2_000_000}, []),
    "noise on every muscle alone": ({}, [patch.object(build, "synergies", lambda env: np.eye(12)),
                                         patch("agents.synergy.synergies", lambda env: np.eye(12))]),
    "upper and lower muscles as one": (PAIRS, []),
    "without seeing the vertical": ({}, [patch("fish_env.envs.layout.TYPICAL_TILT", 1e9)]),
    "alignment weighed 1 instead of 5": ({}, [patch.object(CommandedTurns, "alignment_weight", 1.0)]),
    "alignment by its cosine": ({}, [patch.object(rewards, "alignment", cosine)]),
    "whole episodes, commands as in the task": ({"training_options": {}}, []),
    "all episodes beginning together": ({}, [patch.object(FishVectorEnv, "stagger", lambda self: None)]),
}  # fmt: skip


def weighted(weight: float) -> tuple[dict, list]:
    """Turn-v0 with another weight of the overshoot."""
    return {}, [patch.object(TurnTask, "overshoot_weight", weight)]


TURN: dict[str, tuple[dict, list]] = {
    "overshoot weighed 10 instead of 60": weighted(10.0),
    "overshoot weighed 100": weighted(100.0),
    "overshoot weighed 30": weighted(30.0),
    "overshoot not paid for": weighted(0.0),
}
"""With none undone, `learning/turn_seeds.csv` has it."""
CHOICES = {"left_after_right": (LEFT_AFTER_RIGHT, 1_000_000), "turn": (TURN, CONFIGS["turn"].timesteps)}
"""Fields of `TrainConfig` and patches that undo a choice, and for how many environment steps the task is trained."""


def learn(config: TrainConfig, seed: int) -> dict[str, float]:
    """Train and measure."""
    env = build.make_env(config, config.num_envs, seed)
    model = build.make_model(config, env, seed)
    model.learn(config.timesteps)
    policy = build.export_policy(model, {"env_options": config.env_options})
    env = make_eval_env(config.env_id, EPISODES, evaluation_options(config.env_options))
    return means(evaluate(policy_controller(policy, env), env))


def main() -> None:
    """Every choice that is not in the file yet."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--task", choices=CHOICES, default="left_after_right")
    parser.add_argument("--seeds", type=int, default=2, help="seeds a choice (default 2)")
    parser.add_argument("--fresh", action="store_true", help="begin with an empty table")
    arguments = parser.parse_args()
    torch.set_num_threads(1)
    choices, steps = CHOICES[arguments.task]
    path = RESULTS / f"ablations_{arguments.task}.csv"
    rows = read_rows(path) if path.exists() and not arguments.fresh else []
    done = {(row["choice"], int(row["seed"])) for row in rows}
    todo = [(name, seed) for seed in range(arguments.seeds) for name in choices if (name, seed) not in done]
    for name, seed in tqdm(todo, unit=" runs"):
        fields, patches = choices[name]
        with ExitStack() as stack:
            for change in patches:
                stack.enter_context(change)
            found = learn(replace(CONFIGS[arguments.task], **({"timesteps": steps} | fields)), seed)
        metrics = ("success", "latency", "overshoot", "heading_error", "radius", "speed")
        about = {"choice": name, "seed": seed, "commit": provenance("")["commit"]}
        rows.append(about | {metric: found[metric] for metric in metrics})
        write_csv(path.name, rows, f"{COMMAND} --task {arguments.task} --seeds {arguments.seeds}")
        tqdm.write(str(rows[-1]))


if __name__ == "__main__":
    main()
