"""Does the finest body converge under mesh refinement? Levels 1 to 3 against level 4, in a scene of every task.

python -m benchmarks.bodies.convergence              results/convergence.csv (half an hour)
python -m benchmarks.bodies.convergence --seeds 1    fewer scenes a task

The scenes and the distances are those of `benchmarks.bodies.fidelity`. One material serves all levels. Level 4, of
1,873 nodes, is used nowhere else: it says what the finest body of all other measurements, level 3, still lacks.
"""

import argparse

from tqdm import tqdm

from benchmarks.bodies.fidelity import FIRST_SEED, SEEDS
from benchmarks.common.motion import errors, play, record
from benchmarks.common.statistics import interval_of
from benchmarks.common.tables import write_csv
from fish_env import TASKS, make_fish

LEVELS = (4, 3, 2, 1)


def run(seeds: int, tasks=tuple(TASKS), levels=LEVELS) -> list[dict]:
    """A row for each task, level and quantity: distances to the finest of `levels`, and to the next finer one."""
    fish = {level: make_fish("tetrahedral", level=level) for level in levels}
    rows = []
    with tqdm(total=len(tasks) * len(levels), unit="motion", mininterval=10) as bar:
        for task in tasks:
            contractions, motions = record(task, seeds, FIRST_SEED), {}
            for level in levels:
                bar.set_postfix_str(f"{task}, level {level}")
                motions[level] = play(fish[level], contractions, volumes=True)
                bar.update()
            for level in levels[1:]:
                failed = sum(bool(text) for text in motions[level].failure + motions[levels[0]].failure)
                for against in dict.fromkeys((levels[0], level + 1)):
                    found = errors(motions[level], motions[against], fish[level].control_interval)
                    for name, values in found.items():
                        mean, low, high = interval_of(values)
                        rows.append({
                            "task": task, "level": level, "nodes": fish[level].body.mass.size, "against": against,
                            "quantity": name, "error": f"{mean:.4g}", "low": f"{low:.4g}", "high": f"{high:.4g}",
                            "seeds": seeds, "first_seed": FIRST_SEED, "failed": failed,
                        })  # fmt: skip
    return rows


def main() -> None:
    """Run the scenes and write the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=SEEDS, help=f"scenes a task ({SEEDS})")
    rows = run(parser.parse_args().seeds)
    print(write_csv("convergence.csv", rows, "python -m benchmarks.bodies.convergence"))
    for row in rows:
        if row["quantity"] == "all":
            print(f"{row['task']:18} level {row['level']} from {row['against']}: {100 * float(row['error']):.2f} %")


if __name__ == "__main__":
    main()
