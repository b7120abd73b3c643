"""Methods that were rejected in favour of `leapfrog_chebyshev`, measured on three scenes.

    python -m benchmarks.accuracy.rejected_methods.survey           every method (about 2 min): CSV and chart
    python -m benchmarks.accuracy.rejected_methods.survey --draw    the chart again, from the CSV

They are methods like those of the package, but for one fish and not optimised; they are in the package's table only
while a tank is made. The error is that of `benchmarks/accuracy/work_precision.py`. A force evaluation is a pass over
all springs, be it for their force or for their tangent times a vector; the water may add a second pass over the faces.
What a method spends on its matrices is counted apart and is not in the chart: those that need fewer force evaluations
have that cost instead, except `velocity_verlet`, which needs fewer until the springs are well damped.
"""

import argparse
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
from tqdm import tqdm

from benchmarks.accuracy.rejected_methods import MATRIX_EVERY_STEP, REJECTED_METHODS, TOLERANCE
from benchmarks.accuracy.work_precision import ACCURATE
from benchmarks.common.charts import METHOD_STYLE, pyplot, save
from benchmarks.common.problems import Problem, distance, problems, reference, tank_of
from benchmarks.common.tables import RESULTS, read_table, write_csv
from fish_env import INTEGRATORS, Tank
from fish_env.integrators import Integrator

SCENES = ("turn", "turn_x10", "turn_x10_damped")
SUBSTEPS = (1, 2, 3, 4, 5, 6, 8, 10, 12, 16, 24, 32, 48, 64)
COMPARISONS = ("leapfrog_chebyshev", "rk4", "symplectic_euler")
ENOUGH = 1e-4  # body lengths: no smaller step is tried
TOP = 2.0  # body lengths: larger errors are drawn there
COMMAND = "python -m benchmarks.accuracy.rejected_methods.survey"
CSV = "ideas.csv"
MARKS = {  # colours told apart by colour-blind readers (Okabe & Ito)
    "semi_implicit_positive": ("#D55E00", "s"),
    "semi_implicit_leapfrog": ("#CC79A7", "D"),
    "implicit_damping": ("#56B4E9", "v"),
    "implicit_midpoint": ("#009E73", "^"),
    "generalised_alpha": ("#B8A800", "P"),
    "isotropic": ("#D55E00", "s"),
    "isotropic_leapfrog": ("#CC79A7", "D"),
    "rest_matrix": ("#009E73", "^"),
    "rest_matrix_body": ("#66C2A5", "<"),
    "newmark_rest_matrix": ("#B8A800", "P"),
    "local_global": ("#882255", "X"),
    "velocity_verlet": ("#56B4E9", "v"),
    "force_gradient": ("#999999", "h"),
    "step_doubling": ("#7A5230", "d"),
}


def tank_by(problem: Problem, name: str, substeps: int) -> Tank:
    """A tank whose fish is moved by a rejected method, or by one of the package, with so many steps a control interval.

    Step doubling takes control intervals as its steps; here the tolerated error falls with them.
    """
    if name not in REJECTED_METHODS:
        return tank_of(problem, name, substeps)
    fish, number, parts = problem.fish, problem.fish.control_interval / substeps, substeps
    if name == "step_doubling":
        number, parts = TOLERANCE * fish.length / substeps**2, 1
    method = replace(REJECTED_METHODS[name], number=number)
    INTEGRATORS[name] = Integrator(name, 0, "rejected", *method.cost, "benchmarks/accuracy/rejected_methods", method)
    try:
        return tank_of(problem, name, parts, lanes=1)
    finally:
        del INTEGRATORS[name]


def work_of(tank: Tank, name: str) -> np.ndarray:
    """Force evaluations, factorisations and solves of the fish of a tank so far."""
    work = np.array([tank.counters[kind][0] for kind in ("force_evaluations", "factorisations", "solves")])
    if name in REJECTED_METHODS:
        work[:2] += REJECTED_METHODS[name].once
    if name == "step_doubling":
        work[0] += tank._engine.blocks[0].work.spent[0]
    return work


def measure(problem: Problem, name: str, substeps: int, reference_path: np.ndarray) -> dict:
    """A row: how far a method is from the reference solution, and its work a control interval, until it failed."""
    tank = tank_by(problem, name, substeps)
    path, steps = np.empty_like(reference_path), round(problem.fish.control_interval / tank.dt)
    for k, goal in enumerate(problem.contraction):
        tank.drive(goal[None], steps)
        path[k] = tank.position[0]
        if not tank.alive[0]:
            break
    valid = bool(tank.alive[0])
    forces, factorisations, solves = (round(float(value), 3) for value in work_of(tank, name) / (k + 1))
    return {
        "scene": problem.name,
        "method": name,
        "substeps": substeps,
        "error": distance(problem.fish, path, reference_path) if valid else np.inf,
        "outcome": "bounded" if valid else "failed",
        "forces_per_interval": forces,
        "factorisations_per_interval": factorisations,
        "solves_per_interval": solves,
    }


def sweep(problem: Problem, reference_path: np.ndarray, bar: tqdm) -> list[dict]:
    """Every method and every comparison at every step, largest first, until one is accurate enough."""
    rows = []
    for name in (*REJECTED_METHODS, *COMPARISONS):
        for substeps in SUBSTEPS:
            bar.set_postfix_str(f"{problem.name} {name} {substeps}")
            rows.append(measure(problem, name, substeps, reference_path))
            if rows[-1]["error"] < ENOUGH:
                break
        bar.update()
    return rows


def draw(rows: list[dict], path: Path) -> None:
    """A column a scene, a row a family: error against force evaluations, and above it a line a method for failures."""
    plt = pyplot()

    every_step = tuple(method.name for method in MATRIX_EVERY_STEP)
    families = {
        "a matrix made at every step": every_step,
        "a constant matrix, or none": tuple(name for name in REJECTED_METHODS if name not in every_step),
    }
    heights = [height for names in families.values() for height in (len(names) + len(COMPARISONS), 40)]
    figure, panels = plt.subplots(4, 3, figsize=(15, 12.5), height_ratios=heights, sharex=True, layout="constrained")
    for half, (title, names) in enumerate(families.items()):
        names = (*names, *COMPARISONS)
        for strip, panel, scene in zip(*panels[2 * half : 2 * half + 2], SCENES, strict=True):
            for place, name in enumerate(names):
                draw_line(strip, panel, [entry for entry in rows if entry["scene"] == scene], name, place)
            panel.axhline(ACCURATE, color="#bbbbbb", linewidth=0.8, zorder=0)
            panel.set(xscale="log", yscale="log", ylim=(1e-5, 1.3 * TOP), xlim=(0.9, 800))
            panel.grid(alpha=0.2)
            strip.set(yticks=[], ylim=(len(names) - 0.4, -0.6))
        panels[2 * half, 0].set_ylabel("failed")
        panels[2 * half + 1, 0].set_ylabel("error, body lengths")
        figure.legend(*panels[2 * half + 1, 0].get_legend_handles_labels(), title=title, frameon=False,
                      loc=f"outside right {('upper', 'lower')[half]}")  # fmt: skip
    for top, bottom, scene in zip(panels[0], panels[-1], SCENES, strict=True):
        top.set_title(problems()[scene].title.replace(" and as", "\nand as"))
        bottom.set_xlabel("force evaluations per control interval")
    save(figure, path)


def draw_line(strip, panel, rows: list[dict], name: str, place: int) -> None:
    """One method on one scene: its valid runs in the panel, the failed ones hollow in the strip above."""
    colour, marker = METHOD_STYLE[name] if name in COMPARISONS else MARKS[name]
    style = {"color": colour, "marker": marker, "markersize": 8 if name == "leapfrog_chebyshev" else 4.5}
    valid = [row for row in rows if row["method"] == name and np.isfinite(row["error"])]
    failed = [row["forces_per_interval"] for row in rows if row["method"] == name and not np.isfinite(row["error"])]
    dashes = "--" if name in COMPARISONS else "-"
    panel.plot([row["forces_per_interval"] for row in valid], [min(row["error"], TOP) for row in valid],
               linewidth=1.2, linestyle=dashes, label=name, **style)  # fmt: skip
    strip.plot(failed, [place] * len(failed), linestyle="", fillstyle="none", **style)


def main() -> int:
    """The command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--draw", action="store_true", help="draw the chart again from the CSV")
    if not parser.parse_args().draw:
        rows = []
        with tqdm(total=len(SCENES) * (len(REJECTED_METHODS) + len(COMPARISONS)), unit="sweep") as bar:
            for scene in SCENES:
                bar.set_postfix_str(f"{scene} reference")
                rows += sweep(problems()[scene], reference(problems()[scene])[0], bar)
                write_csv(CSV, rows, COMMAND)  # as it comes: Ctrl-C leaves what is done
    else:
        rows = read_table(CSV)
    draw(rows, RESULTS / "ideas.svg")
    print(f"written to {RESULTS / CSV} and the chart beside it")
    return 0


if __name__ == "__main__":
    sys.exit(main())
