"""Is the default step at most half the largest stable one?

    python -m benchmarks.stability.margins                   the default method (1 min); exit 1 if a limit is missed
    python -m benchmarks.stability.margins --integrator rk4 --substeps 40   another method, at another step

A method that refines its steps does so here too, whatever the step it begins with.

Every task with random, bang-bang and gait actions, and the abrupt manoeuvre, on fish half to twice as stiff, their
damping as it is or multiplied by the same factor. Stable: no fish fails and none has more than BOUND times the energy
that any has with RK4.
"""

import argparse
import sys

import numpy as np
from tqdm import tqdm

from benchmarks.common.actions import BOUND, REFERENCE_SUBSTEPS, STIFFNESS, actions
from benchmarks.common.energy import stretch_and_energy
from benchmarks.common.problems import scaled
from benchmarks.common.tables import write_csv
from fish_env import TASKS, make_fish
from fish_env.bodies import Fish
from fish_env.envs.episode import Episodes

COMMAND = "python -m benchmarks.stability.margins"


def settings(fish: Fish, integrator: str | None, substeps: int | None) -> tuple[str, int, float]:
    """Method, steps a control interval and what refines them: the fish's own, or those given.

    Another method than the fish's own does not refine its steps.

    Raises:
        ValueError: if the fish's control interval is not a whole number of its steps.
    """
    own = fish.control_interval / fish.time_step
    if substeps is None and abs(own - round(own)) > 1e-9:
        raise ValueError(f"{fish.name}: a control interval is {own:g} steps; give a whole number")
    refine = fish.refine if integrator in (None, fish.integrator) else np.inf
    return integrator or fish.integrator, substeps or round(own), refine


def highest_energy(fish: Fish, task: str, kind: str, integrator: str, substeps: int, refine=np.inf):
    """Highest energy of any fish that does these actions in a task, inf if one fails, and why it does."""
    given = actions(fish, kind)
    dt = fish.control_interval / substeps
    how = {"integrator": integrator, "dt": dt, "refine": refine}
    episodes = Episodes(given.shape[1], task=task, body=fish, threads=1, **how)
    episodes.restart(np.ones(episodes.num_envs, bool), range(episodes.num_envs))
    highest = 0.0
    for action in given:
        _, terminated, _ = episodes.advance(action)
        if not episodes.tank.alive.all():
            return np.inf, max(episodes.tank.failure)
        highest = max(highest, stretch_and_energy(episodes.tank)[1].max())
        if terminated.any():
            episodes.restart(terminated)
    return highest, ""


def largest_stable(fish: Fish, task: str, kind: str, integrator: str, substeps: int, refine: float):
    """Fewest steps a control interval from which on, up to twice the default's, all are stable; 0 if not even those.

    Also what happens at one step fewer.
    """
    reference_energy, failed = highest_energy(fish, task, kind, "rk4", REFERENCE_SUBSTEPS)
    if failed:
        return 0, f"RK4 too: {failed}"
    for tried in range(2 * substeps, 0, -1):
        energy, failure = highest_energy(fish, task, kind, integrator, tried, refine)
        if energy > BOUND * reference_energy:
            return (
                tried + 1 if tried < 2 * substeps else 0
            ), failure or f"{energy / reference_energy:.0f} times the energy"
    return 1, ""


def margins(integrator: str | None = None, substeps: int | None = None, kinds=("random", "bang-bang", "gait", "turn"),
            stiffness=STIFFNESS, save=True) -> bool:  # fmt: skip
    """Measure, print and write the margin of every case; True if the default step is at most half of each limit."""
    fish = make_fish()
    integrator, substeps, refine = settings(fish, integrator, substeps)
    cases = [
        (task, kind, factor, damping)
        for task in TASKS
        for factor in stiffness
        for damping in ((1.0,) if factor == 1.0 else (1.0, factor))
        for kind in kinds
    ]
    rows = []
    default = fish.control_interval / substeps
    try:
        for task, kind, factor, damping in tqdm(cases, unit="case", disable=not save):
            fewest, beyond = largest_stable(scaled(fish, factor, damping), task, kind, integrator, substeps, refine)
            largest = fish.control_interval / fewest if fewest else 0.0
            rows.append(
                {
                    "task": task, "actions": kind, "stiffness": factor, "damping": damping, "integrator": integrator,
                    "refine": refine, "default_ms": round(1e3 * default, 4),
                    "largest_stable_ms": round(1e3 * largest, 4), "margin": round(largest / default, 3),
                    "met": 0 < 2 * fewest <= substeps, "beyond": beyond,
                }
            )  # fmt: skip
    except KeyboardInterrupt:
        print("interrupted: what was measured is in the CSV")
    if not rows:
        return False
    if save:
        write_csv("stability_margins.csv", rows, COMMAND)
    print(f"{integrator}, default step {1e3 * default:g} ms, refined beyond a change of {refine:g}")
    print("largest stable steps, ms, worst of each kind of action")
    for kind in kinds:
        mine = [row for row in rows if row["actions"] == kind]
        if mine:
            worst = min(mine, key=lambda row: row["margin"])
            print(f"  {kind:10} {worst['largest_stable_ms']:7g}  (stiffness x{worst['stiffness']:g}, damping "
                  f"x{worst['damping']:g}): {worst['margin']:.2f} times the default; at least 2: "
                  f"{'met' if all(row['met'] for row in mine) else 'MISSED'}")  # fmt: skip
    return all(row["met"] for row in rows) and len(rows) == len(cases)


def main() -> int:
    """The command line; exit 1 if the default step is more than half of a limit."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--integrator", help="instead of the fish's own; nothing is written then")
    parser.add_argument("--substeps", type=int, help="steps a control interval of the default fish, with --integrator")
    chosen = parser.parse_args()
    return 0 if margins(chosen.integrator, chosen.substeps, save=chosen.integrator is None) else 1


if __name__ == "__main__":
    sys.exit(main())
