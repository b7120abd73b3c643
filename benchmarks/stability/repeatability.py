"""The same seed, the same bits: simulations and trainings in other processes, folders and numbers of threads.

    python -m benchmarks.stability.repeatability                 results/repeatability.csv; exit 1 if a bit differed
    python -m benchmarks.stability.repeatability --published     results/published_again.csv: what is published, again

The first command clones the last commit into two folders and computes the digests of TRIALS there, one process for each
of CONFIGURATIONS: one that compiles all kernels, one that finds them, with one to four threads for the fish, for
learning and for numpy's and torch's own libraries, and in the other folder, which compiles kernels of its own. A digest
is of all that is observed and rewarded and of all positions and velocities, or of all parameters of a trained policy
and of its optimizer.

The second command measures the shipped policies and the controllers without learning again, in the 100 episodes of the
published tables, and says whether their numbers are the same, and inside the published intervals: once as this
processor multiplies the matrices of a policy, and once as OpenBLAS does on processors of the kind HASWELL, since the
order of its sums depends on the processor, and on some of them on its threads, of which there is one, as in train.py.
"""

import argparse
import hashlib
import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Callable
from functools import partial
from io import BytesIO
from pathlib import Path
from zipfile import ZipFile

import numpy as np

from agents.statistics import rounded, seed_mean
from benchmarks.common.tables import ROOT, read_table, write_csv
from fish_env import BODIES, INTEGRATORS, TASKS
from fish_env.control import EPISODES, evaluate, evaluation_options, load_policy, make_eval_env, policy_controller
from fish_env.envs import VARIATIONS, FishVectorEnv

COMMAND = "python -m benchmarks.stability.repeatability"
FISH = 64  # four threads of at least 16
LIBRARIES = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS")
HASWELL = "Haswell"  # OPENBLAS_CORETYPE of processors without AVX-512
CONFIGURATIONS = (
    ("a folder, kernels compiled", "first", 1),
    ("the same, kernels found", "first", 1),
    ("two threads", "first", 2),
    ("three threads", "first", 3),
    ("four threads", "first", 4),
    ("another folder, kernels compiled", "second", 2),
)
"""Name, folder and number of threads of every process; digests are compared with those of the first."""


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


def trained(task: str, learner: str, threads: int, updates: int = 8) -> str:
    """The digest of a policy, its value function and its optimizer, trained by `agents.train` for some updates."""
    from agents.config import CONFIGS
    from agents.train import Request, train

    options = CONFIGS[task].env_options | {"threads": threads}
    steps = updates * FISH * CONFIGS[task].rollout
    with tempfile.TemporaryDirectory() as folder:
        train(Request(task, 3, folder=Path(folder, "run"), learner=learner, pictures=False,
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
    **{f"{task}, trained": partial(trained, task, "compiled")
       for task in ("swim", "turn", "left_after_right", "target", "target_3d", "avoid")},
    "swim, trained by Stable-Baselines3": partial(trained, "swim", "sb3"),
}  # fmt: skip
"""What is computed of a number of threads."""


def answer_of(*arguments: str, checkout: Path = ROOT, **variables: str) -> dict:
    """What this module answers in a process of its own, in a checkout, with variables of the environment."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "answer.json")
        command = [sys.executable, "-m", "benchmarks.stability.repeatability", *arguments, "--answer", str(path)]
        subprocess.run(command, cwd=checkout, check=True, stdout=subprocess.DEVNULL,
                       env=os.environ | {"PYTHONPATH": str(checkout)} | variables)  # fmt: skip
        return json.loads(path.read_text())


def digests(names: list[str], threads: int, **keywords) -> dict[str, str]:
    """The digests of trials, from a process of its own whose libraries have as many threads as the fish."""
    libraries = dict.fromkeys(LIBRARIES, str(threads))
    return answer_of("--threads", str(threads), "--trials", *names, **libraries, **keywords)


def compare(names: list[str], configurations=CONFIGURATIONS) -> list[dict]:
    """A row for every configuration and trial: whether its bits are those of the first configuration."""
    rows, first = [], {}
    with tempfile.TemporaryDirectory() as place:
        for folder in dict.fromkeys(folder for _, folder, _ in configurations):
            subprocess.run(["git", "clone", "--quiet", str(ROOT), str(Path(place, folder))], check=True)
        for name, folder, threads in configurations:
            cache = str(Path(place, f"kernels_{folder}"))
            found = digests(names, threads, checkout=Path(place, folder), NUMBA_CACHE_DIR=cache)
            first = first or found
            for trial, digest in found.items():
                rows.append({"configuration": name, "folder": folder, "threads": threads, "trial": trial,
                             "digest": digest[:16], "same": int(digest == first[trial])})  # fmt: skip
            print(f"{name}: {sum(first[each] == found[each] for each in found)} of {len(found)} the same", flush=True)
    return rows


def scored(task: str, condition: str) -> dict[str, dict[str, float | str]]:
    """Means of every metric over the fixed episodes, by method: the shipped policy, and those without learning.

    The metrics are those of the published tables, but for the one that all seeds of a policy are needed for.
    """
    from agents.config import CONFIGS, RESULTS
    from agents.report import baselines
    from fish_env.control.policy import PRETRAINED

    config, result = CONFIGS[task], RESULTS[task]
    keywords, options = ({"": ({}, {})} | result.conditions)[condition]
    env = make_eval_env(config.env_id, EPISODES, evaluation_options(config.env_options) | keywords)
    policy = load_policy(PRETRAINED / task / "policy.npz")
    controllers = baselines(env) | {"PPO": policy_controller(policy, env)}
    found = {}
    for name, controller in controllers.items():
        scores = evaluate(controller, env, options=options)
        metrics = {*result.metrics, "return", "failed"} - {"avoided_possible"}
        found[name] = {metric: rounded(seed_mean(scores, metric)) for metric in sorted(metrics)}
    env.close()
    return found


def all_scores() -> dict[str, dict]:
    """The scores of every task and condition, by "task/condition"."""
    from agents.config import RESULTS

    return {f"{task}/{condition}": scored(task, condition)
            for task, result in RESULTS.items() for condition in ("", *result.conditions)}  # fmt: skip


def published_again() -> list[dict]:
    """Every published number of a shipped policy and of the controllers without learning, beside its measurements."""
    from agents.config import RESULTS
    from fish_env.control.policy import PRETRAINED

    libraries = dict.fromkeys(LIBRARIES, "1")
    here = answer_of("--published", **libraries)
    there = answer_of("--published", OPENBLAS_CORETYPE=HASWELL, **libraries)
    rows = []
    for task in RESULTS:
        seed = json.loads((PRETRAINED / task / "config.json").read_text())["seed"]
        of_seeds = {row["condition"]: row for row in read_table(f"learning/{task}_seeds.csv") if row["seed"] == seed}
        for row in read_table(f"learning/{task}_methods.csv"):
            condition, method, metric, low, high = (row[k] for k in ("condition", "method", "metric", "low", "high"))
            again, other = (found[f"{task}/{condition}"][method].get(metric, "") for found in (here, there))
            if row["value"] == "" or again == "":
                continue  # a mean over nothing, or over all seeds together
            was = of_seeds[condition][metric] if method == "PPO" else row["value"]
            rows.append({"task": task, "condition": condition, "method": method, "metric": metric, "published": was,
                         "again": again, "as_haswell": other, "low": low, "high": high,
                         "same": int(was in (again, other)), "inside": int(low <= again <= high)})  # fmt: skip
    return rows


def main() -> int:
    """The command line; exit 1 if a bit or a published number differed."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--published", action="store_true", help="measure what is published again")
    parser.add_argument("--trials", nargs="+", choices=TRIALS, default=list(TRIALS), help="only these; no table then")
    parser.add_argument("--answer", type=Path, help="write what this process finds to a file, and no table")
    parser.add_argument("--threads", type=int, default=1, help="of a process with --answer (default 1)")
    chosen = parser.parse_args()
    if chosen.answer is not None:
        answer = all_scores() if chosen.published else {name: TRIALS[name](chosen.threads) for name in chosen.trials}
        chosen.answer.write_text(json.dumps(answer))
        return 0
    if chosen.published:
        rows = published_again()
        write_csv("published_again.csv", rows, f"{COMMAND} --published")
    else:
        rows = compare(chosen.trials)
        if set(chosen.trials) == set(TRIALS):
            write_csv("repeatability.csv", rows, COMMAND)
    print(f"{sum(row['same'] for row in rows)} of {len(rows)} are the same")
    return int(not all(row["same"] for row in rows))


if __name__ == "__main__":
    sys.exit(main())
