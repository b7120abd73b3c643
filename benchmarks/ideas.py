"""Methods that were tried and lost to `leapfrog_chebyshev`, as slow prototypes, so that anybody can see why.

    taskset -c 1 python -m benchmarks.ideas             every idea on three scenes (about 4 min): CSV and chart
    taskset -c 1 python -m benchmarks.ideas --draw      the chart again, from the CSV

An idea is a function of the motion and the step h that returns `step(rest, x, v)`, which gives x and v a step later;
`rest(part)` are the rest lengths when that part of the step is over. The error is that of `work_precision.py`. A force
evaluation is a pass over all units, be it for their force or for their tangent times a vector; the water may add a
second pass over the faces. What an idea spends on its matrices is counted apart, and is not in the chart: those that
need fewer force evaluations pay there, but for `velocity_verlet`, which needs fewer until the units are well damped.

Legend: x, v, a positions, velocities and accelerations of one fish (N,3); h step; f force; k, d stiffness and damping
matrices; r separation of each unit's nodes (E,3).
"""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent.parent))  # so that it runs as a script as well as with -m

import argparse
import csv
from collections import Counter

import numpy as np
from tqdm import tqdm

from benchmarks.problems import Problem, distance, problems, reference, run, tank_of
from benchmarks.provenance import RESULTS, write_csv
from benchmarks.work_precision import ACCURATE, STYLE
from fish_env import forces
from fish_env.bodies.mass_spring import LAYERS
from fish_env.forces import springs, water
from fish_env.integrators._common import check
from fish_env.world import VACUUM, World

SCENES = ("turn", "turn_x10", "turn_x10_damped")
SUBSTEPS = (1, 2, 3, 4, 5, 6, 8, 10, 12, 16, 24, 32, 48, 64)
COMPARISONS = ("leapfrog_chebyshev", "rk4", "symplectic_euler")
ENOUGH = 1e-4  # body lengths: no smaller step is tried
ITERATIONS = 10  # of the local-global method, a step
TOLERANCE = 0.01  # body lengths that step doubling may err in a step, at one substep; a quarter of it at two
MOST_FORCES = 4000  # a control interval, after which step doubling has failed
TOP = 2.0  # body lengths: larger errors are drawn there
COMMAND = "python -m benchmarks.ideas"
CSV = RESULTS / "ideas.csv"


class Motion:
    """One fish on its way: its forces and matrices, and a tally of what they cost."""

    def __init__(self, problem: Problem):
        self.fish, self.body, self.world = problem.fish, problem.fish.body, problem.world
        self.stiffness, self.damping = self.body.springs.stiffness, self.body.springs.damping
        self.mass, self.masses = self.body.mass[:, None], np.diag(self.body.mass)
        self.masses3 = np.kron(self.masses, np.eye(3))
        nodes, units = self.body.mass.size, np.arange(self.stiffness.size)
        self.ends = np.zeros((units.size, nodes))
        """(E,N) takes nodes to units: -1 at a unit's first node, 1 at its second."""
        self.ends[units, self.body.springs.nodes[:, 0]] = -1.0
        self.ends[units, self.body.springs.nodes[:, 1]] = 1.0
        self.work = Counter()

    def force(self, rest, x, v):
        """All forces, (N,3) N."""
        self.work["forces"] += 1
        f = np.empty_like(x)
        forces.total(self.body, self.world, rest, x, v, f)
        return f

    def water(self, x, v):
        """Force of the water alone, (N,3) N."""
        f = np.zeros_like(x)
        water.add_force(self.body, self.world, x, v, f)
        return f

    def effective(self, rest, x, v):
        """Tu's effective stiffness of every unit, (E,) N/m."""
        return np.array([springs.unit(self.body.springs, rest, x, v, e)[3] for e in range(rest.size)])

    def isotropic(self, weight):
        """Matrix (N,N) of units that pull back with a weight (E,) wherever their nodes go: one serves x, y and z."""
        return self.ends.T @ (weight[:, None] * self.ends)

    def jacobian(self, rest, x, v, world: World | None = None):
        """Exact stiffness and damping, (3N,3N) N/m and N s/m."""
        k, d = np.empty((2, 3 * len(x), 3 * len(x)))
        forces.jacobian(self.body, world or self.world, rest, x, v, k, d)
        return k, d

    def at_rest(self):
        """Stiffness and damping of the units of the body at rest, (3N,3N)."""
        position = self.body.position
        return self.jacobian(self.body.springs.rest_length, position, np.zeros_like(position), VACUUM)

    def solve(self, matrix, load):
        """A system (N,N) or (3N,3N) solved for a load (N,3), factorised for this one time."""
        self.work["factorisations"] += 1
        self.work["solves"] += 1
        return np.linalg.solve(matrix, load.reshape(len(matrix), -1)).reshape(load.shape)

    def factorised(self, matrix):
        """A function that solves that system for any load, factorised once."""
        self.work["factorisations"] += 1
        inverse = np.linalg.inv(matrix)

        def solve(load):
            self.work["solves"] += 1
            return (inverse @ load.reshape(len(inverse), -1)).reshape(load.shape)

        return solve


class Turning:
    """How far each node's surroundings have turned from their direction at rest: its layer's, or the whole body's."""

    def __init__(self, motion: Motion, layers: bool):
        self.fish, self.layers = motion.fish, layers
        self.layer = np.repeat(np.arange(len(LAYERS)), [len(nodes) for nodes in LAYERS])
        self.at_rest = self.frames(motion.body.position)

    def frames(self, x):
        """Forward, left and up, the columns of (N,3,3)."""
        centre = np.array([x[nodes].mean(axis=0) for nodes in LAYERS])
        if self.layers:
            last = len(LAYERS) - 1
            forward = np.array([centre[max(k - 1, 0)] - centre[min(k + 1, last)] for k in range(last + 1)])
            quads = np.array([LAYERS[min(max(k, 1), 5)] for k in range(last + 1)])
            left = x[quads[:, 0]] - x[quads[:, 1]] - x[quads[:, 2]] + x[quads[:, 3]]
        else:
            forward = np.repeat([centre[1] - centre[4]], len(LAYERS), axis=0)
            left = np.repeat([x[self.fish.left].mean(axis=0) - x[self.fish.right].mean(axis=0)], len(LAYERS), axis=0)
        forward = forward / np.linalg.norm(forward, axis=1, keepdims=True)
        left = left - forward * np.sum(left * forward, axis=1, keepdims=True)
        left = left / np.linalg.norm(left, axis=1, keepdims=True)
        return np.stack([forward, left, np.cross(forward, left)], axis=2)[self.layer]

    def turned(self, solve, x, load):
        """The load turned back to rest, solved for, and the solution turned again."""
        rotation = self.frames(x) @ self.at_rest.transpose(0, 2, 1)
        back = np.einsum("nji,nj->ni", rotation, load)
        return np.einsum("nij,nj->ni", rotation, solve(back))


def leapfrog(h, kick):
    """Drift half a step, kick, drift half a step; the kick has the middle's positions and rest lengths, and old v."""

    def step(rest, x, v):
        middle = x + 0.5 * h * v
        v = v + kick(rest(0.5), middle, v)
        return middle + 0.5 * h * v, v

    return step


# The ideas


def semi_implicit_positive(motion: Motion, h: float):
    """Tu's step, its matrix kept definite: only stretched units are implicit. One (N,N) matrix a step."""

    def step(rest, x, v):
        matrix = motion.masses + h * h * motion.isotropic(np.maximum(motion.effective(rest(0.0), x, v), 0.0))
        v = motion.solve(matrix, motion.mass * v + h * motion.force(rest(0.0), x, v))
        return x + h * v, v

    return step


def isotropic(motion: Motion, h: float):
    """Each unit's stiffness and damping in all directions, which bounds any tangent: one constant (N,N) matrix."""
    weight = h * motion.damping + h * h * motion.stiffness
    solve = motion.factorised(motion.masses + motion.isotropic(weight))

    def step(rest, x, v):
        v = v + solve(h * motion.force(rest(0.0), x, v))
        return x + h * v, v

    return step


def isotropic_leapfrog(motion: Motion, h: float):
    """The same bound, symmetric in time."""
    weight = 0.5 * h * motion.damping + 0.25 * h * h * motion.stiffness
    solve = motion.factorised(motion.masses + motion.isotropic(weight))
    return leapfrog(h, lambda rest, x, v: solve(h * motion.force(rest, x, v)))


def semi_implicit_leapfrog(motion: Motion, h: float):
    """Tu's matrix, his effective stiffness lagged, symmetric in time: one (N,N) matrix a step."""

    def kick(rest, x, v):
        matrix = motion.masses + 0.25 * h * h * motion.isotropic(motion.effective(rest, x, v))
        return motion.solve(matrix, h * motion.force(rest, x, v))

    return leapfrog(h, kick)


def rest_matrix(motion: Motion, h: float, layers=True):
    """Leapfrog with the (3N,3N) matrix of the body at rest, inverted once, turned with each layer of the body."""
    k, d = motion.at_rest()
    solve, turning = motion.factorised(motion.masses3 + 0.5 * h * d + 0.25 * h * h * k), Turning(motion, layers)
    return leapfrog(h, lambda rest, x, v: turning.turned(solve, x, h * motion.force(rest, x, v)))


def rest_matrix_body(motion: Motion, h: float):
    """The same, turned with the body as a whole."""
    return rest_matrix(motion, h, layers=False)


def newmark_rest_matrix(motion: Motion, h: float):
    """Newmark's trapezoid (Newmark 1959), one correction with the turned matrix: of second order whatever that is."""
    k, d = motion.at_rest()
    solve, turning = motion.factorised(motion.masses3 + 0.5 * h * d + 0.25 * h * h * k), Turning(motion, True)
    a = None

    def step(rest, x, v):
        nonlocal a
        a = motion.force(rest(0.0), x, v) / motion.mass if a is None else a
        x, v = x + h * v + 0.5 * h * h * a, v + h * a
        change = turning.turned(solve, x, motion.force(rest(1.0), x, v) - motion.mass * a)
        a = a + change
        return x + 0.25 * h * h * change, v + 0.5 * h * change

    return step


def implicit_midpoint(motion: Motion, h: float):
    """Implicit midpoint, one Newton step with the exact Jacobian: the best a matrix made beforehand can hope for."""

    def kick(rest, x, v):
        k, d = motion.jacobian(rest, x, v)
        return motion.solve(motion.masses3 + 0.5 * h * d + 0.25 * h * h * k, h * motion.force(rest, x, v))

    return leapfrog(h, kick)


def generalised_alpha(motion: Motion, h: float, radius=0.5):
    """Generalised-alpha (Chung & Hulbert 1993), one correction with the exact Jacobian."""
    old_a, old = (2.0 * radius - 1.0) / (radius + 1.0), radius / (radius + 1.0)
    gamma, beta = 0.5 - old_a + old, 0.25 * (1.0 - old_a + old) ** 2
    a = None

    def step(rest, x, v):
        nonlocal a
        a = motion.force(rest(0.0), x, v) / motion.mass if a is None else a
        guess_x, guess_v = x + h * v + 0.5 * h * h * a, v + h * a
        at = rest(1.0 - old), (1.0 - old) * guess_x + old * x, (1.0 - old) * guess_v + old * v
        k, d = motion.jacobian(*at)
        matrix = (1.0 - old_a) * motion.masses3 + (1.0 - old) * (gamma * h * d + beta * h * h * k)
        change = motion.solve(matrix, motion.force(*at) - motion.mass * a)
        a = a + change
        return guess_x + beta * h * h * change, guess_v + gamma * h * change

    return step


def velocity_verlet(motion: Motion, h: float):
    """Velocity Verlet, the force at the end of the step taken with a predicted velocity."""
    a = None

    def step(rest, x, v):
        nonlocal a
        a = motion.force(rest(0.0), x, v) / motion.mass if a is None else a
        x = x + h * v + 0.5 * h * h * a
        after = motion.force(rest(1.0), x, v + h * a) / motion.mass
        v, a = v + 0.5 * h * (a + after), after
        return x, v

    return step


def implicit_damping(motion: Motion, h: float):
    """Leapfrog with the units' damping implicit, stiffness and water explicit: one (3N,3N) matrix a step."""

    def kick(rest, x, v):
        d = motion.jacobian(rest, x, v, VACUUM)[1]
        return motion.solve(motion.masses3 + 0.5 * h * d, h * motion.force(rest, x, v))

    return leapfrog(h, kick)


def force_gradient(motion: Motion, h: float, gradient=1.0 / 12.0):
    """Leapfrog whose kick is corrected by the force's gradient (Takahashi & Imada 1984), damping and water centred."""

    def kick(rest, x, v):
        a = motion.force(rest, x, v) / motion.mass
        motion.work["forces"] += 1  # the tangent's pass, and the water's second
        r, turn = motion.ends @ x, motion.ends @ a
        length = np.linalg.norm(r, axis=1, keepdims=True)
        along = np.sum(r * turn, axis=1, keepdims=True) * r / length**2
        strain = 1.0 - rest[:, None] / length
        elastic = gradient * h * h * motion.stiffness[:, None] * (along + strain * (turn - along))
        correction = -motion.ends.T @ (elastic + 0.5 * h * motion.damping[:, None] * along)
        correction += motion.water(x, v + 0.5 * h * a) - motion.water(x, v)
        return h * (a + correction / motion.mass)

    return leapfrog(h, kick)


def local_global(motion: Motion, h: float):
    """Implicit Euler by local-global iteration, one constant (N,N) matrix (Liu et al. 2013; Bouaziz et al. 2014).

    A unit's damping draws its length to what it was: a stiffness k/h towards that.
    """
    weight = motion.stiffness + motion.damping / h
    solve = motion.factorised(motion.masses + h * h * motion.isotropic(weight))

    def step(rest, x, v):
        inertia = x + h * v + h * h * motion.water(x, v) / motion.mass
        length = np.linalg.norm(motion.ends @ x, axis=1)
        wanted = (motion.stiffness * rest(1.0) + motion.damping / h * length) / weight
        new = inertia
        for _ in range(ITERATIONS):
            motion.work["forces"] += 1
            r = motion.ends @ new
            goal = r * (wanted / np.linalg.norm(r, axis=1))[:, None]
            new = solve(motion.mass * inertia + h * h * motion.ends.T @ (weight[:, None] * goal))
        return new, (new - x) / h

    return step


def step_doubling(motion: Motion, h: float):
    """Symplectic Euler, every step tried whole and halved, and again smaller where the two differ too much.

    Its step covers a control interval; h only says how much a step may err, the square of it.
    """
    interval = motion.fish.control_interval
    allowed = TOLERANCE * motion.fish.length * (h / interval) ** 2
    trial = interval

    def euler(a, x, v, h):
        return x + h * (v + h * a), v + h * a

    def step(rest, x, v):
        nonlocal trial
        now, most = 0.0, motion.work["forces"] + MOST_FORCES
        a = motion.force(rest(0.0), x, v) / motion.mass
        while now < interval * (1.0 - 1e-12):
            if motion.work["forces"] >= most or not np.isfinite(a).all():
                raise FloatingPointError
            length = min(trial, interval - now)
            whole = euler(a, x, v, length)
            half = euler(a, x, v, 0.5 * length)
            between = motion.force(rest((now + 0.5 * length) / interval), *half) / motion.mass
            halves = euler(between, *half, 0.5 * length)
            error = np.linalg.norm(whole[0] - halves[0], axis=1).max()
            trial = length * min(max(0.9 * np.sqrt(allowed / max(error, 1e-300)), 0.2), 2.0)
            if error <= allowed:
                now, (x, v) = now + length, halves
                a = motion.force(rest(now / interval), x, v) / motion.mass
        return x, v

    return step


IDEAS = (
    semi_implicit_positive,
    semi_implicit_leapfrog,
    implicit_damping,
    implicit_midpoint,
    generalised_alpha,
    isotropic,
    isotropic_leapfrog,
    rest_matrix,
    rest_matrix_body,
    newmark_rest_matrix,
    local_global,
    velocity_verlet,
    force_gradient,
    step_doubling,
)
EVERY_STEP = IDEAS[:5]  # a matrix made anew at every step; the others have one for good, or none
MARKS = {  # colours told apart by colour-blind readers (Okabe & Ito)
    "semi_implicit_positive": ("#D55E00", "s"),
    "semi_implicit_leapfrog": ("#CC79A7", "D"),
    "implicit_damping": ("#56B4E9", "v"),
    "implicit_midpoint": ("#009E73", "^"),
    "generalised_alpha": ("#B8A800", "P"),
    "isotropic": ("#D55E00", "s"),
    "isotropic_leapfrog": ("#CC79A7", "D"),
    "rest_matrix": ("#009E73", "^"),
    "rest_matrix_body": ("#66C2A5", "<"),
    "newmark_rest_matrix": ("#B8A800", "P"),
    "local_global": ("#882255", "X"),
    "velocity_verlet": ("#56B4E9", "v"),
    "force_gradient": ("#999999", "h"),
    "step_doubling": ("#7A5230", "d"),
}


def swim(problem: Problem, idea, substeps: int) -> tuple[np.ndarray | None, Counter, int]:
    """Positions at the end of every control interval (K,N,3), None if it failed; the work; the intervals it took."""
    motion, interval = Motion(problem), problem.fish.control_interval
    tank = tank_of(problem, "rk4", substeps)
    control, x, v = tank.control, tank.position[0].copy(), tank.velocity[0].copy()
    parts = 1 if idea is step_doubling else substeps
    step = idea(motion, interval / substeps)
    path = np.empty((len(problem.contraction), *x.shape))
    with np.errstate(all="ignore"):
        for k, goal in enumerate(problem.contraction):
            tank.command(goal[None], interval)
            start, change = control.rest_length[0].copy(), interval * control.rate[0]
            try:
                for s in range(parts):
                    x, v = step(lambda part, s=s: start + (s + part) / parts * change, x, v)  # noqa: B023
            except (FloatingPointError, np.linalg.LinAlgError):
                x = np.full_like(x, np.nan)
            if check(motion.body, x, v):
                return None, motion.work, k + 1
            control.rest_length[0], control.rate[0] = start + change, 0.0
            path[k] = x
    return path, motion.work, len(path)


def row(problem: Problem, name: str, substeps: int, error: float, forces, factorisations, solves) -> dict:
    """One row of the CSV; the work is a control interval's."""
    return {
        "scene": problem.name,
        "method": name,
        "substeps": substeps,
        "error": error,
        "outcome": "bounded" if np.isfinite(error) else "failed",
        "forces_per_interval": round(forces, 3),
        "factorisations_per_interval": round(factorisations, 3),
        "solves_per_interval": round(solves, 3),
    }


def measure(problem: Problem, idea, substeps: int, truth: np.ndarray) -> dict:
    """How far an idea is from the truth, and what it costs."""
    path, work, intervals = swim(problem, idea, substeps)
    error = np.inf if path is None else distance(problem.fish, path, truth)
    cost = (work[name] / intervals for name in ("forces", "factorisations", "solves"))
    return row(problem, idea.__name__, substeps, error, *cost)


def compare(problem: Problem, name: str, substeps: int, truth: np.ndarray) -> dict:
    """The same of a method of the package."""
    path, tank = run(problem, name, substeps)
    sound = bool(tank.alive[0])
    intervals = len(path) if sound else round(tank.time[0] / problem.fish.control_interval) + 1
    cost = (tank.counters[name][0] / intervals for name in ("force_evaluations", "factorisations", "solves"))
    return row(problem, name, substeps, distance(problem.fish, path, truth) if sound else np.inf, *cost)


def sweep(problem: Problem, truth: np.ndarray, bar: tqdm) -> list[dict]:
    """Every idea and every comparison at every step, largest first, until one is accurate enough."""
    rows = []
    for method in (*IDEAS, *COMPARISONS):
        for substeps in SUBSTEPS:
            name = method if isinstance(method, str) else method.__name__
            bar.set_postfix_str(f"{problem.name} {name} {substeps}")
            rows.append((compare if method is name else measure)(problem, method, substeps, truth))
            if rows[-1]["error"] < ENOUGH:
                break
        bar.update()
    return rows


def read() -> list[dict]:
    """The rows of the CSV, numbers as numbers."""
    with CSV.open() as file:
        rows = list(csv.DictReader(line for line in file if not line.startswith("#")))
    for entry in rows:
        entry["error"], entry["forces_per_interval"] = float(entry["error"]), float(entry["forces_per_interval"])
    return rows


def draw(rows: list[dict], path: Path) -> None:
    """A column a scene, a row a family: error against force evaluations, and above it a line a method for failures."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot as plt

    every_step = tuple(idea.__name__ for idea in EVERY_STEP)
    families = {
        "a matrix made at every step": every_step,
        "a constant matrix, or none": tuple(idea.__name__ for idea in IDEAS if idea.__name__ not in every_step),
    }
    heights = [height for names in families.values() for height in (len(names) + len(COMPARISONS), 40)]
    figure, panels = plt.subplots(4, 3, figsize=(15, 12.5), height_ratios=heights, sharex=True, layout="constrained")
    for half, (title, names) in enumerate(families.items()):
        names = (*names, *COMPARISONS)
        for strip, panel, scene in zip(*panels[2 * half : 2 * half + 2], SCENES, strict=True):
            for place, name in enumerate(names):
                draw_line(strip, panel, [entry for entry in rows if entry["scene"] == scene], name, place)
            panel.axhline(ACCURATE, color="#bbbbbb", linewidth=0.8, zorder=0)
            panel.set(xscale="log", yscale="log", ylim=(1e-5, 1.3 * TOP), xlim=(0.9, 800))
            panel.grid(alpha=0.2)
            strip.set(yticks=[], ylim=(len(names) - 0.4, -0.6))
        panels[2 * half, 0].set_ylabel("failed")
        panels[2 * half + 1, 0].set_ylabel("error, body lengths")
        figure.legend(*panels[2 * half + 1, 0].get_legend_handles_labels(), title=title, frameon=False,
                      loc=f"outside right {('upper', 'lower')[half]}")  # fmt: skip
    for top, bottom, scene in zip(panels[0], panels[-1], SCENES, strict=True):
        top.set_title(problems()[scene].title.replace(" and as", "\nand as"))
        bottom.set_xlabel("force evaluations per control interval")
    figure.savefig(path, metadata={"Date": None})
    plt.close(figure)


def draw_line(strip, panel, rows: list[dict], name: str, place: int) -> None:
    """One method on one scene: its sound runs in the panel, the failed ones hollow in the strip above."""
    colour, marker = STYLE[name] if name in COMPARISONS else MARKS[name]
    style = {"color": colour, "marker": marker, "markersize": 8 if name == "leapfrog_chebyshev" else 4.5}
    sound = [row for row in rows if row["method"] == name and np.isfinite(row["error"])]
    failed = [row["forces_per_interval"] for row in rows if row["method"] == name and not np.isfinite(row["error"])]
    dashes = "--" if name in COMPARISONS else "-"
    panel.plot([row["forces_per_interval"] for row in sound], [min(row["error"], TOP) for row in sound],
               linewidth=1.2, linestyle=dashes, label=name, **style)  # fmt: skip
    strip.plot(failed, [place] * len(failed), linestyle="", fillstyle="none", **style)


def main() -> int:
    """The command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--draw", action="store_true", help="draw the chart again from the CSV")
    if not parser.parse_args().draw:
        rows = []
        with tqdm(total=len(SCENES) * (len(IDEAS) + len(COMPARISONS)), unit="sweep") as bar:
            for scene in SCENES:
                bar.set_postfix_str(f"{scene} reference")
                rows += sweep(problems()[scene], reference(problems()[scene])[0], bar)
                write_csv(CSV.name, rows, COMMAND)  # as it comes: Ctrl-C keeps what is done
    else:
        rows = read()
    draw(rows, RESULTS / "ideas.svg")
    print(f"written to {CSV} and the chart beside it")
    return 0


if __name__ == "__main__":
    sys.exit(main())
