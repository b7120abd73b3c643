"""Convergence of the finest body under mesh refinement: levels 1 to 3 against level 4, in scenes of two tasks.

python -m benchmarks.bodies.convergence     results/convergence.csv (8 minutes on two cores)

Scenes and distances are those of `benchmarks.bodies.fidelity`. One material serves all levels. Level 4, of 1,873 nodes,
is used nowhere else: it says what level 3, the reference of all other measurements, still lacks.
"""

import argparse
import multiprocessing

from benchmarks.bodies.fidelity import FIRST_SEED, SEEDS
from benchmarks.common.motion import Motion, errors, play, record
from benchmarks.common.statistics import interval_of
from benchmarks.common.tables import write_csv
from fish_env import make_fish

LEVELS = (4, 3, 2, 1)
TASKS = ("left_after_right", "target")  # the most abrupt scenes, and those that converge worst


def moved(job: tuple[str, int, int]) -> Motion:
    """Motion of a task's scenes, of so many seeds, at a level."""
    task, level, seeds = job
    return play(make_fish("tetrahedral", level=level), record(task, seeds, FIRST_SEED), volumes=True)


def run(seeds: int = SEEDS, tasks=TASKS, levels=LEVELS, each=map) -> list[dict]:
    """A row for each task, level and quantity: distances to the finest of `levels`, and to the next finer one.

    `each` is a `map`, which may share its calls out to processes.
    """
    jobs, rows = [(task, level, seeds) for level in levels for task in tasks], []
    motions = dict(zip(jobs, each(moved, jobs), strict=True))
    for task in tasks:
        for level in levels[1:]:
            fish, motion = make_fish("tetrahedral", level=level), motions[task, level, seeds]
            for against in dict.fromkeys((levels[0], level + 1)):
                other = motions[task, against, seeds]
                for name, values in errors(motion, other, fish.control_interval).items():
                    mean, low, high = interval_of(values)
                    rows.append({
                        "task": task, "level": level, "nodes": fish.body.mass.size, "against": against,
                        "quantity": name, "error": f"{mean:.4g}", "low": f"{low:.4g}", "high": f"{high:.4g}",
                        "seeds": seeds, "first_seed": FIRST_SEED,
                        "failed": sum(bool(text) for text in motion.failure + other.failure),
                    })  # fmt: skip
    return rows


def main() -> None:
    """Run the scenes and write the table."""
    argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter).parse_args()
    with multiprocessing.get_context("spawn").Pool() as pool:
        rows = run(each=pool.imap)
    print(write_csv("convergence.csv", rows, "python -m benchmarks.bodies.convergence"))
    for row in rows:
        if row["quantity"] == "all":
            print(f"{row['task']:18} level {row['level']} from {row['against']}: {100 * float(row['error']):.2f} %")


if __name__ == "__main__":
    main()
