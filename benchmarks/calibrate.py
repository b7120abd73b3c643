"""Calibrate the mass-spring fish so that it swims like a fish of its length, and check that it does.

    python -m benchmarks.calibrate --search     search body and gait (CMA-ES, about 8 min on one core), write both files
    python -m benchmarks.calibrate --gait       search the best open-loop gait of the fish as it is (2 min)
    python -m benchmarks.calibrate --check      measure that gait against the bars, exit 1 if one is missed
    python -m benchmarks.calibrate --trout      measure the fish beside a real trout of 19.6 cm: table, CSV and chart

The search minimises one number: how far the gait is from a stride of 0.58 body lengths, a Strouhal number below 0.36
and a sweep of 0.12 to 0.20 lengths; how much the fish rolls once disturbed; how well it survives being flung about at
nearly the largest step; how far speed and sweep are from the trout's at its three beat frequencies; and
the steps a beat costs, since stiffness is what makes a fish swim and what makes it dear.
"""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent.parent))  # so that it runs as a script as well as with -m

import argparse
import json
import multiprocessing
from dataclasses import dataclass

import numpy as np
from scipy.optimize import brentq

from benchmarks.gaits import NOISE, swim
from benchmarks.provenance import RESULTS, provenance, write_csv
from fish_env import make_fish
from fish_env.bodies.mass_spring import CALIBRATED_FILE
from fish_env.control import Gait, best_gait, evaluate, gait_controller, make_eval_env
from fish_env.control.gait import GAIT_FILE
from fish_env.integrators import limits
from fish_env.tank import Tank

FREQUENCY = 4.0  # Hz, of the gait that is searched; only ratios of times matter to the water law
GAIT_SEED = 2_000_000  # of the episodes a gait is tuned on: neither those of training nor those of evaluation
DIGITS = 4  # significant figures kept of a calibrated parameter


@dataclass(frozen=True)
class Trout:
    """One row of a study of the median fins of a 19.6 cm rainbow trout (J. Exp. Biol., after Drucker & Lauder)."""

    speed: float  # body lengths/s
    frequency: float  # Hz
    sweep: float  # body lengths


TROUT_LENGTH = 0.196  # m
TROUT = tuple(Trout(u, f, cm / 19.6) for u, f, cm in ((0.5, 2.48, 1.80), (1.0, 3.18, 2.55), (2.0, 4.23, 2.85)))

# name, lowest, highest, logarithmic
SPANS = {
    "layer_position": ((0.14, 0.26), (0.30, 0.46), (0.48, 0.62), (0.66, 0.78), (0.80, 0.87)),
    "half_depth": ((0.05, 0.09), (0.085, 0.125), (0.07, 0.115), (0.04, 0.062), (0.03, 0.045)),
    "half_width": ((0.025, 0.06), (0.035, 0.07), (0.03, 0.065), (0.015, 0.034), (0.006, 0.015)),
    "tail_half_span": ((0.12, 0.16),),
    "contracted": ((0.65, 0.8), (0.65, 0.92), (0.65, 0.92)),
    "drag_coefficient": ((1.1, 1.9),),
    "scale": ((0.2, 0.8), (0.3, 0.9), (0.5, 1.0)),  # of the amplitude, at the trout's three frequencies
}


def linear(*names) -> list[tuple[str, float, float, bool]]:
    """Rows of SEARCHED for the spans of that name."""
    return [(f"{name}{k}", low, high, False) for name in names for k, (low, high) in enumerate(SPANS[name])]


SEARCHED = (
    linear("layer_position", "half_depth", "half_width", "tail_half_span")
    + [(f"stiffness{k}", 20.0, 5e3, True) for k in range(3)]
    + [(f"taper{k}", 0.1, 3.0, True) for k in range(1, 6)]
    + [("relaxation_time0", 5e-4, 5e-3, True), ("mass_factor5", 1.0, 2.0, True), ("mass_factor6", 1.0, 4.0, True)]
    + linear("contracted", "drag_coefficient")
    + [("front", 0.0, 1.0, False), ("lag1", -1.0, 6.0, False), ("lag2", -1.0, 7.0, False)]
    + linear("scale")
)


def decode(point: np.ndarray) -> dict[str, float]:
    """Values of the searched numbers at a point of the unit cube."""
    values = {}
    for (name, low, high, logarithmic), u in zip(SEARCHED, np.clip(point, 0, 1), strict=True):
        values[name] = float(low * (high / low) ** u if logarithmic else low + (high - low) * u)
    return values


def parameters(values: dict[str, float]) -> dict:
    """The searched numbers as keywords of the mass-spring fish."""

    def row(name, count, first=0):
        return [1.0] * first + [float(f"{values[f'{name}{k}']:.{DIGITS}g}") for k in range(first, count)]

    single = ("tail_half_span", "relaxation_time", "drag_coefficient")
    rows = {"layer_position": 5, "half_depth": 5, "half_width": 5, "stiffness": 3, "contracted": 3}
    return {
        "length": 0.2,
        **{name: row(name, count) for name, count in rows.items()},
        **{name: row(name, 1)[0] for name in single},
        "taper": row("taper", 6, first=1),
        "mass_factor": row("mass_factor", 7, first=5),
        "contraction_time": 0.07,
        "time_step": 0.02 / 6,
        "control_interval": 0.02,
    }


def linear_limit(fish) -> float:
    """Largest stable step of symplectic Euler on the linearised body, s: damping k = tau c shortens 2/omega.

    The semi-implicit method's is about the same as long as the damping is not very small.
    """
    return limits.leapfrog(fish.body)


def worst_stretch(fish, dt) -> float:
    """Largest stretch of a unit while one side of the fish is flung after the other, as fast as the muscles allow."""
    steps = max(1, round(0.03 / dt))
    tank, worst = Tank(fish, 1, "semi_implicit", 0.03 / steps, fish.water), 0.0
    tank.velocity[0] = np.random.default_rng(0).normal(0.0, NOISE * fish.length, tank.velocity[0].shape)
    for k in range(36):
        side = 1 if (k // 6) % 2 == 0 else -1
        tank.drive(((fish.sides == side) & ((fish.segments < 2) | (k >= 24)))[None].astype(float), steps)
        if not tank.alive[0]:
            return 3.0 - k / 36  # the longer it held, the better: the search needs a slope
        pairs = fish.body.springs.nodes
        length = np.linalg.norm(tank.position[0, pairs[:, 0]] - tank.position[0, pairs[:, 1]], axis=1)
        worst = max(worst, np.max(length / fish.body.springs.rest_length))
    return worst


def cost(point: np.ndarray) -> float:
    """What the search minimises, see the top of the file."""
    values = decode(point)
    outside = 10 * float(np.sum((point - np.clip(point, 0, 1)) ** 2))
    fish = make_fish("mass_spring", **parameters(values))
    dt = linear_limit(fish) / 2
    steps = 1 / (FREQUENCY * dt)
    if steps > 2000:  # too dear to be worth swimming
        return 1e4 + 10 * np.log(steps / 2000) + outside
    lag = (0.0, values["lag1"], values["lag2"])

    def swum(frequency, scale, beats=10, push=0.4):
        gait = Gait(frequency, (scale * values["front"], scale, scale), lag)
        return swim(fish, gait, fish.water, dt, "symplectic_euler", beats, 3, decisions=16, push=push)

    best = swum(FREQUENCY, 1.0, beats=24, push=0.0)
    slower = [swum(row.frequency, values[f"scale{k}"]) for k, row in enumerate(TROUT)]
    if best.failure or any(s.failure for s in slower):
        return 5e3 + outside

    def beyond(value):
        return max(0.0, value)

    short = beyond(0.58 - best.stride)
    total = 400 * short**2 + short + 80 * beyond(best.strouhal - 0.36) ** 2
    total += 200 * beyond(0.12 - best.sweep) ** 2 + 200 * beyond(best.sweep - 0.20) ** 2
    total += 0.05 * beyond(best.wobble - 0.5) ** 2
    total += 0.5 * np.log(max(steps, 100.0) / 200.0) + 10 * beyond(np.log(steps / 300.0)) ** 2
    for ours, real in zip(slower, TROUT, strict=True):
        total += 4 * np.log(max(ours.speed, 0.02) / real.speed) ** 2
        total += 3 * np.log(max(ours.sweep, 0.01) / real.sweep) ** 2
    return float(total + 4 * beyond(worst_stretch(fish, 1.9 * dt) - 1.5) ** 2 + outside)


def search_from(job) -> tuple[float, list[float]]:
    """One run of CMA-ES; returns the lowest cost and where it is."""
    import cma

    seed, generations = job
    strategy = cma.CMAEvolutionStrategy(
        np.full(len(SEARCHED), 0.5), 0.2, {"seed": seed, "popsize": 24, "verbose": -9, "maxiter": generations}
    )
    lowest = (np.inf, [])
    while not strategy.stop():
        points = strategy.ask()
        costs = [cost(point) for point in points]
        strategy.tell(points, costs)
        best = int(np.argmin(costs))
        if costs[best] < lowest[0]:
            lowest = (costs[best], list(points[best]))
        if strategy.countiter % 20 == 0:
            print(f"seed {seed}, generation {strategy.countiter}: {lowest[0]:.4f}", flush=True)
    return lowest


def search(seeds: list[int], generations: int) -> None:
    """Search body and gait from several seeds, keep the best, and write the body and then its best gait."""
    with multiprocessing.get_context("spawn").Pool(len(seeds)) as pool:
        lowest, point = min(pool.map(search_from, [(seed, generations) for seed in seeds]))
    values = decode(np.array(point))
    command = f"python -m benchmarks.calibrate --search --seeds {' '.join(map(str, seeds))} --generations {generations}"
    record = {
        "provenance": provenance(command) | {"cost": lowest, "evaluations": 24 * generations * len(seeds)},
        "parameters": parameters(values),
        "gait": {"amplitude": [values["front"], 1.0, 1.0], "lag": [0.0, values["lag1"], values["lag2"]]},
    }
    CALIBRATED_FILE.write_text(json.dumps(record, indent=2) + "\n")
    write_gait((values["front"], 1.0, 1.0), (0.0, values["lag1"], values["lag2"]), command)


def write_gait(amplitude, lag, command, generations=60) -> None:
    """Find the default fish's best open-loop gait at no more than 4 Hz, from a first guess, and write it.

    Best is fastest in the task itself: mean distance between start and end of eight episodes of Swim-v0, whatever its
    direction. The cruise it settles into, undisturbed, must be within the bars.
    """
    import cma

    fish = make_fish("mass_spring")
    env = make_eval_env("FishEnv/Swim-v0", 8, {"muscle_groups": "pairs"})

    def gait(point):
        u = np.clip(point, 0, 1)
        return Gait(2.0 + 2.0 * u[0], tuple(u[1:4]), (0.0, *(2 * np.pi * point[4:6])))

    def slowness(point):
        found = gait(point)
        speed = evaluate(gait_controller(found, env), env, GAIT_SEED).own_speed.mean()
        outside = float(np.sum((point[:4] - np.clip(point[:4], 0, 1)) ** 2))
        measured = bars(swim(fish, found, fish.water))
        missed = sum(max(0.0, low - value) + max(0.0, value - high) for value, low, high in measured)
        return -speed + 20 * missed + 10 * outside

    start = np.array([1.0, *amplitude, *(np.array(lag[1:]) / (2 * np.pi))])
    options = {"seed": 1, "popsize": 16, "verbose": -9, "maxiter": generations}
    strategy = cma.CMAEvolutionStrategy(start, 0.1, options).optimize(slowness)
    found = gait(strategy.result.xbest)
    rounded = {"frequency": round(found.frequency, 3)} | {
        name: [float(f"{value:.{DIGITS}g}") for value in getattr(found, name)] for name in ("amplitude", "lag")
    }
    GAIT_FILE.parent.mkdir(parents=True, exist_ok=True)
    GAIT_FILE.write_text(json.dumps({"provenance": provenance(command), "gait": rounded}, indent=2) + "\n")


def bars(swum):
    """(value, lowest, highest) of what a gait must reach, with a margin of a hundredth."""
    wobble = np.radians(swum.wobble)
    return (swum.stride, 0.51, np.inf), (swum.strouhal, 0.21, 0.41), (swum.sweep, 0.105, 0.245), (wobble, 0.0, 0.02)


def largest_stable_step(fish, gait, integrator, seconds=3.0) -> float:
    """Largest step, to 2 %, at which the gait and 32 fish jerked at random all survive; in seconds."""

    def survives(steps_per_beat):
        dt = 1 / (gait.frequency * steps_per_beat)
        if swim(fish, gait, fish.water, dt, integrator, decisions=max(1, steps_per_beat // 10)).failure:
            return False
        steps = max(1, round(fish.control_interval / dt))
        tank = Tank(fish, 32, integrator, dt, fish.water)
        generator = np.random.default_rng(0)
        for k in range(round(seconds / (steps * dt))):
            if k % 4 == 0:
                jerk = generator.choice([0.0, 1.0], (32, fish.num_muscles))
            tank.drive(jerk, steps)
        return bool(tank.alive.all())

    fails, holds = 10, 2000
    while holds > fails * 1.02 + 1:
        middle = round(np.sqrt(fails * holds))
        fails, holds = (fails, middle) if survives(middle) else (middle, holds)
    return 1 / (gait.frequency * holds)


def check() -> bool:
    """Measure the best open-loop gait of the default fish against the bars; write gait.csv; True if all are met."""
    fish, gait = make_fish("mass_spring"), best_gait()
    swum, exact = swim(fish, gait, fish.water), swim(fish, gait, fish.water, fish.time_step / 8, "rk4")
    tu = largest_stable_step(fish, gait, "semi_implicit")
    half = 2 / (gait.frequency * tu)
    rows = [
        ("stride, lengths a beat", swum.stride, exact.stride, 0.5, np.inf),
        ("Strouhal number", swum.strouhal, exact.strouhal, 0.2, 0.42),
        ("tail sweep, lengths", swum.sweep, exact.sweep, 0.1, 0.25),
        ("speed, lengths/s", swum.speed, exact.speed, 1.0, np.inf),
        ("beat frequency, Hz", gait.frequency, gait.frequency, 0.0, 4.0),
        ("drag coefficient", fish.water.quadratic / 500.0, fish.water.quadratic / 500.0, 1.0, 2.0),
        ("steps a beat at half Tu's largest stable step", half, np.nan, 0.0, 400.0),
    ]
    table = [
        {
            "quantity": name, "ours": round(float(value), 4), "reference": round(float(reference), 4),
            "lowest": low, "highest": high, "met": bool(low <= value <= high),
        }
        for name, value, reference, low, high in rows
    ]  # fmt: skip
    path = write_csv("gait.csv", table, "python -m benchmarks.calibrate --check")
    print(f"{'':46}{'ours':>9}{'RK4/8':>9}   bar")
    for row in table:
        print(f"{row['quantity']:46}{row['ours']:9.3f}{row['reference']:9.3f}"
              f"   {row['lowest']:g} to {row['highest']:g} {'met' if row['met'] else 'MISSED'}")  # fmt: skip
    print(
        f"largest stable step of Tu's method {tu * 1e3:.3f} ms; the default method's own is {fish.time_step * 1e3:g} ms"
    )
    print(f"written to {path}")
    return all(row["met"] for row in table)


def trout() -> None:
    """Swim at the trout's three beat frequencies, at the amplitude that gives its speed; write trout.csv and .svg."""
    fish = make_fish("mass_spring", length=TROUT_LENGTH)
    amplitude, lag = json.loads(CALIBRATED_FILE.read_text())["gait"].values()
    rows = []
    for real in TROUT:

        def swum(scale, real=real):
            gait = Gait(real.frequency, tuple(scale * a for a in amplitude), tuple(lag))
            return swim(fish, gait, fish.water)

        top = 1.0
        scale = top
        if swum(top).speed > real.speed:
            scale = brentq(lambda s, swum=swum, real=real: swum(s).speed - real.speed, 0.05, top, xtol=1e-3)
        ours = swum(scale)
        rows.append(
            {
                "frequency_hz": real.frequency, "amplitude": round(scale, 3),
                "speed_trout": real.speed, "speed_ours": round(ours.speed, 3),
                "speed_off_percent": round(100 * (ours.speed / real.speed - 1), 1),
                "sweep_trout": round(real.sweep, 4), "sweep_ours": round(ours.sweep, 4),
                "sweep_off_percent": round(100 * (ours.sweep / real.sweep - 1), 1),
                "strouhal_trout": round(real.frequency * real.sweep / real.speed, 3),
                "strouhal_ours": round(ours.strouhal, 3),
            }
        )  # fmt: skip
    path = write_csv("trout.csv", rows, "python -m benchmarks.calibrate --trout")
    for name in rows[0]:
        print(f"{name:20}" + "".join(f"{row[name]:10}" for row in rows))
    draw_trout(rows)
    print(f"written to {path} and {path.with_suffix('.svg')}")


def draw_trout(rows) -> None:
    """Speed and sweep against beat frequency, ours beside the trout's."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot as plt

    figure, panels = plt.subplots(1, 3, figsize=(10, 3.2), layout="constrained")
    frequency = [row["frequency_hz"] for row in rows]
    names = {"speed": "speed, lengths/s", "sweep": "tail sweep, lengths", "strouhal": "Strouhal number"}
    for panel, (quantity, label) in zip(panels, names.items(), strict=True):
        panel.plot(frequency, [row[f"{quantity}_trout"] for row in rows], "o-", color="#4a4a4a", label="trout, 19.6 cm")
        panel.plot(frequency, [row[f"{quantity}_ours"] for row in rows], "s--", color="#0b7a99", label="fish_env")
        panel.set(xlabel="tail beats a second, Hz", ylabel=label, ylim=(0, None))
    panels[0].legend(frameon=False)
    figure.savefig(RESULTS / "trout.svg", metadata={"Date": None})


def main() -> int:
    """The command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    action = parser.add_mutually_exclusive_group(required=True)
    for name in ("search", "gait", "check", "trout"):
        action.add_argument(f"--{name}", action="store_true")
    parser.add_argument("--seeds", type=int, nargs="+", default=[1], help="one CMA-ES run each (--search)")
    parser.add_argument("--generations", type=int, default=300, help="of 24 evaluations (--search)")
    arguments = parser.parse_args()
    if arguments.search:
        search(arguments.seeds, arguments.generations)
    elif arguments.gait:
        start = json.loads(CALIBRATED_FILE.read_text())["gait"]
        write_gait(start["amplitude"], start["lag"], "python -m benchmarks.calibrate --gait")
    elif arguments.check:
        return 0 if check() else 1
    else:
        trout()
    return 0


if __name__ == "__main__":
    sys.exit(main())
