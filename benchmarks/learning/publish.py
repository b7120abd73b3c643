"""Publish the results of `train.py all`: interquartile means over seeds with the baselines, curves, median policies.

For every task, fish_env/control/pretrained/<task>/ gets the policy of the median seed with its configuration, and the
tables of benchmarks/results/learning/ get its rows: seeds.csv (one for each seed and condition), methods.csv (one for
each method, condition and metric, with intervals) and curves.csv. The page of results shows some of the metrics, and
docs/images/curves.svg the curves.
"""

import math
from collections.abc import Iterable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from agents.published import CONFIGS, SEEDS
from benchmarks.common.charts import BLUE, ORANGE, legend_below, panels, save, words
from benchmarks.common.reference import trajectories
from benchmarks.common.statistics import rounded
from benchmarks.common.tables import (
    IMAGES,
    RESULTS,
    ROOT,
    columns,
    filled,
    markdown,
    read_rows,
    read_stored,
    replace_rows,
    select,
    write_csv,
)  # fmt: skip
from benchmarks.learning.avoidability import avoidable
from fish_env.control import EPISODES, Scores, evaluate, evaluation_options, load_policy, make_eval_env
from fish_env.control.files import replacing, writable_folder, write_text
from fish_env.control.policy import PRETRAINED
from fish_env.control.statistics import interquartile_mean, interval, seed_mean
from fish_env.training.checkout import present_commit
from fish_env.training.config import SCORES
from fish_env.training.report import baselines
from fish_env.training.run_folder import read_record

COMMAND = "python train.py all"
CURVE_POINTS = 60
SEEDS_TABLE, METHODS, CURVES = "learning/seeds.csv", "learning/methods.csv", "learning/curves.csv"
PAGE, README = ROOT / "docs" / "results.md", ROOT / "README.md"
UNITS = {
    "speed": ("speed, BL/s", 1, 2),
    "sideways": ("sideways, BL/s", 1, 2),
    "success": ("success, %", 100, 1),
    "latency": ("latency, s", 1, 2),
    "overshoot": ("overshoot, °", 1, 1),
    "radius": ("radius, BL", 1, 2),
    "turning_rate": ("peak rate, °/s", 1, 0),
    "speed_lost": ("speed lost, %", 100, 0),
    "work": ("work, J/kg", 1, 0),
    "peak_strain": ("peak strain, %", 100, 0),
    "targets": ("targets", 1, 2),
    "time_per_target": ("time per target, s", 1, 2),
    "avoided": ("avoided, %", 100, 1),
    "avoided_possible": ("avoided where possible, %", 100, 1),
    "passed": ("passed, %", 100, 1),
    "clearance": ("clearance, BL", 1, 2),
    "escape_distance": ("got away, BL", 1, 2),
    "angle_100ms": ("turned in 0.1 s, °", 1, 0),
    "angle_200ms": ("turned in 0.2 s, °", 1, 0),
    "angle_300ms": ("turned in 0.3 s, °", 1, 0),
    "snout_300ms": ("snout, °", 1, 0),
    "distance_200ms": ("path in 0.2 s, BL", 1, 2),
    "speed_200ms": ("speed after 0.2 s, BL/s", 1, 2),
    "peak_acceleration": ("peak acceleration, m/s²", 1, 1),
    "return": ("return", 1, 1),
    "failed": ("physics failed, %", 100, 2),
}
"""Heading, factor and digits of a metric in the tables of the page."""


class Publication(NamedTuple):
    """What is published of a task."""

    goal: str
    """Summary of the task, in a few words."""
    headline: tuple[str, ...]
    """The metrics of the summary in the README."""
    metrics: tuple[str, ...]
    """The metrics of the table methods.csv, beside return and failures."""
    shown: tuple[str, ...]
    """The metrics of its table on the page."""
    conditions: dict[str, tuple[dict[str, Any], dict[str, Any]]] = {}
    """Other conditions it is evaluated under: keywords of the environment and reset options, by name."""


TURNING = ("success", "latency", "overshoot", "radius", "turning_rate", "speed_lost", "work", "peak_strain")
TARGETS = ("targets", "success", "time_per_target")
AVOIDING = ("avoided", "avoided_possible", "passed", "success", "clearance", "work", "peak_strain")
TURNS = ("success", "latency", "overshoot", "work")
ANGLES = ("angle_100ms", "angle_200ms", "angle_300ms", "snout_300ms")
STARTING = ("success", "escape_distance", *ANGLES, "distance_200ms", "speed_200ms", "peak_acceleration", "latency",
            "turning_rate", "work", "peak_strain")  # fmt: skip
PUBLICATIONS = {
    "swim": Publication(
        "swim along a commanded heading", ("speed",), ("speed", "sideways"), ("speed", "sideways")
    ),
    "turn": Publication(
        "turn by 30 to 180 degrees to either side", ("success", "latency"), TURNING, TURNS,
        {"90 left": ({}, {"turn": math.pi / 2}), "90 right": ({}, {"turn": -math.pi / 2})},
    ),
    "left_after_right": Publication(
        "turn left before a right turn is over", ("success", "latency"), TURNING, TURNS,
        {
            "left after right": ({}, {"side": -1}),
            "right after left": ({}, {"side": 1}),
            "twice the severity": ({"severity": 2.0}, {}),
            "double reversal": ({"reversals": 2}, {}),
        },
    ),
    "target": Publication("reach targets one after another", ("time_per_target",), TARGETS, TARGETS),
    "target_3d": Publication("the same in three dimensions", ("success",), TARGETS, TARGETS),
    "avoid": Publication(
        "pass a sudden obstacle and return to the heading", ("avoided", "success"), AVOIDING, ("avoided", "success"),
        {"after a turn": ({"turning": 1.0}, {}), "in a current": ({}, {"current": 0.5, "current_heading": 1.5})},
    ),
    "fast_start": Publication(
        "get away in a commanded direction", ("escape_distance",), STARTING,
        ("success", "escape_distance", "angle_300ms", "snout_300ms", "peak_acceleration"),
        {"90 degrees, from rest": ({"speed": 0.0, "wait": 0.0}, {"turn": math.pi / 2})},
    ),
}  # fmt: skip
EVERYWHERE = ("motor controllers", "PPO")
"""Methods that the page shows under every condition. The others cannot steer: it shows them only for Swim."""
NOT_SHOWN = ("90 left", "90 right", "left after right", "right after left")
"""Conditions that the page leaves out: they are a part of all episodes."""


def publish(root: Path, tasks=None) -> None:
    """Measure the finished runs under root/<task>/seed_<k> and the baselines, and publish them.

    Raises:
        FileNotFoundError: if no seed of a task is finished.
        ValueError: if a folder that the results go to cannot be written to.
    """
    for folder in (PRETRAINED, RESULTS, IMAGES, PAGE.parent, README.parent):
        writable_folder(folder)
    for task in CONFIGS if tasks is None else tasks:
        seeds = [root / task / f"seed_{seed}" for seed in range(SEEDS[task])]
        runs = [run for run in seeds if (run / "results.json").exists()]
        if not runs:
            raise FileNotFoundError(
                f"no run of {task} in {root} is finished; resume with: python train.py all --runs {root}"
            )
        commits = sorted({read_record(run)["commit"] for run in runs})
        if len(commits) > 1:
            print(f"runs of {task} are of the commits {'; '.join(commits)}: check if the task changed between them")
        publish_task(task, runs)
    if {row["task"] for row in read_stored(CURVES)} == set(CONFIGS):
        draw_curves(IMAGES / "curves.svg")
    for page, tables in ((PAGE, tables_of_page()), (README, {"summary": summary()})):
        write_text(page, filled(page.read_text("utf-8"), tables))


def publish_task(task: str, runs: list[Path]) -> None:
    """Evaluate the seeds of a task and the controllers without learning under every condition, and write the tables."""
    config = CONFIGS[task]
    policies = [load_policy(run / "policy.npz", config.env_id) for run in runs]
    seed_rows, method_rows, generator = [], [], np.random.default_rng(0)
    for condition, (keywords, options) in {"": ({}, {}), **PUBLICATIONS[task].conditions}.items():
        env = make_eval_env(config.env_id, EPISODES, evaluation_options(config.env_options) | keywords)
        methods = {name: [evaluate(env, controller, options=options)] for name, controller in baselines(env).items()}
        methods["PPO"] = [evaluate(env, policy, options=options) for policy in policies]
        if task == "avoid":
            everyone = [scores for found in methods.values() for scores in found]
            where = avoidable(env, options) | np.any([scores["passed"] > 0 for scores in everyone], axis=0)
            for scores in everyone:
                scores["avoided_possible"] = np.where(where, scores["avoided"], np.nan)
        seed_rows += [seed_row(run, condition, s) for run, s in zip(runs, methods["PPO"], strict=True)]
        for method, found in methods.items():
            rows = rows_of(found, PUBLICATIONS[task].metrics, generator)
            method_rows += [{"condition": condition, "method": method} | row for row in rows]
        if not condition:
            ship(runs, methods["PPO"], SCORES[task], PRETRAINED / task)
    measured = {"measured": present_commit()}
    for table, rows in (
        (SEEDS_TABLE, [row | measured for row in seed_rows]), (METHODS, [row | measured for row in method_rows]),
        (CURVES, [row for run in runs for row in curve_rows(run)]),
    ):  # fmt: skip
        replace_rows(table, [{"task": task} | row for row in rows], CONFIGS, COMMAND)
    print(f"\n{task}\n{table_of(method_rows, dict.fromkeys(row['metric'] for row in method_rows))}")


def rows_of(found: list[Scores], metrics: Iterable[str], generator: np.random.Generator) -> list[dict]:
    """A row for each metric of what seeds have scored, beside return and failures, with its interval."""
    rows = []
    for metric in dict.fromkeys((*metrics, "return", "failed")):
        values = zip(("value", "low", "high"), map(rounded, interval(found, metric, generator)), strict=True)
        rows.append({"metric": metric, **dict(values), "seeds": len(found), "episodes": EPISODES})
    return rows


def publish_method(root: Path, integrator: str, tasks=None) -> None:
    """Measure policies trained with another integrator, under it and the default one, next to the default policies.

    It prints a table and writes root/trained_with_<integrator>.csv; nothing is shipped.

    Raises:
        FileNotFoundError: if no seed of a task is finished.
        ValueError: if the folder of the runs cannot be written to.
    """
    writable_folder(root)
    rows, generator = [], np.random.default_rng(0)
    for task in CONFIGS if tasks is None else tasks:
        runs = sorted(path.parent for path in (root / task).glob("seed_*/results.json"))
        if not runs:
            raise FileNotFoundError(f"no run of {task} in {root} is finished; resume with the command that began it")
        settings = read_record(runs[0])["config"]["env_options"]
        policies = [load_policy(run / "policy.npz", CONFIGS[task].env_id) for run in runs]
        for moved, options in ((integrator, settings), ("the default", CONFIGS[task].env_options)):
            env = make_eval_env(CONFIGS[task].env_id, EPISODES, evaluation_options(options))
            found = rows_of([evaluate(env, policy) for policy in policies], PUBLICATIONS[task].headline, generator)
            rows += [{"task": task, "moved_by": moved, "dt": settings.get("dt", "")} | row for row in found]
    command = f"{COMMAND} --integrator {integrator}" + (f" --dt {settings['dt']:g}" if "dt" in settings else "")
    path = (root / f"trained_with_{integrator}.csv").absolute()
    print(f"{method_table(rows, integrator)}\n\n{write_csv(str(path), rows, command)}")


def method_table(rows: list[dict], integrator: str) -> str:
    """Table of policies trained with another integrator and with the default one, as Markdown."""
    heads, lines = ("Task", "Metric", "trained with the default", f"with `{integrator}`", "moved by the default"), []
    for task, metric in dict.fromkeys((row["task"], row["metric"]) for row in rows):
        default = select(read_stored(METHODS), task=task, condition="", method="PPO", metric=metric)
        cells = [cell(row) for row in default] or ["-"]
        lines.append((task, UNITS[metric][0], *cells, *map(cell, select(rows, task=task, metric=metric))))
    return markdown(heads, lines)


def seed_row(run: Path, condition: str, scores: Scores) -> dict:
    """One seed under one condition: the cost of its training and the mean of every metric."""
    config = read_record(run)
    rows = read_rows(run / "curve.csv")
    row = {"condition": condition, "seed": config["seed"], "timesteps": config["config"]["timesteps"],
           "training_seconds": round(float(rows[-1]["seconds"])), "resumed": config.get("resumed", 0),
           "commit": config["commit"]}  # fmt: skip
    return row | {
        name: rounded(seed_mean(scores, name)) for name in (*scores, *(["time_per_target"] * ("targets" in scores)))
    }


def ship(runs: list[Path], scores: list[Scores], metric: str, folder: Path) -> None:
    """Copy policy and configuration of the seed with the median score (the lower of two; of equals, by return)."""
    keys = [(round(seed_mean(found, metric), 6), seed_mean(found, "return")) for found in scores]
    median = sorted(range(len(runs)), key=lambda k: keys[k])[(len(runs) - 1) // 2]
    folder.mkdir(parents=True, exist_ok=True)
    for name in ("policy.npz", "config.json"):
        with replacing(folder / name) as partial:
            partial.write_bytes((runs[median] / name).read_bytes())
    trajectories.cache_clear()


def curve_rows(run: Path) -> list[dict]:
    """The learning curve of a run, at most CURVE_POINTS rows."""
    seed, rows = read_record(run)["seed"], read_rows(run / "curve.csv")
    keep = np.unique(np.linspace(0, len(rows) - 1, min(CURVE_POINTS, len(rows))).astype(int))
    return [{"seed": seed} | {k: rows[i][k] for k in ("timesteps", "seconds", "score", "return")} for i in keep]


def draw_curves(path: Path) -> None:
    """Score against environment steps of six tasks: a thin line for each seed, their interquartile mean bold."""
    figure, grid = panels(3, 6.0, 2)
    for axes, task in zip(grid, (task for task in CONFIGS if task != "left_after_right"), strict=True):
        rows = select(read_stored(CURVES), task=task)
        of_seeds = [select(rows, seed=seed) for seed in dict.fromkeys(row["seed"] for row in rows)]
        lines = [np.array(columns(of_seed, "timesteps", "score"), float) / [[1e6], [1.0]] for of_seed in of_seeds]
        points = np.linspace(max(line[0, 0] for line in lines), min(line[0, -1] for line in lines), CURVE_POINTS)
        levels = np.array([np.interp(points, *line) for line in lines])
        unit, factor, _ = UNITS[SCORES[task]]
        for line in lines:
            axes.plot(line[0], factor * line[1], color=BLUE, alpha=0.4, lw=1, label="each seed")
        mean = interquartile_mean(factor * levels.T)
        axes.plot(points, mean, color=BLUE, lw=2, label="PPO in training, interquartile mean over seeds")
        score = {"metric": SCORES[task], "task": task, "condition": "", "method": "motor controllers"}
        (level,) = select(read_stored(METHODS), **score)
        axes.axhline(factor * float(level["value"]), color=ORANGE, ls="--", label="motor controllers")
        axes.set(title=words(task), xlabel="million environment steps", ylabel=unit, ylim=(0, None))
    legend_below(figure, 3)
    save(figure, path)


def tables_of_page() -> dict[str, str]:
    """The tables of the page, by task."""
    tables = {}
    for task, publication in PUBLICATIONS.items():
        rows = [row for row in select(read_stored(METHODS), task=task) if is_shown(row)]
        if rows:
            tables[task] = table_of(rows, publication.shown)
    return tables


def is_shown(row: dict) -> bool:
    """True for the rows of methods.csv that the page shows."""
    allowed = row["task"] == "swim" or (row["method"] in EVERYWHERE and row["condition"] not in NOT_SHOWN)
    return allowed and row["metric"] in PUBLICATIONS[row["task"]].shown


def summary() -> str:
    """The README's table: the goal of each task, and the metrics that say most, without their intervals, by method."""
    methods = ("random", "motor controllers", "PPO")
    lines, stored = [], select(read_stored(METHODS), condition="")
    for task, publication in PUBLICATIONS.items():
        name = f"[`{CONFIGS[task].env_id.removeprefix('FishEnv/')}`](docs/envs/{task.removesuffix('_3d')}.md)"
        about = f"{name}: {publication.goal}"
        for metric in publication.headline if select(stored, task=task, method="PPO") else ():
            found = {row["method"]: cell(row, False) for row in select(stored, task=task, metric=metric)}
            lines.append((about, UNITS[metric][0], *(found.get(method, "-") for method in methods)))
            about = ""
    return markdown(("Task", "Metric", *methods), lines)


def table_of(rows: list[dict], metrics: Iterable[str]) -> str:
    """The results of a task as Markdown, a line for each method and condition, and a column for each metric."""
    lines, metrics = {}, list(metrics)
    for row in rows:
        several = "s" * (str(row["seeds"]) != "1")
        method = row["method"] if row["method"] != "PPO" else f"PPO, {row['seeds']} seed{several}"
        lines.setdefault(f"{method}{', ' * bool(row['condition'])}{row['condition']}", {})[row["metric"]] = cell(row)
    head = ["", *(UNITS[metric][0] for metric in metrics)]
    return markdown(head, ((name, *(cells[metric] for metric in metrics)) for name, cells in lines.items()))


def cell(row: dict, intervals: bool = True) -> str:
    """A value, with its interval unless that is unwanted or no wider than the digits shown."""
    if row["value"] == "":
        return "-"
    _, factor, digits = UNITS[row["metric"]]
    value, low, high = (f"{factor * float(row[name]):.{digits}f}" for name in ("value", "low", "high"))
    if low == value == high or not intervals:
        return value
    return f"{value} ({low} to {high})" if low.startswith("-") else f"{value} ({low}\N{EN DASH}{high})"
