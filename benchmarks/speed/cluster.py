"""How many environment steps a second Ray RLlib samples and learns from, with one runner and with more.

    python -m benchmarks.speed.cluster     results/cluster.csv (2 minutes on a quiet machine)

One iteration of `examples/train_rllib.py` consists of sampling, learning and copying weights. Sampling is measured with
one runner, with two, and so on up to one for each processor, in turn, by wall time: what a runner hands over is copied
to this process, as in training. It means something on a quiet machine only. Needs the extra [cluster].
"""

import argparse
import gc
import importlib.util
import os
import pickle
import sys
import time
from statistics import median

from benchmarks.common.tables import ROOT, write_csv

COMMAND = "python -m benchmarks.speed.cluster"
REPEATS = 31
FISH, ROLLOUT = 128, 32


def example():
    """The example as a module whose classes are sent to other processes as they are, not by name."""
    from ray import cloudpickle

    spec = importlib.util.spec_from_file_location("train_rllib", ROOT / "examples" / "train_rllib.py")
    assert spec is not None and spec.loader is not None
    module = sys.modules["train_rllib"] = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    cloudpickle.register_pickle_by_value(module)
    return module


def sampled(algorithm, runners: list[int]) -> tuple[float, list]:
    """Seconds that so many runners take for a rollout each, side by side, and the episodes."""
    begun = time.perf_counter()
    found = algorithm.env_runner_group.foreach_env_runner(
        "sample", remote_worker_ids=runners, local_env_runner=False, timeout_seconds=300.0
    )
    return time.perf_counter() - begun, found


def measure(cores: int, repeats: int = REPEATS) -> list[dict]:
    """A row for each number of runners, with the parts of an iteration."""
    import ray

    module = example()
    ray.init(num_cpus=cores + 1, include_dashboard=False, logging_level="ERROR")
    algorithm = module.make_config(module.Args(runners=cores, fish=FISH, rollout=ROLLOUT)).build_algo()
    try:
        gc.freeze()  # as the example
        for _ in range(2):
            algorithm.train()
        seconds: dict[int, list[float]] = {k: [] for k in range(1, cores + 1)}
        learning, copying, episodes = [], [], []
        for _ in range(repeats):
            for k in seconds:
                elapsed, episodes = sampled(algorithm, list(range(1, k + 1)))
                seconds[k].append(elapsed)
            begun = time.perf_counter()
            algorithm.learner_group.update(
                episodes=[episode for part in episodes for episode in part], num_epochs=5, minibatch_size=2048,
                timesteps={"num_env_steps_sampled_lifetime": 0},
            )  # fmt: skip
            learning.append(time.perf_counter() - begun)
            begun = time.perf_counter()
            algorithm.env_runner_group.sync_weights(
                from_worker_or_learner_group=algorithm.learner_group, inference_only=True
            )
            copying.append(time.perf_counter() - begun)
        weights = len(pickle.dumps(algorithm.learner_group.get_weights()))
        handed = len(pickle.dumps(episodes[0]))
    finally:
        algorithm.stop()
        ray.shutdown()
    steps, one = FISH * ROLLOUT, median(seconds[1])
    return [
        {
            "runners": k,
            "samples_per_s": round(k * steps / median(found)),
            "over_one_runner": round(median([k * a / b for a, b in zip(seconds[1], found, strict=True)]), 3),
            "sampling_us_per_step": round(1e6 * one / steps, 2),
            "learning_us_per_step": round(1e6 * median(learning) / (cores * steps), 2),
            "copying_weights_ms": round(1e3 * median(copying), 1),
            "bytes_of_a_step": round(handed / steps),
            "bytes_of_weights": weights,
            "repeats": repeats,
        }
        for k, found in seconds.items()
    ]


def main() -> None:
    """Measure, print, write."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--cores", type=int, default=len(os.sched_getaffinity(0)), help="most runners")
    rows = measure(parser.parse_args().cores)
    for row in rows:
        print(row)
    print(f"written to {write_csv('cluster.csv', rows, COMMAND)}")


if __name__ == "__main__":
    main()
