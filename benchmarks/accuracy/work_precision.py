"""Speed charted against accuracy: every integrator, at many steps, on every scene of `benchmarks/common/problems.py`.

The error is the largest distance, in body lengths, of any node at the end of any control interval from the
reference solution. The time is that of one fish of a batch of 8 on one core, per control interval. Failed runs are at
the top edge.
"""

import time
from functools import cache
from statistics import median

import numpy as np
from tqdm import tqdm

from benchmarks.common import problems
from benchmarks.common.charts import legend_below, panels, save, words
from benchmarks.common.problems import FIXED
from benchmarks.common.tables import RESULTS, publish, read_table, select
from fish_env import INTEGRATORS, make_fish
from fish_env.control.chart import STYLE, SUBSTEPS

DEFAULT = make_fish().integrator
LINES = [*((name, np.inf) for name in FIXED), (DEFAULT, make_fish().refine)]
"""Methods, and what refines their steps: the default method with its own refinement too."""
MOST_SUBSTEPS = {"linearly implicit": 96}  # most steps a control interval that are worth trying
FEWEST = 7  # valid runs a method must show on a scene, if it has them
BATCH, REPEATS = 8, 3
ACCURATE = 0.01  # body lengths
DRAWN = [line for line in LINES if line[0] in set(STYLE) - {"midpoint"}]
NOT_DRAWN = ("turn_x10_damped", "turn_x100")  # scenes that only the table has


def timed(problem: problems.Problem, name: str, substeps: int, refine: float) -> float:
    """Microseconds of computing one control interval of one fish, median of repeats, in a batch on one core."""
    goals = [np.repeat(goal[None], BATCH, axis=0) for goal in problem.contraction]
    taken = []
    for _ in range(REPEATS):
        tank = problems.tank_of(problem, name, substeps, BATCH, refine=refine)
        begin = time.perf_counter()
        for goal in goals:
            tank.drive(goal, substeps)
        taken.append((time.perf_counter() - begin) / BATCH / len(goals) * 1e6)
    return median(taken)


def measure(
    problem: problems.Problem, name: str, substeps: int, reference_path: np.ndarray, seconds=True, refine=np.inf
) -> dict:
    """A row: the cost of a method at a step on a scene, and its error. Failed runs have no cost."""
    path, tank = problems.run(problem, name, substeps, refine=refine)
    valid = bool(tank.alive[0])
    work = {name: int(values[0]) for name, values in tank.counters.items()}
    intervals = len(problem.contraction)
    return {
        "scene": problem.name,
        "integrator": name,
        "refine": refine,
        "substeps": substeps,
        "step_ms": problem.fish.control_interval / substeps * 1e3,
        "error": problems.distance(problem.fish, path, reference_path) if valid else np.inf,
        "us_per_interval": round(timed(problem, name, substeps, refine), 3) if valid and seconds else np.nan,
        "forces_per_interval": work["force_evaluations"] / intervals if valid else np.nan,
        "factorisations_per_interval": work["factorisations"] / intervals if valid else np.nan,
        "solves_per_interval": work["solves"] / intervals if valid else np.nan,
        "refined_intervals": work["refinements"],
        "non_positive_pivots": work["non_positive_pivots"],
        "failure": tank.failure[0],
    }


def steps_worth_trying(name: str) -> list[int]:
    """Substeps of a control interval, the largest step first."""
    return [k for k in SUBSTEPS if k <= MOST_SUBSTEPS.get(INTEGRATORS[name].kind, SUBSTEPS[-1])]


def sweep(problem: problems.Problem, reference_path: np.ndarray, bar: tqdm) -> list[dict]:
    """Every method at every step, largest first; a method stops once it has enough valid rows and 1e-4 is reached."""
    rows = []
    for name, refine in LINES:
        valid = 0
        for substeps in steps_worth_trying(name):
            bar.set_postfix_str(f"{problem.name} {name} {substeps}")
            rows.append(measure(problem, name, substeps, reference_path, refine=refine))
            valid += np.isfinite(rows[-1]["error"])
            if valid >= FEWEST and (rows[-1]["error"] < 1e-4 or valid >= 10):
                break
        bar.update()
    return rows


@cache
def reference_of(scene: str) -> tuple[np.ndarray, dict]:
    """The reference of a scene, and a row that says how it was made and how far an independent method is from it."""
    problem = problems.problems()[scene]
    reference_path, substeps, change = problems.reference(problem)
    stiff = problem.name in ("turn_x100", "turn_x1000", "turn_damped")
    method, tolerance = ("Radau", 1e-9) if stiff else ("DOP853", 1e-11)
    apart = problems.distance(problem.fish, problems.independent(problem, method, tolerance), reference_path)
    row = {"scene": problem.name, "rk4_substeps": substeps, "change": change, "independent": method,
           "tolerance": tolerance, "apart": apart,
           "magnified": round(problems.magnified(problem, reference_path, substeps), 1)}  # fmt: skip
    return reference_path, row


def draw() -> None:
    """One panel for each of six scenes: error against time, a line a method; failed runs on top."""
    rows, across = read_table("work_precision.csv"), "us_per_interval"
    figure, axes = panels(3, 7.2, 2, sharey=True)
    top, bottom = 2.0, 1e-6
    for panel, scene in zip(axes, (name for name in problems.problems() if name not in NOT_DRAWN), strict=True):
        for name, refine in DRAWN:
            colour, marker = STYLE[name]
            line = sorted(select(rows, scene=scene, integrator=name, refine=refine), key=lambda row: row["substeps"])
            valid = [row for row in line if np.isfinite(row["error"])]
            size = 9 if name == DEFAULT else 4.5
            dashes, label_of = ("--", f"{words(name)}, refined") if np.isfinite(refine) else ("-", words(name))
            panel.loglog([row[across] for row in valid], [min(max(row["error"], bottom), top) for row in valid],
                         color=colour, marker=marker, markersize=size, label=label_of, linestyle=dashes)  # fmt: skip
            if valid and len(line) > len(valid):  # where failed runs would lie, by the cost of a step
                each = median(row[across] / row["substeps"] for row in valid)
                failed = [row["substeps"] * each for row in line if not np.isfinite(row["error"])]
                panel.plot(failed, [top] * len(failed), linestyle="", color=colour, marker=marker,
                           markersize=size, fillstyle="none")  # fmt: skip
        panel.axhline(ACCURATE, color="#bbbbbb", linewidth=0.8, zorder=0)
        panel.set(ylim=(bottom, 1.6 * top), title=problems.problems()[scene].title.replace(", ", ",\n"))
    axes[-2].set_xlabel("processor time of a control interval, µs")
    figure.supylabel("error, body lengths (hollow, at the top: failed)")
    legend_below(figure, 3)
    save(figure, RESULTS / "work_precision.svg")


def sweeps() -> list[dict]:
    """The rows of every scene."""
    with tqdm(total=len(problems.problems()) * len(LINES), unit="sweep") as bar:
        return [row for name, each in problems.problems().items() for row in sweep(each, reference_of(name)[0], bar)]


def references() -> list[dict]:
    """The rows of their references."""
    return [reference_of(name)[1] for name in problems.problems()]


if __name__ == "__main__":
    publish(__doc__, {"work_precision.csv": sweeps, "work_precision_references.csv": references}, draw)
