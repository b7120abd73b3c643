"""Evaluate policies on the fixed seeds beside the controllers without learning: tables, and the report of a run."""

import json
from pathlib import Path

from agents.config import TrainConfig
from agents.run_report import write_report
from fish_env.__main__ import print_means
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
        print_rows(config.env_id, rows)
        page = write_report([folder], episodes=EPISODES)
        print(f"\nSaved in {folder}: model.zip, policy.npz, config.json, curve.csv, results.json")
        print(f"Read it:  {page}")
        print(f"Watch it: python train.py play {folder / 'policy.npz'}")


def print_rows(env_id: str, rows: dict[str, dict]) -> None:
    """Print the means of every controller over the fixed evaluation episodes."""
    print()
    about = {"episodes": EPISODES, "first_seed": FIRST_SEED}
    print_means(env_id, [{"policy": name, "means": found} | about for name, found in rows.items()])


def compare(paths: list[Path]) -> dict[Path, dict]:
    """Evaluate policy files (or those that are shipped) on the fixed seeds, with the controllers without learning."""
    found = {}
    for path in paths or shipped_policies().values():
        policy = load_policy(path)
        found[path] = measure_policies(make_policy_env(policy, EPISODES), {str(path): policy}, beside=True)
        print_rows(policy.about["env_id"], found[path])
    return found
