"""How fast the environments are, measured with Gymnasium's own functions, and what a process costs.

    taskset -c 1 python -m benchmarks.throughput                  writes results/throughput.csv and prints the bars
    taskset -c 1 python -m benchmarks.throughput --integrators    what a step of each method costs: results/steps.csv

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
GLIDE = 400  # steps of a run in which the cost of a step is measured

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


def step_cost(steps: dict[str, float]) -> dict[str, float]:
    """Microseconds a step of the gliding default fish takes, for each integrator at its step: medians, interleaved."""
    import fish_env
    from agents.controllers import best_gait

    fish, gait = fish_env.make_fish(), best_gait()
    swimmer = fish_env.Tank(fish, 1, water=fish.water)
    for k in range(50):
        swimmer.swim(gait.action(fish, k * fish.control_interval), fish.control_interval)
    state = swimmer.get_state()
    tanks = {name: fish_env.Tank(fish, 1, name, dt, fish.water) for name, dt in steps.items()}
    times = {name: [] for name in tanks}
    for _ in range(20 * REPEATS):
        for name, tank in tanks.items():
            tank.set_state(state)
            count = GLIDE if fish_env.INTEGRATORS[name].kind != "linearly implicit" else GLIDE // 8
            begin = time.perf_counter()
            tank.advance(count)
            times[name].append((time.perf_counter() - begin) / count * 1e6)
            assert tank.alive.all(), f"{name} failed: {tank.failure}"
    return {name: median(values) for name, values in times.items()}


# Steps of symplectic Euler that one step of a method may cost: 1.3 times what trial code took before this package was
COST = {"explicit_euler": 1.3, "midpoint": 1.3 * 2.1, "rk4": 1.3 * 4.2, "semi_implicit": 1.3 * 1.85,
        "linearly_implicit": 1.3 * 16}  # fmt: skip


def integrators() -> bool:
    """Print and write what a step of each fixed-step method costs beside symplectic Euler's; True if all is met."""
    import fish_env

    fish = fish_env.make_fish()
    names = [name for name, record in fish_env.INTEGRATORS.items() if record.kind != "adaptive"]
    cost = step_cost({name: fish.time_step if name == fish.integrator else 0.0003 for name in names})
    rows = []
    for name, value in cost.items():
        ratio, highest = value / cost["symplectic_euler"], COST.get(name, np.inf)
        rows.append(
            {"integrator": name, "us_per_step": round(value, 3), "symplectic_steps": round(ratio, 3),
             "highest": highest, "met": ratio <= highest}
        )  # fmt: skip
        bar = f"at most {highest:.2f}: {'met' if ratio <= highest else 'MISSED'}" if name in COST else ""
        print(f"{name:28}{value:8.2f} us{ratio:8.2f} steps of symplectic Euler  {bar}")
    print(f"written to {write_csv('steps.csv', rows, 'python -m benchmarks.throughput --integrators')}")
    return all(row["met"] for row in rows)


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
    parser.add_argument("--integrators", action="store_true", help="only what a step of each method costs")
    arguments = parser.parse_args()
    if arguments.integrators:
        return 0 if integrators() else 1
    seconds = arguments.seconds
    cost = step_cost({"symplectic_euler": 0.0003, "semi_implicit": 0.0003, "rk4": 0.0003, "leapfrog_chebyshev": 0.0025})
    explicit = cost["symplectic_euler"]
    with tempfile.TemporaryDirectory() as cache:
        first, again = in_process(FIRST_EPISODE, cache), in_process(FIRST_EPISODE, cache)
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    rows = [
        *((f"one {name} step, us", value, np.nan, np.nan) for name, value in cost.items()),
        ("one semi_implicit step / one explicit step", cost["semi_implicit"] / explicit, 0.0, 2.2),
        ("one rk4 step / one explicit step", cost["rk4"] / explicit, np.nan, np.nan),
        ("one leapfrog_chebyshev step / one explicit step", cost["leapfrog_chebyshev"] / explicit, np.nan, np.nan),
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
