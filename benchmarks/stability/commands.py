"""Does a command break a fish? Every body at its default step, 10 s of random, bang-bang and oscillating actions.

python -m benchmarks.stability.commands                     results/commands.csv; exit 1 if a fish has failed
python -m benchmarks.stability.commands --body two_layer    a trial of one body: nothing is written
"""

import argparse
import sys

from tqdm import tqdm

from benchmarks.common.tables import write_csv
from benchmarks.stability.attack import mistreat, usual_energy
from benchmarks.stability.cases import Settings
from benchmarks.stability.margins import settings
from benchmarks.stability.mistreatment import GOALS, Family
from fish_env import make_fish

COMMAND = "python -m benchmarks.stability.commands"
FISH = {"planar": 10_000, "mass_spring": 10_000, "two_layer": 10_000, "tetrahedral": 500}
"""Of each body, in all kinds of commands together; a fish of tetrahedra takes as long as 30 others."""


def measure(name: str, fish: int) -> list[dict]:
    """A row for each kind of commands."""
    how = Settings(*settings(make_fish(name), None, None))
    usual, counts = usual_energy(make_fish(name), how), [fish // len(GOALS)] * len(GOALS)
    counts[0] += fish - sum(counts)
    with tqdm(total=fish, unit="fish", desc=name) as bar:
        return [
            mistreat(name, Family(kind, 1.0, kind), count, how, seed, usual, bar)[0]
            for seed, (kind, count) in enumerate(zip(GOALS, counts, strict=True))
        ]


def main() -> int:
    """The command line; 1 if a fish has failed."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--body", choices=FISH, help="only this one")
    parser.add_argument("--fish", type=int, help="so many of each body")
    chosen = parser.parse_args()
    bodies = FISH if chosen.body is None else (chosen.body,)
    rows = [row for name in bodies for row in measure(name, chosen.fish or FISH[name])]
    for row in rows:
        print(f"{row['body']:14}{row['family']:14}{row['failures']:6} of {row['fish']:6} fail  {row['reasons']}")
    if chosen.body is None and chosen.fish is None:
        print(write_csv("commands.csv", rows, COMMAND))
    return int(any(row["failures"] for row in rows))


if __name__ == "__main__":
    sys.exit(main())
