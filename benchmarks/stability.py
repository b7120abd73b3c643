"""How long a step each method bears: against stiffness, on the abrupt manoeuvre, in every task, and under attack.

    taskset -c 1 python -m benchmarks.stability             every method, step and stiffness (9 min): CSVs, charts
    taskset -c 1 python -m benchmarks.stability --draw      tables and charts again, from the CSV
    taskset -c 1 python -m benchmarks.stability --margins   is the default step at most half of what is stable? (1 min)
    python -m benchmarks.stability --attack                 try to break the fish (6 min): see benchmarks/attack.py

A run is stable if the fish lives and its energy, kinetic and elastic, never exceeds BOUND times the true motion's. The
largest stable step is the largest below which every tested one is stable: stability can come and go with the step.
Steps beyond a control interval hold each command as long as the step.
"""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent.parent))  # so that it runs as a script as well as with -m

import argparse
import csv
from itertools import pairwise

import numpy as np
from tqdm import tqdm

from benchmarks.margins import stretch_and_energy
from benchmarks.problems import LEAD, LEFT, RIGHT, NotConvergedError, distance, left_after_right, scaled
from benchmarks.provenance import RESULTS, write_csv
from benchmarks.work_precision import STYLE
from fish_env import BODIES, INTEGRATORS, make_fish
from fish_env.bodies import Fish
from fish_env.bodies.fish import ElasticObject
from fish_env.body import Body, make_body
from fish_env.forces.evaluate import Evaluator
from fish_env.tank import Tank
from fish_env.world import VACUUM

FIXED = [name for name, record in INTEGRATORS.items() if record.kind != "adaptive"]
STIFFNESS = (1.0, 3.0, 10.0, 30.0, 100.0, 300.0, 1e3, 3e3, 1e4)  # factors on the units' stiffness, damping kept
HELD = (10, 5, 2)  # steps of so many control intervals
FINEST = 1024  # steps a control interval down to which every cell is computed
CONFIRM = 4  # stable steps, each a fifth shorter, below the largest stable one; DEAR ones are confirmed by 2
DEAR = 50_000  # steps a control interval
BOUND = 10.0  # times the true motion's highest energy
ACCURATE = 0.01  # body lengths
TRUTH = 1e-4  # body lengths: how little halving its steps may change the true motion
COMMAND = "python -m benchmarks.stability"
THESIS = "100 to 150 (Tu 1996)"
PUBLISHED_STEP = 0.055  # s, of the published fish: see docs/physics.md
VERDICTS = ("accurate", "bounded", "blown up")


# Linear theory


def modes(body: Body) -> tuple[np.ndarray, np.ndarray]:
    """Squared frequencies (K,) 1/s2 and damping rates (K,) 1/s of the body's vibrations at rest, rigid motion left out.

    The damping of a mode is its share of the units' damping; exact where all units relax in the same time.
    """
    still = np.zeros_like(body.position)
    matrices = Evaluator(body, VACUUM).jacobian(body.springs.rest_length, body.position, still)
    root = np.repeat(body.mass, 3) ** -0.5
    stiffness, damping = np.array(matrices) * np.outer(root, root)
    squares, shapes = np.linalg.eigh(stiffness)
    real = squares > 1e-9 * squares[-1]
    return squares[real], np.einsum("ik,ij,jk->k", shapes, damping, shapes)[real]


def oscillators(body: Body) -> Body:
    """A body with two nodes and one unit for each vibration of the given one: same frequency, same damping."""
    squares, damping = modes(body)
    pairs = np.arange(2 * squares.size).reshape(-1, 2)
    position = np.zeros((2 * squares.size, 3))
    position[1::2, 0] = 1.0
    position[:, 1] = 10.0 * np.repeat(np.arange(squares.size), 2)
    made = make_body(position, np.full(2 * squares.size, 2.0), pairs, squares, damping, np.ones(squares.size), [])
    return made._replace(elastic_rate=body.elastic_rate, viscous_rate=body.viscous_rate)


def growth(tank: Tank, h: float) -> float:
    """Largest factor by which one step of h s makes a small vibration of the oscillators in a tank of four grow."""
    tank.reset()
    tank.dt, engine = h, tank._engine
    engine._rows.clear()  # no plans for steps of another length: a new tank for each step would take far longer
    engine._plans.clear()
    for i in range(4):
        engine.plan(i)
    state, small, omega = tank.state, 1e-5, np.sqrt(tank.fish.body.springs.stiffness)
    for row, side in ((0, 0.5), (1, -0.5)):  # each unit longer and shorter, then faster and slower
        state.x[row, 1::2, 0] += side * small
        state.x[row, ::2, 0] -= side * small
        state.v[2 + row, 1::2, 0] = side * small * omega
        state.v[2 + row, ::2, 0] = -side * small * omega
    tank.advance(1)
    if state.failure.any():
        return np.inf
    apart = state.x[:, 1::2, 0] - state.x[:, ::2, 0]
    speed = (state.v[:, 1::2, 0] - state.v[:, ::2, 0]) / omega
    columns = [(side[::2] - side[1::2]) / (2 * small) for side in (apart, speed)]  # of what was longer, what was faster
    return float(np.abs(np.linalg.eigvals(np.moveaxis(np.array(columns), 2, 0))).max())


def linear_limit(name: str, body: Body, longest: float) -> float:
    """First step, s, at which a method lets a small vibration of the body in vacuum grow; inf if none up to `longest`.

    Each mode is an oscillator of two nodes, moved by the method's own kernel, so a filter that looks at the whole
    body's highest frequency does so here. Unstable: grows by more than 1e-9 a step.
    """
    pairs = oscillators(body)
    thing = ElasticObject(name="oscillators", body=pairs, length=1.0, time_step=longest, control_interval=longest)
    tank = Tank(thing, 4, name, longest, threads=1)
    squares, damping = pairs.springs.stiffness, pairs.springs.damping
    omega = np.sqrt(squares.max())
    relaxation = (damping / squares)[damping > 0].min(initial=1.0 / omega)
    first = 0.02 * min(1.0 / omega, relaxation, 1.0 / max(omega, damping.max()))
    below = 0.0
    for h in np.append(np.geomspace(first, longest, 1 + int(np.log(longest / first) / np.log(1.03))), longest):
        if growth(tank, h) > 1.0 + 1e-9:
            break
        below = h
    else:
        return np.inf
    while h - below > 1e-6 * h:
        middle = 0.5 * (below + h)
        below, h = (below, middle) if growth(tank, middle) > 1.0 + 1e-9 else (middle, h)
    return float(h)


# Runs


def manoeuvre(fish: Fish) -> np.ndarray:
    """The abrupt manoeuvre until 10 control intervals after the turn: 56 rows of goals."""
    return left_after_right(fish)[: LEAD + RIGHT + LEFT + 10]


def motion(fish: Fish, name: str, substeps: int, held: int = 1) -> tuple[np.ndarray, float, Tank]:
    """The manoeuvre with `substeps` steps every `held` control intervals, until it ends or the fish fails.

    Returns the positions after each command (K,N,3), the highest energy then, and the tank.
    """
    tank = Tank(fish, 1, name, held * fish.control_interval / substeps, fish.water, threads=1)
    path, highest = [], 0.0
    for goal in manoeuvre(fish)[held - 1 :: held]:
        tank.drive(goal[None], substeps)
        if not tank.alive[0]:
            break
        path.append(tank.position[0].copy())
        highest = max(highest, stretch_and_energy(tank)[1][0])
    return np.array(path), highest, tank


def truth(fish: Fish) -> tuple[np.ndarray, float]:
    """The true path (K,N,3) and its highest energy: RK4 at steps short enough that halving them changes nothing."""
    substeps = max(512, int(0.2 * 1000 * fish.control_interval * np.sqrt(fish.body.elastic_rate) / 20))
    coarse, _, _ = motion(fish, "rk4", substeps)
    path, highest, tank = motion(fish, "rk4", 2 * substeps)
    if not tank.alive[0] or not distance(fish, path, coarse) <= TRUTH:
        raise NotConvergedError(f"{fish.name}: RK4 with {2 * substeps} steps a control interval is not accurate enough")
    return path, highest


def cell(fish: Fish, name: str, substeps: int, held: int, true_path: np.ndarray, true_energy: float) -> dict:
    """One run of the manoeuvre: how it ended, how far it was from the truth, and what it met on the way."""
    path, highest, tank = motion(fish, name, substeps, held)
    bounded = bool(tank.alive[0]) and highest <= BOUND * true_energy
    error = distance(fish, path, true_path[held - 1 :: held]) if tank.alive[0] else np.inf
    return {
        "integrator": name,
        "substeps": substeps,
        "intervals": held,
        "step_s": float(f"{tank.dt:.6g}"),
        "verdict": VERDICTS[2] if not bounded else VERDICTS[0] if error <= ACCURATE else VERDICTS[1],
        "error": float(f"{error:.3g}"),
        "energy": float(f"{highest / true_energy:.3g}") if tank.alive[0] else np.inf,
        "non_positive_pivots": int(tank.counters["non_positive_pivots"][0]),
        "failed_at_s": "" if tank.alive[0] else round(float(tank.time[0]), 6),
        "failure": tank.failure[0].split(":")[0],
    }


def grid(finest: int) -> list[int]:
    """Steps a control interval, each about a fifth more than the one before, 1 to `finest`."""
    return list(dict.fromkeys(round(2 ** (j / 4)) for j in range(int(4 * np.log2(finest)) + 1)))


def sweep(fish: Fish, name: str, true_path: np.ndarray, true_energy: float) -> list[dict]:
    """Cells of one method on one fish: all steps down to FINEST, on until stable ones are confirmed, then refined."""

    def at(substeps, held=1):
        return cell(fish, name, substeps, held, true_path, true_energy)

    rows, stable, last_wild = [at(1, held) for held in HELD], 0, 0
    for substeps in grid(2**24):
        if substeps > FINEST and stable >= (2 if substeps > DEAR else CONFIRM):
            break
        rows.append(at(substeps))
        if rows[-1]["verdict"] == VERDICTS[2]:
            stable, last_wild = 0, substeps
        else:
            stable += 1
    tested = sorted(row["substeps"] for row in rows if row["intervals"] == 1)
    low, high = last_wild, next((k for k in tested if k > last_wild), 0)
    while low and high < DEAR and high - low > max(1, 0.03 * low):
        middle = (low + high) // 2
        rows.append(at(middle))
        low, high = (middle, high) if rows[-1]["verdict"] == VERDICTS[2] else (low, middle)
    return rows


def limit(rows: list[dict]) -> tuple[float, float]:
    """Largest stable step of the cells of one method on one fish, and the shortest that is not, s (inf for none)."""
    wild = min((row["step_s"] for row in rows if row["verdict"] == VERDICTS[2]), default=np.inf)
    return max((row["step_s"] for row in rows if row["step_s"] < wild), default=np.nan), wild


def fishes() -> list[tuple[str, float, Fish]]:
    """(body, stiffness factor, fish): the default fish at every stiffness, every other body as it is."""
    default = make_fish()
    stiff = [(default.name, factor, scaled(default, stiffness=factor)) for factor in STIFFNESS]
    return stiff + [(name, 1.0, make_fish(name)) for name in BODIES if name != default.name]


def survey() -> list[dict]:
    """Every cell, or those found before Ctrl-C: the CSV is written after each sweep."""
    rows, cases = [], fishes()
    try:
        with tqdm(total=len(cases) * len(FIXED), unit="sweep") as bar:
            for body, factor, fish in cases:
                bar.set_postfix_str(f"{body} x{factor:g} truth")
                true_path, true_energy = truth(fish)
                for name in FIXED:
                    bar.set_postfix_str(f"{body} x{factor:g} {name}")
                    found = sweep(fish, name, true_path, true_energy)
                    found.sort(key=lambda row: -row["step_s"])
                    rows += [{"body": body, "stiffness": factor} | row for row in found]
                    write_csv("stability.csv", rows, COMMAND)
                    bar.update()
    except KeyboardInterrupt:
        print("interrupted: what was measured is kept")
    return rows


def limits(rows: list[dict]) -> list[dict]:
    """Largest stable step by body, stiffness and method, measured and by linear theory, and over explicit Euler's."""
    table = []
    for body, factor, fish in fishes():
        measured, theory = {}, {}
        for name in FIXED:
            mine = [row for row in rows if (row["body"], row["stiffness"], row["integrator"]) == (body, factor, name)]
            if mine:
                measured[name], theory[name] = limit(mine), linear_limit(name, fish.body, 10 * fish.control_interval)
        explicit, linear = measured.get("explicit_euler", [np.nan])[0], theory.get("explicit_euler", np.nan)
        for name, (largest, wild) in measured.items():
            table.append(
                {
                    "body": body, "stiffness": factor, "integrator": name, "largest_stable_s": largest,
                    "unstable_from_s": wild, "linear_theory_s": theory[name],
                    "over_explicit_euler": round(largest / explicit, 3),
                    "linear_over_explicit_euler": round(theory[name] / linear, 3),
                }
            )  # fmt: skip
    return table


def report(rows: list[dict], table: list[dict]) -> None:
    """Print largest steps over explicit Euler's, and who stays bounded at a step of the control interval."""
    for body in dict.fromkeys(row["body"] for row in table):
        print(f"\n{body}, as it is: largest stable step of the manoeuvre; thesis, over explicit Euler: {THESIS}")
        print(f"{'':30}{'measured, ms':>14}{'linear, ms':>12}{'over explicit':>15}{'linear':>9}")
        for row in table:
            if row["body"] == body and row["stiffness"] == 1.0:
                print(f"{row['integrator']:30}{1e3 * row['largest_stable_s']:14.3f}{1e3 * row['linear_theory_s']:12.3f}"
                      f"{row['over_explicit_euler']:15.1f}{row['linear_over_explicit_euler']:9.1f}")  # fmt: skip
    default = make_fish()
    print(f"\n{default.name} at a step of one control interval: error in body lengths by stiffness, X blown up")
    print(f"{'':30}" + "".join(f"{factor:8g}" for factor in STIFFNESS))
    for name in FIXED:
        line = [row for row in rows if row["body"] == default.name and row["integrator"] == name
                and row["substeps"] == row["intervals"] == 1]  # fmt: skip
        marks = {row["stiffness"]: "X" if row["verdict"] == VERDICTS[2] else f"{row['error']:.2f}" for row in line}
        print(f"{name:30}" + "".join(f"{marks.get(factor, ''):>8}" for factor in STIFFNESS))


# Charts

COLOURS = ("#0072B2", "#F5C26B", "#4A4A4A")  # of VERDICTS


def read() -> list[dict]:
    """The cells of the CSV, numbers as numbers."""
    with (RESULTS / "stability.csv").open() as file:
        rows = list(csv.DictReader(line for line in file if not line.startswith("#")))
    for row in rows:
        for key in ("stiffness", "step_s", "error", "energy"):
            row[key] = float(row[key])
        for key in ("substeps", "intervals", "non_positive_pivots"):
            row[key] = int(row[key])
    return rows


def pyplot():
    """Matplotlib without a screen."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot as plt

    return plt


def draw_limits(table: list[dict], path: Path) -> None:
    """Largest stable step against stiffness: measured, a marker; linear theory, a dashed line."""
    plt, fish = pyplot(), make_fish()
    implicit = [name for name in FIXED if INTEGRATORS[name].factorisations and name != "semi_implicit"]
    shared = [name for name in FIXED if name not in implicit]
    figure, panels = plt.subplots(1, 2, figsize=(12.5, 6), sharey=True, layout="constrained")
    top = 1e3 * HELD[0] * fish.control_interval
    for panel, names, title in zip(panels, (shared, implicit), ("explicit, stabilised and Tu's", "linearly implicit"),
                                   strict=True):  # fmt: skip
        for name in names:
            line = [row for row in table if row["body"] == fish.name and row["integrator"] == name]
            colour, marker = STYLE.get(name, ("#444444", "P"))
            factor = [row["stiffness"] for row in line]
            hollow = name in ("semi_implicit", "linearly_implicit_water")  # so that what lies beneath is seen
            panel.loglog(factor, [1e3 * row["largest_stable_s"] for row in line], color=colour, marker=marker,
                         markersize=9 if hollow or marker == "*" else 5, fillstyle="none" if hollow else "full",
                         linewidth=1.4, label=name)  # fmt: skip
            theory = [min(1e3 * row["linear_theory_s"], 1.25 * top) for row in line]
            panel.plot(factor, theory, color=colour, linestyle=(0, (4, 3)), linewidth=1.0)
        for value in (fish.control_interval, fish.time_step):
            panel.axhline(1e3 * value, color="#888888", linewidth=0.8, linestyle=":", zorder=0)
        panel.plot([], [], color="#444444", linestyle=(0, (4, 3)), linewidth=1.0, label="linear theory (top: none)")
        panel.set(title=title, xlabel="stiffness over the default fish's (damping kept)", xlim=(0.85, 1.2e4))
        panel.grid(alpha=0.2)
        panel.legend(frameon=False, loc="lower left", fontsize=8.5)
    panels[0].text(1.1e4, 1e3 * fish.control_interval * 0.93, "control interval", fontsize=8, ha="right", va="top")
    panels[0].text(1.1e4, 1e3 * fish.time_step * 1.07, "default step", fontsize=8, ha="right", va="bottom")
    panels[0].set_ylabel("largest stable step, ms")
    figure.savefig(path, metadata={"Date": None})
    plt.close(figure)


def edges(values) -> np.ndarray:
    """Borders of the cells around increasing values on a logarithmic axis."""
    logarithm = np.log(values)
    middle = 0.5 * (logarithm[1:] + logarithm[:-1])
    ends = 2 * logarithm[0] - middle[0], 2 * logarithm[-1] - middle[-1]
    return np.exp(np.concatenate([ends[:1], middle, ends[1:]]))


def draw_verdicts(plt, figure, columns=5) -> None:
    """The legend below a map."""
    handles = [plt.Rectangle((0, 0), 1, 1, color=colour) for colour in COLOURS]
    texts = [f"accurate: within {ACCURATE:.0%} of a body length", "bounded but wrong", "blown up"]
    for marker, size, colour, width, text in (
        ("o", 3.5, "white", 0.6, "non-positive pivots met"),
        ("D", 7, "white", 1.6, "the fish's own step"),
    ):
        handles.append(plt.Line2D([], [], ls="", marker=marker, ms=size, color=colour, mec="black", mew=width))
        texts.append(text)
    figure.legend(handles, texts, loc="outside lower center", ncols=columns, frameon=False, handlelength=1.2)


def draw_map(rows: list[dict], path: Path) -> None:
    """Accurate, bounded or blown up: a panel a method, step against stiffness; dots where pivots were not positive."""
    plt, fish = pyplot(), make_fish()
    columns = -(-len(FIXED) // 2)
    figure, panels = plt.subplots(2, columns, figsize=(3.1 * columns, 8.6), sharex=True, sharey=True, squeeze=False,
                                  layout="constrained")  # fmt: skip
    coarse = set(grid(FINEST))
    steps = sorted(1e3 * fish.control_interval / k for k in {*coarse, *(1 / held for held in HELD)})
    for panel in panels.flat[len(FIXED) :]:
        panel.set_axis_off()
    for panel, name in zip(panels.flat, FIXED, strict=False):
        shade, dotted = np.full((len(steps), len(STIFFNESS)), np.nan), []
        for row in rows:
            if row["body"] == fish.name and row["integrator"] == name:
                close = np.abs(np.log(np.array(steps) / (1e3 * row["step_s"])))
                if close.min() < 1e-4:  # not one of the refinement
                    shade[close.argmin(), STIFFNESS.index(row["stiffness"])] = VERDICTS.index(row["verdict"])
                    if row["non_positive_pivots"]:
                        dotted.append((row["stiffness"], 1e3 * row["step_s"]))
        colours = plt.matplotlib.colors.ListedColormap(COLOURS)
        panel.pcolormesh(edges(STIFFNESS), edges(steps), shade, cmap=colours, vmin=-0.5, vmax=2.5, edgecolors="white",
                         linewidth=0.3, rasterized=True)  # fmt: skip
        if dotted:
            panel.plot(*zip(*dotted, strict=True), "o", color="white", mec="black", mew=0.4, markersize=2.8)
        own = fish.time_step if name == fish.integrator else None
        if own:
            panel.plot(1.0, 1e3 * own, "D", color="white", mec="black", mew=1.6, markersize=7, clip_on=False)
        panel.axhline(1e3 * fish.control_interval, color="black", linewidth=0.7, linestyle=":")
        panel.set(xscale="log", yscale="log")
        panel.set_title(name, fontsize=10)
    for panel in panels[-1]:
        panel.set_xlabel("stiffness over the default's")
    for panel in panels[:, 0]:
        panel.set_ylabel("step, ms (dotted line: control interval)")
    draw_verdicts(plt, figure)
    figure.savefig(path, dpi=200, metadata={"Date": None})
    plt.close(figure)


def draw_published(rows: list[dict], path: Path, body="published") -> None:
    """The same for the published fish as it is: a row a method, the published step marked."""
    plt, fish = pyplot(), make_fish(body)
    figure, panel = plt.subplots(figsize=(9.5, 4.6), layout="constrained")
    for number, name in enumerate(reversed(FIXED)):
        line = sorted((row for row in rows if row["body"] == body and row["integrator"] == name),
                      key=lambda row: row["step_s"])  # fmt: skip
        border = edges([row["step_s"] for row in line]) if line else ()
        for row, (left, right) in zip(line, pairwise(border), strict=False):
            panel.barh(number, right - left, left=left, height=0.86, color=COLOURS[VERDICTS.index(row["verdict"])],
                       edgecolor="white", linewidth=0.3)  # fmt: skip
            if row["non_positive_pivots"]:
                panel.plot(row["step_s"], number, "o", color="white", mec="black", mew=0.4, markersize=3)
    own = FIXED[::-1].index(fish.integrator)
    panel.plot(fish.time_step, own, "D", color="white", mec="black", mew=1.6, markersize=8)
    panel.axvline(PUBLISHED_STEP, color="black", linewidth=0.9, linestyle=":")
    panel.set(xscale="log", xlabel=f"step, s (dotted line: the published {PUBLISHED_STEP} s)", yticks=range(len(FIXED)),
              yticklabels=FIXED[::-1], title="the published fish in its own water")  # fmt: skip
    panel.set_ylim(-0.6, len(FIXED) - 0.4)
    draw_verdicts(plt, figure, 3)
    figure.savefig(path, metadata={"Date": None})
    plt.close(figure)


def draw_all(rows: list[dict]) -> None:
    """Tables and every chart from the cells."""
    table = limits(rows)
    write_csv("stability_limits.csv", table, COMMAND)
    report(rows, table)
    draw_limits(table, RESULTS / "stability.svg")
    draw_map(rows, RESULTS / "stability_map.svg")
    draw_published(rows, RESULTS / "stability_published.svg")
    print(f"written to {RESULTS / 'stability.csv'} and stability_*.csv, stability*.svg beside it")


def main() -> int:
    """The command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    action = parser.add_mutually_exclusive_group()
    action.add_argument("--draw", action="store_true", help="tables and charts again from the CSV")
    action.add_argument(
        "--margins", action="store_true", help="default step against the largest stable one; exit 1 if missed"
    )
    action.add_argument("--attack", action="store_true", help="try to break the fish; exit 1 if the method does")
    parser.add_argument("--integrator", help="of --margins and --attack, instead of the fish's own")
    parser.add_argument("--substeps", type=int, help="steps a control interval of the default fish, with --integrator")
    parser.add_argument("--fish", type=int, default=10_000, help="of --attack, in all families of random actions")
    parser.add_argument("--evaluations", type=int, default=10_000, help="of the search of --attack")
    arguments = parser.parse_args()
    if arguments.margins:
        from benchmarks.margins import margins

        return 0 if margins(arguments.integrator, arguments.substeps) else 1
    if arguments.attack:
        from benchmarks.attack import attack

        return 0 if attack(arguments.integrator, arguments.substeps, arguments.fish, arguments.evaluations) else 1
    draw_all(read() if arguments.draw else survey())
    return 0


if __name__ == "__main__":
    sys.exit(main())
