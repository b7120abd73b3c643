"""Evaluate policies on the fixed seeds beside the controllers without learning: tables, and the report of a run."""

import json
from collections.abc import Mapping
from contextlib import closing, suppress
from pathlib import Path
from typing import Any

from fish_env.bodies.fitted import level_of
from fish_env.control import Controller, Policy, best_gait, gait_controller, load_policy, random_actions, scripted
from fish_env.control.env_spec import make_checked_batch
from fish_env.control.evaluation import EPISODES, FIRST_SEED, environment_for, evaluate
from fish_env.control.files import write_text
from fish_env.control.printing import print_means
from fish_env.control.statistics import summary
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


def measure_policy(
    name: str, policy: Policy, with_baselines: bool, changes: Mapping[str, Any], episodes: int, seed: int = FIRST_SEED
) -> list[dict[str, Any]]:
    """Records for `print_means` of a policy on these seeds, after those of the baselines if `with_baselines`."""
    env_id, options = environment_for(policy, changes)
    about = {"env_id": env_id, "env_options": options, "episodes": episodes, "first_seed": seed}
    with closing(make_checked_batch(env_id, options, episodes)) as env:
        every = (baselines(env) if with_baselines else {}) | {name: policy}
        return [about | {"policy": one, **summary(evaluate(env, act, seed))} for one, act in every.items()]


def report(folder: Path, config: TrainConfig, pictures: bool = True) -> None:
    """Evaluate on fixed seeds and write results.json; with pictures, print the table and write report.html too."""
    policy = load_policy(folder / "policy.npz", config.env_id)
    records = measure_policy("trained policy", policy, pictures, {}, EPISODES)
    rows = {record["policy"]: record["means"] for record in records}
    results = {"episodes": EPISODES, "first_seed": FIRST_SEED, "rows": rows}
    write_text(folder / "results.json", json.dumps(results, indent=2) + "\n")
    if pictures:
        from fish_env.training.report_page import write_report  # loads matplotlib

        print_means(records)
        page = write_report([folder], episodes=EPISODES)
        print(f"\nSaved in {folder}: model.zip, policy.npz, config.json, curve.csv, results.json")
        print(f"Read it:  {page}")
