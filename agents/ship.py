"""Ship the median of several runs: copy its policy to agents/pretrained/<task>/ and write what all of them scored.

python -m agents.ship swim runs/swim/<time> runs/swim/<time> runs/swim/<time>
"""

import argparse
import csv
import json
import shutil
from pathlib import Path

PRETRAINED = Path(__file__).parent / "pretrained"


def ship(task: str, runs: list[Path]) -> Path:
    """Copy the policy of the run with the median speed; results.csv gets a row a run. Returns the copied file."""
    rows = []
    for run in runs:
        results = json.loads((run / "results.json").read_text())
        config = json.loads((run / "config.json").read_text())
        gait, policy = results["rows"][1], results["rows"][2]
        if config["task"] != task:
            raise ValueError(f"{run} is a run of task {config['task']!r}, not {task!r}")
        rows.append(
            {
                "seed": config["seed"],
                "timesteps": config["config"]["timesteps"],
                "speed": policy["speed"],
                "slowest": policy["lowest"],
                "gait_speed": gait["speed"],
                "gait_own_speed": gait["own_speed"],
                "failures": policy["failures"],
                "training_seconds": last_seconds(run / "curve.csv"),
            }
        )
    order = sorted(range(len(rows)), key=lambda k: rows[k]["speed"])
    median = order[len(order) // 2]
    folder = PRETRAINED / task
    folder.mkdir(parents=True, exist_ok=True)
    for name in ("policy.npz", "config.json"):
        shutil.copy(runs[median] / name, folder / name)
    with (folder / "results.csv").open("w", newline="") as file:
        writer = csv.DictWriter(file, rows[0].keys(), lineterminator="\n")
        writer.writeheader()
        writer.writerows(rows)
    return folder / "policy.npz"


def last_seconds(curve: Path) -> float:
    """Training time in the last row of a learning curve, s."""
    with curve.open() as file:
        return float(list(csv.DictReader(file))[-1]["seconds"])


def main() -> None:
    """The command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("task")
    parser.add_argument("runs", type=Path, nargs="+")
    arguments = parser.parse_args()
    print(f"shipped {ship(arguments.task, arguments.runs)}")


if __name__ == "__main__":
    main()
