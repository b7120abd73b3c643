"""How fast fish and environments are, what a process costs, and what a first use takes.

    python -m benchmarks.speed.throughput                  everything below (about 6 min on a quiet machine)
    python -m benchmarks.speed.throughput --environments   steps a second, memory, first use: results/throughput.csv
    python -m benchmarks.speed.throughput --kinds          kinds of kernels, precisions, varied fish: results/kinds.csv
    python -m benchmarks.speed.throughput --integrators    what a step of each method costs: results/steps.csv
    python -m benchmarks.speed.throughput --bodies         what an interval of each body costs: results/bodies.csv

What is compared runs in turn, within one process, and is counted in processor time: other processes count less. The
first two bars are of Gymnasium's own functions and of the clock: they mean something on a quiet machine only.
"""

import argparse
import os
import subprocess
import sys
import tempfile
from statistics import median

import numpy as np

from benchmarks.common.tables import RESULTS, write_csv
from benchmarks.speed import costs

REPEATS = 5
COMMAND = "python -m benchmarks.speed.throughput"

FIRST_EPISODE = """
import time
begin = time.{clock}()
import gymnasium as gym, fish_env
env = gym.make("FishEnv/Swim-v0")
env.reset(seed=0)
env.step(env.action_space.sample())
print(time.{clock}() - begin)
"""

FIRST_BATCH = FIRST_EPISODE.replace('make("FishEnv/Swim-v0")', 'make_vec("FishEnv/Swim-v0", num_envs=64, threads=1)')

MEMORY = """
import sys, gymnasium as gym, fish_env
env = gym.make("FishEnv/Swim-v0")
env.reset(seed=0)
env.step(env.action_space.sample())
assert not {"torch", "stable_baselines3", "pygame", "matplotlib"} & set(sys.modules)
fields = dict(line.split(":") for line in open("/proc/self/status") if ":" in line)
print(int(fields["VmRSS"].split()[0]) / 1024)
"""

# Steps of symplectic Euler that one step of a method may cost: 1.3 times what trial code took before this package was
COST = {"explicit_euler": 1.3, "midpoint": 1.3 * 2.1, "rk4": 1.3 * 4.2, "semi_implicit": 1.3 * 1.85,
        "linearly_implicit": 1.3 * 16}  # fmt: skip


def integrators() -> bool:
    """Print and write what a step of each fixed-step method costs beside symplectic Euler's; True if all is met."""
    rows = []
    for row in costs.integrators():
        highest = COST.get(row["integrator"], np.inf)
        met = float(row["symplectic_steps"]) <= highest
        rows.append(row | {"highest": highest, "met": met})
        bar = f"at most {highest:.2f}: {'met' if met else 'MISSED'}" if np.isfinite(highest) else ""
        print(f"{row['integrator']:28}{row['us_per_step']:>8} us{row['symplectic_steps']:>8} steps of symplectic Euler "
              f" {bar:24}one of {row['fish_in_lanes']} in lanes: {row['over_alone']} of it")  # fmt: skip
    print(f"written to {write_csv('steps.csv', rows, COMMAND + ' --integrators')}")
    return all(row["met"] for row in rows)


def bodies() -> bool:
    """Print and write what a control interval of each body costs."""
    rows = costs.bodies()
    for row in rows:
        print(row)
    print(f"written to {write_csv('bodies.csv', rows, COMMAND + ' --bodies')}")
    return True


def kinds() -> bool:
    """Print and write what kinds of kernels cost beside one another."""
    rows = costs.kinds()
    if (os.cpu_count() or 1) > 1:
        rows.append(costs.threads())
    for row in rows:
        print(f"{row['table']:22}{row['name']:28}{row['us']:>8} us{row['ratio']:>8} of {row['against']}")
    print(f"written to {write_csv('kinds.csv', rows, COMMAND + ' --kinds')}")
    return True


def env_rate(seconds: int) -> float:
    """Steps a second of `gym.make("FishEnv/Swim-v0")`, random actions, `gymnasium.utils.performance.benchmark_step`."""
    import gymnasium as gym
    from gymnasium.utils.performance import benchmark_step

    import fish_env  # noqa: F401

    env = gym.make("FishEnv/Swim-v0")
    return median(benchmark_step(env, seconds, seed=0) for _ in range(REPEATS))


def vector_rate(seconds: int, num_envs: int, **options) -> float:
    """Fish-steps a second of a batch, random actions, `gymnasium.utils.performance.benchmark_vector_step`."""
    import gymnasium as gym
    from gymnasium.utils.performance import benchmark_vector_step

    import fish_env  # noqa: F401

    env = gym.make_vec("FishEnv/Swim-v0", num_envs=num_envs, **options)
    rate = median(benchmark_vector_step(env, seconds, seed=0) for _ in range(REPEATS))
    env.close()
    return rate


def in_process(code: str, cache: str | None = None) -> float:
    """The number a fresh Python process prints."""
    environment = os.environ | {"FISH_ENV_QUIET": "1"} | ({"NUMBA_CACHE_DIR": cache} if cache else {})
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, env=environment, check=True)
    return float(done.stdout.split()[-1])


def starts() -> list[tuple]:
    """First make, reset and step in a fresh process, nothing compiled and then all of it, by two clocks."""
    rows = []
    for name, code in (("one fish", FIRST_EPISODE), ("a batch of 64", FIRST_BATCH)):
        for clock, text in (("perf_counter", "s"), ("process_time", "s of processor time")):
            with tempfile.TemporaryDirectory() as cache:
                first = in_process(code.format(clock=clock), cache)
                again = median(in_process(code.format(clock=clock), cache) for _ in range(REPEATS))
            bars = (0.0, 25.0), (0.0, 2.0)
            rows.append((f"first make + reset + step of {name}, nothing compiled, {text}", first, *bars[0]))
            rows.append((f"first make + reset + step of {name}, compiled before, {text}", again, *bars[1]))
    return rows


def environments(seconds: int = 2) -> bool:
    """Print and write steps a second, memory and first use, beside their bars; True if all are met."""
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    rows = [
        ("gym.make environment, steps/s", env_rate(seconds), 12_000, np.inf),
        ("256 fish on one thread, steps/s", vector_rate(seconds, 256, threads=1), 20_000, np.inf),
        ("256 fish on one thread, float32, steps/s", vector_rate(seconds, 256, threads=1, dtype="float32"), np.nan,
         np.nan),
        (f"256 fish on {cores} processors, steps/s", vector_rate(seconds, 256, threads=cores), np.nan, np.nan),
        *starts(),
        ("memory of a process with one environment, MB", in_process(MEMORY), 0.0, 250.0),
    ]  # fmt: skip
    table = [
        {"quantity": name, "value": round(float(value), 3), "lowest": low, "highest": high,
         "met": "" if np.isnan(low) else bool(low <= value <= high)}
        for name, value, low, high in rows
    ]  # fmt: skip
    for row in table:
        bar = "" if row["met"] == "" else f"{row['lowest']:g} to {row['highest']:g} {'met' if row['met'] else 'MISSED'}"
        print(f"{row['quantity']:82}{row['value']:12,.2f}   {bar}")
    print(f"written to {write_csv('throughput.csv', table, COMMAND + ' --environments')}")
    return all(row["met"] != False for row in table)  # noqa: E712 - "" means no bar


PARTS = {"environments": environments, "kinds": kinds, "integrators": integrators, "bodies": bodies}


def main() -> int:
    """Measure, write, and compare with the bars; exit 1 if one is missed."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    for name, part in PARTS.items():
        parser.add_argument(f"--{name}", action="store_true", help=part.__doc__.split(";")[0].rstrip("."))
    chosen = vars(parser.parse_args())
    RESULTS.mkdir(exist_ok=True)
    met = [part() for name, part in PARTS.items() if chosen[name] or not any(chosen.values())]
    return 0 if all(met) else 1


if __name__ == "__main__":
    sys.exit(main())
