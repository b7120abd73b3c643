"""Two ways in which a muscle follows its command: at a limited rate, or by first-order activation.

python -m benchmarks.learning.muscles     results/muscles.csv (some 7 minutes on two cores)

With each, policies are trained on the default fish and on tetrahedra, and measured on every body with the same muscles,
without further training: how fast they swim, how far their commands then jump from one control interval to the next,
and whether and how soon they carry out a reversal. The upper and the lower muscle of a side act together.
"""

import argparse
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from multiprocessing import get_context

import numpy as np
import torch
from tqdm import tqdm

from agents.build import export_policy, make_env, make_model
from agents.config import CONFIGS
from benchmarks.common.tables import write_csv
from fish_env import make_fish
from fish_env.control import evaluate, evaluation_options, make_eval_env, policy_controller

COMMAND = "python -m benchmarks.learning.muscles"
MUSCLES = {"limited rate": (0.0, 0.0), "first order": (0.015, 0.05)}
"""Time constants of activation and deactivation, s (Thelen 2003); zeros: 0.07 s from natural to full contraction."""
STEPS = {"swim": 400_000, "left_after_right": 1_000_000}
"""Environment steps of training. Tetrahedra have not learned a reversal after 200,000."""
SOURCES = ("mass_spring", "tetrahedral")
"""Bodies that are trained on."""
TARGETS = {"mass_spring": 40, "planar": 40, "two_layer": 24, "tetrahedral": 24}
"""Bodies that are measured on, and how many episodes."""
METRICS = {"swim": ("speed", "sideways", "jump", "failed"), "left_after_right": ("success", "latency", "failed")}
"""What is measured. Not how commands jump in a reversal: those policies act every other interval, and what is commanded
in between depends on the muscles."""
SEEDS = 2


def run(job) -> list[dict]:
    """Train once, and measure on every body."""
    task, muscles, source, seed = job
    torch.set_num_threads(1)
    times, config = MUSCLES[muscles], CONFIGS[task]
    options = config.env_options | {"muscle_groups": "pairs", "threads": 1}
    config = replace(config, env_options=options | {"body": make_fish(source, activation_time=times)})
    env = make_env(config, config.num_envs, seed)
    model = make_model(config, env, seed)
    model.learn(STEPS[task])
    policy, rows = export_policy(model, {"task": task, "env_id": config.env_id, "env_options": options}), []
    env.close()
    for target, episodes in TARGETS.items():
        fish = make_fish(target, activation_time=times)
        env = make_eval_env(config.env_id, episodes, evaluation_options(options) | {"body": fish})
        control, jumps, last = policy_controller(policy, env), [], []

        def watched(obs, time, control=control, jumps=jumps, last=last):
            action = np.clip(control(obs, time), -1.0, 1.0)
            if last:
                jumps.append(0.5 * np.abs(action - last.pop()).mean())
            last.append(action.copy())
            return action

        scores = evaluate(watched, env) | {"jump": np.array(jumps)}
        rows += [
            {"task": task, "muscles": muscles, "trained_on": source, "seed": seed, "measured_on": target,
             "metric": name, "value": f"{np.nanmean(scores[name]):.4g}", "episodes": episodes}
            for name in METRICS[task]
        ]  # fmt: skip
        env.close()
    return rows


def main() -> None:
    """The command line."""
    argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter).parse_args()
    jobs = [(t, m, s, k) for k in range(SEEDS) for t in STEPS for s in SOURCES for m in MUSCLES]
    rows = []
    with ProcessPoolExecutor(mp_context=get_context("spawn")) as pool, tqdm(total=len(jobs), unit="run") as bar:
        for found in pool.map(run, jobs):
            rows += found
            bar.update()
            for row in found:
                if row["metric"] != "failed":
                    tqdm.write(" ".join(str(value) for value in row.values()))
    print(write_csv("muscles.csv", rows, COMMAND))


if __name__ == "__main__":
    main()
