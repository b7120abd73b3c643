"""Publish what `train.py all` found: interquartile means over seeds beside the baselines, curves, the median policies.

For every task, agents/pretrained/<task>/ gets the policy of the median seed, seeds.csv (a row a seed), methods.csv (a
row a method, with intervals) and curves.csv; docs/images/curves.svg shows the curves.
"""

import csv
import json
import shutil
from pathlib import Path

import numpy as np

from agents.config import CONFIGS, RESULTS
from agents.evaluate import FIRST_SEED, Scores, evaluate, make_eval_env
from agents.report import PRETRAINED, baselines, pyplot

RESAMPLES = 2000
CURVE_POINTS = 60
IMAGES = Path(__file__).parent.parent / "docs" / "images"


def publish(root: Path, tasks=None) -> None:
    """Gather the finished runs under root/<task>/seed_<k> and publish them.

    Raises:
        FileNotFoundError: if a seed of a task has no results.
    """
    tasks = list(CONFIGS if tasks is None else tasks)
    for task in tasks:
        runs = [root / task / f"seed_{seed}" for seed in range(RESULTS[task].seeds)]
        for run in runs:
            if not (run / "scores.npz").exists():
                raise FileNotFoundError(f"{run} is not finished; go on with: python train.py all --runs {root}")
        folder = PRETRAINED / task
        folder.mkdir(parents=True, exist_ok=True)
        scores = [dict(np.load(run / "scores.npz")) for run in runs]
        write_rows(folder / "seeds.csv", [seed_row(run, found) for run, found in zip(runs, scores, strict=True)])
        ship(runs, scores, RESULTS[task].score, folder)
        write_rows(folder / "methods.csv", method_rows(task, scores))
        write_rows(folder / "curves.csv", [row for run in runs for row in curve_rows(run)])
        print(f"{task}: median policy, seeds, methods and curves are in {folder}")
    if all((PRETRAINED / task / "curves.csv").exists() for task in CONFIGS):
        draw_curves(IMAGES / "curves.svg")


def seed_mean(scores: Scores, metric: str) -> float:
    """Mean of a metric over a seed's episodes, those in which it is known; time a target over all targets together."""
    if metric == "time_per_target":
        return float(scores["seconds"].sum() / max(scores["targets"].sum(), 1e-9))
    values = scores[metric]
    return float(values[np.isfinite(values)].mean()) if np.isfinite(values).any() else np.nan


def interquartile_mean(values: np.ndarray) -> float:
    """Mean of the middle half; values on the edges count in part."""
    values = np.sort(values[np.isfinite(values)])
    if not values.size:
        return np.nan
    edges = np.linspace(0.0, 1.0, values.size + 1)
    weight = np.clip(np.minimum(edges[1:], 0.75) - np.maximum(edges[:-1], 0.25), 0.0, None)
    return float(weight @ values / weight.sum())


def interval(scores: list[Scores], metric: str, generator: np.random.Generator) -> tuple[float, float, float]:
    """Interquartile mean over seeds of their means, and its 95 % bootstrap interval.

    Seeds are drawn anew with replacement, and the episodes of each; a method without seeds only draws episodes.
    """
    found = []
    for _ in range(RESAMPLES):
        drawn = [scores[k] for k in generator.integers(len(scores), size=len(scores))]
        count = len(drawn[0]["return"])
        picks = [generator.integers(count, size=count) for _ in drawn]
        means = [
            seed_mean({name: s[name][pick] for name in {metric, "seconds", "targets"} & s.keys()}, metric)
            for s, pick in zip(drawn, picks, strict=True)
        ]
        found.append(interquartile_mean(np.array(means)))
    found = np.array(found)
    low, high = np.quantile(found[np.isfinite(found)], [0.025, 0.975]) if np.isfinite(found).any() else (np.nan, np.nan)
    return interquartile_mean(np.array([seed_mean(s, metric) for s in scores])), float(low), float(high)


def seed_row(run: Path, scores: Scores) -> dict:
    """One seed: what it cost and the mean of every metric."""
    config = json.loads((run / "config.json").read_text())
    with (run / "curve.csv").open() as file:
        seconds = float(list(csv.DictReader(file))[-1]["seconds"])
    row = {"seed": config["seed"], "timesteps": config["config"]["timesteps"], "training_seconds": round(seconds)}
    return row | {name: rounded(seed_mean(scores, name)) for name in scores}


def ship(runs: list[Path], scores: list[Scores], metric: str, folder: Path) -> None:
    """Copy the policy and the configuration of the seed with the median score (of equals, the median return)."""
    keys = [(round(seed_mean(found, metric), 6), seed_mean(found, "return")) for found in scores]
    median = sorted(range(len(runs)), key=lambda k: keys[k])[len(runs) // 2]
    for name in ("policy.npz", "config.json"):
        shutil.copy(runs[median] / name, folder / name)


def method_rows(task: str, scores: list[Scores]) -> list[dict]:
    """A row for every method and metric: value and interval."""
    config, episodes = CONFIGS[task], len(scores[0]["return"])
    env = make_eval_env(config.env_id, episodes, config.env_options)
    methods = {name: [evaluate(controller, env, FIRST_SEED)] for name, controller in baselines(env).items()}
    methods["PPO"] = scores
    generator = np.random.default_rng(0)
    rows = []
    for method, found in methods.items():
        for metric in dict.fromkeys((*RESULTS[task].metrics, "return", "failed")):
            value, low, high = interval(found, metric, generator)
            rows.append({"method": method, "metric": metric, "value": rounded(value), "low": rounded(low),
                         "high": rounded(high), "seeds": len(found), "episodes": episodes})  # fmt: skip
    return rows


def curve_rows(run: Path) -> list[dict]:
    """The learning curve of a run, thinned."""
    seed = json.loads((run / "config.json").read_text())["seed"]
    with (run / "curve.csv").open() as file:
        rows = list(csv.DictReader(file))
    keep = np.unique(np.linspace(0, len(rows) - 1, min(CURVE_POINTS, len(rows))).astype(int))
    return [{"seed": seed} | {k: rows[i][k] for k in ("timesteps", "seconds", "score", "return")} for i in keep]


def draw_curves(path: Path) -> None:
    """Score against decisions for every task: a thin line a seed, the interquartile mean bold."""
    plt = pyplot()
    plt.rcParams["svg.hashsalt"] = "fish_env"
    figure, grid = plt.subplots(2, 3, figsize=(10, 5.4), layout="constrained")
    for axes, task in zip(grid.flat, CONFIGS, strict=True):
        with (PRETRAINED / task / "curves.csv").open() as file:
            rows = list(csv.DictReader(file))
        lines = {}
        for row in rows:
            lines.setdefault(row["seed"], []).append((float(row["timesteps"]) / 1e6, float(row["score"])))
        lines = [np.array(line).T for line in lines.values()]
        grid_points = np.linspace(max(line[0, 0] for line in lines), min(line[0, -1] for line in lines), 60)
        middle = [
            interquartile_mean(np.array(v))
            for v in zip(*(np.interp(grid_points, *line) for line in lines), strict=True)
        ]
        for line in lines:
            axes.plot(*line, color="#0b7a99", alpha=0.3, lw=0.8)
        axes.plot(grid_points, middle, color="#0b7a99", lw=2)
        with (PRETRAINED / task / "methods.csv").open() as file:
            base = [r for r in csv.DictReader(file) if r["method"] == "motor controllers"]
        level = next(float(r["value"]) for r in base if r["metric"] == RESULTS[task].score)
        axes.axhline(level, color="#c0562f", ls="--", lw=1)
        axes.set(title=task.replace("_", " "), xlabel="million decisions", ylabel=RESULTS[task].score, ylim=(0, None))
    figure.savefig(path, metadata={"Date": None})
    plt.close(figure)


def rounded(value: float) -> float | str:
    """Four digits after the point, or nothing for what is not known."""
    return round(value, 4) if np.isfinite(value) else ""


def write_rows(path: Path, rows: list[dict]) -> None:
    """A CSV file."""
    with path.open("w", newline="") as file:
        writer = csv.DictWriter(file, rows[0].keys(), lineterminator="\n")
        writer.writeheader()
        writer.writerows(rows)
