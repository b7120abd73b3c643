"""Training runs on one body and fine-tuning on another, stored in folders, and their policies measured."""

import json
import os
import time
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import replace
from multiprocessing import get_context
from pathlib import Path
from typing import NamedTuple

import numpy as np
import torch
from stable_baselines3 import PPO
from stable_baselines3.common.callbacks import BaseCallback
from tqdm import tqdm

from agents.build import export_policy, make_env, make_model, start_from
from agents.config import CONFIGS, TrainConfig, fine_tuning
from agents.train import on_body
from benchmarks.common.tables import provenance
from fish_env import make_fish
from fish_env.control import Scores, evaluate, evaluation_options, load_policy, make_eval_env, policy_controller
from fish_env.control.files import replacing

TASKS = {"swim": 1_000_000, "left_after_right": 2_000_000}
"""Environment steps of training."""
SEEDS = {"swim": 3, "left_after_right": 2}
"""Of training. A seed of the second takes the tetrahedra four minutes."""
TUNINGS = {"swim": 3, "left_after_right": 6}
"""Seeds of fine-tuning from every other body, which take the trained seeds in turn."""
STOPS, SHORT_STOPS = 8, 4
"""Checkpoints of a run."""
BODIES = {"planar": 100, "mass_spring": 100, "two_layer": 50, "tetrahedral": 25}
"""Episodes on each body, the least expensive first; fewer on the most expensive."""
FINEST, VALIDATION_LEVEL, VALIDATION_EPISODES = "tetrahedral", 2, 6
"""The finest body that is trained on, and its level of detail that policies are validated on."""


class Run(NamedTuple):
    """One training run, or one of fine-tuning a policy that was trained on another body."""

    task: str
    body: str
    seed: int
    source: str = ""

    def folder(self, root: Path) -> Path:
        return root / self.task / (f"{self.source}_to_{self.body}" if self.source else self.body) / f"seed_{self.seed}"

    def begun_with(self) -> "Run":
        """The training that a fine-tuning begins with."""
        return Run(self.task, self.source, self.seed % SEEDS[self.task])

    def config(self) -> TrainConfig:
        config = replace(on_body(CONFIGS[self.task], self.body), timesteps=TASKS[self.task])
        return fine_tuning(config) if self.source else config


class Checkpoints(BaseCallback):
    """Saves the policy at every stop, in `folder`, and records the processor's seconds of training until then."""

    def __init__(self, folder: Path, stops: set[int], about: dict):
        super().__init__()
        self.folder, self.stops, self.about, self.seconds = folder, stops, about, {}

    def _on_training_start(self) -> None:
        self._begun = time.process_time()

    def _on_step(self) -> bool:
        return True

    def _on_rollout_start(self) -> None:
        if self.num_timesteps in self.stops:
            now = time.process_time()
            self.seconds[self.num_timesteps] = now - self._begun
            export_policy(self.model, self.about).save(self.folder / f"policy_{self.num_timesteps}.npz")
            self._begun += time.process_time() - now  # saving does not count

    def _on_training_end(self) -> None:
        self._on_rollout_start()


def learn(run: Run, root: Path) -> None:
    """Carry a run out; its folder gets policy_<steps>.npz, model.zip and, at the end, seconds.json."""
    torch.set_num_threads(1)
    config, folder = run.config(), run.folder(root)
    folder.mkdir(parents=True, exist_ok=True)
    env = make_env(config, config.num_envs, run.seed)
    model = make_model(config, env, run.seed)
    if run.source:
        start_from(model, PPO.load(run.begun_with().folder(root) / "model.zip", device="cpu"))
    update = config.num_envs * config.rollout
    whole = -(-config.timesteps // update)
    stops = {update * round(whole * k / n) for n in [SHORT_STOPS if run.source else STOPS] for k in range(n + 1)}
    checkpoints = Checkpoints(
        folder, stops, {"task": run.task, "env_id": config.env_id, "env_options": config.env_options}
    )
    other = make_eval_env(config.env_id, 1, config.env_options)  # loads what is compiled, before the clock runs
    other.reset(seed=0)
    other.step(other.action_space.sample())
    model.learn(config.timesteps, checkpoints)
    env.close()
    model.save(folder / "model.zip")
    record = {
        "seconds": {str(k): round(v, 2) for k, v in checkpoints.seconds.items()},
        "commit": provenance("")["commit"],
    }
    (folder / "seconds.json").write_text(json.dumps(record, indent=2) + "\n")


def measured(run: Run, root: Path, steps: int, body: str, level: int | None, episodes: int) -> Scores:
    """Scores of a policy of a run on a body, cached beside it."""
    folder = run.folder(root)
    cached = folder / f"scores_{steps}_{body}{level or ''}_{episodes}.npz"
    if not cached.exists():
        policy = load_policy(folder / f"policy_{steps}.npz")
        fish = body if level is None else make_fish(body, level=level)
        options = evaluation_options(policy.about["env_options"]) | {"body": fish}
        env = make_eval_env(CONFIGS[run.task].env_id, episodes, options)
        scores = evaluate(policy_controller(policy, env), env)
        env.close()
        with replacing(cached) as partial:
            np.savez(partial, **scores)
    with np.load(cached) as file:
        return dict(file)


def stops_of(run: Run, root: Path) -> dict[int, float]:
    """Environment steps and seconds of the checkpoints of a run."""
    record = json.loads((run.folder(root) / "seconds.json").read_text())
    return {int(k): v for k, v in record["seconds"].items()}


def pin(processors) -> None:
    """Pin this process to a processor of its own."""
    if hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(0, {processors.get()})


def in_parallel(work: list[tuple], jobs: int | None, what: str) -> None:
    """Call work[i][0](*work[i][1:]), each on one processor, as many side by side as asked."""
    context = get_context("spawn")
    places = sorted(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else list(range(os.cpu_count() or 1))
    jobs, queue = jobs or len(places), context.Queue()
    for k in range(jobs):
        queue.put(places[k % len(places)])
    with ProcessPoolExecutor(jobs, context, pin, (queue,)) as pool, tqdm(total=len(work), desc=what, unit="job") as bar:
        try:
            for done in as_completed([pool.submit(*call) for call in work]):
                done.result()
                bar.update()
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)
            raise


def runs(tasks: list[str], bodies: list[str]) -> tuple[list[Run], list[Run]]:
    """Training runs and fine-tuning runs, first seeds first."""
    every = [
        Run(task, body, seed)
        for seed in range(max(max(SEEDS.values()), max(TUNINGS.values())))
        for task in tasks
        for body in bodies
    ]
    found = [run for run in every if run.seed < SEEDS[run.task]]
    tuned = [
        run._replace(source=source)
        for run in every
        for source in bodies
        if source != run.body and run.seed < TUNINGS[run.task]
    ]
    return found, tuned
