"""Errors and prices of methods on random scenes that nothing was fitted to, in drag and in reactive water.

Fish begin at rest and are commanded for 2 s: contractions that every muscle holds for 1 to 15 control intervals,
bang-bang ones, square waves, gaits, and strokes nearly as strong and fast as they can be. The error of a scene is the
largest distance, in body lengths, of any node at the end of any control interval from RK4, whose steps were halved
until nothing moved by more than CONVERGED. A scene that magnifies a disturbance more than MAGNIFIED-fold has no error:
it is counted. The abrupt turn of `benchmarks/common/problems.py` stands beside them. The price is the processor time of
a control interval of one fish in a batch on one core, over all scenes from start to end, median of REPEATS.
"""

import time
from typing import NamedTuple

import numpy as np
from tqdm import tqdm

from benchmarks.accuracy.work_precision import SUBSTEPS
from benchmarks.common.charts import METHOD_STYLE, legend_below, panels, save
from benchmarks.common.families import bang_bang, gaits, sprints, square
from benchmarks.common.problems import DISTURBANCE, converge, left_after_right, steps_of
from benchmarks.common.tables import RESULTS, columns, publish, read_table, select
from fish_env import INTEGRATORS, Fish, Tank, World, make_fish

BODIES = {"mass_spring": 256, "planar": 256, "two_layer": 65, "tetrahedral": 65}
"""Each body, and the fish in a batch: all scenes once where a body is slow."""
SEED, SECONDS = 420_000, 2.0  # first seed, duration of a scene
HOLDS = (1, 2, 5, 15)  # control intervals that a random contraction is held
CONVERGED = 1e-6  # body lengths: how little halving its steps may change a reference
MAGNIFIED = 1e4  # a scene that magnifies more is unpredictable
FEWEST, MOST = 256, 8192  # steps a control interval of a reference
REPEATS = 3
STEPS = {"leapfrog_chebyshev": (3, 4, 6, 8, 12, 24, 48), "rosenbrock": (6, 12, 24, 48)}
"""Steps a control interval, not refined; the fish's own, refined as it says, is tried too."""
METHODS = ("midpoint", "rk4", "symplectic_euler", "semi_implicit")
EACH = 4  # numbers of steps tried of each of these, from half of those that linear theory asks for


class Setting(NamedTuple):
    """A fish in its water, and all scenes: the random ones, and the abrupt turn as the last."""

    fish: Fish
    world: World
    goals: np.ndarray
    """(S+1,K,M) contractions in [0, 1]."""


SETTINGS = [("reactive", body) for body in ("mass_spring", "planar")] + [("drag", body) for body in BODIES]
"""Waters and bodies. References of the other bodies in reactive water would take most of an hour."""


def held(fish: Fish, generator: np.random.Generator, times: np.ndarray) -> np.ndarray:
    """Every muscle holds one random contraction after another, each for the same time, one of HOLDS."""
    hold = int(generator.choice(HOLDS))
    return np.repeat(generator.uniform(size=(-(-len(times) // hold), fish.num_muscles)), hold, axis=0)[: len(times)]


FAMILIES = ((held, 16), (bang_bang, 16), (square, 16), (gaits, 8), (sprints, 8))
"""Families of commands, and how many scenes of each."""


def setting(body: str, water: str) -> Setting:
    """A body that is calibrated for a water, in it, with its scenes."""
    fish = make_fish(body, water=water, **({"level": 1} if body == "tetrahedral" else {}))
    times = fish.control_interval * np.arange(1, round(SECONDS / fish.control_interval) + 1)
    goals = [
        family(fish, np.random.default_rng([SEED + k, scene]), times)
        for k, (family, count) in enumerate(FAMILIES)
        for scene in range(count)
    ]
    return Setting(fish, fish.water, np.stack([*goals, left_after_right(fish)[: len(times)]]))


class Motion(NamedTuple):
    """What became of the scenes."""

    path: np.ndarray
    """(K,S+1,N,3) positions at the ends of control intervals, m."""
    alive: np.ndarray
    """(S+1,) whether the fish lives at the end."""
    price: float
    """Microseconds of processor time per control interval of a living fish; nan if none lives at the end."""


def move(scenes: Setting, name: str, substeps: int, refine=np.inf, batch=0, disturbed=None) -> Motion:
    """Move all scenes, again and again in turn to fill a batch; `disturbed` (S+1,N,3) m is added to the start."""
    fish, count = scenes.fish, len(scenes.goals)
    goals = scenes.goals[np.resize(np.arange(count), max(batch, count))].transpose(1, 0, 2).copy()
    dt = fish.control_interval / substeps
    tank = Tank(fish, goals.shape[1], name, dt, scenes.world, threads=1, refine=refine)
    if disturbed is not None:
        tank.position[:] += disturbed
    path, lived, taken = np.empty((len(goals), count, *tank.position.shape[1:])), 0, 0.0
    for k, goal in enumerate(goals):
        lived += int(tank.alive.sum())
        begin = time.process_time()
        tank.drive(goal, substeps)
        taken += time.process_time() - begin
        path[k] = tank.position[:count]
    return Motion(path, tank.alive[:count], taken / lived * 1e6 if tank.alive.any() else np.nan)


def distances(fish: Fish, path: np.ndarray, other: np.ndarray) -> np.ndarray:
    """Largest distance (S+1,) of any node at any time between two paths, body lengths."""
    return np.linalg.norm(path - other, axis=-1).max(axis=(0, 2)) / fish.length


class Reference(NamedTuple):
    """The reference of all scenes of a setting."""

    path: np.ndarray
    predictable: np.ndarray
    """(S+1,) whether a scene has an error."""
    substeps: int
    change: float
    """Largest change of a predictable scene by the last halving, body lengths."""


def magnification(scenes: Setting, substeps: int) -> np.ndarray:
    """How many times each scene (S+1,) magnifies a small random displacement of the nodes; inf where a fish fails."""
    body = scenes.fish.body
    noise = np.random.default_rng(SEED).normal(size=(len(scenes.goals), *body.position.shape))
    moved = move(scenes, "rk4", substeps, disturbed=DISTURBANCE * scenes.fish.length * noise * (body.inverse_mass > 0))
    still = move(scenes, "rk4", substeps)
    apart = distances(scenes.fish, moved.path, still.path) / DISTURBANCE
    return np.where(moved.alive & still.alive, apart, np.inf)


def reference(scenes: Setting) -> Reference:
    """RK4 with its steps halved until no predictable scene changes by more than CONVERGED.

    The fewest steps a control interval are FEWEST, or twice, four times as many, where RK4 is stable.
    """
    fish, fewest = scenes.fish, FEWEST
    while fish.control_interval / fewest > 0.5 * INTEGRATORS["rk4"].base(fish.body):
        fewest *= 2
    predictable = magnification(scenes, fewest) <= MAGNIFIED
    path, substeps, change = converge(
        fish.name, lambda k: move(scenes, "rk4", k).path,
        lambda fine, coarse: float(distances(fish, fine, coarse)[predictable].max()), (fewest, MOST), CONVERGED,
    )  # fmt: skip
    return Reference(path, predictable, substeps, change)


def lines(fish: Fish) -> list[tuple[str, int, float]]:
    """Methods, steps a control interval and refinements that are tried; the fish's own first."""
    found = [(fish.integrator, steps_of(fish), fish.refine)]
    found += [(name, k, np.inf) for name, steps in STEPS.items() for k in steps]
    for name in METHODS:
        least = 0.5 * fish.control_interval / INTEGRATORS[name].base(fish.body)
        found += [(name, k, np.inf) for k in [k for k in SUBSTEPS if k >= least][:EACH]]
    return list(dict.fromkeys(found))


def measure(body: str, water: str, scenes: Setting, truth: Reference, line: tuple[str, int, float]) -> dict:
    """A row: how the errors of a method at a step are distributed over the random scenes, and the price.

    Errors are those of the predictable scenes in which no fish fails; `worst_of` is the family of the worst.
    """
    name, substeps, refine = line
    runs = [move(scenes, name, substeps, refine, BODIES[body]) for _ in range(REPEATS)]
    error, alive = distances(scenes.fish, runs[0].path, truth.path), runs[0].alive
    *random, turn = np.where(truth.predictable & alive, error, np.nan)
    known = np.array(random)[np.isfinite(random)]
    families = np.repeat([family.__name__ for family, _ in FAMILIES], [count for _, count in FAMILIES])
    mean, ninety, worst, of = np.nan, np.nan, np.nan, ""
    if known.size:
        mean, ninety, worst = np.exp(np.log(known).mean()), np.quantile(known, 0.9), known.max()
        of = families[np.nanargmax(random)]
    return {
        "body": body, "water": water, "integrator": name, "refine": refine, "substeps": substeps,
        "scenes": len(random), "unpredictable": int((~truth.predictable[:-1]).sum()),
        "failed": int((~alive[:-1]).sum()), "geometric_mean": float(mean), "ninety_percent": float(ninety),
        "worst": float(worst), "worst_of": str(of), "turn": float(turn),
        "us_per_interval": round(float(np.median([run.price for run in runs])), 3), "batch": BODIES[body],
        "rk4_substeps": truth.substeps, "change": truth.change,
    }  # fmt: skip


def measure_all() -> list[dict]:
    """The rows of every setting."""
    rows = []
    for water, body in SETTINGS:
        scenes = setting(body, water)
        truth = reference(scenes)
        rows += [measure(body, water, scenes, truth, line) for line in tqdm(lines(scenes.fish), f"{body}, {water}")]
    return rows


def least_expensive(rows: list[dict], accuracy: float, key: str) -> dict:
    """The least expensive row without failures whose error, that of `key`, is at most `accuracy` body lengths."""
    return min((row for row in rows if not row["failed"] and row[key] <= accuracy), key=lambda r: r["us_per_interval"])


def draw() -> None:
    """One panel a body and water: geometric mean against price, and lines up to the worst scene, a tick at 90 %."""
    rows = read_table("held_out.csv")
    cases = list(dict.fromkeys((row["water"], row["body"]) for row in rows))
    height = len(cases) // 3
    figure, axes = panels(3, (13, 4.0 * height), height, sharey=True)
    for panel, (water, body) in zip(axes, cases, strict=True):
        mine = select(rows, water=water, body=body)
        for name in dict.fromkeys(row["integrator"] for row in mine):
            colour, marker = METHOD_STYLE[name]
            line = [row for row in select(mine, integrator=name) if row["geometric_mean"] > 0.0]
            line.sort(key=lambda row: row["us_per_interval"])
            price, mean, ninety, worst = columns(line, "us_per_interval", "geometric_mean", "ninety_percent", "worst")
            full = select(line, failed=0)
            panel.loglog(*columns(full, "us_per_interval", "geometric_mean"), color=colour, linewidth=1.2)
            panel.vlines(price, mean, worst, color=colour, linewidth=0.6, alpha=0.6)
            panel.plot(price, ninety, color=colour, linestyle="", marker="_")
            for part, fill, label in (full, "full", name), ([row for row in line if row["failed"]], "none", None):
                panel.plot(*columns(part, "us_per_interval", "geometric_mean"), color=colour, marker=marker,
                           linestyle="", fillstyle=fill, label=label)  # fmt: skip
        low, high = panel.get_xlim()
        ticks = [tick for tick in (1, 2, 5, 10, 20, 50, 100, 200, 500, 1000, 2000) if low < tick < high]
        panel.set_xticks(ticks, map(str, ticks))
        panel.set_xticks([], minor=True)
        panel.set(title=f"{body}, {water}", xlabel="processor time, us per control interval")
    for panel in axes[::3]:
        panel.set_ylabel("error, body lengths (hollow: some failed)")
    legend_below(figure, axes[0], 6)
    save(figure, RESULTS / "held_out.svg")


if __name__ == "__main__":
    publish(__doc__, {"held_out.csv": measure_all}, draw)
