"""Light fish in heavy water: which fail, and how far the others are from a fine solution.

python -m benchmarks.stability.heavy_water                  results/heavy_water.csv; exit 1 if a fish has failed

Half the mass and twice the drag, the extremes of the variation, with water up to 16 times as dense as water is: a node
is slowed down up to 64 times as fast as in the fish's own scenes. The stiffness is anything that the variation allows.
"""

import argparse
import sys

import numpy as np
from tqdm import tqdm

from benchmarks.common.tables import write_csv
from benchmarks.stability.mistreatment import GOALS, LEVELS
from benchmarks.stability.soak import drive
from fish_env import make_fish
from fish_env.envs import FishVectorEnv

COMMAND = "python -m benchmarks.stability.heavy_water"
BODIES = ("mass_spring", "planar", "two_layer")
DENSITIES = (1.0, 2.0, 4.0, 16.0)  # over that of water
FISH, INTERVALS = 128, 250  # of each body, density and kind of commands; control intervals of 0.02 s or so
COMPARED, AHEAD, FINER = 32, 25, 32  # fish and intervals that are solved by RK4 too, with steps that many times shorter
VARIATION = {"stiffness": (0.5, 2.0), "mass": (0.5, 0.5), "drag": (2.0, 2.0)}


def batch(body: str, density: float, fish: int, **options) -> FishVectorEnv:
    """Fish of a body in water that is so many times as dense as its own."""
    own = make_fish(body).water
    water = own._replace(linear=density * own.linear, quadratic=density * own.quadratic)
    return FishVectorEnv(fish, body=body, water=water, variation=VARIATION, autoreset_mode="SameStep", **options)


def errors(body: str, density: float, kind: str) -> np.ndarray:
    """How far the centres of fish are from a fine solution after AHEAD intervals, body lengths (COMPARED,)."""
    centres = []
    for options in ({}, {"integrator": "rk4", "dt": make_fish(body).time_step / FINER}):
        env = batch(body, density, COMPARED, **options)
        env.reset(seed=2)
        for goals in GOALS[kind](env.tank.fish, COMPARED, np.random.default_rng(2))[:AHEAD]:
            _, _, terminated, _, _ = env.step(2.0 / LEVELS * goals.astype(np.float32) - 1.0)
            if terminated.any():
                raise RuntimeError(f"{body} failed beside its fine solution: {options or 'default method'}")
        centres.append(env.tank.position.mean(axis=1) / env.tank.fish.length)
        env.close()
    return np.linalg.norm(centres[0] - centres[1], axis=1)


def measure(body: str, density: float, kind: str) -> dict:
    """A row: failures, and the errors of a short stretch."""
    env = batch(body, density, FISH)
    goals = GOALS[kind](env.tank.fish, FISH, np.random.default_rng(1))[:INTERVALS]
    found = drive(env, goals, seed=1)
    env.close()
    off = errors(body, density, kind)
    return {
        "body": body, "density": density, "commands": kind, "fish": FISH, "fish_steps": found["fish_steps"],
        "failures": sum(found["reasons"].values()), "error_median_bl": f"{np.median(off):.2g}",
        "error_worst_bl": f"{off.max():.2g}",
    }  # fmt: skip


def main() -> int:
    """The command line; 1 if a fish has failed."""
    argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter).parse_args()
    cases = [(body, density, kind) for body in BODIES for density in DENSITIES for kind in GOALS]
    rows = [measure(*case) for case in tqdm(cases, unit="case")]
    for row in rows:
        print(*row.values(), sep="  ")
    print(write_csv("heavy_water.csv", rows, COMMAND))
    return int(any(row["failures"] for row in rows))


if __name__ == "__main__":
    sys.exit(main())
