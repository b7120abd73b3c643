"""Share of failed fish over the step of six methods: is Tu's semi-implicit method stable where others fail?

Two kinds of commands: the abrupt left turn before the right turn is over, pulled for a time and with a strength of its
own in every fish, and every muscle relaxed or fully contracted at random in every control interval. The fish begin at
rest, and nothing is refined. With a step beyond the control interval, a command lasts as long as the step. Cost is the
processor time of a fish in the batch on one core per simulated second, median of the calls before any fish fails.
Units of the published fish are graphics units.
"""

import time
import warnings

import numpy as np
from tqdm import tqdm

from benchmarks.common.charts import METHOD_STYLE, legend_below, panels, save
from benchmarks.common.problems import left_after_right
from benchmarks.common.tables import IMAGES, RESULTS, publish, read_table
from benchmarks.stability.survey import CONFIRM, grid, limit
from fish_env import Fish, Tank, make_fish

METHODS = {
    "explicit_euler": "explicit Euler", "midpoint": "midpoint", "rk4": "Runge-Kutta 4",
    "symplectic_euler": "symplectic Euler", "semi_implicit": "Tu's semi-implicit",
    "leapfrog_chebyshev": "the default, not refined",
}  # fmt: skip
FISH = {"published": {"body": "published"}, "drag": {"water": "drag"}, "reactive": {"water": "reactive"}}
"""Arguments of `make_fish` by name."""
TITLES = {"published": "published fish", "drag": "fish for drag", "reactive": "default fish"}
COUNT, SEED = 64, 0  # fish in a batch
STEPS = [(2, 1), *((1, substeps) for substeps in grid(2048))]
"""Control intervals and steps in them, from the longest step."""
FINEST = 64  # steps a control interval that every method tries; it goes on until CONFIRM steps are without failures
PUBLISHED = 0.055  # step, graphics time units
CALLS = 5  # before any fish fails: fewer give no cost


def abrupt(fish: Fish, generator: np.random.Generator) -> np.ndarray:
    """Contractions (66,M): swim, pull all right muscles, then all left ones, for 6 to 14 control intervals each."""
    right, left = generator.integers(6, 15, 2)
    return generator.uniform(0.8, 1.0) * left_after_right(fish, right, left)[:66]


def random(fish: Fish, generator: np.random.Generator) -> np.ndarray:
    """Contractions (200,M): none or all of every muscle, drawn in every control interval."""
    return generator.integers(0, 2, (200, fish.num_muscles)).astype(float)


COMMANDS = {"abrupt": abrupt, "random": random}
WORDS = {"abrupt": "abrupt turn", "random": "random full commands"}


def driven(fish: Fish, name: str, step: tuple[int, int], goals: np.ndarray) -> tuple[int, float]:
    """Failed fish of those that are driven through goals (K,B,M), and cost, ms per simulated s; nan if unknown."""
    (intervals, substeps), costs = step, []
    duration, count = intervals * fish.control_interval, goals.shape[1]
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", message=".*will fail on.*")  # steps above the limit are the subject
        tank = Tank(fish, count, name, duration / substeps, fish.water, threads=1, refine=np.inf)
    for goal in goals[intervals - 1 :: intervals]:
        begin = time.process_time()
        tank.drive(goal, substeps)
        taken = time.process_time() - begin
        if tank.alive.all():
            costs.append(1e3 * taken / count / duration)
        elif not tank.alive.any():
            break
    return int((~tank.alive).sum()), float(np.median(costs)) if len(costs) >= CALLS else np.nan


def curve(fish: Fish, name: str, goals: np.ndarray) -> list[dict]:
    """A row a step of a method, from the longest to CONFIRM steps in succession without failures."""
    rows: list[dict] = []
    driven(fish, name, (1, 1), goals[:1])  # compiles
    for step in STEPS:
        failed, cost = driven(fish, name, step, goals)
        rows.append({"steps_per_interval": step[1] / step[0],
                     "step_s": float(f"{step[0] * fish.control_interval / step[1]:.6g}"),
                     "fish": goals.shape[1], "failed": failed, "ms_per_s": float(f"{cost:.4g}")})  # fmt: skip
        if step[1] >= FINEST and not any(row["failed"] for row in rows[-CONFIRM:]):
            break
    return rows


def measure() -> list[dict]:
    """The rows of every fish, kind of commands and method."""
    rows = []
    for name, given in tqdm(FISH.items(), unit="fish"):
        fish = make_fish(**given)
        for kind, draw_goals in COMMANDS.items():
            goals = np.stack([draw_goals(fish, np.random.default_rng([SEED, b])) for b in range(COUNT)], axis=1)
            rows += [{"body": name, "commands": kind, "integrator": method} | row
                     for method in METHODS for row in curve(fish, method, goals)]  # fmt: skip
    return rows


def longest_safe(**wanted) -> tuple[float, float]:
    """Largest step, s, at and below which no fish of the rows fails, and highest cost there, ms per simulated s."""
    safe: dict[float, bool] = {}
    rows = read_table("stability_claim.csv", **wanted)
    for row in rows:
        safe[row["step_s"]] = safe.get(row["step_s"], True) and not row["failed"]
    step, _ = limit(safe)
    return step, max(row["ms_per_s"] for row in rows if row["step_s"] == step)


def draw_panel(panel, body: str, kind: str, label) -> None:
    """Draw the curves of a fish under a kind of commands; `label` returns the words for a method."""
    scale = 1.0 if body == "published" else 1e3
    for name in METHODS:
        rows = read_table("stability_claim.csv", body=body, commands=kind, integrator=name)
        colour, marker = METHOD_STYLE[name]
        wide = name in ("explicit_euler", "semi_implicit")  # beneath others, so that both are seen
        panel.plot([scale * row["step_s"] for row in rows], [100 * row["failed"] / row["fish"] for row in rows],
                   color=colour, marker=marker, markersize=7 if wide or marker == "*" else 3.5, label=label(name),
                   fillstyle="none" if wide else "full", linewidth=3.2 if wide else 1.3, zorder=3 - wide)  # fmt: skip
    panel.set_xscale("log")
    panel.xaxis.set_major_formatter("{x:g}")
    panel.set(ylim=(-4, 104), xlabel="step, time units" if body == "published" else "step, ms")


def with_cost(name: str) -> str:
    """The words for a method, its longest safe step of the published fish in the abrupt turn, and the cost there."""
    step, cost = longest_safe(body="published", commands="abrupt", integrator=name)
    return f"{METHODS[name]}: {step:.2g}; {1e3 * cost:.2g} µs"


def draw() -> None:
    """Draw the six panels, and that of the published fish in the abrupt turn."""
    figure, axes = panels(3, 6.8, 2, sharex="col", sharey=True)
    for panel, (kind, body) in zip(axes, ((kind, body) for kind in COMMANDS for body in FISH), strict=True):
        draw_panel(panel, body, kind, METHODS.get)
        panel.set_title(f"{TITLES[body]},\n{WORDS[kind]}")
    for panel in axes[::3]:
        panel.set_ylabel("failed fish, %")
    legend_below(figure, 3)
    save(figure, RESULTS / "stability_claim.svg")
    figure, (panel,) = panels(1, 5.6)
    draw_panel(panel, "published", "abrupt", with_cost)
    panel.axvline(PUBLISHED, color="#888888", linewidth=0.8, linestyle=":", zorder=0)
    panel.text(PUBLISHED, 1.01, "published step", transform=panel.get_xaxis_transform(), ha="center")
    panel.set(ylabel="failed fish, %")
    panel.set_title("Published fish: left turn begun before the right turn is over", pad=20)
    legend_below(figure, 2, title="longest step without failures; processor time of a fish per time unit")
    save(figure, IMAGES / "claim.svg")


if __name__ == "__main__":
    publish(__doc__, {"stability_claim.csv": measure}, draw)
