"""Search the mass-spring body and its gait, so that it swims like a fish of its length (CMA-ES).

    python -m benchmarks.calibration.search     writes both parameter files (about 8 min on one core)

The search minimises one number: how far the gait is from a stride of 0.58 body lengths, a Strouhal number below 0.36
and a sweep of 0.12 to 0.20 body lengths; how much the fish rolls once disturbed; how far its springs stretch under
abrupt commands at nearly the largest step; how far speed and sweep are from the trout's at its three beat frequencies;
and the steps a beat costs, since stiffness makes a fish swim well and makes it expensive.
"""

import argparse
import json
import multiprocessing

import numpy as np

from benchmarks.calibration.gait_search import DIGITS, write_gait
from benchmarks.calibration.gaits import NOISE, swim
from benchmarks.calibration.trout import TROUT
from benchmarks.common.tables import provenance
from fish_env import make_fish
from fish_env.bodies.mass_spring import CALIBRATED_FILE
from fish_env.control import Gait
from fish_env.integrators import limits
from fish_env.tank import Tank

FREQUENCY = 4.0  # Hz, of the gait that is searched; only ratios of times matter to the water law

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
        "activation_time": (0.0, 0.0),
        "time_step": 0.02 / 6,
        "control_interval": 0.02,
    }


def linear_limit(fish) -> float:
    """Largest stable step of symplectic Euler on the linearised body, s: damping k = tau c shortens 2/omega.

    The semi-implicit method's is about the same as long as the damping is not very small.
    """
    return limits.leapfrog(fish.body)


def worst_stretch(fish, dt) -> float:
    """Largest stretch of a spring while one side of the fish is flung after the other, as fast as the muscles allow."""
    steps = max(1, round(0.03 / dt))
    tank, worst = Tank(fish, 1, "semi_implicit", 0.03 / steps, fish.water), 0.0
    tank.velocity[0] = np.random.default_rng(0).normal(0.0, NOISE * fish.length, tank.velocity[0].shape)
    for k in range(36):
        side = 1 if (k // 6) % 2 == 0 else -1
        tank.drive(((fish.sides == side) & ((fish.segments < 2) | (k >= 24)))[None].astype(float), steps)
        if not tank.alive[0]:
            return 3.0 - k / 36  # the longer it survived, the better: the search needs a slope
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
    if steps > 2000:  # too expensive to be of use
        return 1e4 + 10 * np.log(steps / 2000) + outside
    lag = (0.0, values["lag1"], values["lag2"])

    def swum(frequency, scale, beats=10, push=0.4):
        gait = Gait(frequency, (scale * values["front"], scale, scale), lag)
        return swim(fish, gait, fish.water, dt, "symplectic_euler", beats, 3, points=16, push=push)

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
    """Search body and gait from several seeds, take the best, and write the body and then its best gait."""
    with multiprocessing.get_context("spawn").Pool(len(seeds)) as pool:
        lowest, point = min(pool.map(search_from, [(seed, generations) for seed in seeds]))
    values = decode(np.array(point))
    command = f"python -m benchmarks.calibration.search --seeds {' '.join(map(str, seeds))} --generations {generations}"
    record = {
        "provenance": provenance(command) | {"cost": lowest, "evaluations": 24 * generations * len(seeds)},
        "parameters": parameters(values),
        "gait": {"amplitude": [values["front"], 1.0, 1.0], "lag": [0.0, values["lag1"], values["lag2"]]},
    }
    CALIBRATED_FILE.write_text(json.dumps(record, indent=2) + "\n")
    write_gait((values["front"], 1.0, 1.0), (0.0, values["lag1"], values["lag2"]), command)


def main() -> None:
    """The command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, nargs="+", default=[1], help="one run of CMA-ES each")
    parser.add_argument("--generations", type=int, default=300, help="of 24 evaluations")
    arguments = parser.parse_args()
    search(arguments.seeds, arguments.generations)


if __name__ == "__main__":
    main()
