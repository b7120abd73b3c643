"""What an environment step costs during training: the environment, acting, the update; and the time to learn Swim.

python -m benchmarks.learning.learning_speed         results/learning_speed.csv: both learners, on one core and on all
python -m benchmarks.learning.learning_speed --gait  results/gait_seconds.csv: seconds to the speed of the best gait

Both learners and both numbers of threads take turns within one process; medians. Everything is compiled before. `load`
is that of the whole machine in its last minute, this process included: run it on a quiet one.
"""

import os
import sys

os.environ.setdefault("OMP_NUM_THREADS", "1")  # before numpy and torch are loaded
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
os.environ.setdefault("MKL_NUM_THREADS", "1")

import argparse
import contextlib
import time
from dataclasses import replace
from statistics import median

import torch
from stable_baselines3.common.callbacks import BaseCallback

from agents.build import LEARNERS, export_policy, make_env, make_model
from agents.config import CONFIGS, TrainConfig
from benchmarks.common.tables import write_csv
from fish_env.control import best_gait, evaluate, evaluation_options, gait_controller, make_eval_env, policy_controller
from fish_env.tank_options import available_processors

COMMAND = "python -m benchmarks.learning.learning_speed"
ROLLOUTS = 4  # timed together
REPEATS = 7
SEEDS = 5
BARS = {1: 35_000, 2: 60_000}
"""Environment steps a second on Swim, learning included, on so many cores."""
GAIT_BAR = 8.0  # s on all cores


def with_threads(config: TrainConfig, threads: int) -> TrainConfig:
    """The settings of a task with so many threads for the fish and for the update."""
    return replace(config, env_options=config.env_options | {"threads": threads})


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


class UntilFast(BaseCallback):
    """Stops the training when the policy, without noise, swims as fast as asked on the evaluation seeds."""

    def __init__(self, speed: float):
        super().__init__()
        self.speed, self.measuring = speed, 0.0
        self.env = make_eval_env(CONFIGS["swim"].env_id, 20, evaluation_options(CONFIGS["swim"].env_options))

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


class Run:
    """A learner at work, and what its parts take."""

    def __init__(self, task: str, learner: str, threads: int):
        config = with_threads(CONFIGS[task], threads)
        self.learner, self.threads, self.steps = learner, threads, ROLLOUTS * config.rollout * config.num_envs
        self.env = make_env(config, config.num_envs, seed=0)
        self.model = make_model(config, self.env, 0, learner=learner)
        self.model.learn(self.steps)
        self.watches = {
            "environment": Stopwatch(self.env, "step"),
            "rollouts": Stopwatch(self.model, "collect_rollouts"),
            "learning": Stopwatch(self.model, "train"),
        }
        self.found: list[dict[str, float]] = []

    def measure(self) -> None:
        """Learn from some rollouts; microseconds an environment step of each part, and of all."""
        for watch in self.watches.values():
            watch.seconds = 0.0
        begin = time.perf_counter()
        self.model.learn(self.steps, reset_num_timesteps=False)
        total = time.perf_counter() - begin
        taken = {name: watch.seconds for name, watch in self.watches.items()}
        parts = {
            "environment": taken["environment"],
            "acting": taken["rollouts"] - taken["environment"],
            "learning": taken["learning"],
            "all": total,
        }
        self.found.append({name: seconds / self.steps * 1e6 for name, seconds in parts.items()})

    def row(self) -> dict:
        """Medians."""
        middle = {name: median(found[name] for found in self.found) for name in self.found[0]}
        numbers = {f"{name}_us": round(value, 2) for name, value in middle.items()}
        rate = round(1e6 / middle["all"])
        return {"learner": self.learner, "threads": self.threads} | numbers | {"steps_per_second": rate}


def shares(task: str) -> bool:
    """Print and write what a step costs; True if the bars are met, which are for Swim."""
    counts = sorted({1, available_processors()})
    runs = [Run(task, learner, threads) for threads in counts for learner in LEARNERS]
    for _ in range(REPEATS):
        for run in runs:
            run.measure()
    met, rows = True, []
    for run in runs:
        row = {"task": task} | run.row()
        plain = next(other for other in runs if other.threads == run.threads and other.learner == "sb3").row()
        row |= {"over_sb3": round(row["steps_per_second"] / plain["steps_per_second"], 2), "load": os.getloadavg()[0]}
        wanted = BARS.get(run.threads) if run.learner == "compiled" and task == "swim" else None
        row |= {"lowest": wanted or "", "met": "" if wanted is None else row["steps_per_second"] >= wanted}
        met &= row["met"] is not False
        rows.append(row)
        print(row)
    print(f"written to {write_csv('learning_speed.csv', rows, f'{COMMAND} --task {task}')}")
    return met


def time_to_gait(learner: str, seed: int, speed: float) -> dict:
    """Seconds of learning, the measuring left out, until the policy swims that fast on the evaluation seeds."""
    config = CONFIGS["swim"]
    model = make_model(config, make_env(config, config.num_envs, seed), seed, learner=learner)
    watch, begin = UntilFast(speed), time.perf_counter()
    with contextlib.suppress(StopIteration):
        model.learn(config.timesteps, callback=watch)
    seconds = time.perf_counter() - begin - watch.measuring
    return {"learner": learner, "seed": seed, "reached": bool(watch.reached), "steps": model.num_timesteps,
            "seconds": round(seconds, 2), "load": os.getloadavg()[0]}  # fmt: skip


def gait(learners: list[str]) -> bool:
    """Print and write how soon each learner is as fast as the best open-loop gait; True if the bar is met."""
    config = CONFIGS["swim"]
    env = make_eval_env(config.env_id, 100, evaluation_options(config.env_options))
    wanted = float(evaluate(gait_controller(best_gait(), env), env)["speed"].mean())
    print(f"the best open-loop gait swims {wanted:.3f} body lengths/s")
    for learner in learners:  # compiles
        make_model(config, make_env(config, config.num_envs, 0), 0, learner=learner).learn(1)
    rows = []
    for seed in range(SEEDS):
        for learner in learners:
            rows.append({"gait_speed": round(wanted, 3)} | time_to_gait(learner, seed, wanted))
            print(rows[-1])
    print(f"written to {write_csv('gait_seconds.csv', rows, COMMAND + ' --gait')}")
    seconds = {name: median(row["seconds"] for row in rows if row["learner"] == name) for name in learners}
    met = seconds["compiled"] <= GAIT_BAR and all(row["reached"] for row in rows)
    print(f"median seconds {seconds}; at most {GAIT_BAR:g} with compiled kernels: {'met' if met else 'MISSED'}")
    return met


def main() -> int:
    """The command line; exit 1 if a bar is missed."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--task", default="swim", choices=CONFIGS, help="whose steps to time (default swim)")
    parser.add_argument("--gait", action="store_true", help="how soon Swim is learned")
    parser.add_argument("--sb3", action="store_true", help="with --gait: Stable-Baselines3's own code as well")
    arguments = parser.parse_args()
    torch.set_num_threads(1)
    if arguments.gait:
        return 0 if gait(["compiled", *(["sb3"] if arguments.sb3 else [])]) else 1
    return 0 if shares(arguments.task) else 1


if __name__ == "__main__":
    sys.exit(main())
