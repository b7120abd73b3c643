"""Try to break the fish, as a user's agent might: `python -m benchmarks.stability --attack` (about 6 min).

Thousands of fish at the defaults are driven at random and bang-bang, at their own natural frequencies, from perturbed,
fast, crumpled and inverted starts, softer and stiffer, lighter and heavier; then a search (CMA-ES) looks for the
actions that stretch them most. A fish that fails is run again from its start with RK4 at an eighth of the step: if that
fails too, the cause is what was done to the fish, not the method. The worst cases are kept in tests/worst/.
"""

import json
from collections import Counter
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np
from tqdm import tqdm

from benchmarks.margins import settings, stretch_and_energy
from benchmarks.problems import scaled, swimming
from benchmarks.provenance import write_csv
from fish_env import BODIES, make_fish
from fish_env.bodies import Fish
from fish_env.bodies.mass_spring import LAYERS
from fish_env.tank import Tank

COMMAND = "python -m benchmarks.stability --attack"
WORST = Path(__file__).parent.parent / "tests" / "worst"
INTERVALS = 500  # control intervals a fish is driven: 10 s of the default
BATCH = 500
OTHERS = 5  # times fewer fish and evaluations of bodies that are not the default
EXPLAINED = 50  # failures of a family that are run again with RK4
LEVELS = 255  # goals are whole numbers of them, so that a sequence is kept in bytes
POPULATION, SEARCHED = 50, 200  # of the search; control intervals a candidate is driven
KEPT = 2  # worst sequences of a batch considered, and of each kind of failure of a body kept


@dataclass(frozen=True)
class Family:
    """Fish that are mistreated alike; `share` of all that are driven at random."""

    name: str
    share: float
    kind: str
    start: str = "rest"
    stiffness: float = 1.0
    mass: float = 1.0


def families() -> list[Family]:
    """Every way of mistreating a fish."""
    found = [Family(kind, 0.25, kind) for kind in ("random", "bang-bang")]
    found += [Family(f"{start}, {kind}", 0.025, kind, start) for start in STARTS if start != "rest"
              for kind in ("random", "bang-bang")]  # fmt: skip
    factors = [(0.5, 1.0), (1.5, 1.0), (1.0, 0.5), (1.0, 1.5), (0.5, 1.5), (1.5, 0.5), (0.5, 0.5), (1.5, 1.5)]
    share = (1.0 - sum(family.share for family in found)) / (2 * len(factors))
    found += [Family(f"stiffness x{c:g}, mass x{m:g}, {kind}", share, kind, "rest", c, m) for c, m in factors
              for kind in ("random", "bang-bang")]  # fmt: skip
    return found


# Starts: positions (B,N,3) m and velocities (B,N,3) m/s of a family, from a generator


def at_rest(fish, count, generator):
    """Relaxed and still."""
    return np.repeat(fish.body.position[None], count, 0), np.zeros((count, *fish.body.position.shape))


def noise(fish, size, count, generator):
    """Random vectors (B,N,3), of `size` along each axis in which a node is free: a flat fish stays in its plane."""
    return size * generator.normal(size=(count, *fish.body.position.shape)) * (fish.body.inverse_mass > 0.0)


def perturbed(fish, count, generator):
    """Nodes out of place by 2 % of a body length, each way."""
    x, v = at_rest(fish, count, generator)
    return x + noise(fish, 0.02 * fish.length, count, generator), v


def fast(fish, count, generator):
    """Flung through the water at up to 10 body lengths a gait beat, spinning, every node with a velocity of its own."""
    x, v = at_rest(fish, count, generator)
    rate = fish.length / (10 * fish.control_interval)  # a body length in ten control intervals
    v += 2 * rate * generator.uniform(-1, 1, (count, 1, 3)) + noise(fish, 0.3 * rate, count, generator)
    spin = generator.normal(size=(count, 1, 3)) / (10 * fish.control_interval)
    v += np.cross(spin, x - x.mean(axis=1, keepdims=True))
    return x, v * (fish.body.inverse_mass > 0.0)


def crumpled(fish, count, generator):
    """Shrunk to 0.6 of its size, with nodes out of place by 1 % of a body length."""
    x, v = at_rest(fish, count, generator)
    return 0.6 * x + noise(fish, 0.01 * fish.length, count, generator), v


def inverted(fish, count, generator):
    """Partly turned inside out: left and right exchanged in one to three of the five cross-sections."""
    (x, v), sections = at_rest(fish, count, generator), cross_sections(fish)
    for b in range(count):
        for k in generator.choice(5, generator.integers(1, 4), replace=False):
            x[b, sections[k], 1] *= -1.0
    return x + noise(fish, 0.002 * fish.length, count, generator), v


def cross_sections(fish: Fish) -> list[np.ndarray]:
    """The nodes nearest to each of the five square layers of landmarks; those nearest to nose or tail are in none."""
    marks = fish.points(fish.body.position)[:, 0]
    place = np.array([marks[nodes].mean() for nodes in LAYERS])
    nearest = np.abs(fish.body.position[:, :1] - place).argmin(axis=1)
    return [np.flatnonzero(nearest == k) for k in range(1, 6)]


def beginning(start: str, fish: Fish, count: int, generator) -> list[np.ndarray]:
    """Positions and velocities (B,N,3) of a kind of start, rounded to what a kept case holds."""
    return [part.astype(np.float32).astype(float) for part in STARTS[start](fish, count, generator)]


STARTS = {"rest": at_rest, "perturbed": perturbed, "fast": fast, "crumpled": crumpled, "inverted": inverted}


# Actions: goals (K,B,M) in whole numbers of 1/255


def natural_periods(fish: Fish) -> np.ndarray:
    """Control intervals that a vibration of the body takes, those of 2 and more, and the gait's beat."""
    from benchmarks.stability import modes

    periods = 2 * np.pi / np.sqrt(modes(fish.body)[0]) / fish.control_interval
    return np.append(periods[periods >= 2.0], 13.0)


def random_goals(fish, count, generator):
    """A new goal for every muscle and control interval."""
    return generator.integers(0, LEVELS + 1, (INTERVALS, count, fish.num_muscles), dtype=np.uint8)


def bang_bang_goals(fish, count, generator):
    """All or nothing, at one of the body's own frequencies a fish, a phase for each segment and side."""
    period = generator.choice(natural_periods(fish), count)
    groups = fish.grouping("pairs")
    phase = generator.uniform(0, 1, (count, groups.max() + 1))[:, groups]
    turns = np.arange(INTERVALS)[:, None, None] / period[:, None] + phase
    return (LEVELS * (turns % 1.0 < 0.5)).astype(np.uint8)


GOALS = {"random": random_goals, "bang-bang": bang_bang_goals}


# Runs


def drive(tank: Tank, goals: np.ndarray) -> dict[str, np.ndarray]:
    """Drive a tank through goals (K,B,M): worst stretch, when that was, highest energy and when a fish failed, (B,)."""
    substeps = round(tank.fish.control_interval / tank.dt)
    stretch, when, highest, failed = np.zeros((4, tank.num_fish))
    failed[:] = np.inf
    for k, goal in enumerate(goals):
        tank.drive(goal / LEVELS, substeps)
        failed[~tank.alive & np.isinf(failed)] = k
        longest, energy = stretch_and_energy(tank)
        when[longest > stretch] = k
        stretch = np.maximum(stretch, longest)
        highest = np.maximum(highest, energy)
        if k % 25 == 0 and not tank.alive.any():
            break
    return {"stretch": stretch, "when": when, "energy": highest, "failed": failed}


class Settings(NamedTuple):
    """How fish are moved: method, steps a control interval, and what refines them."""

    integrator: str
    substeps: int
    refine: float = np.inf


def tank_at(fish: Fish, how: Settings, position, velocity, threads=None) -> Tank:
    """A tank with fish at these positions and velocities (B,N,3)."""
    dt = fish.control_interval / how.substeps
    tank = Tank(fish, len(position), how.integrator, dt, fish.water, threads, refine=how.refine)
    tank.position[:], tank.velocity[:] = position, velocity
    return tank


def case_of(fish, family, how: Settings, position, velocity, goals, found, i) -> dict:
    """All it takes to repeat fish i of a batch up to its worst moment, or a little beyond where it failed."""
    end = int(found["failed"][i] if np.isfinite(found["failed"][i]) else found["when"][i]) + 2
    return {
        "body": fish.name, "family": family.name, "stiffness": family.stiffness, "mass": family.mass,
        **how._asdict(), "stretch": float(found["stretch"][i]),
        "failure": "", "position": position[i], "velocity": velocity[i], "goals": goals[:end, i],
    }  # fmt: skip


def replay(case: dict, how: Settings | None = None, copies=1, threads=1) -> tuple[Tank, np.ndarray]:
    """Repeat a kept case, or move it otherwise, `copies` fish alike: the tank at the end, and their worst stretch."""
    how = how or Settings(case["integrator"], case["substeps"], case.get("refine", np.inf))
    fish = scaled(make_fish(case["body"]), stiffness=case["stiffness"], mass=case["mass"])
    start = [np.repeat(case[name][None], copies, 0) for name in ("position", "velocity")]
    tank = tank_at(fish, how, *start, threads)
    return tank, drive(tank, np.repeat(case["goals"][:, None], copies, 1))["stretch"]


def explained(fish, substeps, position, velocity, goals, failed) -> int:
    """How many of these fish RK4 at an eighth of the step loses too, each by half again the time it failed at."""
    tank = tank_at(fish, Settings("rk4", 8 * substeps), position, velocity)
    found = drive(tank, goals[: int(1.5 * failed.max()) + 10])["failed"]
    tank.close()
    return int((found <= 1.5 * failed + 10).sum())


def mistreat(name: str, family: Family, count: int, how: Settings, seed: int, usual: float, bar):
    """Drive `count` fish of a family; its row of the CSV, and its worst cases."""
    fish = scaled(make_fish(name), stiffness=family.stiffness, mass=family.mass)
    reasons, kept, redone, too = Counter(), [], 0, 0
    stretch = highest = 0.0
    for first in range(0, count, BATCH):
        size = min(BATCH, count - first)
        generator = np.random.default_rng([seed, first])
        start = beginning(family.start, fish, size, generator)
        goals = GOALS[family.kind](fish, size, generator)
        tank = tank_at(fish, how, *start)
        found = drive(tank, goals)
        alive = tank.alive
        reasons.update(tank.failure[~alive])
        stretch, highest = max(stretch, found["stretch"].max()), max(highest, found["energy"][alive].max(initial=0.0))
        lost = np.flatnonzero(~alive)[: EXPLAINED - redone]
        if lost.size:
            redone += lost.size
            too += explained(fish, how.substeps, start[0][lost], start[1][lost], goals[:, lost], found["failed"][lost])
        worst = np.argsort(np.where(alive, found["stretch"], 0.0))[: -1 - KEPT : -1]
        for i in (*worst[alive[worst]], *lost[:KEPT]):
            case = case_of(fish, family, how, *start, goals, found, i)
            kept.append(case | {"failure": str(tank.failure[i])})
        tank.close()
        bar.update(size)
    survivors = count > sum(reasons.values())
    row = {
        "body": name, "family": family.name, **step_of(fish, how), "fish": count,
        "failures": sum(reasons.values()), "reasons": "; ".join(f"{n} {r}" for r, n in reasons.items()),
        "worst_stretch": round(float(stretch), 4),
        "peak_energy_over_gait": round(float(highest / usual), 2) if survivors else np.nan,
        "rerun_with_rk4": redone, "rk4_fails_too": too,
    }  # fmt: skip
    return row, kept


def decoded(fish: Fish, points: np.ndarray, grouping: str) -> np.ndarray:
    """Goals (SEARCHED,B,M) of points (B,3G) of the search: period, phase and share of a period, a muscle group each."""
    groups = fish.grouping(grouping)
    period, phase, duty = np.moveaxis(points.reshape(len(points), 3, -1)[:, :, groups], 1, 0)
    period = 2.0 * 20.0 ** (0.5 + 0.5 * np.sin(period))  # 2 to 40 control intervals
    turns = np.arange(SEARCHED)[:, None, None] / period + phase
    return (LEVELS * (turns % 1.0 < 0.5 + 0.4 * np.sin(duty))).astype(np.uint8)


def step_of(fish: Fish, how: Settings) -> dict:
    """How fish were moved, as the table says it."""
    return {"integrator": how.integrator, "step_s": fish.control_interval / how.substeps, "refine": how.refine}


def search(name: str, evaluations: int, how: Settings, usual: float, bar) -> tuple[list[dict], list]:
    """Look for the actions that stretch a fish most, or give it most energy, by CMA-ES from several starts."""
    import cma

    fish = make_fish(name)
    rows, kept = [], []
    goals_sought = [(grouping, aim) for grouping in ("pairs", "muscles") for aim in ("stretch", "energy")]
    for seed, (grouping, aim) in enumerate(goals_sought, start=1):
        size = 3 * (int(fish.grouping(grouping).max()) + 1)
        family = Family(f"search for {aim}, {grouping}", 0.0, "bang-bang")
        options = {"seed": seed, "popsize": POPULATION, "verbose": -9}
        strategy = cma.CMAEvolutionStrategy(np.random.default_rng(seed).uniform(-1.5, 1.5, size), 0.7, options)
        reasons, best, too, redone, highest, tried = Counter(), (-np.inf, None), 0, 0, 0.0, 0
        while tried < evaluations / len(goals_sought):
            points = np.array(strategy.ask())
            goals = decoded(fish, points, grouping)
            start = beginning("rest", fish, POPULATION, None)
            tank = tank_at(fish, how, *start)
            found = drive(tank, goals)
            failed = np.isfinite(found["failed"])
            value = np.where(failed, 10.0 - found["failed"] / SEARCHED, found["stretch"])
            if aim == "energy":
                value = np.where(failed, 1e6 - found["failed"], found["energy"] / usual)
            strategy.tell(points, -value)
            tried += POPULATION
            reasons.update(tank.failure[failed])
            highest = max(highest, found["energy"][~failed].max(initial=0.0))
            lost = np.flatnonzero(failed)[: EXPLAINED - redone]
            if lost.size:
                redone += lost.size
                rerun = [part[lost] for part in start]
                too += explained(fish, how.substeps, *rerun, goals[:, lost], found["failed"][lost])
            i = int(value.argmax())
            if value[i] > best[0]:
                case = case_of(fish, family, how, *start, goals, found, i)
                best = value[i], case | {"failure": str(tank.failure[i])}
            tank.close()
            bar.update(POPULATION)
        kept.append(best[1])
        rows.append(
            {
                "body": name, "family": family.name, **step_of(fish, how),
                "fish": tried, "failures": sum(reasons.values()),
                "reasons": "; ".join(f"{n} {r}" for r, n in reasons.items()),
                "worst_stretch": round(best[1]["stretch"], 4),
                "peak_energy_over_gait": round(float(highest / usual), 2),
                "rerun_with_rk4": redone, "rk4_fails_too": too,
            }
        )  # fmt: skip
    return rows, kept


def keep(cases: list[dict], folder: Path = WORST) -> None:
    """Write the worst survivor of each kind of mistreatment and the first of each kind of failure, for each body.

    Replaces what is there.
    """
    chosen = {}
    for case in sorted(cases, key=lambda case: (len(case["goals"]) if case["failure"] else 0, -case["stretch"])):
        kind = case["family"].split(",")[0].split(" ")[0]  # all stiffnesses and masses are one kind, all searches too
        chosen.setdefault((case["body"], case["failure"], kind), case)
    failures = Counter()
    folder.mkdir(exist_ok=True)
    for path in folder.glob("*.npz"):
        path.unlink()
    for number, ((body, failure, kind), case) in enumerate(sorted(chosen.items(), key=lambda item: item[0])):
        failures[body, failure] += 1
        if failure and failures[body, failure] > KEPT:
            continue
        parts = {key: value for key, value in case.items() if isinstance(value, np.ndarray)}
        about = json.dumps({key: value for key, value in case.items() if key not in parts})
        exact = {key: value if key == "goals" else value.astype(np.float32) for key, value in parts.items()}
        np.savez_compressed(folder / f"{body}-{number:02d}-{kind}.npz", about=about, **exact)


def kept(folder: Path = WORST) -> dict[str, dict]:
    """The kept cases by name."""
    cases = {}
    for path in sorted(folder.glob("*.npz")):
        with np.load(path) as file:
            exact = {name: file[name].astype(float) for name in ("position", "velocity")}
            cases[path.stem] = json.loads(str(file["about"])) | exact | {"goals": file["goals"]}
    return cases


def usual_energy(fish: Fish, how: Settings) -> float:
    """Highest energy of a fish that swims the gait, J."""
    tank = tank_at(fish, how, *at_rest(fish, 1, None))
    return float(drive(tank, LEVELS * swimming(fish, 100)[:, None])["energy"][0])


def attack(integrator=None, substeps=None, fish=10_000, evaluations=10_000) -> bool:
    """Attack every body; table, CSV and kept cases. True if each failure of the default fish run again is RK4's too."""
    rows, cases, default = [], [], make_fish().name
    effort = {name: 1 if name == default else OTHERS for name in BODIES}
    complete = False
    with tqdm(total=sum((fish + evaluations) // less for less in effort.values()), unit="fish") as bar:
        try:
            for name, less in effort.items():
                swimmer = make_fish(name)
                given = (integrator, substeps) if name == default else (None, None)
                how = Settings(*settings(swimmer, *given))
                usual = usual_energy(swimmer, how)
                for seed, family in enumerate(families()):
                    bar.set_postfix_str(f"{name}, {family.name}")
                    count = -int(-fish * family.share // less)
                    row, found = mistreat(name, family, count, how, seed, usual, bar)
                    rows.append(row)
                    cases += found
                bar.set_postfix_str(f"{name}, search")
                found_rows, found = search(name, evaluations // less, how, usual, bar)
                rows += found_rows
                cases += found
            complete = True
        except KeyboardInterrupt:
            print("interrupted: the table holds what was found; the kept cases stay as they were")
    if rows:
        write_csv("attack.csv", rows, COMMAND)
    if complete:
        keep(cases)
    print(f"{'body':12}{'family':40}{'fish':>7}{'failed':>8}{'RK4 too':>12}{'stretch':>9}{'energy':>8}")
    for row in rows:
        again = f"{row['rk4_fails_too']} of {row['rerun_with_rk4']}" if row["rerun_with_rk4"] else ""
        print(f"{row['body']:12}{row['family']:40}{row['fish']:7}{row['failures']:8}{again:>12}"
              f"{row['worst_stretch']:9.3f}{row['peak_energy_over_gait']:8.1f}  {row['reasons']}")  # fmt: skip
    own = [row for row in rows if row["body"] == default]
    return all(row["rk4_fails_too"] == row["rerun_with_rk4"] for row in own)
