"""Do policies move from body to body, and does learning on a cheap one save time?

python -m benchmarks.transfer              learn on every body, replay on every other, fine-tune there:
                                           results/transfer_matrix.csv, transfer_curves.csv and
                                           docs/images/transfer.svg (hours; stop and go on at any time)
python -m benchmarks.transfer --chart      the chart only, from the CSVs
python -m benchmarks.transfer --shipped    what the shipped policies do on the other bodies: results/transfer.csv

Every run learns for as many decisions with the settings of its task, whatever the body; a run of fine-tuning begins
with what was learnt on another body. Runs keep the policies on their way, with the processor's seconds until then.
"""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent.parent))  # so that it runs as a script as well as with -m

import argparse
import csv
import json
import os
import time
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import replace
from multiprocessing import get_context
from typing import NamedTuple

import numpy as np
from tqdm import tqdm

from agents.config import CONFIGS, RESULTS, TrainConfig
from agents.controllers import scripted
from agents.evaluate import FIRST_SEED, Scores, evaluate, make_eval_env, measuring, policy_controller
from agents.policy import load_policy
from agents.report import PRETRAINED
from agents.results import interval, read_rows, rounded
from benchmarks.provenance import RESULTS as FILES
from benchmarks.provenance import write_csv

TASKS = {"swim": 1_000_000, "left_after_right": 1_000_000}
"""Decisions to learn for."""
SHORT = 98_304
"""Decisions of fine-tuning: twelve updates."""
SHORT_RATE = 3e-4
"""Learning rate at the beginning of fine-tuning."""
SEEDS = 3
STOPS, SHORT_STOPS = 8, 4
"""Policies kept on the way of a run."""
BODIES = {"planar": 100, "mass_spring": 100, "two_layer": 100, "tetrahedral": 40}
"""Episodes on each body, cheapest first; fewer on the dearest."""
FINEST, PROOF, PROOF_EPISODES = "tetrahedral", 2, 10
"""The finest body that can be learnt on, and the level of it that policies are proved on."""
RUNS = Path("runs/transfer")
SHIPPED = ("swim", "turn", "left_after_right", "target", "avoid")


class Run(NamedTuple):
    """One learning run, or one of fine-tuning what was learnt on another body."""

    task: str
    body: str
    seed: int
    source: str = ""

    def folder(self, root: Path) -> Path:
        return root / self.task / (f"{self.source}_to_{self.body}" if self.source else self.body) / f"seed_{self.seed}"

    def config(self) -> TrainConfig:
        from agents.train import on_body

        config = replace(on_body(CONFIGS[self.task], self.body), timesteps=TASKS[self.task])
        return replace(config, timesteps=SHORT, learning_rate=SHORT_RATE) if self.source else config


def learn(run: Run, root: Path) -> None:
    """Carry a run out; its folder gets policy_<decisions>.npz, model.zip, and seconds.json when it is whole."""
    import torch
    from stable_baselines3 import PPO
    from stable_baselines3.common.callbacks import BaseCallback

    from agents.build import export_policy, make_env, make_model, start_from
    from benchmarks.provenance import provenance

    torch.set_num_threads(1)
    config, folder = run.config(), run.folder(root)
    folder.mkdir(parents=True, exist_ok=True)
    env = make_env(config, config.num_envs, run.seed)
    model = make_model(config, env, run.seed)
    if run.source:
        start_from(model, PPO.load(Run(run.task, run.source, run.seed).folder(root) / "model.zip", device="cpu"))
    update = config.num_envs * config.rollout
    whole = -(-config.timesteps // update)
    stops = {update * round(whole * k / n) for n in [SHORT_STOPS if run.source else STOPS] for k in range(n + 1)}
    seconds: dict[int, float] = {}

    class Keep(BaseCallback):
        """Keeps the policy at every stop, after the learning; its own time does not count."""

        def _on_training_start(self) -> None:
            self.begun = time.process_time()

        def _on_step(self) -> bool:
            return True

        def _on_rollout_start(self) -> None:
            if self.num_timesteps in stops:
                now = time.process_time()
                seconds[self.num_timesteps] = now - self.begun
                about = {"task": run.task, "env_id": config.env_id, "env_options": config.env_options}
                export_policy(self.model, about).save(folder / f"policy_{self.num_timesteps}.npz")
                self.begun += time.process_time() - now

        def _on_training_end(self) -> None:
            self._on_rollout_start()

    other = make_eval_env(config.env_id, 1, config.env_options)  # loads what is compiled, before the clock runs
    other.reset(seed=0)
    other.step(other.action_space.sample())
    model.learn(config.timesteps, Keep())
    env.close()
    model.save(folder / "model.zip")
    record = {"seconds": {str(k): round(v, 2) for k, v in seconds.items()}, "commit": provenance("")["commit"]}
    (folder / "seconds.json").write_text(json.dumps(record, indent=2) + "\n")


def measured(run: Run, root: Path, decisions: int, body: str, level: int | None, episodes: int) -> Scores:
    """Scores of a policy of a run on a body, kept beside it."""
    folder = run.folder(root)
    kept = folder / f"scores_{decisions}_{body}{level or ''}_{episodes}.npz"
    if not kept.exists():
        from fish_env import make_fish

        policy = load_policy(folder / f"policy_{decisions}.npz")
        fish = body if level is None else make_fish(body, level=level)
        env = make_eval_env(CONFIGS[run.task].env_id, episodes, measuring(policy.about["env_options"]) | {"body": fish})
        scores = evaluate(policy_controller(policy, env), env)
        env.close()
        np.savez(kept, **scores)
    with np.load(kept) as file:
        return dict(file)


def stops_of(run: Run, root: Path) -> dict[int, float]:
    """Decisions and seconds at which the policies of a run were kept."""
    record = json.loads((run.folder(root) / "seconds.json").read_text())
    return {int(k): v for k, v in record["seconds"].items()}


def pin(processors) -> None:
    """Keep this process on a processor of its own."""
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
    """Runs of learning and of fine-tuning, first seeds first."""
    found = [Run(task, body, seed) for seed in range(SEEDS) for task in tasks for body in bodies]
    tuned = [run._replace(source=source) for run in found for source in bodies if source != run.body]
    return found, tuned


def measurements(learnt: list[Run], tuned: list[Run], root: Path) -> list[tuple]:
    """What `measured` is to be called with: last policies on every body, those on the way on the finest."""
    calls = []
    for run in (*learnt, *tuned):
        stops = sorted(stops_of(run, root))
        if not run.source:
            calls += [(run, root, stops[-1], body, None, BODIES[body]) for body in BODIES]
            calls.append((run, root, stops[-1], FINEST, PROOF, PROOF_EPISODES))
        else:
            calls.append((run, root, stops[-1], run.body, None, BODIES[run.body]))
        if not run.source or run.body == FINEST:
            calls += [(run, root, stop, FINEST, None, BODIES[FINEST]) for stop in stops]
    return list(dict.fromkeys(calls))


def matrix_rows(learnt: list[Run], tuned: list[Run], root: Path) -> list[dict]:
    """A row for a body learnt on, the body replayed on, before or after fine-tuning there, and a metric."""
    generator, rows = np.random.default_rng(0), []
    cells: dict[tuple, list[Scores]] = {}
    for run, _, stop, body, level, episodes in measurements(learnt, tuned, root):
        if stop == max(stops_of(run, root)):
            key = (run.task, run.source or run.body, body, level or "", SHORT if run.source else 0)
            cells.setdefault(key, []).append(measured(run, root, stop, body, level, episodes))
    for (task, source, body, level, short), found in cells.items():
        for metric in dict.fromkeys((RESULTS[task].score, *RESULTS[task].headline, "return", "failed")):
            value, low, high = interval(found, metric, generator)
            rows.append({
                "task": task, "learnt_on": source, "body": body, "level": level, "fine_tuned": short, "metric": metric,
                "value": rounded(value), "low": rounded(low), "high": rounded(high), "seeds": len(found),
                "episodes": len(found[0]["return"]), "first_seed": FIRST_SEED,
            })  # fmt: skip
    return rows


def curve_rows(learnt: list[Run], tuned: list[Run], root: Path) -> list[dict]:
    """The score on the finest body along every run; a fine-tuning counts the seconds of what it began with."""
    rows = []
    for run in (*learnt, *(run for run in tuned if run.body == FINEST)):
        before = max(stops_of(run._replace(body=run.source, source=""), root).values()) if run.source else 0.0
        for stop, seconds in stops_of(run, root).items():
            scores = measured(run, root, stop, FINEST, None, BODIES[FINEST])
            rows.append({
                "task": run.task, "learnt_on": run.source or run.body, "fine_tuned": int(bool(run.source)),
                "seed": run.seed, "decisions": stop, "seconds": round(before + seconds, 1),
                "metric": RESULTS[run.task].score, "score_on_finest": rounded(scores[RESULTS[run.task].score].mean()),
                "return_on_finest": rounded(scores["return"].mean()),
            })  # fmt: skip
    return rows


def shipped_rows() -> list[dict]:
    """What the shipped policies and the motor controllers, made for the default fish, do on every body."""
    from benchmarks.fidelity import interval_of

    found = []
    with tqdm(total=2 * len(SHIPPED) * len(BODIES), unit="evaluation") as bar:
        for task in SHIPPED:
            policy = load_policy(PRETRAINED / task / "policy.npz")
            for body, episodes in BODIES.items():
                options = measuring(CONFIGS[task].env_options) | {"body": body}
                for who in ("policy", "motor controllers"):
                    bar.set_postfix_str(f"{task}, {body}, {who}")
                    env = make_eval_env(CONFIGS[task].env_id, episodes, options)
                    scores = evaluate(policy_controller(policy, env) if who == "policy" else scripted(env), env)
                    env.close()
                    for metric in dict.fromkeys((*RESULTS[task].headline, "failed")):
                        known = scores[metric][np.isfinite(scores[metric])]
                        mean, low, high = interval_of(known) if known.size else (np.nan,) * 3
                        found.append({
                            "task": task, "learnt_on": "mass_spring" if who == "policy" else "", "body": body,
                            "who": who, "metric": metric, "mean": f"{mean:.4g}", "low": f"{low:.4g}",
                            "high": f"{high:.4g}", "episodes": episodes, "first_seed": FIRST_SEED,
                        })  # fmt: skip
                    bar.update()
    return found


def main() -> None:
    """Learn, fine-tune, measure, write down and draw what is asked for."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--shipped", action="store_true", help="only the shipped policies on the other bodies")
    parser.add_argument("--chart", action="store_true", help="only the chart, from the CSVs")
    parser.add_argument("--runs", type=Path, default=RUNS, help=f"where runs are kept ({RUNS})")
    parser.add_argument("--tasks", nargs="+", choices=list(TASKS), default=list(TASKS), help="only these")
    parser.add_argument(
        "--bodies", nargs="+", choices=list(BODIES), default=list(BODIES), help="only these; no CSV then"
    )
    parser.add_argument("--jobs", type=int, help="runs side by side (default one a processor)")
    chosen = parser.parse_args()
    if chosen.shipped:
        write_csv("transfer.csv", shipped_rows(), "python -m benchmarks.transfer --shipped")
        return
    if not chosen.chart:
        for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
            os.environ.setdefault(name, "1")  # for the processes to come
        learnt, tuned = runs(chosen.tasks, chosen.bodies)
        for what, some in (("learning", learnt), ("fine-tuning", tuned)):
            left = [run for run in some if not (run.folder(chosen.runs) / "seconds.json").exists()]
            in_parallel([(learn, run, chosen.runs) for run in left], chosen.jobs, what)
        calls = measurements(learnt, tuned, chosen.runs)
        in_parallel([(measured, *call) for call in calls], chosen.jobs, "measuring")
        if set(chosen.bodies) != set(BODIES):
            return
        write_csv("transfer_matrix.csv", matrix_rows(learnt, tuned, chosen.runs), "python -m benchmarks.transfer")
        write_csv("transfer_curves.csv", curve_rows(learnt, tuned, chosen.runs), "python -m benchmarks.transfer")


if __name__ == "__main__":
    main()
