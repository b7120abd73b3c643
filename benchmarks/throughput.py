"""How fast the environments are, measured with Gymnasium's own functions, and what a process costs.

    taskset -c 1 python -m benchmarks.throughput        writes results/throughput.csv and prints the bars

Run it pinned to one core and on a quiet machine. Ratios are taken from runs that alternate within one process.
"""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent.parent))  # so that it runs as a script as well as with -m

import argparse
import os
import subprocess
import tempfile
import time
from statistics import median

import numpy as np

from benchmarks.provenance import write_csv

REPEATS = 5
STEPS = 20_000

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


def step_cost(integrators) -> dict[str, float]:
    """Microseconds a step of the default fish takes, by integrator: medians of interleaved runs while it swims."""
    import fish_env
    from agents.controllers import best_gait

    fish, gait = fish_env.make_fish(), best_gait()
    tanks = {name: fish_env.Tank(fish, 1, name, water=fish.water) for name in integrators}
    for tank in tanks.values():  # compile, and get under way
        for k in range(50):
            tank.swim(gait.action(fish, k * fish.control_interval), fish.control_interval)
    times = {name: [] for name in tanks}
    for _ in range(3 * REPEATS):
        for name, tank in tanks.items():
            tank.reset()
            begin = time.perf_counter()
            tank.advance(STEPS)
            times[name].append((time.perf_counter() - begin) / STEPS * 1e6)
            assert tank.alive.all()
    return {name: median(values) for name, values in times.items()}


def env_rate(seconds: int) -> float:
    """Steps a second of `gym.make("FishEnv/Swim-v0")`, random actions, `gymnasium.utils.performance.benchmark_step`."""
    import gymnasium as gym
    from gymnasium.utils.performance import benchmark_step

    import fish_env  # noqa: F401

    env = gym.make("FishEnv/Swim-v0")
    return median(benchmark_step(env, seconds, seed=0) for _ in range(REPEATS))


def vector_rate(seconds: int, num_envs: int, threads: int) -> float:
    """Fish-steps a second of a batch, random actions, `gymnasium.utils.performance.benchmark_vector_step`."""
    import gymnasium as gym
    from gymnasium.utils.performance import benchmark_vector_step

    import fish_env  # noqa: F401

    env = gym.make_vec("FishEnv/Swim-v0", num_envs=num_envs, threads=threads)
    rate = median(benchmark_vector_step(env, seconds, seed=0) for _ in range(REPEATS))
    env.close()
    return rate


def in_process(code: str, cache: str | None = None) -> float:
    """The number a fresh Python process prints."""
    environment = os.environ | ({"NUMBA_CACHE_DIR": cache} if cache else {})
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, env=environment, check=True)
    return float(done.stdout.split()[-1])


def main() -> int:
    """Measure, write, and compare with the bars; exit 1 if one is missed."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seconds", type=int, default=2, help="of each repeat (default 2)")
    seconds = parser.parse_args().seconds
    cost = step_cost(("symplectic_euler", "semi_implicit", "rk4"))
    explicit = cost["symplectic_euler"]
    with tempfile.TemporaryDirectory() as cache:
        first, again = in_process(FIRST_EPISODE, cache), in_process(FIRST_EPISODE, cache)
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    rows = [
        *((f"one {name} step, us", value, np.nan, np.nan) for name, value in cost.items()),
        ("one semi_implicit step / one explicit step", cost["semi_implicit"] / explicit, 0.0, 2.2),
        ("one rk4 step / one explicit step", cost["rk4"] / explicit, np.nan, np.nan),
        ("gym.make environment, steps/s", env_rate(seconds), 12_000, np.inf),
        ("256 fish on one thread, steps/s", vector_rate(seconds, 256, 1), 20_000, np.inf),
        (f"256 fish on {cores} processors, steps/s", vector_rate(seconds, 256, cores), np.nan, np.nan),
        ("first make + reset + step, nothing cached, s", first, 0.0, 25.0),
        ("first make + reset + step, cached, s", again, 0.0, 2.0),
        ("memory of a process with one environment, MB", in_process(MEMORY), 0.0, 250.0),
    ]
    table = [
        {"quantity": name, "value": round(float(value), 3), "lowest": low, "highest": high,
         "met": "" if np.isnan(low) else bool(low <= value <= high)}
        for name, value, low, high in rows
    ]  # fmt: skip
    for row in table:
        bar = "" if row["met"] == "" else f"{row['lowest']:g} to {row['highest']:g} {'met' if row['met'] else 'MISSED'}"
        print(f"{row['quantity']:48}{row['value']:12,.2f}   {bar}")
    print(f"written to {write_csv('throughput.csv', table, 'python -m benchmarks.throughput')}")
    return 0 if all(row["met"] != False for row in table) else 1  # noqa: E712 - "" means no bar


if __name__ == "__main__":
    sys.exit(main())
