"""Evaluate policies on the fixed seeds beside the controllers without learning: tables, and the report of a run."""

import json
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path

from fish_env.bodies.fitted import level_of
from fish_env.control import (
    EPISODES,
    FIRST_SEED,
    Controller,
    Policy,
    best_gait,
    evaluate,
    evaluation_options,
    gait_controller,
    load_policy,
    make_eval_env,
    make_policy_env,
    means,
    random_actions,
    scripted,
)
from fish_env.control.files import write_text
from fish_env.control.printing import print_means
from fish_env.envs import FishVectorEnv
from fish_env.training.config import TrainConfig


def baselines(env: FishVectorEnv) -> dict[str, Controller]:
    """The controllers without learning; motor controllers for the tasks that they can do."""
    found: dict[str, Controller] = {
        "random": random_actions(env),
        "best open-loop gait": gait_controller(best_gait(level_of(env.tank.world)), env),
    }
    with suppress(ValueError):  # a task of somebody else's
        found["motor controllers"] = scripted(env)
    return found


def measure_policies(env: FishVectorEnv, policies: dict[str, Policy], beside: bool) -> dict[str, dict]:
    """Means over the evaluation episodes of policies, after those of the baselines if `beside` is True."""
    every = (baselines(env) if beside else {}) | policies
    return {name: means(evaluate(env, policy)) for name, policy in every.items()}


def report(folder: Path, config: TrainConfig, pictures: bool = True) -> None:
    """Evaluate on fixed seeds and write results.json; with pictures, print the table and write report.html too."""
    policies = {"trained policy": load_policy(folder / "policy.npz", config.env_id)}
    env = make_eval_env(config.env_id, EPISODES, evaluation_options(config.env_options))
    rows = measure_policies(env, policies, pictures)
    results = {"episodes": EPISODES, "first_seed": FIRST_SEED, "rows": rows}
    write_text(folder / "results.json", json.dumps(results, indent=2) + "\n")
    if pictures:
        from fish_env.training.run_report import write_report  # loads matplotlib

        print_rows(config.env_id, rows)
        page = write_report([folder], episodes=EPISODES)
        print(f"\nSaved in {folder}: model.zip, policy.npz, config.json, curve.csv, results.json")
        print(f"Read it:  {page}")
        print(f"Watch it: fish_env play {folder}")


def print_rows(env_id: str, rows: dict[str, dict]) -> None:
    """Print the means of every controller over the fixed evaluation episodes."""
    print()
    about = {"episodes": EPISODES, "first_seed": FIRST_SEED}
    print_means(env_id, [{"policy": name, "means": found} | about for name, found in rows.items()])


def compare_with_controllers(policies: Mapping[str, Policy], **changes) -> dict[str, dict]:
    """Evaluate policies on the fixed seeds beside the controllers without learning; print and return the means.

    Args:
        policies: by the names that are printed.
        changes: options of the environments to use instead of those of the training; None is ignored.
    """
    found = {}
    for name, policy in policies.items():
        found[name] = measure_policies(make_policy_env(policy, EPISODES, **changes), {name: policy}, beside=True)
        print_rows(policy.about["env_id"], found[name])
    return found
