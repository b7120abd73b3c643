"""Where an obstacle can be avoided at all: where at least one of many scripted escapes gets past it untouched.

The escapes are the motor controllers with more and less water to the obstacle, reckoning with higher and lower speeds,
and blind ones: as soon as an obstacle is seen, bend to one side for a while, or stop swimming.
"""

from functools import partial

import numpy as np

from agents.evaluate import FIRST_SEED, Controller, evaluate
from agents.sequencer import Caution, Sequencer, aim_past, scripted
from fish_env.envs import FishVectorEnv

ROOMS, SPEEDS = (0.1, 0.25, 0.35, 0.5, 0.8), (1.0, 1.8, 2.4)
BENDS = (0.1, 0.2, 0.3, 0.5)  # s


def cautious(env: FishVectorEnv, room: float, speed: float) -> Controller:
    """The motor controllers with other ideas of what is near."""
    controller: Sequencer = scripted(env)
    controller.aim = partial(aim_past, caution=Caution(env.task.radius, room, speed))
    return controller


def blind(env: FishVectorEnv, side: int, duration: float) -> Controller:
    """Swims by the motor controllers; when an obstacle is seen it bends to a side, or relaxes (side 0), for a while."""
    swimming = cautious(env, 0.0, 0.0)
    fish = env.tank.fish
    escape = np.where(fish.sides[env.leaders] == side, 1.0, -1.0)
    seen_at = np.full(env.num_envs, np.inf)

    def act(obs: np.ndarray, time: float) -> np.ndarray:
        if time == 0:
            seen_at[:] = np.inf
        seen = np.abs(obs[:, -6:-3]).max(axis=1) > 0
        seen_at[:] = np.minimum(seen_at, np.where(seen, time, np.inf))
        return np.where((time - seen_at < duration)[:, None] & seen[:, None], escape, swimming(obs, time))

    return act


def possible(env: FishVectorEnv, options=None) -> np.ndarray:
    """(B,) True for the evaluation episodes of an `AvoidTask` environment in which some escape gets past untouched."""
    escapes = [cautious(env, room, speed) for room in ROOMS for speed in SPEEDS]
    escapes += [blind(env, side, duration) for side in (-1, 0, 1) for duration in BENDS]
    past = np.zeros(env.num_envs, dtype=bool)
    for escape in escapes:
        past |= evaluate(escape, env, FIRST_SEED, options)["passed"] > 0
    return past
