"""What sensing costs, and what policies keep under conditions that they were not trained for.

It trains Swim, Turn and LeftAfterRight with sensors, two seeds each, on all processors, and evaluates them and the
shipped policies, which observe nodes, on the usual seeds and on the held-out protocol (`fish_env.protocols`). Finished
trainings are kept in runs/sensing.
"""

import multiprocessing
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from functools import cache
from itertools import product
from pathlib import Path

import numpy as np
from tqdm import tqdm

from benchmarks.common.charts import BLUE, ORANGE, legend_below, panels, save, words
from benchmarks.common.tables import IMAGES, publish, read_table, select
from fish_env import protocols
from fish_env.control.evaluation import evaluate, make_policy_env, means
from fish_env.control.policy import Policy, load_policy
from fish_env.physics.tank_options import available_processors
from fish_env.training.build import export_policy, make_env, make_model
from fish_env.training.config import CONFIGS

TASKS, SEEDS, RUNS = ("swim", "turn", "left_after_right"), (0, 1), Path("runs", "sensing")
SENSING = {
    "sensors": {"observation": "sensors"},
    "sensors and history": {"observation": "sensors", "history": 1},
    "the same, robust": {"observation": "sensors", "history": 1},
}
"""Keywords of the environment; the last is trained under noise, delays and variation (`protocols.TRAINING`)."""
ROBUST = "the same, robust"


def policy_file(seed: int, task: str, sensing: str) -> Path:
    """Where a trained policy is kept."""
    return RUNS / f"{task}, {sensing}, {seed}.npz"


def train(seed: int, task: str, sensing: str) -> None:
    """Train a policy with the settings of its task, and keep it."""
    import torch

    torch.set_num_threads(1)
    config = CONFIGS[task]
    options = config.env_options | SENSING[sensing]
    if sensing == ROBUST:
        options = protocols.robust_options(config.env_id, **options)
    config = replace(config, env_options=options)
    env = make_env(config, config.num_envs, seed)
    model = make_model(config, env, seed)
    model.learn(config.timesteps)
    export_policy(model, {"env_id": config.env_id, "env_options": options}).save(policy_file(seed, task, sensing))


@cache
def trained(task: str) -> dict[str, list[Policy]]:
    """The policies of a task by their sensing, one a seed; all that are missing are trained first, a process each."""
    RUNS.mkdir(parents=True, exist_ok=True)
    missing = [job for job in product(SEEDS, reversed(TASKS), SENSING) if not policy_file(*job).exists()]
    with ProcessPoolExecutor(available_processors(), multiprocessing.get_context("spawn")) as pool:
        list(tqdm(pool.map(train, *zip(*missing, strict=True)), total=len(missing), unit="policy"))
    return {sensing: [load_policy(policy_file(seed, task, sensing)) for seed in SEEDS] for sensing in SENSING}


def score(policy: Policy, task: str) -> float:
    """A policy's score on the usual seeds, without the noise and so on of its training."""
    nominal = protocols.condition_options(policy, dict(policy.about["env_options"]), protocols.HELD_OUT[0])
    env = make_policy_env(policy, **nominal)
    found = means(evaluate(env, policy))[protocols.SCORES[task]]
    env.close()
    assert found is not None  # speeds and successes are always defined
    return found


def sensing_rows() -> list[dict]:
    """A row for each task and sensing, on the usual seeds."""
    rows = []
    for task in TASKS:
        shipped = load_policy(task)
        nodes = score(shipped, task)
        for sensing, policies in {"nodes, shipped": [shipped], **trained(task)}.items():
            scores = [score(policy, task) for policy in policies]
            mean = float(np.mean(scores))
            about = {"task": task, "sensing": sensing, "metric": protocols.SCORES[task], "seeds": len(policies)}
            numbers = {"score": mean, "lowest": min(scores), "of nodes": mean / nodes}
            rows.append(about | {name: round(value, 4) for name, value in numbers.items()})
    return rows


def held_out_rows() -> list[dict]:
    """A row for each task, way of training and held-out condition."""
    rows = []
    for task in TASKS:
        for name, policies in (("shipped", [load_policy(task)]), (ROBUST, trained(task)[ROBUST])):
            tables = [protocols.evaluate_held_out(policy) for policy in policies]
            for same in zip(*tables, strict=True):
                numbers = {key: [row[key] for row in same] for key in ("value", "share", "failed")}
                means_of = {key: round(float(np.mean(values)), 4) for key, values in numbers.items()}
                rows.append({"task": task, "policy": name, "condition": same[0]["condition"]} | means_of)
    return rows


def draw() -> None:
    """Draw the held-out scores, over that of the shipped policy under no change."""
    figure, axes = panels(len(TASKS), 6.4, sharey=True)
    for axis, task in zip(axes, TASKS, strict=True):
        rows = read_table("learning/held_out.csv", task=task)
        (whole,) = select(rows, policy="shipped", condition="as built")
        for name, colour, shift in (("shipped", BLUE, -0.2), (ROBUST, ORANGE, 0.2)):
            mine = select(rows, policy=name)
            label = "trained without" if name == "shipped" else "trained with noise, delays and variation"
            scores = [row["value"] / whole["value"] for row in mine]
            axis.barh(np.arange(len(mine)) + shift, scores, 0.38, color=colour, label=label)
        axis.set_yticks(range(len(mine)), [words(row["condition"]) for row in mine])
        axis.axvline(0.9, color="black", lw=0.8, ls=":")
        axis.set(title=words(task), xlim=(0.0, 1.2))
    axes[0].invert_yaxis()
    axes[1].set_xlabel("score over that of the shipped policy on the fish as built (dotted: 0.9)")
    legend_below(figure, 2)
    save(figure, IMAGES / "conditions.svg")


if __name__ == "__main__":
    publish(__doc__, {"learning/sensing.csv": sensing_rows, "learning/held_out.csv": held_out_rows}, draw)
