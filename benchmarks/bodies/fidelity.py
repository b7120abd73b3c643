"""Distance of every body to the finest one, and its cost, in a scene of every task.

A scene is an episode of the task with the motor controllers: the contractions of the default fish's muscles are
recorded and played to every body, from rest, open loop. The finest body is that of tetrahedra at level 3; level 2 says
how much it still changes. Bodies are timed in turn, in processor time, many fish together as in training.
"""

import numpy as np
from tqdm import tqdm

from benchmarks.common.charts import BLUE, GREEN, ORANGE, PINK, legend_below, panels, save, words
from benchmarks.common.motion import errors, play, record
from benchmarks.common.statistics import interval_of
from benchmarks.common.tables import IMAGES, publish, read_table, select
from benchmarks.common.timing import Swim, timed
from fish_env import TASKS, Fish, Tank, make_fish

BODIES = (
    ("planar", {}), ("mass_spring", {}), ("two_layer", {}),
    ("tetrahedral", {"level": 1}), ("tetrahedral", {"level": 2}), ("tetrahedral", {"level": 3}),
)  # fmt: skip
FINEST = ("tetrahedral", 3)
SEEDS, FIRST_SEED = 3, 5_000
BATCH, REPEATS = 64, 9  # fish timed together, and timings whose median is taken
COLOURS = {
    ("planar", ""): (GREEN, "v"), ("mass_spring", ""): (BLUE, "o"), ("two_layer", ""): (ORANGE, "^"),
    ("tetrahedral", 1): (PINK, "s"), ("tetrahedral", 2): ("black", "D"),
}  # fmt: skip


def every_fish() -> dict[tuple, Fish]:
    """The fish of BODIES, by body and level."""
    return {(name, options.get("level", "")): make_fish(name, **options) for name, options in BODIES}


def costs_of(fish: dict, contractions: np.ndarray) -> dict:
    """Processor seconds a simulated second of one fish, of each kind, timed in turn."""
    tanks = [Tank(one, BATCH if one.body.mass.size < 500 else 1, water=one.water, threads=1) for one in fish.values()]
    told = [contractions[np.resize(np.arange(SEEDS), tank.num_fish)].swapaxes(0, 1).copy() for tank in tanks]
    found = timed([Swim(tank, goals) for tank, goals in zip(tanks, told, strict=True)], REPEATS)
    spans = [one.control_interval for one in fish.values()]
    return {key: 1e-6 * cost.time[1] / span for key, cost, span in zip(fish, found, spans, strict=True)}


def run() -> list[dict]:
    """Every body in a scene of every task, a row for each quantity."""
    fish, rows = every_fish(), []
    scenes = {task: record(task, SEEDS, FIRST_SEED) for task in TASKS}
    cost = costs_of(fish, scenes["swim"])
    with tqdm(total=len(scenes) * len(fish), unit="motion") as bar:
        for task, contractions in scenes.items():
            motions = {}
            for key in sorted(fish, key=lambda key: -cost[key]):
                bar.set_postfix_str(f"{task}, {key[0]} {key[1]}")
                motions[key] = play(fish[key], contractions, volumes=True)
                bar.update()
            for key, motion in motions.items():
                failed = sum(map(bool, motion.failure))
                for name, values in errors(motion, motions[FINEST], fish[key].control_interval).items():
                    mean, low, high = (np.inf,) * 3 if failed else interval_of(values)
                    rows.append({
                        "task": task, "body": key[0], "level": key[1], "nodes": fish[key].body.mass.size,
                        "cost_s_per_s": f"{cost[key]:.5g}", "quantity": name,
                        "error": f"{mean:.4g}", "low": f"{low:.4g}", "high": f"{high:.4g}",
                        "seeds": SEEDS, "first_seed": FIRST_SEED, "failed": failed,
                    })  # fmt: skip
    return rows


def draw() -> None:
    """Distance over cost, a panel a task."""
    rows = [row for row in read_table("fidelity.csv", quantity="all") if 0.0 < row["error"] < np.inf]
    figure, axes = panels(3, 7.0, 2, sharex=True, sharey=True)
    for panel, task in zip(axes, dict.fromkeys(row["task"] for row in rows), strict=False):
        for row in select(rows, task=task):
            x, y, low, high = 1e3 * row["cost_s_per_s"], *(100 * row[name] for name in ("error", "low", "high"))
            name, level = row["body"], row["level"]
            colour, marker = COLOURS[name, level]
            label = f"{name.replace('_', '-')}{f', level {level}' if level else ''}"
            panel.errorbar(x, y, [[y - low], [high - y]], fmt=marker, color=colour, capsize=3, label=label)
        panel.set(xscale="log", yscale="log", xlim=(0.05, 1000), ylim=(0.3, 100), title=words(task))
        panel.set_yticks(ticks := [0.5, 1, 2, 5, 10, 20, 50, 100], [f"{tick:g}" for tick in ticks])
        panel.set_yticks([], minor=True)
    axes[-2].set_xlabel("processor time of a fish, ms per simulated second")
    legend_below(figure, 5)
    figure.supylabel("distance to the finest body, %")
    save(figure, IMAGES / "fidelity.svg")


if __name__ == "__main__":
    publish(__doc__, {"fidelity.csv": run}, draw)
