"""Step-size limits of every method: against stiffness, on the abrupt manoeuvre, and by linear theory.

A run is stable if the fish does not fail and its energy, kinetic and elastic, never exceeds BOUND times the reference
solution's. The largest stable step is the largest below which every tested one is stable: stability can come and go
with the step. With a step beyond the control interval, a command lasts as long as the step.
"""

import numpy as np
from tqdm import tqdm

from benchmarks.common import problems
from benchmarks.common.charts import METHOD_STYLE, own_legend, panels, save, words
from benchmarks.common.measures import stretch_and_energy
from benchmarks.common.problems import FIXED
from benchmarks.common.tables import RESULTS, publish, read_table
from benchmarks.stability.linear import linear_limit
from fish_env import BODIES, INTEGRATORS, Fish, Tank, make_fish

STIFFNESS = (1.0, 3.0, 10.0, 30.0, 100.0, 300.0, 1e3, 3e3, 1e4)  # factors on the springs' stiffness, damping as it is
INTERVALS_PER_STEP = (10, 5, 2)  # of the steps that are longer than a control interval
FINEST = 1024  # steps a control interval down to which every step is tried
CONFIRM = 4  # stable steps, each a fifth shorter, below the largest stable one; EXPENSIVE ones are confirmed by 2
EXPENSIVE = 50_000  # steps a control interval
BOUND = 10.0  # times the reference solution's highest energy
CONVERGED = 1e-4  # body lengths: how little halving its steps may change the reference solution


def manoeuvre(fish: Fish) -> np.ndarray:
    """The abrupt manoeuvre until 10 control intervals after the turn: 56 rows of goals."""
    return problems.left_after_right(fish)[: problems.LEAD + problems.RIGHT + problems.LEFT + 10]


def motion(fish: Fish, name: str, substeps: int, intervals: int = 1) -> tuple[np.ndarray, float, Tank]:
    """The manoeuvre with `substeps` steps every `intervals` control intervals, until it ends or the fish fails.

    Returns the positions after each command (K,N,3), the highest energy then, and the tank.
    """
    tank = Tank(fish, 1, name, intervals * fish.control_interval / substeps, fish.water, threads=1, refine=np.inf)
    path, highest = [], 0.0
    for goal in manoeuvre(fish)[intervals - 1 :: intervals]:
        tank.drive(goal[None], substeps)
        if not tank.alive[0]:
            break
        path.append(tank.position[0].copy())
        highest = max(highest, stretch_and_energy(tank)[1][0])
    return np.array(path), highest, tank


def reference_energy(fish: Fish) -> float:
    """Highest energy, J, of the reference solution: RK4, at steps whose halving changes its path by CONVERGED.

    Raises:
        NotConvergedError: if halving the steps changes it by more.
    """
    substeps = max(512, int(0.2 * 1000 * fish.control_interval * np.sqrt(fish.body.max_stiffness_eigenvalue) / 20))
    coarse, _, _ = motion(fish, "rk4", substeps)
    path, highest, tank = motion(fish, "rk4", 2 * substeps)
    if not tank.alive[0] or not problems.distance(fish, path, coarse) <= CONVERGED:
        raise problems.NotConvergedError(
            f"{fish.name}: RK4 with {2 * substeps} steps a control interval is not accurate enough"
        )
    return highest


def grid(finest: int) -> list[int]:
    """Steps a control interval, each about a fifth more than the one before, 1 to `finest`."""
    return list(dict.fromkeys(round(2 ** (j / 4)) for j in range(int(4 * np.log2(finest)) + 1)))


def sweep(fish: Fish, name: str, energy: float) -> dict[float, bool]:
    """Whether a method is stable on a fish at steps, s: down to FINEST, on until confirmed, then between the limits."""
    found: dict[float, bool] = {}

    def is_stable(substeps: int, intervals: int = 1) -> bool:
        _, highest, tank = motion(fish, name, substeps, intervals)
        step = float(f"{tank.dt:.6g}")
        found[step] = bool(tank.alive[0]) and highest <= BOUND * energy
        return found[step]

    for intervals in INTERVALS_PER_STEP:
        is_stable(1, intervals)
    tested, stable, low = [], 0, 0  # low: the most steps that are not stable
    for substeps in grid(2**24):
        if substeps > FINEST and stable >= (2 if substeps > EXPENSIVE else CONFIRM):
            break
        tested.append(substeps)
        if is_stable(substeps):
            stable += 1
        else:
            stable, low = 0, substeps
    high = next((k for k in tested if k > low), 0)
    while low and high < EXPENSIVE and high - low > max(1, 0.03 * low):
        middle = (low + high) // 2
        low, high = (low, middle) if is_stable(middle) else (middle, high)
    return found


def limit(found: dict[float, bool]) -> tuple[float, float]:
    """Largest stable step of a sweep, and the shortest that is not, s (inf for none)."""
    unstable = min((step for step, stable in found.items() if not stable), default=np.inf)
    return max((step for step in found if step < unstable), default=np.nan), unstable


def cases() -> list[tuple[str, float, Fish]]:
    """(body, stiffness factor, fish): the default fish at every stiffness, every other body as it is."""
    default = make_fish()
    stiff = [(default.name, factor, problems.scaled(default, stiffness=factor)) for factor in STIFFNESS]
    return stiff + [(name, 1.0, make_fish(name)) for name in BODIES if name != default.name]


def limits(fish: Fish) -> list[dict]:
    """Rows of every method on a fish: largest stable step, measured and by linear theory, and over explicit Euler's."""
    energy, longest = reference_energy(fish), INTERVALS_PER_STEP[0] * fish.control_interval
    measured = {name: limit(sweep(fish, name, energy)) for name in FIXED}
    theory = {name: linear_limit(name, fish.body, longest) for name in FIXED}
    return [
        {
            "integrator": name, "largest_stable_s": largest, "unstable_from_s": unstable,
            "linear_theory_s": theory[name],
            "over_explicit_euler": round(largest / measured["explicit_euler"][0], 3),
            "linear_over_explicit_euler": round(theory[name] / theory["explicit_euler"], 3),
        }
        for name, (largest, unstable) in measured.items()
    ]  # fmt: skip


def measure() -> list[dict]:
    """The rows of every fish."""
    rows = []
    for body, factor, fish in tqdm(cases(), unit="fish"):
        rows += [{"body": body, "stiffness": factor} | row for row in limits(fish)]
    return rows


def draw() -> None:
    """Draw the largest stable step against stiffness: measured, a marker; linear theory, a dashed line.

    The midpoint method, between explicit Euler and RK4, is in the table only.
    """
    fish = make_fish()
    implicit = [name for name in FIXED if INTEGRATORS[name].factorisations and name != "semi_implicit"]
    shared = [name for name in FIXED if name not in (*implicit, "midpoint")]
    figure, axes = panels(2, 7.4, sharey=True)
    top = 1e3 * INTERVALS_PER_STEP[0] * fish.control_interval
    for panel, names, title in zip(axes, (shared, implicit), ("explicit, stabilised and Tu's", "linearly implicit"),
                                   strict=True):  # fmt: skip
        for name in names:
            line = read_table("stability_limits.csv", body=fish.name, integrator=name)
            colour, marker = METHOD_STYLE[name]
            factor = [row["stiffness"] for row in line]
            hollow = name in ("semi_implicit", "linearly_implicit_water")  # so that what lies beneath is seen
            panel.loglog(factor, [1e3 * row["largest_stable_s"] for row in line], color=colour, marker=marker,
                         markersize=9 if hollow or marker == "*" else 5, fillstyle="none" if hollow else "full",
                         linewidth=1.4, label=words(name))  # fmt: skip
            theory = [min(1e3 * row["linear_theory_s"], 1.25 * top) for row in line]
            panel.plot(factor, theory, color=colour, linestyle=(0, (4, 3)), linewidth=1.0)
        for value in (fish.control_interval, fish.time_step):
            panel.axhline(1e3 * value, color="#888888", linewidth=0.8, linestyle=":", zorder=0)
        panel.plot([], [], color="#444444", linestyle=(0, (4, 3)), linewidth=1.0, label="linear theory (top: none)")
        panel.set(title=title, xlabel="stiffness over that of the default fish", xlim=(0.85, 1.2e4))
        own_legend(panel)
    axes[0].text(1.0, 1e3 * fish.control_interval * 0.93, "control interval", va="top")
    axes[0].text(1.1e4, 1e3 * fish.time_step * 1.07, "default step", ha="right", va="bottom")
    axes[0].set_ylabel("largest stable step, ms")
    save(figure, RESULTS / "stability.svg")


if __name__ == "__main__":
    publish(__doc__, {"stability_limits.csv": measure}, draw)
