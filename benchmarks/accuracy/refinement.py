"""Steps a control interval, and intervals that are repeated with shorter ones: error, cost and stability.

    python -m benchmarks.accuracy.refinement            two CSVs (about 3 min)
    python -m benchmarks.accuracy.refinement --bars     the default against its bars; exit 1 if one is missed

The default method repeats an interval, with steps half as long, when a spring changes its length by more than the
part `refine` within a step. The error is the largest distance, in body lengths, of any node at the end of any interval
of the gait or the abrupt manoeuvre from where RK4 with REFERENCE_STEPS steps puts it. The cost counts what is discarded
too. Stable: no fish half to twice as stiff fails, or has more than BOUND times the energy that any has with RK4.
"""

import argparse
import sys

import numpy as np
from tqdm import tqdm

from benchmarks.common.actions import BOUND, REFERENCE_SUBSTEPS, STIFFNESS, actions
from benchmarks.common.energy import stretch_and_energy
from benchmarks.common.problems import Problem, distance, problems, run, scaled, steps_of, tank_of
from benchmarks.common.tables import RESULTS, read_table, write_csv
from fish_env import Tank, make_fish
from fish_env.bodies import Fish

SCENES = ("gait", "turn")
STEPS = (3, 4, 5, 6, 7, 8, 10, 12)
REFINE = (np.inf, 0.2, 0.1, 0.05)
REFERENCE_STEPS = 1024  # of RK4
KINDS = ("random", "bang-bang", "turn")
SINGLE = 5e-5  # body lengths that float32 may be off float64 over the manoeuvre
ACCURATE = 0.01  # body lengths that the default may be off the reference solution
COMMAND = "python -m benchmarks.accuracy.refinement"
ERRORS, STABLE = "refinement.csv", "refinement_stable.csv"


class Meter:
    """How many steps the fish of a tank have taken, with those of repeated intervals."""

    def __init__(self, tank: Tank):
        self.tank, self.steps, self.again, self.intervals = tank, 0.0, 0, 0
        self.before = tank.counters["refinements"].copy()

    def read(self, substeps: int) -> None:
        """Count an interval of so many steps that has just been taken."""
        now = self.tank.counters["refinements"]
        times = now - self.before  # halved so many times: 1 + 2 + 4 ... as many steps in all
        self.steps += substeps * float((2.0 ** (times + 1) - 1.0).mean())
        self.again += int((times > 0).sum())
        self.intervals += 1
        self.before = now.copy()

    def row(self) -> dict:
        """Means an interval and fish."""
        return {
            "steps_taken": round(self.steps / self.intervals, 4),
            "intervals_refined": round(self.again / self.intervals / self.tank.num_fish, 5),
            "forces_per_interval": round(float(self.tank.counters["force_evaluations"].mean()) / self.intervals, 3),
        }


def measure(problem: Problem, steps: int, refine: float, reference_path: np.ndarray, **options) -> dict:
    """A row: how far the default method is from a path (K,N,3), and what it costs. `options` as for `Tank`."""
    tank = tank_of(problem, problem.fish.integrator, steps, refine=refine, **options)
    path, meter = np.empty_like(reference_path), Meter(tank)
    for k, goal in enumerate(problem.contraction):
        tank.drive(goal[None], steps)
        meter.read(steps)
        path[k] = tank.position[0]
    error = distance(problem.fish, path, reference_path) if tank.alive[0] else np.inf
    against = "float64" if tank.kind.dtype == "float32" else f"RK4, {REFERENCE_STEPS} steps"
    return {
        "scene": problem.name,
        "dtype": tank.kind.dtype,
        "against": against,
        "steps": steps,
        "refine": refine,
        "error": float(f"{error:.4g}"),
        **meter.row(),
    }


def errors() -> list[dict]:
    """Every number of steps and every refinement on every scene; then float32 at the default."""
    rows, fish = [], make_fish()
    for scene in SCENES:
        problem = problems()[scene]
        reference_path = run(problem, "rk4", REFERENCE_STEPS)[0]
        rows += [measure(problem, steps, refine, reference_path) for refine in REFINE for steps in STEPS]
    for scene in SCENES:
        default = (steps_of(fish), fish.refine)
        double = run(problems()[scene], fish.integrator, default[0], refine=fish.refine)[0]
        rows.append(measure(problems()[scene], *default, double, dtype="float32"))
    return rows


def under_commands(fish: Fish, kind: str, integrator: str, steps: int, refine: float) -> tuple[float, str, dict]:
    """Highest energy, J, of any fish under commands of a kind, inf if one fails and why, and the cost."""
    given = actions(fish, kind)
    tank = Tank(fish, given.shape[1], integrator, fish.control_interval / steps, fish.water, threads=1, refine=refine)
    meter, highest = Meter(tank), 0.0
    for action in given:
        tank.swim(action, fish.control_interval)
        meter.read(steps)
        if not tank.alive.all():
            return np.inf, max(tank.failure), meter.row()
        highest = max(highest, float(stretch_and_energy(tank)[1].max()))
    return highest, "", meter.row()


def stable(fish: Fish, kind: str, refine: float) -> dict:
    """The largest base step from which on, down to the shortest of STEPS, all are stable; the cost at the default."""
    allowed = BOUND * under_commands(fish, kind, "rk4", REFERENCE_SUBSTEPS, np.inf)[0]
    fewest, beyond = 0, ""
    for steps in range(STEPS[-1], 0, -1):
        energy, beyond, _ = under_commands(fish, kind, fish.integrator, steps, refine)
        if energy > allowed:
            beyond = beyond or f"{energy / allowed * BOUND:.0f} times the energy"
            break
        fewest = steps
    cost = under_commands(fish, kind, fish.integrator, steps_of(fish), refine)[2]
    largest = 1e3 * fish.control_interval / fewest if fewest else 0.0
    return {"fewest_steps": fewest, "largest_stable_ms": round(largest, 4), "beyond": beyond, **cost}


def stability() -> list[dict]:
    """Every kind of command and every refinement on fish half to twice as stiff, with the same or scaled damping."""
    fish, rows = make_fish(), []
    factors = [(factor, damping) for factor in STIFFNESS for damping in sorted({1.0, factor})]
    for kind in tqdm(KINDS, unit="kind of command"):
        for stiffness, damping in factors:
            for refine in REFINE:
                named = {"actions": kind, "stiffness": stiffness, "damping": damping, "refine": refine}
                rows.append(named | stable(scaled(fish, stiffness, damping), kind, refine))
    return rows


def worst(limits: list[dict], refine: float, kinds=KINDS) -> float:
    """The largest base step, ms, that is stable for all fish under commands of these kinds."""
    return min(row["largest_stable_ms"] for row in limits if row["actions"] in kinds and row["refine"] == refine)


def bars() -> bool:
    """Print what the default reaches beside what it has to; True if all is met."""
    fish, rows, limits = make_fish(), read_table(ERRORS), read_table(STABLE)
    default = (steps_of(fish), fish.refine)
    mine = [row for row in rows if (row["steps"], row["refine"]) == default]
    found = []
    for row in mine:
        highest = SINGLE if row["dtype"] == "float32" else ACCURATE
        found.append((f"{row['scene']}, {row['dtype']} against {row['against']}, body lengths", row["error"],
                      row["error"] <= highest, f"at most {highest:g}"))  # fmt: skip
    for kind in KINDS:
        largest = worst(limits, default[1], (kind,))
        found.append((f"{kind}, largest stable base step, ms", largest, largest >= 2e3 * fish.time_step * (1 - 1e-9),
                      f"at least {2e3 * fish.time_step:.3g}"))  # fmt: skip
    for name, value, met, bar in found:
        print(f"{name}: {value:.4g}, bar {bar}: {'met' if met else 'MISSED'}")
    return all(met for _, _, met, _ in found)


def main() -> int:
    """The command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--bars", action="store_true", help="compare the CSVs with the bars, exit 1 if one is missed")
    if not parser.parse_args().bars:
        write_csv(ERRORS, errors(), COMMAND)
        write_csv(STABLE, stability(), COMMAND)
        print(f"written to {RESULTS / ERRORS} and {STABLE} beside it")
    return 0 if bars() else 1


if __name__ == "__main__":
    sys.exit(main())
