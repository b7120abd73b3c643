"""Runs of the stability survey: the abrupt manoeuvre by one method at one step, and which steps are stable."""

import numpy as np

from benchmarks.common.energy import stretch_and_energy
from benchmarks.common.problems import LEAD, LEFT, RIGHT, NotConvergedError, distance, left_after_right, scaled
from fish_env import BODIES, INTEGRATORS, make_fish
from fish_env.bodies import Fish
from fish_env.physics.tank import Tank

FIXED = [name for name, record in INTEGRATORS.items() if record.kind != "adaptive"]
STIFFNESS = (1.0, 3.0, 10.0, 30.0, 100.0, 300.0, 1e3, 3e3, 1e4)  # factors on the springs' stiffness, damping as it is
INTERVALS_PER_STEP = (10, 5, 2)  # of the steps that are longer than a control interval
FINEST = 1024  # steps a control interval down to which every cell is computed
CONFIRM = 4  # stable steps, each a fifth shorter, below the largest stable one; EXPENSIVE ones are confirmed by 2
EXPENSIVE = 50_000  # steps a control interval
BOUND = 10.0  # times the reference solution's highest energy
ACCURATE = 0.01  # body lengths
CONVERGED = 1e-4  # body lengths: how little halving its steps may change the reference solution
VERDICTS = ("accurate", "bounded", "blown up")


def manoeuvre(fish: Fish) -> np.ndarray:
    """The abrupt manoeuvre until 10 control intervals after the turn: 56 rows of goals."""
    return left_after_right(fish)[: LEAD + RIGHT + LEFT + 10]


def motion(fish: Fish, name: str, substeps: int, intervals: int = 1) -> tuple[np.ndarray, float, Tank]:
    """The manoeuvre with `substeps` steps every `intervals` control intervals, until it ends or the fish fails.

    Returns the positions after each command (K,N,3), the highest energy then, and the tank.
    """
    tank = Tank(fish, 1, name, intervals * fish.control_interval / substeps, fish.water, threads=1)
    path, highest = [], 0.0
    for goal in manoeuvre(fish)[intervals - 1 :: intervals]:
        tank.drive(goal[None], substeps)
        if not tank.alive[0]:
            break
        path.append(tank.position[0].copy())
        highest = max(highest, stretch_and_energy(tank)[1][0])
    return np.array(path), highest, tank


def reference(fish: Fish) -> tuple[np.ndarray, float]:
    """The reference solution (K,N,3) and its highest energy: RK4, at steps whose halving changes it by CONVERGED.

    Raises:
        NotConvergedError: if halving the steps changes it by more.
    """
    substeps = max(512, int(0.2 * 1000 * fish.control_interval * np.sqrt(fish.body.max_stiffness_eigenvalue) / 20))
    coarse, _, _ = motion(fish, "rk4", substeps)
    path, highest, tank = motion(fish, "rk4", 2 * substeps)
    if not tank.alive[0] or not distance(fish, path, coarse) <= CONVERGED:
        raise NotConvergedError(f"{fish.name}: RK4 with {2 * substeps} steps a control interval is not accurate enough")
    return path, highest


def cell(
    fish: Fish, name: str, substeps: int, intervals: int, reference_path: np.ndarray, reference_energy: float
) -> dict:
    """One run of the manoeuvre: how it ended, how far it was from the reference solution, and its counters."""
    path, highest, tank = motion(fish, name, substeps, intervals)
    bounded = bool(tank.alive[0]) and highest <= BOUND * reference_energy
    error = distance(fish, path, reference_path[intervals - 1 :: intervals]) if tank.alive[0] else np.inf
    return {
        "integrator": name,
        "substeps": substeps,
        "intervals": intervals,
        "step_s": float(f"{tank.dt:.6g}"),
        "verdict": VERDICTS[2] if not bounded else VERDICTS[0] if error <= ACCURATE else VERDICTS[1],
        "error": float(f"{error:.3g}"),
        "energy": float(f"{highest / reference_energy:.3g}") if tank.alive[0] else np.inf,
        "non_positive_pivots": int(tank.counters["non_positive_pivots"][0]),
        "failed_at_s": "" if tank.alive[0] else round(float(tank.time[0]), 6),
        "failure": tank.failure[0].split(":")[0],
    }


def grid(finest: int) -> list[int]:
    """Steps a control interval, each about a fifth more than the one before, 1 to `finest`."""
    return list(dict.fromkeys(round(2 ** (j / 4)) for j in range(int(4 * np.log2(finest)) + 1)))


def sweep(fish: Fish, name: str, reference_path: np.ndarray, reference_energy: float) -> list[dict]:
    """Cells of one method on one fish: all steps down to FINEST, on until stable ones are confirmed, then refined."""

    def at(substeps, intervals=1):
        return cell(fish, name, substeps, intervals, reference_path, reference_energy)

    rows, stable, last_unstable = [at(1, intervals) for intervals in INTERVALS_PER_STEP], 0, 0
    for substeps in grid(2**24):
        if substeps > FINEST and stable >= (2 if substeps > EXPENSIVE else CONFIRM):
            break
        rows.append(at(substeps))
        if rows[-1]["verdict"] == VERDICTS[2]:
            stable, last_unstable = 0, substeps
        else:
            stable += 1
    tested = sorted(row["substeps"] for row in rows if row["intervals"] == 1)
    low, high = last_unstable, next((k for k in tested if k > last_unstable), 0)
    while low and high < EXPENSIVE and high - low > max(1, 0.03 * low):
        middle = (low + high) // 2
        rows.append(at(middle))
        low, high = (middle, high) if rows[-1]["verdict"] == VERDICTS[2] else (low, middle)
    return rows


def limit(rows: list[dict]) -> tuple[float, float]:
    """Largest stable step of the cells of one method on one fish, and the shortest that is not, s (inf for none)."""
    unstable = min((row["step_s"] for row in rows if row["verdict"] == VERDICTS[2]), default=np.inf)
    return max((row["step_s"] for row in rows if row["step_s"] < unstable), default=np.nan), unstable


def cases() -> list[tuple[str, float, Fish]]:
    """(body, stiffness factor, fish): the default fish at every stiffness, every other body as it is."""
    default = make_fish()
    stiff = [(default.name, factor, scaled(default, stiffness=factor)) for factor in STIFFNESS]
    return stiff + [(name, 1.0, make_fish(name)) for name in BODIES if name != default.name]
