"""Speed charted against accuracy: every integrator, at many steps, on every scene of `benchmarks/problems.py`.

    taskset -c 1 python -m benchmarks.work_precision            all scenes (about 12 min): CSV and charts
    taskset -c 1 python -m benchmarks.work_precision --draw     the charts again, from the CSV
    taskset -c 1 python -m benchmarks.work_precision --bars     the default and the better method against their bars

The error is the largest distance, in body lengths, of any node at the end of any control interval from where it truly
is. The time is that of one fish of a batch of 8 on one core, per control interval. Failed runs are at the top edge.
"""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent.parent))  # so that it runs as a script as well as with -m

import argparse
import csv
import time
from statistics import median

import numpy as np
from tqdm import tqdm

from benchmarks.margins import stretch_and_energy
from benchmarks.problems import Problem, distance, independent, magnified, problems, reference, run, steps_of, tank_of
from benchmarks.provenance import RESULTS, write_csv
from fish_env import INTEGRATORS, make_fish

SUBSTEPS = (1, 2, 3, 4, 5, 6, 8, 10, 12, 16, 24, 32, 48, 64, 96, 128, 192, 256, 384, 512, 768, 1024)
FIXED = [name for name, record in INTEGRATORS.items() if record.kind != "adaptive"]
DEFAULT = make_fish().integrator
LINES = [*((name, np.inf) for name in FIXED), (DEFAULT, make_fish().refine)]
"""Methods, and what refines their steps: the default method with its own refinement too."""
DEAREST = {"linearly implicit": 96}  # most steps a control interval that are worth their while
FEWEST = 7  # sound runs a method must show on a scene, if it has them
BATCH, REPEATS = 8, 3
ACCURATE = 0.01  # body lengths
COMMAND = "python -m benchmarks.work_precision"
CSV = RESULTS / "work_precision.csv"
TEXTBOOK = ("explicit_euler", "symplectic_euler", "midpoint", "rk4", "semi_implicit", "linearly_implicit",
            "linearly_implicit_projected", "linearly_implicit_water", "rosenbrock")  # fmt: skip
STYLE = {  # colours told apart by colour-blind readers (Okabe & Ito), one marker a family
    "explicit_euler": ("#999999", "x"),
    "symplectic_euler": ("#E69F00", "o"),
    "midpoint": ("#56B4E9", "o"),
    "rk4": ("#0072B2", "o"),
    "semi_implicit": ("#D55E00", "s"),
    "linearly_implicit": ("#009E73", "^"),
    "linearly_implicit_projected": ("#66C2A5", "v"),
    "linearly_implicit_water": ("#1B9E77", "<"),
    "rosenbrock": ("#CC79A7", "D"),
    "leapfrog_chebyshev": ("#000000", "*"),
}


def timed(problem: Problem, name: str, substeps: int, refine: float) -> float:
    """Microseconds of computing one control interval of one fish, median of repeats, in a batch on one core."""
    goals = [np.repeat(goal[None], BATCH, axis=0) for goal in problem.contraction]
    taken = []
    for _ in range(REPEATS):
        tank = tank_of(problem, name, substeps, BATCH, refine=refine)
        begin = time.perf_counter()
        for goal in goals:
            tank.drive(goal, substeps)
        taken.append((time.perf_counter() - begin) / BATCH / len(goals) * 1e6)
    return median(taken)


def measure(problem: Problem, name: str, substeps: int, truth: np.ndarray, seconds=True, refine=np.inf) -> dict:
    """One row: what a method at a step costs on a scene, and how far it is from the truth. Failed runs have no cost."""
    path, tank = run(problem, name, substeps, refine=refine)
    sound = bool(tank.alive[0])
    work = {name: int(values[0]) for name, values in tank.counters.items()}
    intervals = len(problem.contraction)
    return {
        "scene": problem.name,
        "integrator": name,
        "refine": refine,
        "substeps": substeps,
        "step_ms": problem.fish.control_interval / substeps * 1e3,
        "error": distance(problem.fish, path, truth) if sound else np.inf,
        "us_per_interval": round(timed(problem, name, substeps, refine), 3) if sound and seconds else np.nan,
        "forces_per_interval": work["force_evaluations"] / intervals if sound else np.nan,
        "factorisations_per_interval": work["factorisations"] / intervals if sound else np.nan,
        "solves_per_interval": work["solves"] / intervals if sound else np.nan,
        "refined_intervals": work["refinements"],
        "non_positive_pivots": work["non_positive_pivots"],
        "failure": tank.failure[0],
    }


def steps_worth_trying(name: str) -> list[int]:
    """Substeps of a control interval, the largest step first."""
    return [k for k in SUBSTEPS if k <= DEAREST.get(INTEGRATORS[name].kind, SUBSTEPS[-1])]


def sweep(problem: Problem, truth: np.ndarray, bar: tqdm) -> list[dict]:
    """Every method at every step, largest first; a method stops once it has enough sound rows and 1e-4 is reached."""
    rows = []
    for name, refine in LINES:
        sound = 0
        for substeps in steps_worth_trying(name):
            bar.set_postfix_str(f"{problem.name} {name} {substeps}")
            rows.append(measure(problem, name, substeps, truth, refine=refine))
            sound += np.isfinite(rows[-1]["error"])
            if sound >= FEWEST and (rows[-1]["error"] < 1e-4 or sound >= 10):
                break
        bar.update()
    return rows


def true_path(problem: Problem) -> tuple[np.ndarray, dict]:
    """The reference of a scene, and a row that says how it was made and what an independent method thinks of it."""
    truth, substeps, change = reference(problem)
    stiff = problem.name in ("turn_x100", "turn_x1000", "turn_damped")
    method, tolerance = ("Radau", 1e-9) if stiff else ("DOP853", 1e-11)
    apart = distance(problem.fish, independent(problem, method, tolerance), truth)
    row = {"scene": problem.name, "rk4_substeps": substeps, "change": change, "independent": method,
           "tolerance": tolerance, "apart": apart,
           "magnified": round(magnified(problem, truth, substeps), 1)}  # fmt: skip
    return truth, row


def energy(name: str, substeps: int, seconds=4.0) -> tuple[np.ndarray, np.ndarray]:
    """Total energy over that at the start, of the undamped fish vibrating in vacuum, at each control interval."""
    from benchmarks.problems import scaled, vibration

    problem = vibration(scaled(make_fish(), damping=0.0))
    fish = problem.fish
    tank = tank_of(problem, name, substeps)
    times, values = [], []
    for k in range(round(seconds / fish.control_interval)):
        values.append(stretch_and_energy(tank)[1][0])
        times.append(k * fish.control_interval)
        tank.advance(substeps)
        if not tank.alive[0]:
            values += [np.inf]
            times += [(k + 1) * fish.control_interval]
            break
    return np.array(times), np.array(values) / values[0]


def read() -> list[dict]:
    """The rows of the CSV, numbers as numbers."""
    with CSV.open() as file:
        rows = list(csv.DictReader(line for line in file if not line.startswith("#")))
    for row in rows:
        for key in ("error", "us_per_interval", "forces_per_interval", "step_ms", "refine"):
            row[key] = float(row[key])
        row["substeps"] = int(row["substeps"])
    return rows


def draw(rows: list[dict], across: str, label: str, path: Path, only=()) -> None:
    """One panel a scene (those of `only`, or all): error against `across`, a line a method; failed runs on top."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot as plt

    scenes = {name: problem for name, problem in problems().items() if not only or name in only}
    shape, size = ((1, len(only)), (5.2 * len(only), 4.6)) if only else ((2, 4), (16, 8.2))
    figure, panels = plt.subplots(*shape, figsize=size, sharey=True, squeeze=False, layout="constrained")
    top, bottom = 2.0, 1e-6
    for panel, (scene, problem) in zip(panels.flat, scenes.items(), strict=True):
        mine = [row for row in rows if row["scene"] == scene]
        for name, refine in LINES:
            colour, marker = STYLE.get(name, ("#444444", "P"))
            line = sorted((row for row in mine if (row["integrator"], row["refine"]) == (name, refine)),
                          key=lambda row: row["substeps"])  # fmt: skip
            sound = [row for row in line if np.isfinite(row["error"])]
            size = 9 if name == DEFAULT else 4.5
            dashes, label_of = ("--", f"{name}, refined") if np.isfinite(refine) else ("-", name)
            panel.loglog([row[across] for row in sound], [min(max(row["error"], bottom), top) for row in sound],
                         color=colour, marker=marker, markersize=size, linewidth=1.2, label=label_of,
                         linestyle=dashes)  # fmt: skip
            if sound and len(line) > len(sound):  # where failed runs would lie: a step costs what it costs
                unit = median(row[across] / row["substeps"] for row in sound)
                failed = [row["substeps"] * unit for row in line if not np.isfinite(row["error"])]
                panel.plot(failed, [top] * len(failed), linestyle="", color=colour, marker=marker,
                           markersize=size, fillstyle="none")  # fmt: skip
        panel.axhline(ACCURATE, color="#bbbbbb", linewidth=0.8, zorder=0)
        panel.set(ylim=(bottom, 1.6 * top), xlabel=label)
        panel.set_title(problem.title.replace(", ", ",\n"), fontsize=10)
        panel.grid(alpha=0.2)
    for row in panels:
        row[0].set_ylabel("error, body lengths (hollow: failed)")
    handles, names = panels[0, 0].get_legend_handles_labels()
    figure.legend(handles, names, loc="outside lower center", ncols=4 if only else 5, frameon=False)
    figure.savefig(path, metadata={"Date": None})
    plt.close(figure)


def draw_energy(path: Path) -> list[dict]:
    """Energy of the undamped fish in vacuum against time, for every method, at two steps; returns the CSV's rows."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot as plt

    rows = []
    figure, panels = plt.subplots(1, 2, figsize=(11, 4), sharey=True, layout="constrained")
    for panel, substeps in zip(panels, (16, 64), strict=True):
        for name in FIXED:
            times, values = energy(name, substeps)
            colour, _ = STYLE.get(name, ("#444444", "P"))
            shown = np.clip(values, 0.0, 2.0)
            panel.plot(times, shown, color=colour, label=name, linewidth=1.3)
            rows.append({"integrator": name, "substeps": substeps, "seconds": round(times[-1], 3),
                         "energy_at_end": values[-1], "largest": values.max()})  # fmt: skip
        panel.set(title=f"{20 / substeps:g} ms a step", xlabel="time, s", ylim=(0.0, 2.05))
        panel.grid(alpha=0.2)
    panels[0].set_ylabel("energy over that at the start (2: that or more)")
    handles, names = panels[0].get_legend_handles_labels()
    figure.legend(handles, names, loc="outside right center", frameon=False)
    figure.savefig(path, metadata={"Date": None})
    plt.close(figure)
    return rows


def draw_all() -> None:
    """Every chart from the CSV."""
    rows = read()
    draw(rows, "us_per_interval", "time, us per control interval", RESULTS / "work_precision_time.svg")
    path = RESULTS / "work_precision_turn.svg"
    draw(rows, "us_per_interval", "time, us per control interval", path, only=("turn", "turn_x10"))
    draw(rows, "forces_per_interval", "force evaluations per control interval", RESULTS / "work_precision_forces.svg")


def cheapest(rows: list[dict], scene: str, names) -> dict:
    """The row of a scene with the least time among those at least as accurate as ACCURATE, as are all smaller steps."""
    accurate = []
    mine = [row for row in rows if row["scene"] == scene and row["integrator"] in names]
    for key in dict.fromkeys((row["integrator"], row["refine"]) for row in mine):
        line = sorted((row for row in mine if (row["integrator"], row["refine"]) == key),
                      key=lambda row: -row["substeps"])  # fmt: skip
        for row in line:  # from the smallest step: stop where it first becomes inaccurate
            if not row["error"] <= ACCURATE:
                break
            accurate.append(row)
    return min(accurate, key=lambda row: row["us_per_interval"])


def bars(rows: list[dict]) -> bool:
    """Print the default's error, and the better method's time beside the cheapest textbook method's; True if met."""
    met = True
    fish = problems()["turn"].fish
    default = measure(problems()["turn"], fish.integrator, steps_of(fish), true_path(problems()["turn"])[0],
                      seconds=False, refine=fish.refine)  # fmt: skip
    print(f"default ({fish.integrator}, {fish.time_step * 1e3:g} ms, refined): error {default['error']:.2%} of a body"
          f" length over the manoeuvre, bar 1 %: {'met' if default['error'] <= ACCURATE else 'MISSED'}")  # fmt: skip
    met &= default["error"] <= ACCURATE
    for scene in ("turn", "turn_x10", "turn_x10_damped"):
        book, ours = (cheapest(rows, scene, names) for names in (TEXTBOOK, set(FIXED) - set(TEXTBOOK)))
        ratio = ours["us_per_interval"] / book["us_per_interval"]
        print(f"{problems()[scene].title}: {ours['integrator']} {ours['us_per_interval']:.1f} us "
              f"({ours['substeps']} steps, {ours['error']:.2%}), {book['integrator']} {book['us_per_interval']:.1f} us "
              f"({book['substeps']} steps, {book['error']:.2%}): ratio {ratio:.2f}, bar 0.33: "
              f"{'met' if ratio <= 1 / 3 else 'MISSED'}")  # fmt: skip
        met &= ratio <= 1 / 3
    return bool(met)


def main() -> int:
    """The command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    action = parser.add_mutually_exclusive_group()
    action.add_argument("--draw", action="store_true", help="draw the charts again from the CSV")
    action.add_argument("--bars", action="store_true", help="compare with the bars, exit 1 if one is missed")
    arguments = parser.parse_args()
    if arguments.bars:
        return 0 if bars(read()) else 1
    if not arguments.draw:
        rows, references = [], []
        with tqdm(total=len(problems()) * len(LINES), unit="sweep") as bar:
            for problem in problems().values():
                bar.set_postfix_str(f"{problem.name} reference")
                truth, row = true_path(problem)
                references.append(row)
                rows += sweep(problem, truth, bar)
                write_csv(CSV.name, rows, COMMAND)  # as it comes: Ctrl-C keeps what is done
        write_csv("work_precision_references.csv", references, COMMAND)
        write_csv("energy.csv", draw_energy(RESULTS / "energy.svg"), COMMAND)
    draw_all()
    print(f"written to {CSV} and the charts beside it")
    return 0


if __name__ == "__main__":
    sys.exit(main())
