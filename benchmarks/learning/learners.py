"""The table of learners: trials of the protocol of `fish_env benchmark`, their scores, and what a score of 1 is.

Trainings run on all processors, and finished trials are kept in runs/learners. Files of `fish_env benchmark` that are
named are checked, and their rows are added to the table instead. With --references, the returns of random actions and
of the best controller known are written too: they stay as they are for a version of the protocol.
"""

import json
import multiprocessing
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
from tqdm import tqdm

from benchmarks.common.charts import BLUE, GREEN, GREY, ORANGE, PINK, legend_below, panels, save, words
from benchmarks.common.reference import as_text, changed, from_text, trajectories
from benchmarks.common.tables import (
    IMAGES,
    ROOT,
    filled,
    make_parser,
    markdown,
    read_stored,
    read_table,
    select,
    write_csv,
)  # fmt: skip
from fish_env.control import load_policy, random_actions, scripted
from fish_env.control import protocols as protocol
from fish_env.control.files import write_text
from fish_env.control.statistics import interquartile_mean
from fish_env.envs import FishVectorEnv
from fish_env.physics.tank_options import available_processors
from fish_env.training.benchmark import KEY, benchmark, measure, read_result, score_rows
from fish_env.training.config import CONFIGS

RUNS, COMMAND = Path("runs", "learners"), "python -m benchmarks.learning.learners"
TABLE, CURVES = "learning/learners.csv", "learning/learner_curves.csv"
REFERENCES = Path(protocol.__file__).with_name("protocol.json")
PAGE = ROOT / "docs" / "benchmark.md"
SMALL, BUDGET = ("swim", "left_after_right"), protocol.BUDGETS[0]
TRIALS = (
    ("ppo", protocol.TASKS, protocol.LEVELS, protocol.BUDGETS),
    ("agents.learners:sac", SMALL, ["easy"], (BUDGET,)),
    ("agents.learners:tqc", SMALL, ["easy"], (BUDGET,)),
    ("agents.learners:recurrent_ppo", SMALL, ["easy", "hard"], (BUDGET,)),
)
"""Learner, tasks, levels and budgets."""
COLOURS = {"ppo": BLUE, "sac": ORANGE, "tqc": GREEN, "recurrent_ppo": PINK}
MOTIONS, HORIZON, KEPT = 64, 15, 3  # of the planner: motions that are tried; steps that are planned, and carried out


def trials() -> list[tuple]:
    """All trials: the learner, and what `KEY` names; the small budgets first."""
    found = [
        (learner, *key) for learner, tasks, levels, budgets in TRIALS
        for key in product(tasks, levels, budgets, protocol.SEEDS)
    ]  # fmt: skip
    return sorted(found, key=lambda trial: trial[3])


def file_of(learner: str, *key) -> Path:
    """Where a trial is kept."""
    return RUNS / f"{'_'.join(map(str, (learner, *key)))}.json".replace(":", ".")


def check_motions() -> None:
    """Refuse to add to trials that were made when fish moved otherwise.

    Raises:
        SystemExit: naming them.
    """
    path = RUNS / "motions.txt"
    if not path.exists():
        write_text(path, as_text(trajectories()))
    elif other := changed(from_text(path.read_text("utf-8")), [f"task {task}" for task in protocol.TASKS]):
        raise SystemExit(f"{RUNS} has trials of before {', '.join(other)} changed; move it away")


def run(trial: tuple) -> None:
    """Run a trial, unless it is finished."""
    import torch

    torch.set_num_threads(1)
    learner, *key = trial
    benchmark(learner, file_of(*trial), *([one] for one in key))


def planner(env: FishVectorEnv) -> Callable[[np.ndarray, float], np.ndarray]:
    """The beginning of the best of several motions from the state of the fish: waves, and changes of the last plan.

    Predictive sampling of Howell et al. (2022), with waves of random shooting beside its samples.
    """
    generator, fish, count = np.random.default_rng(0), env.tank.fish, env.num_envs
    assert env.spec is not None  # it was made by its id
    options = {name: value for name, value in env.spec.kwargs.items() if name != "vectorization_mode"}
    batch = FishVectorEnv(**options | {"num_envs": count * MOTIONS})
    low, high = (2.0, 0.0, -1.5, 0.7, -0.5), (10.0, 2.0 * np.pi, 3.0, 2.0, 0.5)
    plan = np.zeros(0)

    def act(obs: np.ndarray, time: float) -> np.ndarray:
        nonlocal plan
        step = round(time / env.control_interval) % KEPT
        if step == 0:
            frequency, phase, lag, size, side = generator.uniform(low, high, (batch.num_envs, 5)).T[:, :, None, None]
            ahead = env.control_interval * np.arange(HORIZON)[:, None]
            wave = size * np.sin(2.0 * np.pi * frequency * ahead + phase - lag * fish.segments)
            motions = np.clip(fish.sides * (wave + side), -1.0, 1.0)
            if time > 0.0:
                later = np.repeat(np.roll(plan, -KEPT, axis=1), MOTIONS, axis=0)
                noise = np.repeat(
                    generator.normal(0.0, 0.3, (batch.num_envs, HORIZON // KEPT, fish.sides.size)), KEPT, 1
                )
                changed = np.arange(batch.num_envs) % MOTIONS
                noise[changed == 0] = 0.0
                motions = np.where((changed < MOTIONS // 2)[:, None, None], np.clip(later + noise, -1.0, 1.0), motions)
            batch.set_state(env.get_state(np.repeat(np.arange(count), MOTIONS)))
            total, going_on = np.zeros(batch.num_envs), np.ones(batch.num_envs, dtype=bool)
            for k in range(HORIZON):
                _, reward, terminated, truncated, _ = batch.step(motions[:, k])
                total += reward * going_on
                going_on &= ~(terminated | truncated)
            best = total.reshape(count, MOTIONS).argmax(axis=1) + MOTIONS * np.arange(count)
            plan = motions[best]
        return plan[:, step]

    return act


def controllers() -> dict[str, tuple[Callable, list[str], list[str]]]:
    """What needs no trial: a function of the batch that returns a controller, its tasks and levels, by name."""
    everywhere = list(protocol.TASKS), list(protocol.LEVELS)
    found: dict[str, tuple[Callable, list[str], list[str]]] = {
        "random": (random_actions, *everywhere),
        "motor controllers": (scripted, *everywhere),
        "planner": (planner, ["swim"], ["easy"]),
    }
    for task in protocol.TASKS:
        policy = load_policy(task)
        found[f"shipped {task}"] = (lambda env, policy=policy: policy, [task], ["easy", "medium"])
    return found


def measure_controllers() -> None:
    """Keep the results of `controllers` as those of learners; shipped policies have the steps of their training."""
    for name, (make, tasks, levels) in tqdm(controllers().items(), unit="controller"):
        runs = []
        for task, level in product(tasks, levels):
            steps = CONFIGS[task].timesteps if name.startswith("shipped") else 0
            about = dict(zip(KEY, (task, level, steps, 0), strict=True)) | {"processor_seconds": 0.0, "curve": []}
            runs.append(about | measure(make, task, level))
        found = {"protocol": protocol.VERSION, "learner": name.removesuffix(f" {tasks[0]}"), "runs": runs}
        write_text(RUNS / f"{name}.json", json.dumps(found) + "\n")


def kept_results() -> list[dict[str, Any]]:
    """What is kept in runs/learners, by learner."""
    results: dict[str, list[dict[str, Any]]] = {}
    for path in sorted(RUNS.glob("*.json")):
        found = read_result(path)
        results.setdefault(found["learner"], []).extend(found["runs"])
    return [{"learner": learner, "runs": runs} for learner, runs in results.items()]


def write_references(results: list[dict[str, Any]]) -> None:
    """Write what scores of 0 and 1 are: the mean return of random actions, and the largest of any controller."""
    known = {task: {level: {} for level in protocol.LEVELS} for task in protocol.TASKS}
    for result in results:
        for each in result["runs"]:
            mean, entry = round(float(np.mean(each["returns"])), 4), known[each["task"]][each["level"]]
            if result["learner"] == "random":
                entry["random"] = mean
            if mean > entry.get("reference", -np.inf):
                by = f"{result['learner']}, {each['steps']:,} steps" if each["steps"] else result["learner"]
                entry |= {"reference": mean, "by": by}
    write_text(REFERENCES, json.dumps({"version": protocol.VERSION, "references": known}, indent=1) + "\n")
    protocol.references.cache_clear()


def add(results: list[dict[str, Any]], command: str) -> None:
    """Put the rows of results into the tables, in place of rows of the same trials."""
    rows = [row for result in results for row in score_rows(result)]
    curves = [
        {"learner": result["learner"], **{name: run[name] for name in KEY}}
        | {"trained": at, "return": total, "value": value}
        for result in results
        for run in result["runs"]
        for at, total, value in run["curve"]
    ]
    for table, new, names in ((TABLE, rows, ("learner", *KEY[:3])), (CURVES, curves, ("learner", *KEY))):
        key = {tuple(str(row[name]) for name in names) for row in new}
        kept = [row for row in read_stored(table) if tuple(row[name] for name in names) not in key]
        print(write_csv(table, kept + new, command, () if kept else None))


def table() -> str:
    """The scores of all learners as Markdown: a row for each level and budget, a column for each task."""
    lines: dict[tuple, dict[str, dict]] = {}
    for row in read_table(TABLE):
        key = (list(protocol.LEVELS).index(row["level"]), row["steps"] if row["seconds"] else 0, row["learner"])
        lines.setdefault(key, {})[row["task"]] = row
    found = []
    for (level, steps, learner), tasks in sorted(lines.items()):
        if learner != "random":
            minutes = f"{np.mean([row['seconds'] for row in tasks.values()]) / 60:.1f}" if steps else ""
            about = (f"{learner.rpartition(':')[2]}, {list(protocol.LEVELS)[level]}", f"{steps:,}" if steps else "")
            found.append((*about, *(cell(tasks.get(task)) for task in protocol.TASKS), minutes))
    return markdown(("learner, level", "steps", *map(words, protocol.TASKS), "processor, min"), found)


def cell(row: dict | None) -> str:
    """The score with its interval over seeds, and the held-out score."""
    if row is None:
        return "-"
    dash = " to " if row["low"] < 0 else "\N{EN DASH}"
    ends = f" ({row['low']:.2f}{dash}{row['high']:.2f})" if row["seeds"] > 1 else ""
    return f"{row['score']:.2f}{ends}; {row['held_out']:.2f}"


def draw() -> None:
    """Fill in the table of the page, and draw the metric in training of two tasks beside the best found."""
    write_text(PAGE, filled(PAGE.read_text("utf-8"), {"learners": table()}))
    figure, axes = panels(2, 4.6)
    for axis, task, name in zip(axes, SMALL, ("speed, BL/s", "latency, s"), strict=True):
        rows = [row for row in read_table(CURVES, task=task, level="easy") if row["value"] != ""]
        for learner, steps in dict.fromkeys((row["learner"], row["steps"]) for row in rows):
            mine = select(rows, learner=learner, steps=steps)
            short = learner.rpartition(":")[2]
            seeds = [select(mine, seed=seed) for seed in dict.fromkeys(row["seed"] for row in mine)]
            begin, end = (pick(row["trained"] for seed in seeds for row in seed) for pick in (min, max))
            at = np.geomspace(begin, end, 40)
            lines = [np.interp(at, *(np.array([row[k] for row in seed], float) for k in ("trained", "value")))
                     for seed in seeds]  # fmt: skip
            label = f"{words(short)}, {'a million' if steps > BUDGET else '100,000'} steps"
            mean, dashes = interquartile_mean(np.transpose(lines)), "-" if steps == BUDGET else "--"
            axis.plot(at / 1000, mean, color=COLOURS.get(short, GREY), ls=dashes, label=label)
        quantity = protocol.TASKS[task][1]
        bound = [row["bound"] for row in read_table("learning/bound.csv", task=task, quantity=quantity)]
        axis.axhline(np.mean(bound), color="black", ls=":", label="best found by optimal control")
        axis.set(title=words(task), xlabel="thousand environment steps", ylabel=name, xscale="log", ylim=(0, None))
    legend_below(figure, 3)
    save(figure, IMAGES / "learners.svg")


def main() -> None:
    """Run what is missing and publish, or add the files that are named."""
    parser = make_parser(__doc__)
    parser.add_argument("files", nargs="*", type=Path, help="results of fish_env benchmark, to be added")
    parser.add_argument("--references", action="store_true", help="write fish_env/control/protocol.json too")
    parser.add_argument("--finished", action="store_true", help="publish the trials that are finished, and run none")
    given = parser.parse_args()
    if given.files:
        add([read_result(path) for path in given.files], COMMAND)
        return draw()
    RUNS.mkdir(parents=True, exist_ok=True)
    check_motions()
    missing = [] if given.finished else [trial for trial in trials() if not file_of(*trial).exists()]
    with ProcessPoolExecutor(available_processors(), multiprocessing.get_context("spawn")) as pool:
        list(tqdm(pool.map(run, missing), total=len(missing), unit="trial"))
    measure_controllers()
    results = kept_results()
    if given.references:
        write_references(results)
    add(results, COMMAND)
    return draw()


if __name__ == "__main__":
    main()
