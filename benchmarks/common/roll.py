"""Whether a fish stays upright while it swims strongly: the roll of a fish that begins disturbed."""

import numpy as np

from benchmarks.common.measures import pose_of
from fish_env import Fish, Tank
from fish_env.control import Gait

GAITS, SECONDS, LAST = 16, 3.0, 25
"""How many gaits, for how long, and the control intervals at the end in which the roll is looked at."""
NOISE = 0.05  # body lengths a second: node velocities at the start, so that an unstable gait has something to grow from


def strong_gaits(count=GAITS) -> list[Gait]:
    """Gaits of more than half the strength, 3 to 4.3 beats a second and any lags, drawn from a fixed seed."""
    generator, found = np.random.default_rng(0), []
    for _ in range(count):
        lag = np.cumsum([0.0, *generator.uniform(-0.6, 1.6, 2)])
        found.append(Gait(generator.uniform(3.0, 4.3), tuple(generator.uniform(0.6, 1.0, 3)), tuple(lag)))
    return found


def roll(fish: Fish) -> np.ndarray:
    """Largest angle (GAITS,) rad between the up axis and the vertical in the last half second; pi for what failed."""
    steps = round(fish.control_interval / fish.time_step)
    tank = Tank(fish, GAITS, water=fish.water, threads=1)
    times = fish.control_interval * np.arange(1, round(SECONDS / fish.control_interval) + 1)
    contraction = np.stack([gait.contraction(fish, times) for gait in strong_gaits()], axis=1)
    noise = np.random.default_rng(0).normal(0.0, NOISE * fish.length, fish.body.position.shape)
    tank.velocity[:] += noise * (fish.body.inverse_mass > 0.0) + (fish.length, 0.0, 0.0)
    tilted = np.zeros(GAITS)
    for k, goal in enumerate(contraction):
        tank.drive(goal, steps)
        if k >= len(contraction) - LAST:
            upright = pose_of(tank).axes[:, 2, 2]
            tilted = np.maximum(tilted, np.arccos(np.clip(upright, -1.0, 1.0)))
    return np.where(tank.alive, np.nan_to_num(tilted, nan=np.pi), np.pi)
