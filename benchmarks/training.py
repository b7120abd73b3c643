"""How fast PPO trains end to end, what share each part takes, and how soon it swims as fast as the best gait.

python -m benchmarks.training     writes results/training.csv
"""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent.parent))  # so that it runs as a script as well as with -m

import os

os.environ.setdefault("OMP_NUM_THREADS", "1")

import argparse
import contextlib
import time
from dataclasses import replace
from statistics import median

import torch
from stable_baselines3.common.callbacks import BaseCallback

from agents.build import export_policy, make_env, make_model
from agents.config import CONFIGS
from agents.controllers import best_gait
from agents.evaluate import evaluate, gait_controller, make_eval_env, measuring, policy_controller
from benchmarks.provenance import write_csv

ROLLOUTS = 12  # timed, after two that are not
REPEATS = 3


class Stopwatch:
    """Adds up the time that calls of a function take."""

    def __init__(self, owner, name: str):
        self.seconds, function = 0.0, getattr(owner, name)

        def timed(*arguments, **options):
            begin = time.perf_counter()
            result = function(*arguments, **options)
            self.seconds += time.perf_counter() - begin
            return result

        setattr(owner, name, timed)


def shares(integrator: str | None, threads: int | None) -> dict:
    """Decisions a second of PPO on Swim-v0 with a method and so many threads for the fish, and where the time goes."""
    config = CONFIGS["swim"]
    options = config.env_options | {"integrator": integrator, "threads": threads}
    config = replace(config, env_options=options, timesteps=(ROLLOUTS + 2) * config.rollout * config.num_envs)
    env = make_env(config, config.num_envs, seed=0)
    fish = env.unwrapped.fish
    model = make_model(config, env, seed=0)
    model.learn(2 * config.rollout * config.num_envs)
    watches = {
        "physics": Stopwatch(fish, "_swim"),
        "environment": Stopwatch(env, "step_wait"),
        "learning": Stopwatch(model, "train"),
    }
    begin = time.perf_counter()
    model.learn(ROLLOUTS * config.rollout * config.num_envs, reset_num_timesteps=False)
    total = time.perf_counter() - begin
    physics, environment, learning = (watches[name].seconds / total for name in watches)
    rate = ROLLOUTS * config.rollout * config.num_envs / total
    return {
        "integrator": fish.tank.integrator.name,
        "threads": fish.tank.threads,
        "decisions_per_second": rate,
        "physics": physics,
        "rest_of_environment": environment - physics,
        "acting_and_storing": 1 - environment - learning,
        "learning": learning,
    }


class UntilFast(BaseCallback):
    """Stops the training when the policy, without noise, swims as fast as asked on the evaluation seeds."""

    def __init__(self, speed: float):
        super().__init__()
        self.speed, self.measuring = speed, 0.0
        self.env = make_eval_env(CONFIGS["swim"].env_id, 20, measuring(CONFIGS["swim"].env_options))

    def _on_step(self) -> bool:
        return True

    def _on_rollout_start(self) -> None:
        begin = time.perf_counter()
        self.reached = (
            evaluate(policy_controller(export_policy(self.model, {}), self.env), self.env)["speed"].mean() >= self.speed
        )
        self.measuring += time.perf_counter() - begin
        if self.reached:
            raise StopIteration


def time_to_gait() -> dict:
    """Seconds of training, the measuring left out, until the policy is as fast as the best open-loop gait."""
    config = CONFIGS["swim"]
    env = make_eval_env(config.env_id, 100, measuring(config.env_options))
    wanted = float(evaluate(gait_controller(best_gait(), env), env)["speed"].mean())
    model = make_model(config, make_env(config, config.num_envs, seed=0), seed=0)
    watch, begin = UntilFast(wanted), time.perf_counter()
    with contextlib.suppress(StopIteration):
        model.learn(config.timesteps, callback=watch)
    return {"gait_speed": wanted, "reached": bool(watch.reached), "decisions": model.num_timesteps,
            "seconds": time.perf_counter() - begin - watch.measuring}  # fmt: skip


def main() -> None:
    """The command line."""
    argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter).parse_args()
    torch.set_num_threads(1)
    rows = []
    for integrator, threads in ((None, None), ("semi_implicit", None), (None, 1)):
        runs = [shares(integrator, threads) for _ in range(REPEATS)]
        row = {name: value if isinstance(value, str) else round(median(run[name] for run in runs), 3)
               for name, value in runs[0].items()}  # fmt: skip
        rows.append(row | {"what": "PPO on Swim-v0"})
        print(rows[-1])
    found = time_to_gait()
    print(found)
    rows[0] |= {f"to_gait_{name}": round(value, 3) for name, value in found.items()}
    empty = dict.fromkeys(rows[0], "")
    print(write_csv("training.csv", [empty | row for row in rows], "python -m benchmarks.training"))


if __name__ == "__main__":
    main()
