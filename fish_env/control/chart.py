"""Errors and costs of integrators and steps on random scenes of a fish, their chart, and which of them to take.

Fish begin at rest and are commanded for 2 s: contractions that every muscle holds for 1 to 15 control intervals,
bang-bang ones, square waves, gaits, and strokes nearly as strong and fast as they can be. The error of a scene is the
largest distance, in body lengths, of any node at the end of any control interval from RK4, whose steps were halved
until nothing moved by more than is allowed. A scene that magnifies a disturbance more than MAGNIFIED-fold has no error:
it is counted. The cost is the processor time of a control interval of one fish in a batch on one core, over all scenes
from start to end, median of repeats.
"""

import time
import warnings
from collections.abc import Callable, Mapping, Sequence
from contextlib import closing
from dataclasses import replace
from itertools import takewhile
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from fish_env.bodies import Fish
from fish_env.control.evaluation import as_controller, make_policy_env
from fish_env.control.files import replacing, writable_file, write_csv
from fish_env.control.gait import Gait
from fish_env.control.policy import shipped_policy
from fish_env.control.sequencer import random_actions
from fish_env.envs import FishVectorEnv
from fish_env.physics.integrators import INTEGRATORS
from fish_env.physics.records import World
from fish_env.physics.tank import Tank
from fish_env.physics.tank_options import longest_step

SEED, SECONDS = 420_000, 2.0  # first seed, duration of a scene
HOLDS = (1, 2, 5, 15)  # control intervals that a random contraction is held
DISTURBANCE = 1e-7  # body lengths: how far nodes are moved to see how much of it a scene makes
CONVERGED = 1e-6  # body lengths: how little halving its steps may change a reference
MAGNIFIED = 1e4  # a scene that magnifies more is unpredictable
FEWEST, MOST = 256, 8192  # steps a control interval of a reference
BATCH, REPEATS = 64, 3  # fish, and times that they are moved
SUBSTEPS = (1, 2, 3, 4, 5, 6, 8, 10, 12, 16, 24, 32, 48, 64, 96, 128, 192, 256, 384, 512, 768, 1024)
STEPS = {"leapfrog_chebyshev": (3, 4, 6, 8, 12, 16, 32, 64), "rosenbrock": (6, 12, 24, 48)}
"""Steps a control interval, not refined; the fish's own, refined as it says, is tried too."""
METHODS = ("midpoint", "rk4", "symplectic_euler", "semi_implicit")
EACH = 4  # numbers of steps tried of each of these, from half of those that linear theory asks for
STYLE = {  # colour of Okabe & Ito, and marker
    "symplectic_euler": ("#E69F00", "o"),
    "midpoint": ("#56B4E9", "o"),
    "rk4": ("#0072B2", "o"),
    "semi_implicit": ("#D55E00", "s"),
    "rosenbrock": ("#CC79A7", "D"),
    "leapfrog_chebyshev": ("#000000", "*"),
}
WORDS = {
    "symplectic_euler": "symplectic Euler", "rk4": "Runge-Kutta 4", "semi_implicit": "Tu's semi-implicit",
    "rosenbrock": "Rosenbrock", "leapfrog_chebyshev": "leapfrog-Chebyshev", "explicit_euler": "explicit Euler",
}  # fmt: skip
"""Names of methods as they are read; of others, as they are typed."""


class NotConvergedError(RuntimeError):
    """A reference that still changes with its step: no error can be measured against it."""


# Commands: each function draws the contractions of one scene, (K,M), from a generator, at times (K,) s


def for_pairs(fish: Fish, drawn) -> np.ndarray:
    """Contractions (S,K,M) of the muscles, of those (S,K,6) of segments and sides."""
    return np.clip(drawn, 0.0, 1.0)[:, :, fish.grouping("pairs")]


def piecewise(generator, intervals, longest, draw) -> np.ndarray:
    """(K,6) values, each held for a random time of 1 to `longest` control intervals."""
    found = np.empty((intervals, 6))
    for column in found.T:
        k = 0
        while k < intervals:
            pause = int(generator.integers(1, longest + 1))
            column[k : k + pause] = draw(generator)
            k += pause
    return found


def held(fish: Fish, generator: np.random.Generator, times: np.ndarray) -> np.ndarray:
    """Every muscle holds one random contraction after another, each for the same time, one of HOLDS."""
    hold = int(generator.choice(HOLDS))
    return np.repeat(generator.uniform(size=(-(-len(times) // hold), fish.num_muscles)), hold, axis=0)[: len(times)]


def bang_bang(fish, generator, times):
    """Each side of each segment is relaxed or contracted fully, for up to 0.3 s."""
    return for_pairs(fish, piecewise(generator, len(times), 15, lambda g: g.choice([0.0, 1.0]))[None])[0]


def square(fish, generator, times):
    """Left and right in turn at 1 to 6 Hz, the segments after one another."""
    frequency, lag = generator.uniform(1.0, 6.0), np.cumsum([0.0, *generator.uniform(0.0, 0.35, 2)])
    wave = np.sin(2 * np.pi * (frequency * times[:, None] - lag)) >= 0.0
    return for_pairs(fish, generator.uniform(0.3, 1.0) * np.stack([wave, ~wave], axis=2).reshape(1, len(times), 6))[0]


def gaits(fish, generator, times, highest=6.0):
    """Sinusoidal gaits of any frequency from 1 to `highest` Hz, amplitudes and lags."""
    lag = np.cumsum([0.0, *generator.uniform(0.0, 2.5, 2)])
    gait = Gait(generator.uniform(1.0, highest), tuple(generator.uniform(0.2, 1.0, 3)), tuple(lag))
    return gait.contraction(fish, times)


def sprints(fish, generator, times):
    """Gaits as the fastest are: 3.5 to 4 Hz, nearly full contractions, short lags."""
    lag = np.cumsum([0.0, *generator.uniform(-0.1, 0.7, 2)])
    amplitude = 1.0, generator.uniform(0.85, 1.0), generator.uniform(0.6, 1.0)
    return Gait(generator.uniform(3.5, 4.0), amplitude, tuple(lag)).contraction(fish, times)


FAMILIES = ((held, 16), (bang_bang, 16), (square, 16), (gaits, 8), (sprints, 8))
"""Families of commands, and how many scenes of each."""


class Setting(NamedTuple):
    """A fish in its water, and all scenes."""

    fish: Fish
    world: World
    goals: np.ndarray  # (S,K,M) contractions in [0, 1]
    kinds: tuple[str, ...]  # family of each scene that statistics are of; scenes after those have an error only


def random_scenes(fish: Fish, world: World) -> Setting:
    """A fish in water with the scenes of FAMILIES."""
    times = fish.control_interval * np.arange(1, round(SECONDS / fish.control_interval) + 1)
    thirds = replace(fish, segments=fish.thirds)
    goals = [
        family(thirds, np.random.default_rng([SEED + k, scene]), times)
        for k, (family, count) in enumerate(FAMILIES)
        for scene in range(count)
    ]
    return Setting(fish, world, np.stack(goals), tuple(f.__name__ for f, count in FAMILIES for _ in range(count)))


def task_scenes(fish: Fish, world: World, task: str) -> Setting:
    """A fish in water, with the commands of a task's shipped policy in it, or random ones where none fits the fish."""
    options, kind = {"body": fish, "water": world}, f"policy of {task}"
    try:
        policy = shipped_policy(task)
        env = make_policy_env(policy, BATCH, **options)
        controller = as_controller(policy, env)
    except ValueError:  # there is no policy, or the fish has other nodes than that of its training
        env, kind = FishVectorEnv(BATCH, task=task, **options), f"random actions in {task}"
        controller = random_actions(env)
    with closing(env):
        obs, interval, goals = env.reset(seed=SEED)[0], env.control_interval, []
        for k in range(round(SECONDS / interval)):
            action = controller(obs, k * interval)
            goals.append(np.clip(0.5 * (1.0 + action), 0.0, 1.0)[:, env.groups])
            obs = env.step(action)[0]
    return Setting(replace(fish, control_interval=interval), world, np.stack(goals, axis=1), (kind,) * BATCH)


class Motion(NamedTuple):
    """Paths of the scenes, which fish live, and the time it took."""

    path: np.ndarray  # (K,S,N,3) positions at the ends of control intervals, m
    alive: np.ndarray  # (S,) whether the fish lives at the end
    price: float  # microseconds of processor time per control interval of a living fish; nan if none lives at the end


def move(scenes: Setting, name: str, substeps: int, refine=np.inf, batch=0, disturbed=None) -> Motion:
    """Move all scenes, again and again in turn to fill a batch; `disturbed` (S,N,3) m is added to the start."""
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
    """Largest distance (S,) of any node at any time between two paths, body lengths."""
    return np.linalg.norm(path - other, axis=-1).max(axis=(0, 2)) / fish.length


class Reference(NamedTuple):
    """The reference of all scenes of a setting."""

    path: np.ndarray
    predictable: np.ndarray  # (S,) whether a scene has an error
    substeps: int
    change: float  # largest change of a predictable scene by the last halving, body lengths


def magnification(scenes: Setting, substeps: int) -> np.ndarray:
    """Factors (S,) by which the scenes magnify a small random displacement of the nodes; inf where a fish fails."""
    body = scenes.fish.body
    noise = np.random.default_rng(SEED).normal(size=(len(scenes.goals), *body.position.shape))
    moved = move(scenes, "rk4", substeps, disturbed=DISTURBANCE * scenes.fish.length * noise * (body.inverse_mass > 0))
    still = move(scenes, "rk4", substeps)
    return np.where(moved.alive & still.alive, distances(scenes.fish, moved.path, still.path) / DISTURBANCE, np.inf)


def converge(name: str, solve: Callable, apart: Callable, steps: tuple[int, int], allowed: float) -> tuple:
    """A solution by RK4 whose steps are halved until nothing changes by more than is allowed, body lengths."""
    # `solve` returns one by a number of steps a control interval, of which `steps` has the fewest and the most; `apart`
    # returns the distance of two. With it come its steps and the last change; NotConvergedError if the most do not do.
    (substeps, most), change = steps, np.inf
    found = solve(substeps)
    while not change <= allowed:
        if 2 * substeps > most:
            raise NotConvergedError(
                f"{name}: RK4 with {substeps} steps an interval differs by {change:.1e} body lengths from half "
                f"as many, more than {allowed:g}; allow more steps or take a tamer scene"
            )
        substeps, coarse = 2 * substeps, found
        found = solve(substeps)
        change = apart(found, coarse)
    return found, substeps, change


def reference(scenes: Setting, fewest: int = FEWEST, allowed: float = CONVERGED) -> Reference:
    """RK4 with its steps halved until no predictable scene changes by more than is allowed, body lengths."""
    # The fewest steps a control interval are as given, or twice, four times as many, where RK4 is stable.
    fish = scenes.fish
    while fish.control_interval / fewest > 0.5 * INTEGRATORS["rk4"].base(fish.body):
        fewest *= 2
    predictable = magnification(scenes, fewest) <= MAGNIFIED
    if not predictable.any():
        raise NotConvergedError(f"{fish.name}: RK4 fails or is unpredictable in every scene; give a stiffer fish")
    path, substeps, change = converge(
        fish.name, lambda k: move(scenes, "rk4", k).path,
        lambda fine, coarse: float(distances(fish, fine, coarse)[predictable].max()), (fewest, MOST), allowed,
    )  # fmt: skip
    return Reference(path, predictable, substeps, change)


Line = tuple[str, int, float]  # A method, its steps a control interval, and what refines them


def steps_of(fish: Fish) -> int:
    """Steps a control interval at the fish's own step."""
    return round(fish.control_interval / fish.time_step)


def lines(fish: Fish, world: World, steps: Mapping[str, Sequence[int]] = STEPS) -> list[Line]:
    """Methods, steps a control interval and refinements that are tried; the fish's own first. `steps` as STEPS."""
    found = [(fish.integrator, steps_of(fish), fish.refine)]
    found += [(name, k, np.inf) for name, tried in steps.items() for k in tried]
    for name in METHODS:
        base = INTEGRATORS[name].base(fish.body)
        least = 0.5 * fish.control_interval / base if base > 0.0 else np.inf
        found += [(name, k, np.inf) for k in [k for k in SUBSTEPS if k >= least][:EACH]]
    return [line for line in dict.fromkeys(found) if not INTEGRATORS[line[0]].refuses(fish.body, world)]


def measure(scenes: Setting, truth: Reference, line: Line, batch: int) -> tuple[dict[str, Any], np.ndarray]:
    """A row: how the errors of a method at a step are distributed over the scenes with a kind, and the cost."""
    # Errors are those of the predictable scenes in which no fish fails; `worst_of` is the family of the worst. All
    # errors (S,) come with it, nan where there is none.
    name, substeps, refine = line
    runs, count = [move(scenes, name, substeps, refine, batch) for _ in range(REPEATS)], len(scenes.kinds)
    alive = runs[0].alive
    error = np.where(truth.predictable & alive, distances(scenes.fish, runs[0].path, truth.path), np.nan)
    known = error[:count][np.isfinite(error[:count])]
    mean, ninety, worst, of = np.nan, np.nan, np.nan, ""
    if known.size:
        mean, ninety, worst = np.exp(np.log(known).mean()), np.quantile(known, 0.9), known.max()
        of = scenes.kinds[np.nanargmax(error[:count])]
    return {
        "integrator": name, "refine": refine, "substeps": substeps,
        "scenes": count, "unpredictable": int((~truth.predictable[:count]).sum()),
        "failed": int((~alive[:count]).sum()), "geometric_mean": float(mean), "ninety_percent": float(ninety),
        "worst": float(worst), "worst_of": of,
        "us_per_interval": round(float(np.median([run.price for run in runs])), 3), "batch": batch,
        "rk4_substeps": truth.substeps, "change": truth.change,
    }, error  # fmt: skip


def draw_errors(panel, rows: Sequence[dict]) -> None:
    """Draw the geometric mean of errors against cost, and lines up to the worst scene, a tick at 90 %."""

    def columns(part, *names) -> list[list]:
        return [[row[name] for row in part] for name in names]

    for name in dict.fromkeys(row["integrator"] for row in rows):
        colour, marker = STYLE.get(name, ("#999999", "x"))
        line = [row for row in rows if row["integrator"] == name and row["geometric_mean"] > 0.0]
        line.sort(key=lambda row: row["us_per_interval"])
        cost, mean, ninety, worst = columns(line, "us_per_interval", "geometric_mean", "ninety_percent", "worst")
        full = [row for row in line if row["failed"] == 0]
        panel.loglog(*columns(full, "us_per_interval", "geometric_mean"), color=colour, linewidth=1.2)
        panel.vlines(cost, mean, worst, color=colour, linewidth=0.6, alpha=0.6)
        panel.plot(cost, ninety, color=colour, linestyle="", marker="_")
        some = [row for row in line if row["failed"]]
        for part, fill, label in (full, "full", WORDS.get(name, name)), (some, "none", None):
            panel.plot(*columns(part, "us_per_interval", "geometric_mean"), color=colour, marker=marker,
                       linestyle="", fillstyle=fill, label=label)  # fmt: skip
    low, high = panel.get_xlim()
    ticks = [tick for k in range(7) for tick in (10**k, 2 * 10**k, 5 * 10**k) if low < tick < high]
    panel.set_xticks(ticks, map(str, ticks))
    panel.set_xticks([], minor=True)


def recommend(scenes: Setting, rows: Sequence[dict], error: float) -> tuple[dict, str]:
    """The least expensive row within an error, body lengths, or else the most accurate one, and a sentence about it."""
    # Its method's largest safe step is the longest at and below which no fish fails, unrefined, and at most the limit
    # of linear theory.
    fish, interval, fewest = scenes.fish, scenes.fish.control_interval, min(row["failed"] for row in rows)
    usable = [row for row in rows if row["failed"] == fewest and np.isfinite(row["geometric_mean"])]
    good = [row for row in usable if row["geometric_mean"] <= error]
    best = min(good or usable, key=lambda row: row["us_per_interval" if good else "geometric_mean"])
    name, mean = best["integrator"], best["geometric_mean"]
    tried = [row for row in rows if row["integrator"] == name and row["refine"] == np.inf]
    tried.sort(key=lambda row: -row["substeps"])
    safe = [interval / row["substeps"] for row in takewhile(lambda row: row["failed"] == fewest, tried)]
    limit = longest_step(fish, scenes.world, INTEGRATORS[name])
    step = min(max(safe, default=0.0), limit)  # a limit of nan is none
    least = "at least " if len(safe) == len(tried) and step != limit else ""
    unmet = f"no method tried has an error of at most {100 * error:.2g} %; the most accurate is"
    lost = f"; {fewest} of {best['scenes']} scenes fail with every method" if fewest else ""
    return best, (
        f"{'take' if good else unmet} {name} with dt={interval:g} / {best['substeps']}: error {100 * mean:.2g} %, time "
        f"{best['us_per_interval']:.2g} us a control interval; the largest safe step is {least}{step:.3g} s{lost}"
    )


def chart(fish: Fish, world: World, path: str | Path, error: float = 0.01, task: str | None = None) -> str:
    """Measure methods and steps on a fish in water, write a chart and a table, and return which of them to take."""
    # The chart is an .svg file, the table a .csv file of the same name. `error` is the wanted geometric mean, body
    # lengths. The commands are those of a task's policy in it, or random ones. ValueError for an error that is not
    # positive, an unknown task or a file that cannot be written; NotConvergedError without a reference.
    from matplotlib.figure import Figure
    from tqdm import tqdm

    if not 0.0 < error < np.inf:
        raise ValueError(f"the error is {100 * error:g} %; give a positive percentage of the body length, such as 1%")
    path = writable_file(path, (".svg",))
    scenes = random_scenes(fish, world) if task is None else task_scenes(fish, world, task)
    steps = [k for k in SUBSTEPS if k <= max(48, 4 * steps_of(scenes.fish))]
    tried = lines(scenes.fish, world, dict.fromkeys(("leapfrog_chebyshev", fish.integrator), steps))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of steps that are too long: they are to be tried
        truth = reference(scenes, 64, max(error / 1000, 1e-8))
        rows = [measure(scenes, truth, line, BATCH)[0] for line in tqdm(tried, fish.name)]
    best, sentence = recommend(scenes, rows, error)
    write_csv(path.with_suffix(".csv"), [rows[0], *(row.values() for row in rows)])
    figure = Figure(figsize=(7.5, 5.5), layout="constrained")
    panel = figure.subplots()
    draw_errors(panel, rows)
    panel.axhline(error, color="#999999", linestyle="--", linewidth=0.8)
    panel.plot(best["us_per_interval"], best["geometric_mean"], "ko", markersize=13, fillstyle="none",
               label="recommended")  # fmt: skip
    panel.yaxis.set_major_formatter(lambda share, _: f"{100 * share:g}")
    panel.set(
        title=f"{fish.name}, {scenes.kinds[0] if task else 'random scenes'}: mean, 90th percentile (tick), worst",
        xlabel=f"processor time of a control interval of {scenes.fish.control_interval:g} s, µs",
        ylabel="error, per cent of the body length (hollow: some failed)",
    )
    figure.legend(loc="outside lower center", ncols=4, frameon=False)
    with replacing(path) as partial:
        figure.savefig(partial, format="svg", metadata={"Date": None})
    return sentence
