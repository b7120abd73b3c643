"""Environments a user would train on, one core, as their makers hand them out; random actions prepared beforehand."""

import os
from collections.abc import Callable
from importlib.metadata import version
from importlib.util import find_spec
from typing import NamedTuple

os.environ.setdefault("MUJOCO_GL", "disable")  # dm_control then looks for no display

import gymnasium as gym
import numpy as np

import fish_env  # noqa: F401 - registers its environments

STEPS = 1000  # of a run, a whole number of episodes of each single environment: resets are included


class Environment(NamedTuple):
    """One to be timed: `run` takes `steps` environment steps, over all copies, with the resets that fall due."""

    name: str
    package: str  # and its version
    copies: int
    interval: float  # s of simulated time in a step
    steps: int
    run: Callable[[], None]


def single(name: str, package: str) -> Environment:
    """A single environment with the wrappers that `gym.make` puts around it."""
    env = gym.make(name)
    env.reset(seed=0)
    env.action_space.seed(0)
    actions = [env.action_space.sample() for _ in range(STEPS)]

    def run():
        for action in actions:
            _, _, terminated, truncated, _ = env.step(action)
            if terminated or truncated:
                env.reset()

    return Environment(name, described(package), 1, seconds(env), STEPS, run)


def control_suite() -> Environment:
    """dm_control's fish, task swim, which returns a `TimeStep` and has no wrappers."""
    from dm_control import suite

    env = suite.load("fish", "swim", task_kwargs={"random": 0})
    spec = env.action_spec()
    actions = np.random.default_rng(0).uniform(spec.minimum, spec.maximum, (STEPS, *spec.shape))
    env.reset()

    def run():
        for action in actions:
            if env.step(action).last():
                env.reset()

    return Environment("dm_control fish-swim", described("dm_control"), 1, env.control_timestep(), STEPS, run)


def vector(name: str, package: str, copies: int, calls: int, **options) -> Environment:
    """A vector environment, which resets its copies by itself; `calls` of `step` a run."""
    env = gym.make_vec(name, num_envs=copies, **options)
    env.reset(seed=0)
    env.action_space.seed(0)
    actions = [env.action_space.sample() for _ in range(calls)]

    def run():
        for action in actions:
            env.step(action)

    return Environment(f"{name}, {type(env).__name__}", described(package), copies, seconds(env), calls * copies, run)


def described(package: str) -> str:
    """A package and its version."""
    return f"{package} {version(package)}"


def seconds(env) -> float:
    """Simulated time of an environment step, which every one of them plays at its true speed."""
    return 1.0 / env.metadata["render_fps"]


def singles() -> list[Environment]:
    """Ours first, then the peers."""
    gymnasium = [single(*each) for each in (("HalfCheetah-v5", "mujoco"), ("Swimmer-v5", "mujoco"))]
    found = find_spec("dm_control") is not None
    if not found:
        print("dm_control is not installed (it cannot be on Python 3.13) and is left out")
    return [single("FishEnv/Swim-v0", "fish_env"), *gymnasium, *([control_suite()] if found else [])]


def vectors() -> list[Environment]:
    """Ours first, then Gymnasium's vector environment on one thread."""
    return [
        vector("FishEnv/Swim-v0", "fish_env", 256, 250, threads=1),
        vector("HalfCheetah-v5", "mujoco", 8, STEPS, vectorization_mode="sync"),
    ]
