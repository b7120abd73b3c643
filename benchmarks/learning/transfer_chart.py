"""Tables and chart of how policies move from body to body."""

from pathlib import Path

import numpy as np

from agents.config import FINE_TUNING, RESULTS
from agents.results import UNITS
from agents.statistics import rounded
from benchmarks.common.charts import pyplot, save
from benchmarks.common.tables import IMAGES
from benchmarks.learning.transfer_runs import BODIES, FINEST, VALIDATION_LEVEL

GOALS = (0.8, 0.9, 0.95, 1.0)
"""Parts of the final score of training on the finest body itself to which the seconds are counted."""
COLOURS = {"planar": "tab:green", "mass_spring": "tab:blue", "two_layer": "tab:orange", "tetrahedral": "tab:red"}


def ways(rows: list[dict], task: str, source: str) -> dict[str, np.ndarray]:
    """Seconds and score on the finest body, (K,2), along training on a body and fine-tuning after it, for each seed."""
    mine = [row for row in rows if (row["task"], row["learnt_on"]) == (task, source)]
    mine.sort(key=lambda row: (int(row["fine_tuned"]), int(row["decisions"])))
    found: dict[str, list] = {}
    for row in mine:
        if not (int(row["fine_tuned"]) and int(row["decisions"]) == 0):  # where the training ended
            found.setdefault(str(row["seed"]), []).append((float(row["seconds"]), float(row["score_on_finest"])))
    return {seed: np.array(points) for seed, points in found.items()}


def reached(way: np.ndarray, goal: float) -> float:
    """Seconds after which a way comes to a score, in between by straight lines; infinity if it never does."""
    over = np.flatnonzero(way[:, 1] >= goal)
    if not over.size or over[0] == 0:
        return float(way[0, 0]) if over.size else np.inf
    (t0, s0), (t1, s1) = way[over[0] - 1], way[over[0]]
    return float(t0 + (goal - s0) / (s1 - s0) * (t1 - t0))


def saving_rows(rows: list[dict], bodies=tuple(BODIES)) -> list[dict]:
    """Seconds to a part of the final score of training on the finest body, by the body trained on first."""
    found = []
    for task in dict.fromkeys(row["task"] for row in rows):
        own = ways(rows, task, FINEST)
        end = np.mean([way[-1, 1] for way in own.values()])
        for goal in GOALS:
            direct = [reached(way, goal * end) for way in own.values()]
            for body in bodies:
                taken = [reached(way, goal * end) for way in ways(rows, task, body).values()]
                saved = np.mean(direct) / np.mean(taken) if np.isfinite([*direct, *taken]).all() else np.nan
                found.append({
                    "task": task, "learnt_on": body, "of_what_the_finest_learns": goal, "score": rounded(goal * end),
                    "seconds": rounded(np.mean(taken)), "least": rounded(min(taken)), "most": rounded(max(taken)),
                    "times_faster": rounded(saved), "seeds": len(taken),
                })  # fmt: skip
    return found


def matrix(rows: list[dict], task: str, short: int, columns: list[tuple[str, str]]) -> np.ndarray:
    """Score, low and high (3, trained on, replayed on) of a task; nan where nothing was measured."""
    metric = RESULTS[task].score
    found = np.full((3, len(BODIES), len(columns)), np.nan)
    for row in rows:
        place = (row["body"], str(row["level"]))
        if (row["task"], row["metric"]) != (task, metric) or place not in columns:
            continue
        own = row["learnt_on"] == row["body"] and not row["level"]  # nothing to fine-tune there
        if int(row["fine_tuned"]) == short or own:
            cell = found[:, list(BODIES).index(row["learnt_on"]), columns.index(place)]
            cell[:] = [float(row[name]) for name in ("value", "low", "high")]
    return found


def chart(matrices: list[dict], curves: list[dict]) -> Path:
    """A row a task: scores as trained, after fine-tuning, and on the finest body over seconds of training."""
    plt = pyplot()
    tasks = list(dict.fromkeys(row["task"] for row in matrices))
    figure, axes = plt.subplots(
        len(tasks), 3, figsize=(14, 3.6 * len(tasks)), layout="constrained", squeeze=False, width_ratios=(5, 4, 6)
    )
    direct, steps = [(body, "") for body in BODIES], FINE_TUNING["timesteps"]
    for (plain, tuned, line), task in zip(axes, tasks, strict=True):
        unit, factor, digits = UNITS[RESULTS[task].score]
        tables = [
            (plain, 0, [*direct, (FINEST, str(VALIDATION_LEVEL))], "as trained"),
            (tuned, steps, direct, f"after {steps // 1000} k environment steps there"),
        ]
        values = [factor * matrix(matrices, task, short, columns) for _, short, columns, _ in tables]
        low, high = (f([np.nanmin(v[0]) for v in values] + [np.nanmax(v[0]) for v in values]) for f in (min, max))
        for (ax, _, columns, title), (value, least, most) in zip(tables, values, strict=True):
            ax.imshow(value, vmin=low - 0.5 * (high - low), vmax=high, cmap="Blues", aspect="auto")
            for (i, j), number in np.ndenumerate(value):
                if np.isfinite(number):
                    shade = "white" if number > low + 0.6 * (high - low) else "black"
                    spread = f"{least[i, j]:.{digits}f} to {most[i, j]:.{digits}f}"
                    ax.text(j, i - 0.1, f"{number:.{digits}f}", ha="center", va="center", fontsize=9, color=shade)
                    ax.text(j, i + 0.2, spread, ha="center", va="center", fontsize=6.5, color=shade)
            names = [body.replace("_", "\n") + (f"\nlevel {level}" if level else "") for body, level in columns]
            ax.set_xticks(range(len(columns)), names, fontsize=8)
            ax.set_yticks(range(len(BODIES)), list(BODIES), fontsize=8)
            ax.set(title=f"{task.replace('_', ' ')}: {unit}, {title}", xlabel="replayed on", ylabel="trained on")
            ax.title.set_size(9)
        for body, colour in COLOURS.items():
            for k, (seed, way) in enumerate(ways(curves, task, body).items()):
                end = sum((r["task"], r["learnt_on"], str(r["seed"]), int(r["fine_tuned"])) == (task, body, seed, 0)
                          for r in curves)  # fmt: skip
                label = body if k == 0 else None
                line.plot(way[1:end, 0], factor * way[1:end, 1], color=colour, lw=1.2, label=label)
                line.plot(way[end - 1 :, 0], factor * way[end - 1 :, 1], color=colour, lw=1.2, ls=":", marker=".")
        line.set(xscale="log", xlabel="processor seconds of training", ylabel=f"{unit}, on {FINEST}")
        line.set_title("trained on (dotted: then fine-tuned on the finest)", fontsize=9)
        line.legend(frameon=False, fontsize=8)
    save(figure, IMAGES / "transfer.svg")
    return IMAGES / "transfer.svg"
