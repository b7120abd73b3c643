"""The same seed, the same bits: simulations and trainings in other processes, folders and numbers of threads.

    python -m benchmarks.stability.repeatability         results/repeatability.csv (10 min); exit 1 if a bit differed

The command clones the last commit into two folders and computes the digests of TRIALS there, one process for each of
CONFIGURATIONS: one that compiles all kernels, one that finds them and has four threads for the fish and for learning,
one with four threads of numpy's and torch's own libraries, where the order of sums, and so the bits of a training,
depends on their number (train.py has one), and one in the other folder, which compiles kernels of its own. A digest is
of all that is observed and rewarded and of all positions and velocities, or of all parameters of a trained policy and
of its optimizer.
"""

import argparse
import hashlib
import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from io import BytesIO
from pathlib import Path
from zipfile import ZipFile

import numpy as np

from benchmarks.common.tables import ROOT, write_csv
from fish_env import BODIES, INTEGRATORS, TASKS
from fish_env.envs import VARIATIONS, FishVectorEnv

COMMAND = "python -m benchmarks.stability.repeatability"
FISH = 64  # four threads of at least 16
LIBRARIES = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS")


@dataclass(frozen=True)
class Configuration:
    """How a process computes digests."""

    name: str
    folder: str
    """Which of the clones it runs in."""
    threads: int
    """For the fish, and for learning by compiled kernels."""
    libraries: int = 1
    """Threads of the libraries of numpy, scipy and torch."""


CONFIGURATIONS = (
    Configuration("kernels compiled", "first", 1),
    Configuration("four threads", "first", 4),
    Configuration("four threads of libraries", "first", 1, 4),
    Configuration("another folder, kernels compiled", "second", 2),
)
"""Digests are compared with those of the first."""


def swum(keywords: dict, threads: int, steps: int = 20) -> str:
    """The digest of a batch that is driven at random over the ends of its episodes."""
    env = FishVectorEnv(FISH, threads=threads, autoreset_mode="SameStep", max_episode_steps=8, **keywords)
    actions = np.random.default_rng(0).uniform(-1.0, 1.0, (steps, *env.action_space.shape)).astype(np.float32)
    seen = hashlib.sha256(env.reset(seed=5)[0].tobytes())
    for action in actions:
        for part in (*env.step(action)[:4], env.tank.position, env.tank.velocity):
            seen.update(np.ascontiguousarray(part).tobytes())
    env.close()
    return seen.hexdigest()


def trained(task: str, threads: int, updates: int = 8) -> str:
    """The digest of a policy, its value function and its optimizer, trained by `agents.train` for some updates."""
    from agents.config import CONFIGS
    from agents.train import Request, train

    options = CONFIGS[task].env_options | {"threads": threads}
    steps = updates * FISH * CONFIGS[task].rollout
    with tempfile.TemporaryDirectory() as folder:
        train(Request(task, 3, folder=Path(folder, "run"), pictures=False,
                      changes={"timesteps": steps, "num_envs": FISH, "env_options": options}))  # fmt: skip
        return parameters(Path(folder, "run"))


def parameters(folder: Path) -> str:
    """The digest of the numbers of the run in a folder: those of model.zip and of policy.npz."""
    import torch

    seen = hashlib.sha256()
    with ZipFile(folder / "model.zip") as file:
        for name in ("policy.pth", "policy.optimizer.pth"):
            held = torch.load(BytesIO(file.read(name)), weights_only=True)
            for key, value in sorted(leaves(held)):
                seen.update(key.encode() + value)
    policy = np.load(folder / "policy.npz")
    for name in sorted(set(policy.files) - {"about"}):  # which holds the number of threads
        seen.update(name.encode() + policy[name].tobytes())
    return seen.hexdigest()


def leaves(held, name: str = "") -> list[tuple[str, bytes]]:
    """The numbers in dictionaries, lists and tensors, each by its path; tensors as their bytes."""
    if isinstance(held, dict):
        return [leaf for key, value in held.items() for leaf in leaves(value, f"{name}/{key}")]
    if isinstance(held, list | tuple):
        return [leaf for key, value in enumerate(held) for leaf in leaves(value, f"{name}/{key}")]
    return [(name, held.numpy().tobytes() if hasattr(held, "numpy") else repr(held).encode())]


VARIED = {"variation": {name: (option.low, option.high) for name, option in VARIATIONS.items()}}
TRIALS: dict[str, Callable[[int], str]] = {
    **{f"{task} on mass_spring": partial(swum, {"task": task}) for task in TASKS},
    **{f"swim on {body}": partial(swum, {"body": body}) for body in BODIES if body != "mass_spring"},
    **{f"swim by {name}": partial(swum, {"integrator": name}, steps=4) for name in INTEGRATORS},
    "swim in float32": partial(swum, {"dtype": "float32"}),
    "swim, all that may vary": partial(swum, VARIED),
    **{f"{task}, trained": partial(trained, task)
       for task in ("swim", "turn", "left_after_right", "target", "target_3d", "avoid")},
}  # fmt: skip
"""What is computed of a number of threads."""


def digests(names: list[str], how: Configuration, checkout: Path = ROOT, **variables: str) -> dict[str, str]:
    """The digests of trials, from a process of its own in a checkout, with variables of the environment."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "answer.json")
        command = [sys.executable, "-m", "benchmarks.stability.repeatability", "--threads", str(how.threads)]
        subprocess.run([*command, "--answer", str(path), "--trials", *names], cwd=checkout, check=True,
                       stdout=subprocess.DEVNULL, env=os.environ | {"PYTHONPATH": str(checkout)} | variables
                       | dict.fromkeys(LIBRARIES, str(how.libraries)))  # fmt: skip
        return json.loads(path.read_text())


def compare(names: list[str], configurations: Sequence[Configuration] = CONFIGURATIONS) -> list[dict]:
    """A row for every configuration and trial: whether its bits are those of the first."""
    rows, first = [], {}
    with tempfile.TemporaryDirectory() as place:
        for folder in dict.fromkeys(how.folder for how in configurations):
            subprocess.run(["git", "clone", "--quiet", str(ROOT), str(Path(place, folder))], check=True)
        for how in configurations:
            cache = str(Path(place, f"kernels_{how.folder}"))
            found = digests(names, how, checkout=Path(place, how.folder), NUMBA_CACHE_DIR=cache)
            first = first or found
            rows += [{"configuration": how.name, "folder": how.folder, "threads": how.threads,
                      "libraries": how.libraries, "trial": trial, "digest": digest[:16],
                      "same": int(digest == first[trial])} for trial, digest in found.items()]  # fmt: skip
            same = sum(first[each] == found[each] for each in found)
            print(f"{how.name}: {same} of {len(found)} the same", flush=True)
    return rows


def promised(row: dict) -> bool:
    """Whether a row must be the same: all but trainings, and Radau's LAPACK, whose libraries have several threads."""
    return row["libraries"] == 1 or not ("trained" in row["trial"] or row["trial"] == "swim by radau")


def main() -> int:
    """The command line; exit 1 if a bit that is promised differed."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--trials", nargs="+", choices=TRIALS, default=list(TRIALS), help="only these; no table then")
    parser.add_argument("--answer", type=Path, help="write what this process finds to a file, and no table")
    parser.add_argument("--threads", type=int, default=1, help="of a process with --answer (default 1)")
    chosen = parser.parse_args()
    if chosen.answer is not None:
        chosen.answer.write_text(json.dumps({name: TRIALS[name](chosen.threads) for name in chosen.trials}))
        return 0
    rows = compare(chosen.trials)
    if set(chosen.trials) == set(TRIALS):
        write_csv("repeatability.csv", rows, COMMAND)
    print(f"{sum(row['same'] for row in rows)} of {len(rows)} are the same")
    return int(not all(row["same"] for row in rows if promised(row)))


if __name__ == "__main__":
    sys.exit(main())
