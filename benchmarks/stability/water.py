"""What water with inertia does to stability: stress tests of fish, the largest steps of methods, and the abrupt turn.

Fish whose nodes move a little are driven for 10 s: every muscle at random, or all or nothing at random (bang-bang);
segments and sides all or nothing at the body's natural frequencies (resonant); all muscles of one side or of the other,
alternating by chance, or as square waves of 1 to 12 Hz. A fish that fails is run again with RK4 at an eighth of the
step. Roll is about the long axis, pitch that of the long axis.
Largest steps are those of `benchmarks.stability.survey`. The abrupt turn's error is the largest distance of any node at
any time from RK4, and its magnification that of a small disturbance, for factors on stiffness and on damping.
"""

import math

import numpy as np
from tqdm import tqdm

from benchmarks.common.measures import pose_of
from benchmarks.common.problems import Problem, distance, left_after_right, magnified, reference, run, scaled
from benchmarks.common.tables import publish
from benchmarks.stability.cases import Tally, own_settings
from benchmarks.stability.mistreatment import GOALS, INTERVALS, LEVELS, Family, at_rest, noise
from benchmarks.stability.survey import limits
from fish_env import Fish, make_fish
from fish_env.bodies.fitted import WATERS
from fish_env.control.chart import NotConvergedError, steps_of

FISH = {"mass_spring": 1024, "planar": 256, "two_layer": 64, "tetrahedral": 32}  # of each body and kind of command
BATCH, EXPLAINED = 256, 16  # fish at a time; failures that are run again
NOISE = 0.05  # body lengths/s: node velocities at the start, so that an unstable roll has something to grow from
TILTED = 60.0  # degrees
SUBSTEPS = (3, 4, 6, 8, 12, 24, 48)  # of the abrupt turn, a control interval
FACTORS = [(k, d) for k in (0.7, 1.0, 1.4) for d in (0.7, 1.0, 1.4)]  # on the stiffness and the damping of springs


def bang_bang_goals(fish, count, generator):
    """Every muscle fully contracted or relaxed, anew in every control interval."""
    return (LEVELS * generator.integers(0, 2, (INTERVALS, count, fish.num_muscles))).astype(np.uint8)


def alternating_goals(fish, count, generator):
    """All muscles of one side and none of the other; every control interval they change over with a chance of 0.2."""
    side = generator.random((1, count)) < 0.5
    side = side ^ (np.cumsum(generator.random((INTERVALS, count)) < 0.2, axis=0) % 2 == 1)
    return (LEVELS * ((fish.sides > 0) == side[..., None])).astype(np.uint8)


def square_goals(fish, count, generator):
    """All muscles of one side and none of the other, as a square wave of 1 to 12 Hz."""
    turns = np.arange(INTERVALS)[:, None] * fish.control_interval * generator.uniform(1.0, 12.0, count)
    return (LEVELS * ((fish.sides > 0) == (turns % 1.0 < 0.5)[..., None])).astype(np.uint8)


KINDS = {
    "random": GOALS["random"], "bang-bang": bang_bang_goals, "resonant": GOALS["bang-bang"],
    "alternating": alternating_goals, "square waves": square_goals,
}  # fmt: skip


def stress(fish: Fish, kind: str, count: int) -> dict:
    """Drive `count` fish by a kind of command, at their own step and in their water; what became of them."""
    tally, found = Tally(fish, Family(kind, 1.0, kind), own_settings(fish), EXPLAINED), []
    for first in range(0, count, BATCH):
        size = min(BATCH, count - first)
        generator = np.random.default_rng([list(KINDS).index(kind), first])
        goals = KINDS[kind](fish, size, generator)
        start = at_rest(fish, size, None)[0], noise(fish, NOISE * fish.length, size, generator)
        leaning = np.zeros((2, size))  # degrees of roll and pitch at most

        def watch(tank, leaning=leaning):
            height = np.clip(pose_of(tank).axes[:, :, 2], -1.0, 1.0)
            angles = np.arctan2(height[:, 1], height[:, 2]), np.arcsin(height[:, 0])
            leaning[:] = np.fmax(leaning, np.degrees(np.abs(angles)))

        tank, *_ = tally.drive(start, goals, watch)
        found.append((*leaning, tank.counters["refinements"].copy()))
        tank.close()
    roll, pitch, refined = np.concatenate(found, axis=1)
    return {
        "commands": kind, **tally.lost(), "refined_percent": round(100.0 * float(refined.mean()) / INTERVALS, 3),
        "rolled_percent": round(100.0 * float((roll > TILTED).mean()), 3),
        "pitched_percent": round(100.0 * float((pitch > TILTED).mean()), 3),
        "median_roll_deg": round(float(np.median(roll)), 2),
    }  # fmt: skip


def stressed() -> list[dict]:
    """Rows of every body, in each water that it is calibrated for."""
    rows = []
    for water, body in tqdm([(water, body) for water in WATERS for body in FISH], "stress test"):
        fish = make_fish(body, water=water)
        about = {"body": body, "water": water, "step_s": round(fish.time_step, 7)}
        rows += [about | stress(fish, kind, FISH[body]) for kind in KINDS]
    return rows


def margins() -> list[dict]:
    """Rows of every method's largest stable step in the abrupt turn, in both waters."""
    return [{"water": water} | row for water in tqdm(WATERS, "margins") for row in limits(make_fish(water=water))]


def turn(fish: Fish) -> dict:
    """Errors of the abrupt turn, body lengths: of the fish's own step, refined, and of steps that are not.

    None is known where the turn is unpredictable, so that no reference converges: it magnifies without limit.
    """
    problem = Problem("turn", "left after right", fish, fish.water, left_after_right(fish))
    try:
        path, substeps, _ = reference(problem)
    except NotConvergedError:
        return {"magnified": math.inf, "rk4_substeps": 0, "own": math.nan} | {f"at_{k}": math.nan for k in SUBSTEPS}
    row = {"magnified": float(f"{magnified(problem, path, substeps):.3g}"), "rk4_substeps": substeps}
    for key, steps, refine in (("own", steps_of(fish), fish.refine), *((f"at_{k}", k, math.inf) for k in SUBSTEPS)):
        swum, tank = run(problem, fish.integrator, steps, refine=refine)
        row[key] = float(f"{distance(fish, swum, path):.3g}") if tank.alive[0] else math.nan
    return row


def turns() -> list[dict]:
    """Rows of the abrupt turn: the fish for drag, and that for reactive water with its neighbours, with failures."""
    cases = [("drag", 1.0, 1.0), *(("reactive", *factors) for factors in FACTORS)]
    rows = []
    for water, stiffness, damping in tqdm(cases, "turns"):
        fish = scaled(make_fish(water=water), stiffness, damping)
        found = [stress(fish, kind, BATCH) for kind in KINDS]
        rows.append(
            {"water": water, "stiffness": stiffness, "damping": damping} | turn(fish)
            | {"fish": BATCH * len(KINDS), "failures": sum(row["failures"] for row in found),
               "rolled_percent": max(row["rolled_percent"] for row in found)}
        )  # fmt: skip
    return rows


if __name__ == "__main__":
    publish(__doc__, {"water_stability.csv": stressed, "water_limits.csv": margins, "water_turn.csv": turns})
