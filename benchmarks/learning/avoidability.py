"""In which episodes an obstacle can be avoided: those in which one of many scripted manoeuvres passes it untouched.

The manoeuvres are those of the motor controllers with more and less distance to the obstacle and at higher and lower
assumed speeds, and open-loop ones: as soon as an obstacle is observed, bend to one side for a while, or stop swimming.
"""

from functools import partial

import numpy as np

from fish_env.control import FIRST_SEED, Controller, Sequencer, evaluate, scripted
from fish_env.control.sequencer import ObstacleMargins, aim_past
from fish_env.envs import FishVectorEnv
from fish_env.tasks.avoid import AvoidTask

ROOMS, SPEEDS = (0.1, 0.25, 0.35, 0.5, 0.8), (1.0, 1.8, 2.4)
BENDS = (0.1, 0.2, 0.3, 0.5)  # s


def cautious(env: FishVectorEnv, room: float, speed: float) -> Controller:
    """The motor controllers that keep `room` body lengths off and assume a speed, body lengths per second."""
    if not isinstance(env.task, AvoidTask):
        raise ValueError(f"the task is {type(env.task).__name__}; give an environment of an AvoidTask")
    controller: Sequencer = scripted(env)
    controller.aim = partial(aim_past, layout=env.layout, margins=ObstacleMargins(env.task.radius, room, speed))
    return controller


def open_loop(env: FishVectorEnv, side: int, duration: float) -> Controller:
    """The motor controllers; once an obstacle is observed the fish bends to a side, or relaxes (0), for a while."""
    swimming = cautious(env, 0.0, 0.0)
    fish = env.tank.fish
    bend = np.where(fish.sides[env.first_muscle_of_group] == side, 1.0, -1.0)
    seen_at = np.full(env.num_envs, np.inf)

    def act(obs: np.ndarray, time: float) -> np.ndarray:
        if time == 0:
            seen_at[:] = np.inf
        seen = np.abs(env.layout.read(obs, "obstacle's nearness")).max(axis=1) > 0
        seen_at[:] = np.minimum(seen_at, np.where(seen, time, np.inf))
        return np.where((time - seen_at < duration)[:, None] & seen[:, None], bend, swimming(obs, time))

    return act


def avoidable(env: FishVectorEnv, options=None) -> np.ndarray:
    """(B,) True for the evaluation episodes of an `AvoidTask` environment in which some manoeuvre passes untouched."""
    manoeuvres = [cautious(env, room, speed) for room in ROOMS for speed in SPEEDS]
    manoeuvres += [open_loop(env, side, duration) for side in (-1, 0, 1) for duration in BENDS]
    past = np.zeros(env.num_envs, dtype=bool)
    for manoeuvre in manoeuvres:
        past |= evaluate(env, manoeuvre, FIRST_SEED, options)["passed"] > 0
    return past
