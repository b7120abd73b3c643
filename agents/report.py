"""Evaluate policies on the fixed seeds beside the controllers without learning: tables, and the report of a run."""

import json
from pathlib import Path

import numpy as np

from agents.build import export_policy, make_env, make_model
from agents.config import CONFIGS, RESULTS, TrainConfig
from agents.run_report import write_report
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
    policy_controller,
    random_actions,
    scripted,
    shipped_policies,
)
from fish_env.control.files import write_text
from fish_env.envs import FishVectorEnv


def baselines(env: FishVectorEnv) -> dict[str, Controller]:
    """The controllers without learning."""
    return {
        "random": random_actions(env),
        "best open-loop gait": gait_controller(best_gait(), env),
        "motor controllers": scripted(env),
    }


def measure_policies(env: FishVectorEnv, policies: dict[str, Policy], beside: bool) -> dict[str, dict]:
    """Means over the evaluation episodes of policies, after those of the baselines if `beside` is True."""
    controllers = (baselines(env) if beside else {}) | {n: policy_controller(p, env) for n, p in policies.items()}
    return {name: means(evaluate(controller, env)) for name, controller in controllers.items()}


def report(folder: Path, task: str, config: TrainConfig, seed: int, pictures: bool = True) -> None:
    """Evaluate on fixed seeds and write results.json; with pictures, print the table and write report.html too."""
    policies = {"trained policy": load_policy(folder / "policy.npz", config.env_id)}
    if pictures:
        policies = {"untrained policy": untrained_policy(config, seed)} | policies
    env = make_eval_env(config.env_id, EPISODES, evaluation_options(config.env_options))
    rows = measure_policies(env, policies, pictures)
    results = {"episodes": EPISODES, "first_seed": FIRST_SEED, "rows": rows}
    write_text(folder / "results.json", json.dumps(results, indent=2) + "\n")
    if pictures:
        print_table(task, rows)
        page = write_report([folder], episodes=EPISODES)
        print(f"\nSaved in {folder}: model.zip, policy.npz, config.json, curve.csv, results.json")
        print(f"Read it:  {page}")
        print(f"Watch it: python train.py play {folder / 'policy.npz'}")


def untrained_policy(config: TrainConfig, seed: int) -> Policy:
    """The policy before any training."""
    env = make_env(config, 1, seed)
    return export_policy(make_model(config, env, seed), {"env_id": config.env_id, "env_options": config.env_options})


def print_table(task: str, rows: dict[str, dict]) -> None:
    """Print the means of every controller over the fixed evaluation episodes."""
    columns = (*RESULTS[task].metrics, "return", "failed")
    print(f"\n{task}: mean over {EPISODES} episodes (metrics and their units: docs/envs/)")
    widths = [max(12, len(name) + 2) for name in columns]
    print(" " * 20 + "".join(name.rjust(width) for name, width in zip(columns, widths, strict=True)))
    for name, row in rows.items():
        cells = ["-" if row.get(column) is None else f"{row[column]:.3f}" for column in columns]
        print(name.ljust(20) + "".join(cell.rjust(width) for cell, width in zip(cells, widths, strict=True)))
    if task == "swim" and "best open-loop gait" in rows:
        gait, policy = rows["best open-loop gait"], rows["trained policy"]
        own = np.hypot(gait["speed"], gait["sideways"])  # from means, so about
        faster = policy["speed"] / gait["speed"], policy["speed"] / own
        print(f"The policy swims {faster[0]:.2f} times as fast along the heading as the gait, which cannot steer, and "
              f"{faster[1]:.2f} times as fast as the gait along its own line.")  # fmt: skip


def open_policy(path: Path, episodes: int = EPISODES, **changes) -> tuple[str, Policy, FishVectorEnv]:
    """A policy file: its task, the policy, and an environment to evaluate it in; `changes` are options of that."""
    policy = load_policy(path)
    task = policy.about.get("task")
    if not isinstance(task, str) or task not in CONFIGS or policy.about["env_id"] != CONFIGS[task].env_id:
        what = f"task {task!r} in {policy.about['env_id']!r}"
        raise ValueError(f"{path} is for {what}; choose a policy for one of {', '.join(CONFIGS)}")
    return task, policy, make_policy_env(policy, episodes, **changes)


def compare(paths: list[Path]) -> dict[Path, dict]:
    """Evaluate policy files (or those that are shipped) on the fixed seeds, with the controllers without learning."""
    found = {}
    for path in paths or shipped_policies().values():
        task, policy, env = open_policy(path)
        found[path] = measure_policies(env, {"trained policy": policy}, beside=True)
        print_table(task, found[path])
    return found
