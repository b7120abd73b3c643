"""What each body costs and how far it is from the finest one, in a scene of every task.

python -m benchmarks.bodies.fidelity              results/fidelity.csv and docs/images/fidelity.svg (some 12 minutes)
python -m benchmarks.bodies.fidelity --chart      the chart only, from the CSV
python -m benchmarks.bodies.fidelity --seeds 2    fewer scenes a task: quick, with wider intervals
taskset -c 1 python -m benchmarks.bodies.fidelity --cost    results/body_costs.csv, timed side by side on one processor

A scene is an episode of the task with the motor controllers: the contractions of the default fish's muscles are
recorded and played to every body, from rest, open loop. The finest body is that of tetrahedra at its highest level;
the level below says how much it still changes.
"""

import argparse
import time
from pathlib import Path

import numpy as np
from tqdm import tqdm

from benchmarks.common.charts import pyplot, save
from benchmarks.common.motion import errors, play, record
from benchmarks.common.statistics import interval_of
from benchmarks.common.tables import IMAGES, read_table, write_csv
from fish_env import TASKS, Tank, make_fish
from fish_env.bodies import Fish

BODIES = (
    ("planar", {}), ("mass_spring", {}), ("two_layer", {}),
    ("tetrahedral", {"level": 1}), ("tetrahedral", {"level": 2}), ("tetrahedral", {"level": 3}),
)  # fmt: skip
FINEST = ("tetrahedral", 3)
SEEDS, FIRST_SEED = 3, 5_000
BATCH, REPEATS = 64, 9  # fish timed together, as in learning, and timings whose median is taken
IN_A_ROW = 5  # control intervals timed together
TOLERANCES = (0.05, 0.1, 0.2, 0.5)


def costs_of(fish: dict, contractions: np.ndarray) -> dict:
    """Processor seconds a simulated second of one fish, of each kind, timed in turn: medians of REPEATS."""
    tanks = {
        key: Tank(one, BATCH if one.body.mass.size < 500 else 1, water=one.water, threads=1)
        for key, one in fish.items()
    }
    spans: dict = {key: [] for key in fish}
    for k in range(REPEATS + 1):  # the first is compilation
        for key, tank in tanks.items():
            interval, muscles = fish[key].control_interval, fish[key].num_muscles
            goals = [np.resize(contractions[:, k + j], (tank.num_fish, muscles)) for j in range(IN_A_ROW)]
            if tank.num_fish == 1:
                goals = goals[:1]
            else:
                tank.drive(goals[0], round(interval / tank.dt))  # or the first would fetch what another body displaced
            begun = time.process_time()  # of one thread: other processes count less
            for goal in goals:
                tank.drive(goal, round(interval / tank.dt))
            spans[key].append((time.process_time() - begun) / len(goals) / tank.num_fish / interval)
    return {key: float(np.median(found[1:])) for key, found in spans.items()}


def costs(fish: dict) -> list[dict]:
    """What each body costs beside the default one."""
    cost = costs_of(fish, record("swim", 2, FIRST_SEED))
    return [
        {
            "body": key[0], "level": key[1], "nodes": one.body.mass.size, "cost_s_per_s": f"{cost[key]:.4g}",
            "simulated_s_per_s": f"{1 / cost[key]:.4g}",
            "over_mass_spring": f"{cost[key] / cost['mass_spring', '']:.3f}",
            "fish_together": BATCH if one.body.mass.size < 500 else 1, "repeats": REPEATS,
        }
        for key, one in fish.items()
    ]  # fmt: skip


def every_fish() -> dict[tuple, Fish]:
    """The fish of BODIES, by body and level."""
    return {(name, options.get("level", "")): make_fish(name, **options) for name, options in BODIES}


def run(seeds: int) -> list[dict]:
    """Every body in a scene of every task, a row for each quantity."""
    fish = every_fish()
    scenes = {task: record(task, seeds, FIRST_SEED) for task in TASKS}
    cost = costs_of(fish, scenes["swim"])
    rows = []
    with tqdm(total=len(scenes) * len(fish), unit="motion") as bar:
        for task, contractions in scenes.items():
            motions = {}
            for key in sorted(fish, key=lambda key: -cost[key]):
                bar.set_postfix_str(f"{task}, {key[0]} {key[1]}")
                motions[key] = play(fish[key], contractions, volumes=True)
                bar.update()
            for key, motion in motions.items():
                valid = [not text for text in motion.failure]
                against = {"finest": FINEST} | ({"mass_spring": ("mass_spring", "")} if key[0] == "planar" else {})
                for reference, name, values in (
                    (label, name, values)
                    for label, other in against.items()
                    for name, values in errors(motion, motions[other], fish[key].control_interval).items()
                ):
                    mean, low, high = interval_of(values) if all(valid) else (np.inf,) * 3
                    rows.append({
                        "task": task, "body": key[0], "level": key[1], "nodes": fish[key].body.mass.size,
                        "cost_s_per_s": f"{cost[key]:.5g}", "against": reference, "quantity": name,
                        "error": f"{mean:.4g}", "low": f"{low:.4g}", "high": f"{high:.4g}",
                        "seeds": seeds, "first_seed": FIRST_SEED, "failed": len(valid) - sum(valid),
                    })  # fmt: skip
    return rows


def overall(rows: list[dict], task: str) -> list[dict]:
    """Rows of a task with the error over all, against the finest body."""
    return [r for r in rows if (r["task"], r["quantity"], r["against"]) == (task, "all", "finest")]


def least_expensive(rows: list[dict], task: str, tolerance: float) -> dict | None:
    """The least expensive body whose error over all is within the tolerance in a task's scene, or None."""
    fit = [row for row in overall(rows, task) if 0.0 < float(row["error"]) <= tolerance]
    return min(fit, key=lambda row: float(row["cost_s_per_s"]), default=None)


def label(row: dict) -> str:
    """A body and its level in short."""
    return row["body"] + (f" {row['level']}" if row["level"] else "")


def chart(rows: list[dict]) -> Path:
    """Error over cost, a panel a task, the least expensive body inside each tolerance ringed."""
    plt = pyplot()

    tasks = list(dict.fromkeys(row["task"] for row in rows))
    figure, axes = plt.subplots(2, 3, figsize=(12, 7), sharex=True, sharey=True)
    colours = {"planar": "tab:green", "mass_spring": "tab:blue", "two_layer": "tab:orange", "tetrahedral": "tab:red"}
    for ax, task in zip(axes.flat, tasks, strict=False):
        for row in overall(rows, task):
            if not 0.0 < float(row["error"]) < np.inf:
                continue
            x, y = 1e3 * float(row["cost_s_per_s"]), 100 * float(row["error"])
            bars = [[y - 100 * float(row["low"])], [100 * float(row["high"]) - y]]
            ax.errorbar(x, y, bars, fmt="o", color=colours[row["body"]], capsize=3)
            place = {"planar": (-14, -17), "two_layer": (4, 8), "tetrahedral 2": (-20, -15)}.get(label(row), (6, 4))
            ax.annotate(label(row), (x, y), xytext=place, textcoords="offset points", fontsize=8)
        for tolerance in TOLERANCES:
            ax.axhline(100 * tolerance, color="0.85", lw=0.8, zorder=0)
            best = least_expensive(rows, task, tolerance)
            if best:
                ax.plot(1e3 * float(best["cost_s_per_s"]), 100 * float(best["error"]), "o", ms=13, mfc="none", mec="k")
        ax.set(xscale="log", yscale="log", xlim=(0.03, 5000), ylim=(0.3, 100), title=task.replace("_", " "))
        ax.set_yticks(ticks := [0.5, 1, 2, 5, 10, 20, 50, 100], [f"{tick:g}" for tick in ticks])
        ax.set_yticks([], minor=True)
    for ax in axes[-1]:
        ax.set_xlabel("cost, ms a simulated second")
    for ax in axes[:, 0]:
        ax.set_ylabel("distance to the finest body, %")
    handles = [plt.Line2D([], [], marker="o", ls="", color=c, label=b) for b, c in colours.items()]
    handles.append(
        plt.Line2D([], [], marker="o", ls="", ms=12, mfc="none", mec="k", label="least expensive within a line")
    )
    axes.flat[-1].axis("off")
    axes.flat[-1].legend(handles=handles, loc="center", frameon=False)
    figure.tight_layout()
    path = IMAGES / "fidelity.svg"
    save(figure, path)
    return path


def main() -> None:
    """Run the scenes and draw the chart."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--chart", action="store_true", help="only draw the chart")
    parser.add_argument("--seeds", type=int, default=SEEDS, help=f"scenes a task ({SEEDS})")
    parser.add_argument("--cost", action="store_true", help="only what each body costs, into results/body_costs.csv")
    chosen = parser.parse_args()
    if chosen.cost:
        rows = costs(every_fish())
        write_csv("body_costs.csv", rows, "taskset -c 1 python -m benchmarks.bodies.fidelity --cost")
        for row in rows:
            print(row)
        return
    if not chosen.chart:
        write_csv("fidelity.csv", run(chosen.seeds), "python -m benchmarks.bodies.fidelity")
    rows = read_table("fidelity.csv")
    print(chart(rows))
    for task in dict.fromkeys(row["task"] for row in rows):
        for tolerance in TOLERANCES:
            best = least_expensive(rows, task, tolerance)
            print(f"{task:18} within {100 * tolerance:3.0f} %: {label(best) if best else 'none'}")


if __name__ == "__main__":
    main()
