"""The stress test: try to make every body fail, as a user's agent might.

    python -m benchmarks.stability.stress               every body (10 min); exit 1 if the default method fails
    python -m benchmarks.stability.stress --body planar --fish 100 --evaluations 50     a trial: nothing is written

Thousands of fish at the defaults are driven at random, bang-bang at their own natural frequencies, and left against
right, from perturbed, fast, crumpled and inverted starts, softer and stiffer, lighter and heavier; then a search
(CMA-ES) looks for the actions that stretch them most. A fish that fails is run again from its start with RK4 at an
eighth of the step: if that fails too, the cause is what was done to the fish, not the method. The worst cases are
stored in tests/worst.npz.
"""

import math
import sys

import numpy as np
from tqdm import tqdm

from benchmarks.common.problems import scaled, swimming
from benchmarks.common.tables import make_parser, write_csv
from benchmarks.stability.cases import STORED, Settings, Tally, case_of, drive, own_settings, store, tank_at
from benchmarks.stability.mistreatment import GOALS, LEVELS, Family, at_rest, beginning, families
from benchmarks.stability.stress_search import search
from fish_env import BODIES, Fish, make_fish

COMMAND = "python -m benchmarks.stability.stress"
FISH, EVALUATIONS = 10_000, 10_000  # of the default fish: in all families; of the search
BATCH = 500  # fish at a time
OTHERS = 5  # times fewer fish and evaluations of bodies that are not the default


def mistreat(name: str, family: Family, count: int, how: Settings, seed: int, usual: float, bar):
    """Drive `count` fish of a family; its row of the CSV, and its worst cases."""
    fish = scaled(make_fish(name), stiffness=family.stiffness, mass=family.mass)
    tally, cases = Tally(fish, family, how), []
    for first in range(0, count, BATCH):
        size = min(BATCH, count - first)
        generator = np.random.default_rng([seed, first])
        start = beginning(family.start, fish, size, generator)
        goals = GOALS[family.kind](fish, size, generator)
        tank, found, lost = tally.drive(start, goals)
        worst = np.argsort(np.where(tank.alive, found["stretch"], 0.0))[: -1 - STORED : -1]
        for i in (*worst[tank.alive[worst]], *lost[:STORED]):
            case = case_of(fish, family, how, *start, goals, found, i)
            cases.append(case | {"failure": str(tank.failure[i])})
        tank.close()
        bar.update(size)
    return tally.row(usual), cases


def usual_energy(fish: Fish, how: Settings) -> float:
    """Highest energy of a fish that swims the gait, J."""
    tank = tank_at(fish, how, *at_rest(fish, 1, None))
    return float(drive(tank, LEVELS * swimming(fish, 100)[:, None])["energy"][0])


def stress_body(name: str, how: Settings, fish: int, evaluations: int, bar) -> tuple[list[dict], list[dict]]:
    """Drive so many fish of a body, in all families, and search: rows of the CSV, and the worst cases."""
    usual = usual_energy(make_fish(name), how)
    rows, cases = [], []
    for seed, family in enumerate(families()):
        bar.set_postfix_str(f"{name}, {family.name}")
        row, found = mistreat(name, family, math.ceil(fish * family.share), how, seed, usual, bar)
        rows.append(row)
        cases += found
    bar.set_postfix_str(f"{name}, search")
    more_rows, more_cases = search(name, evaluations, how, usual, bar)
    return rows + more_rows, cases + more_cases


def stress(bodies=tuple(BODIES), fish=FISH, evaluations=EVALUATIONS) -> list[dict]:
    """Test bodies; a row of the table for each family and search.

    Other bodies than the default one take OTHERS times fewer fish and evaluations. The CSV and the stored cases are
    replaced only by a test of every body with the default numbers.
    """
    rows, cases, default = [], [], make_fish().name
    effort = {name: 1 if name == default else OTHERS for name in bodies}
    with tqdm(total=sum((fish + evaluations) // less for less in effort.values()), unit="fish") as bar:
        for name, less in effort.items():
            found = stress_body(name, own_settings(make_fish(name)), fish / less, evaluations // less, bar)
            rows += found[0]
            cases += found[1]
    if (set(bodies), fish, evaluations) == (set(BODIES), FISH, EVALUATIONS):
        write_csv("stress.csv", rows, COMMAND)
        store(cases)
    return rows


def report(rows: list[dict]) -> bool:
    """Print the table; True if every failure of the default fish that was run again is RK4's too."""
    print(f"{'body':12}{'family':40}{'fish':>7}{'failed':>8}{'RK4 too':>12}{'stretch':>9}{'energy':>8}")
    for row in rows:
        again = f"{row['rk4_fails_too']} of {row['rerun_with_rk4']}" if row["rerun_with_rk4"] else ""
        print(f"{row['body']:12}{row['family']:40}{row['fish']:7}{row['failures']:8}{again:>12}"
              f"{row['worst_stretch']:9.3f}{row['peak_energy_over_gait']:8.1f}  {row['reasons']}")  # fmt: skip
    own = [row for row in rows if row["body"] == make_fish().name]
    return all(row["rk4_fails_too"] == row["rerun_with_rk4"] for row in own)


def main() -> int:
    """The command line; exit 1 if the default fish fails where RK4 does not."""
    parser = make_parser(__doc__)
    parser.add_argument("--body", choices=BODIES, help="only this one")
    parser.add_argument("--fish", type=int, default=FISH, help=f"in all families of random actions ({FISH:,})")
    parser.add_argument("--evaluations", type=int, default=EVALUATIONS, help=f"of the search ({EVALUATIONS:,})")
    chosen = parser.parse_args()
    bodies = (chosen.body,) if chosen.body else tuple(BODIES)
    return 0 if report(stress(bodies, chosen.fish, chosen.evaluations)) else 1


if __name__ == "__main__":
    sys.exit(main())
