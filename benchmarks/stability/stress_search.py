"""A search for the commands that stretch a fish most, or give it most energy, by CMA-ES."""

import numpy as np

from benchmarks.stability.cases import Settings, Tally, case_of
from benchmarks.stability.mistreatment import LEVELS, Family, beginning
from fish_env import Fish, make_fish

POPULATION, SEARCHED = 50, 200  # of the search; control intervals a candidate is driven


def decoded(fish: Fish, points: np.ndarray, grouping: str) -> np.ndarray:
    """Goals (SEARCHED,B,M) of points (B,3G) of the search: period, phase and share of a period, a muscle group each."""
    groups = fish.grouping(grouping)
    period, phase, duty = np.moveaxis(points.reshape(len(points), 3, -1)[:, :, groups], 1, 0)
    period = 2.0 * 20.0 ** (0.5 + 0.5 * np.sin(period))  # 2 to 40 control intervals
    turns = np.arange(SEARCHED)[:, None, None] / period + phase
    return (LEVELS * (turns % 1.0 < 0.5 + 0.4 * np.sin(duty))).astype(np.uint8)


def search(name: str, evaluations: int, how: Settings, usual: float, bar) -> tuple[list[dict], list]:
    """Look for the actions that stretch a fish most, or give it most energy, by CMA-ES from several starts."""
    import cma

    fish = make_fish(name)
    rows, found_cases = [], []
    goals_sought = [(grouping, aim) for grouping in ("pairs", "muscles") for aim in ("stretch", "energy")]
    for seed, (grouping, aim) in enumerate(goals_sought, start=1):
        size = 3 * (int(fish.grouping(grouping).max()) + 1)
        family = Family(f"search for {aim}, {grouping}", 0.0, "bang-bang")
        options = {"seed": seed, "popsize": POPULATION, "verbose": -9}
        strategy = cma.CMAEvolutionStrategy(np.random.default_rng(seed).uniform(-1.5, 1.5, size), 0.7, options)
        tally, best, tried = Tally(fish, family, how), (-np.inf, {}), 0
        while not tried or tried < evaluations / len(goals_sought):
            points = np.array(strategy.ask())
            goals = decoded(fish, points, grouping)
            start = beginning("rest", fish, POPULATION, None)
            tank, found, _ = tally.drive(start, goals)
            failed = np.isfinite(found["failed"])
            value = np.where(failed, 10.0 - found["failed"] / SEARCHED, found["stretch"])
            if aim == "energy":
                value = np.where(failed, 1e6 - found["failed"], found["energy"] / usual)
            strategy.tell(points, -value)
            tried += POPULATION
            i = int(value.argmax())
            if value[i] > best[0]:
                case = case_of(fish, family, how, *start, goals, found, i)
                best = value[i], case | {"failure": str(tank.failure[i])}
            tank.close()
            bar.update(POPULATION)
        found_cases.append(best[1])
        rows.append(tally.row(usual) | {"worst_stretch": round(best[1]["stretch"], 4)})
    return rows, found_cases
