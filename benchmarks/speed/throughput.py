"""Cost of fish and environments: one fish and many, environment steps, sensing, states, pictures, memory, first use.

What is compared runs in turn, within one process, and is counted in processor time: other processes count less. Ratios
are medians of those of each round. Everything is made several times: where its arrays come to lie in memory can cost a
tank twice its time. Environment steps and first use are by the clock: they mean something on a quiet machine only.
"""

import os
import subprocess
import sys
import tempfile
from collections.abc import Callable
from functools import partial
from statistics import median

import numpy as np

from benchmarks.common.tables import publish
from benchmarks.common.timing import ROUNDS, Swim, costs, interleaved, swimming, timed
from fish_env import Tank, make_fish
from fish_env.envs import FishVectorEnv

SPREAD = 0.2  # by which the factors of varied fish differ from 1
MANY = 256  # fish
REPEATS, SECONDS = 5, 2  # of environments

FIRST_EPISODE = """
import time
begin = time.perf_counter()
import gymnasium as gym, fish_env
env = gym.make("FishEnv/Swim-v0")
env.reset(seed=0)
env.step(env.action_space.sample())
print(time.perf_counter() - begin)
"""
MEMORY = """
import sys, gymnasium as gym, fish_env
env = gym.make("FishEnv/Swim-v0")
env.reset(seed=0)
env.step(env.action_space.sample())
assert not {"torch", "stable_baselines3", "pygame", "matplotlib"} & set(sys.modules)
fields = dict(line.split(":") for line in open("/proc/self/status") if ":" in line)
print(int(fields["VmRSS"].split()[0]) / 1024)
"""


def vary(tank: Tank) -> Tank:
    """Make every fish differ from the others."""
    generator = np.random.default_rng(0)
    for i in range(tank.num_fish):
        stiffness, mass, drag = generator.uniform(1.0 - SPREAD, 1.0 + SPREAD, 3)
        current = 0.1 * tank.fish.length * generator.uniform(-1.0, 1.0, 3) * (not tank.fish.flat, 1.0, 0.0)
        tank.vary(i, stiffness, mass, drag, current)
    return tank


def intervals() -> list[tuple[str, float]]:
    """Time of a control interval of the default fish, us: alone and one of many, in every kind of batch."""
    fish = make_fish()
    batches = {
        "alone": {"num_fish": 1}, f"one of {MANY}": {}, f"one of {MANY}, float32": {"dtype": "float32"},
        f"one of {MANY} that differ": {}, f"one of {MANY}, one at a time": {"lanes": "xyz"},
    }  # fmt: skip

    def make():
        tanks = {name: swimming(fish, **{"num_fish": MANY} | options) for name, options in batches.items()}
        return [Swim(vary(tank) if "differ" in name else tank) for name, tank in tanks.items()]

    found = costs(make)
    return [(f"a control interval, {name}, us", cost.time[1]) for name, cost in zip(batches, found, strict=True)]


def env_rate(num_envs: int = 1, **options) -> float:
    """Environment steps a second with random actions, by Gymnasium's own functions."""
    import gymnasium as gym
    from gymnasium.utils.performance import benchmark_step, benchmark_vector_step

    if num_envs == 1:
        env = gym.make("FishEnv/Swim-v0")
        return median(benchmark_step(env, SECONDS, seed=0) for _ in range(REPEATS))
    envs = gym.make_vec("FishEnv/Swim-v0", num_envs=num_envs, **options)
    rate = median(benchmark_vector_step(envs, SECONDS, seed=0) for _ in range(REPEATS))
    envs.close()
    return rate


def in_process(code: str, cache: str | None = None) -> float:
    """The number that a fresh Python process prints, with its kernels in a folder of its own or in the usual one."""
    environment = os.environ | {"FISH_ENV_QUIET": "1"} | ({"FISH_ENV_CACHE": cache} if cache else {})
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, env=environment, check=True)
    return float(done.stdout.split()[-1])


def environments() -> list[tuple[str, float]]:
    """Steps a second, memory, and the first make, reset and step of a process."""
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    with tempfile.TemporaryDirectory() as cache:
        first = in_process(FIRST_EPISODE, cache)
        again = median(in_process(FIRST_EPISODE, cache) for _ in range(REPEATS))
    return [
        ("gym.make environment, steps/s", env_rate()),
        (f"{MANY} fish on one thread, steps/s", env_rate(MANY, threads=1)),
        (f"{MANY} fish on one thread, float32, steps/s", env_rate(MANY, threads=1, dtype="float32")),
        (f"{MANY} fish on {cores} processors, steps/s", env_rate(MANY, threads=cores)),
        ("first make + reset + step of one fish, nothing compiled, s", first),
        ("first make + reset + step of one fish, compiled before, s", again),
        ("memory of a process with one environment, MB", in_process(MEMORY)),
    ]


SENSED = {
    "observation_noise": {"velocity": 0.1, "vertical": 0.01}, "action_noise": 0.1, "observation_delay": (0, 1),
    "action_delay": (0, 1), "history": 1,
}  # fmt: skip
INSTRUMENTS = SENSED | {"observation": "sensors", "observation_noise": {"angular velocity": 0.1, "vertical": 0.01}}
KINDS = {"nodes": {}, "noise, delays and a history": SENSED, "the same, with sensors": INSTRUMENTS}
SMALL = {"render_mode": "rgb_array", "width": 84, "height": 84, "panel": False}


class Steps:
    """Steps of an environment with an action that is always the same, begun at a reset; perhaps with pictures."""

    def __init__(self, env: FishVectorEnv, pictures=False):
        self.env, self.pictures, self.count = env, pictures, env.num_envs
        self.action = np.zeros(env.action_space.shape, dtype=np.float32)

    def start(self) -> None:
        """Begin anew."""
        self.env.reset(seed=0)

    def run(self, times: int) -> None:
        """Step on."""
        for _ in range(times):
            self.env.step(self.action)
            if self.pictures:
                self.env.render()


def kinds_of_steps(count: int) -> list[Steps]:
    """Steps of a new environment of each kind."""
    return [Steps(FishVectorEnv(count, task="swim", threads=1, **kind)) for kind in KINDS.values()]


def options() -> list[tuple[str, float]]:
    """What noise, delays, a history and sensors add to an environment step; times of states and of small pictures."""
    found = []
    for count in (1, MANY):
        _, *added = costs(partial(kinds_of_steps, count), 4 * ROUNDS, most=1000)
        for name, cost in zip(list(KINDS)[1:], added, strict=True):
            found.append((f"an environment step of {count} fish, {name}, over one of nodes", cost.ratio[1]))
        env, often = FishVectorEnv(count, task="swim", threads=1), max(1, 500 // count)
        env.reset(seed=0)
        for name, work in (("get_state", env.get_state), ("set_state", partial(env.set_state, env.get_state()))):
            (cost,) = interleaved([(lambda: None, partial(repeat, work, often), often * count)], 4 * ROUNDS)
            found.append((f"{name} of {count} fish, us a fish", cost.time[1]))
    env = FishVectorEnv(1, task="swim", threads=1)
    work = partial(repeat, partial(env.linearise, np.zeros((1, 12))), 10)
    (cost,) = interleaved([(lambda: None, work, 10)], ROUNDS)
    found.append(("linearise of one fish, us", cost.time[1]))
    for camera in ("above", "side", "follow"):
        env = FishVectorEnv(1, task="swim", threads=1, camera=camera, **SMALL)
        (cost,) = timed([Steps(env, pictures=True)], ROUNDS)
        found.append((f"pictures of 84 x 84 a second, {camera}, with the step", 1e6 / cost.time[1]))
    return found


def repeat(work: Callable[[], object], times: int) -> None:
    """Do it so many times."""
    for _ in range(times):
        work()


def measure() -> list[dict]:
    """A row for each quantity."""
    return [{"quantity": name, "value": f"{value:.5g}"} for name, value in environments() + intervals() + options()]


if __name__ == "__main__":
    publish(__doc__, {"throughput.csv": measure})
