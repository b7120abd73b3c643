"""Is the default step at most half the largest stable one? `python -m benchmarks.stability --margins` runs this.

A method that refines its steps does so here too, whatever the step it begins with.

Every task with random, bang-bang and gait actions, and the abrupt manoeuvre, on fish half to twice as stiff, their
damping kept or scaled along. Stable: no fish fails and none has more than BOUND times the energy that any has with RK4.
"""

import numpy as np
from tqdm import tqdm

from benchmarks.problems import left_after_right, scaled, swimming
from benchmarks.provenance import write_csv
from fish_env import TASKS, make_fish
from fish_env.bodies import Fish
from fish_env.envs.episode import Episodes
from fish_env.tank import Tank

STIFFNESS = (0.5, 0.7, 1.0, 1.4, 2.0)
FISH, INTERVALS = 16, 150  # of a task with random or bang-bang actions
TRUE_SUBSTEPS = 64  # of RK4
BOUND = 10.0  # times RK4's highest energy
COMMAND = "python -m benchmarks.stability --margins"


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


def stretch_and_energy(tank: Tank) -> tuple[np.ndarray, np.ndarray]:
    """Of every fish, (B,): largest length over natural length of any unit; kinetic and elastic energy, J."""
    springs = tank.fish.body.springs
    apart = tank.position[:, springs.nodes[:, 1]] - tank.position[:, springs.nodes[:, 0]]
    length = np.sqrt(np.einsum("bek,bek->be", apart, apart))
    kinetic = np.einsum("n,bnk,bnk->b", tank.fish.body.mass, tank.velocity, tank.velocity)
    energy = 0.5 * (kinetic + (length - tank.rest_length) ** 2 @ springs.stiffness)
    return (length / springs.rest_length).max(axis=1), energy


def actions(fish: Fish, kind: str) -> np.ndarray:
    """Actions (K,B,M) of one kind: the same for every step, so that only the step differs."""
    generator = np.random.default_rng(0)
    if kind == "random":
        return generator.uniform(-1.0, 1.0, (INTERVALS, FISH, fish.num_muscles))
    if kind == "bang-bang":
        held = generator.integers(1, 14, FISH)  # control intervals between switches
        sides = generator.choice([-1.0, 1.0], (INTERVALS, FISH, fish.num_muscles))
        return sides[np.arange(INTERVALS)[:, None] // held, np.arange(FISH)]
    goals = swimming(fish, INTERVALS) if kind == "gait" else left_after_right(fish)
    return 2.0 * goals[:, None] - 1.0


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
    true_energy, torn = highest_energy(fish, task, kind, "rk4", TRUE_SUBSTEPS)
    if torn:
        return 0, f"RK4 too: {torn}"
    for tried in range(2 * substeps, 0, -1):
        energy, failure = highest_energy(fish, task, kind, integrator, tried, refine)
        if energy > BOUND * true_energy:
            return (tried + 1 if tried < 2 * substeps else 0), failure or f"{energy / true_energy:.0f} times the energy"
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
        print("interrupted: what was measured is kept")
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
