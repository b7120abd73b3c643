"""Reference trajectories: short motions, a number each, that tell whether a table is older than what it measured.

Every table has the numbers of the day on which it was made in its head. It is stale where one that it follows is
another now, beyond what processors and compilers differ by. A change of code that changes no motion makes nothing
stale.
"""

from collections.abc import Callable, Iterable
from fnmatch import fnmatch
from functools import cache

import numpy as np

from fish_env import BODIES, TASKS, Fish, Tank, World, make_fish
from fish_env.control import load_policy, scripted, shipped_policies
from fish_env.envs import FishVectorEnv
from fish_env.soft.objects import OBJECTS

TOLERANCE = 1e-6
"""Relative difference that a number may have on another processor."""
INTERVALS = 12  # control intervals of a fish


def summary(position: np.ndarray, length: float) -> float:
    """Sum of positions (...,N,3) m over a length, with weights that tell nodes and axes apart."""
    weights = np.cos(np.arange(1.0, position.size + 1).reshape(position.shape))
    return float((position * weights).sum() / length)


def swim(fish: Fish, water: World | None = None) -> float:
    """Positions and velocities of a fish, in its own water unless another is given, bent to and fro."""
    tank = Tank(fish, water=fish.water if water is None else water, threads=1)
    for k in range(INTERVALS):
        tank.swim(np.where(fish.sides > 0, 1.0, -1.0) * np.cos(0.5 * k), fish.control_interval)
    return summary(tank.position, fish.length) + summary(tank.velocity, fish.length)


def perform(task: str) -> float:
    """Rewards and observations in a task under the motor controllers."""
    env = FishVectorEnv(2, task=task, threads=1, max_episode_steps=None)
    control, (obs, _), total = scripted(env), env.reset(seed=1), 0.0
    for k in range(6 * INTERVALS):
        obs, reward, *_ = env.step(control(obs, k * env.control_interval))
        total += float(reward.sum()) + 1e-3 * float(obs.sum())
    env.close()
    return total


def fall(name: str) -> float:
    """Positions of an elastic object a twentieth of a second after a push."""
    thing = OBJECTS[name].make()
    tank = Tank(thing, water=thing.water, threads=1)
    tank.velocity[..., 0] += 0.1 * np.cos(np.arange(len(thing.body.mass)))
    tank.advance(max(1, round(0.05 / tank.dt)))
    return summary(tank.position, thing.length)


def act(name: str) -> float:
    """Actions of a shipped policy on observations that are made up."""
    policy = load_policy(shipped_policies()[name])
    obs = np.cos(np.arange(3.0 * policy.weights[0].shape[0])).reshape(3, -1).astype(np.float32)
    return float((policy(obs) * np.cos(np.arange(policy.biases[-1].size))).sum())


TRAJECTORIES: dict[str, Callable[[], float]] = {
    **{f"body {name}": lambda name=name: swim(make_fish(name)) for name in BODIES},
    "water drag": lambda: swim(make_fish(water="drag")),
    **{f"task {name}": lambda name=name: perform(name) for name in TASKS},
    **{f"object {name}": lambda name=name: fall(name) for name in OBJECTS},
    **{f"policy {name}": lambda name=name: act(name) for name in shipped_policies()},
}
"""Each by what it is of."""


@cache
def trajectories() -> dict[str, float]:
    """All numbers by name: some seconds."""
    return {name: make() for name, make in TRAJECTORIES.items()}


def partly(now: dict[str, float], then: dict[str, float], tasks: Iterable[str]) -> dict[str, float]:
    """The numbers of now of these tasks and their policies, and those of then of all else."""
    tasks = set(tasks)
    return then | {name: value for name, value in now.items() if name.rpartition(" ")[2] in tasks}


def as_text(numbers: dict[str, float]) -> str:
    """The numbers as a table's head has them."""
    return "; ".join(f"{name} {value:.9g}" for name, value in numbers.items())


def from_text(text: str) -> dict[str, float]:
    """The numbers of a head; those that cannot be read are left out."""
    found = {}
    for part in text.split("; "):
        name, _, number = part.rpartition(" ")
        try:
            found[name] = float(number)
        except ValueError:
            continue
    return found


def changed(then: dict[str, float], patterns: Iterable[str]) -> list[str]:
    """Names of the trajectories that match one of the patterns and are others now, or were not computed then."""
    now = {name: value for name, value in trajectories().items() if any(fnmatch(name, p) for p in patterns)}
    same = {
        name for name, value in now.items() if abs(then.get(name, np.inf) - value) <= TOLERANCE * max(1, abs(value))
    }
    return sorted(now.keys() - same)
