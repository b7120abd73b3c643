"""The protocol by which learners are compared: a learner trains in every trial, and its file holds what it reached.

    found = benchmark("mine:learn", "mine.json", tasks=["swim"], levels=["easy"], budgets=[10_000], seeds=[0])

A learner is a function of a `Trial` that returns what `fish_env.control.evaluate` takes: a model, a policy, a function.
"""

import json
import os
from collections.abc import Callable, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.vec_env import VecEnv
from tqdm import tqdm

from fish_env.checks import check_names, is_whole
from fish_env.control import protocols
from fish_env.control.console import import_from_here
from fish_env.control.evaluation import EPISODES, FIRST_SEED, PolicyLike, checked_episodes, evaluate, make_eval_env
from fish_env.control.files import write_text
from fish_env.control.protocols import BUDGETS, LEVELS, SEEDS, TASKS, VERSION, held_out_return, level_options
from fish_env.control.statistics import Scores, interval, mean_over_seeds
from fish_env.envs import FishVectorEnv, make_sb3_vec_env
from fish_env.physics.tank_options import checked_count
from fish_env.training.build import export_policy, make_env, make_model
from fish_env.training.callbacks import ended
from fish_env.training.config import CONFIGS
from fish_env.training.run_folder import versions

KEY = ("task", "level", "steps", "seed")
CURVE_ROWS = 20
SEEDS_BELOW = FIRST_SEED // 10  # fish i of a trial starts from its seed + i: none from one of the evaluation


class Curve(BaseCallback):
    """Mean return and metric of the training's own episodes, a row for each twentieth of the budget."""

    def __init__(self, steps: int, metric: str):
        super().__init__()
        self.every, self.metric, self.rows, self._found = steps / CURVE_ROWS, metric, [], []

    def _on_step(self) -> bool:
        self._found += [(sum(info["terms"].values()), info[self.metric]) for info in ended(self.locals["infos"])]
        if self._found and self.num_timesteps >= (len(self.rows) + 1) * self.every:
            finite = [[float(v) for v in values if np.isfinite(v)] for values in zip(*self._found, strict=True)]
            means = [round(float(np.mean(values)), 4) if values else None for values in finite]
            self.rows.append([self.num_timesteps, *means])
            self._found = []
        return True


@dataclass(frozen=True)
class Trial:
    """A training: `steps` environment steps on a task at a level, from a seed."""

    task: str
    level: str
    steps: int
    seed: int
    curve: Curve
    """A callback of Stable-Baselines3 that keeps the learning curve: `model.learn(trial.steps, trial.curve)`."""

    @property
    def env_id(self) -> str:
        """Id of the environment in which the result is evaluated."""
        return TASKS[self.task][0]

    @property
    def options(self) -> dict[str, Any]:
        """Its keywords."""
        return level_options(self.task, self.level)

    def make_env(self, num_envs: int, **training) -> VecEnv:
        """The batch to train on; `training` are keywords that differ in training, such as shorter episodes."""
        return make_sb3_vec_env(self.env_id, num_envs, self.seed, staggered=True, **self.options | training)


Learner = Callable[[Trial], PolicyLike]


def ppo(trial: Trial) -> PolicyLike:
    """The package's own PPO with the settings of `fish_env train`."""
    config = CONFIGS[trial.task]
    config = replace(config, timesteps=trial.steps, env_options=config.env_options | trial.options)
    with closing(make_env(config, config.num_envs, trial.seed)) as env:
        model = make_model(config, env, trial.seed)
        model.learn(trial.steps, trial.curve)
        return export_policy(model, {"env_id": config.env_id, "env_options": config.env_options})


def find_learner(name: str) -> Learner:
    """The learner of a name: "ppo", or module:function of a module that can be imported, also from this folder.

    Raises:
        ValueError: if there is none.
    """
    if name == "ppo":
        return ppo
    module, colon, function = name.rpartition(":")
    found = getattr(import_from_here(module), function, None) if colon else None
    if not callable(found):
        raise ValueError(f"the learner is {name!r}; give ppo, or module:function of a function of a Trial")
    return found


def benchmark(
    learner: str,
    path: str | Path,
    tasks: Sequence[str] = tuple(TASKS),
    levels: Sequence[str] = tuple(LEVELS),
    budgets: Sequence[int] = BUDGETS,
    seeds: Sequence[int] = SEEDS,
) -> dict[str, Any]:
    """Run the trials of a learner that its file does not hold yet; the file is written after each of them.

    Args:
        learner: "ppo", or module:function.
        path: the .json file.
        tasks: keys of `protocols.TASKS`.
        levels: keys of `protocols.LEVELS`.
        budgets: numbers of environment steps.
        seeds: of the learner.

    Returns:
        What the file holds (`read_result`).

    Raises:
        ValueError: for an unknown learner, task or level, a number that is not allowed, a file that is no result or is
            of another learner, or what is no policy.
    """
    learn, path = find_learner(learner), Path(path)
    check_names("unknown task", TASKS, *tasks)
    check_names("unknown level", LEVELS, *levels)
    found = {"protocol": VERSION, "learner": learner, "versions": versions(), "runs": []}
    if path.exists():
        found = read_result(path)
        if found["learner"] != learner:
            raise ValueError(f"{path} is of the learner {found['learner']}; give --save another file")
    done = {_key(run) for run in found["runs"]}
    counts = [checked_count(steps, "steps") for steps in budgets]
    numbers = [checked_episodes(1, seed)[1] for seed in seeds]
    if max(numbers, default=0) >= SEEDS_BELOW:
        raise ValueError(f"seed is {max(numbers)}; give less than {SEEDS_BELOW}: those of the evaluation lie beyond")
    wanted = dict.fromkeys((t, v, n, s) for s in numbers for n in counts for t in tasks for v in levels)  # each once
    try:
        for key in tqdm([key for key in wanted if key not in done], unit="trial", desc=learner, dynamic_ncols=True):
            found["runs"].append(run_trial(learn, *key))
            others = read_result(path) if path.exists() else found  # another process may have added trials
            if others["learner"] == learner:
                found["runs"] = list({_key(run): run for run in (*others["runs"], *found["runs"])}.values())
            write_text(path, json.dumps(found) + "\n")
    except KeyboardInterrupt:
        print(f"\n{len(found['runs'])} trials are in {path}; the same command goes on from there.")
        raise
    return found


def run_trial(learn: Learner, task: str, level: str, steps: int, seed: int) -> dict[str, Any]:
    """Train and evaluate once: a run of a result."""
    trial = Trial(task, level, steps, seed, Curve(steps, TASKS[task][1]))
    begin = sum(os.times()[:4])  # of this process and of those that it has waited for
    policy = learn(trial)
    seconds = sum(os.times()[:4]) - begin
    trained = max(getattr(policy, "num_timesteps", 0), trial.curve.num_timesteps)  # of a model; of what used the curve
    if trained > steps + 10_000:  # a last rollout may be over
        raise ValueError(f"the learner took {trained:,} environment steps, and the budget is {steps:,}; take fewer")
    return dict(zip(KEY, (task, level, steps, seed), strict=True)) | measure(lambda env: policy, task, level) | {
        "processor_seconds": round(seconds, 1), "curve": trial.curve.rows,
    }  # fmt: skip


def measure(make: Callable[[FishVectorEnv], PolicyLike], task: str, level: str) -> dict[str, Any]:
    """Returns, failures and metric of the episodes of the protocol, and the mean return in its held-out conditions.

    `make` returns the policy for a batch.
    """
    with closing(make_eval_env(TASKS[task][0], EPISODES, level_options(task, level))) as env:
        scores = evaluate(env, make(env), FIRST_SEED)
    rows = {name: [round(float(v), 4) if np.isfinite(v) else None for v in scores[key]]
            for name, key in (("returns", "return"), ("metrics", TASKS[task][1]))}  # fmt: skip
    return rows | {"failed": float(scores["failed"].mean()), "held_out": held_out_return(make, task, level)}


def read_result(path: str | Path) -> dict[str, Any]:
    """Read and check a file of `benchmark`: `protocol`, `learner`, `versions` and `runs`.

    Raises:
        FileNotFoundError: if there is no such file.
        ValueError: if it is no result of this version of the protocol, saying what is wrong.
    """
    try:
        found = json.loads(Path(path).read_text(encoding="utf-8"))
        if found["protocol"] != VERSION:
            raise ValueError(f"it is of version {found['protocol']} of the protocol, which has {VERSION} now")
        for run in found["runs"]:
            _check_run(run)
        keys = [_key(run) for run in found["runs"]]
        if not keys or len(set(keys)) < len(keys) or not isinstance(found["learner"], str):
            raise ValueError("it has a trial twice, or none, or no learner")
    except (ValueError, KeyError, TypeError, UnicodeDecodeError) as error:
        reason = f"it has no {error}" if isinstance(error, KeyError) else error
        raise ValueError(f"{path} is no result of fish_env benchmark: {reason}") from error
    return found


def _key(run: Mapping[str, Any]) -> tuple:
    return tuple(run[name] for name in KEY)


def _check_run(run: Mapping[str, Any]) -> None:
    check_names("unknown task", TASKS, run["task"])
    check_names("unknown level", LEVELS, run["level"])
    if len(run["returns"]) != EPISODES or len(run["metrics"]) != EPISODES:
        raise ValueError(f"a trial has {len(run['returns'])} returns; give {EPISODES}")
    if not np.isfinite([*run["returns"], run["failed"], run["held_out"], run["processor_seconds"]]).all():
        raise ValueError("a return, a share or a time is not finite")
    if not all(is_whole(run[name]) and run[name] >= 0 for name in ("steps", "seed")):
        raise ValueError(f"steps are {run['steps']!r} and the seed {run['seed']!r}; give whole numbers")
    if any(len(row) != 3 for row in run["curve"]):
        raise ValueError("a row of a curve has not three numbers")


def score_rows(result: Mapping[str, Any]) -> list[dict[str, Any]]:
    """A row for each task, level and budget of a result.

    `score`, with `low` and `high` of its 95 % interval, `return` and `value`, that of the `metric`, are interquartile
    means over seeds. `failed`, `held_out` and the processor time of a training, `seconds`, are means.
    """
    groups: dict[tuple, list[Mapping[str, Any]]] = {}
    for run in result["runs"]:
        groups.setdefault((run["task"], run["level"], run["steps"]), []).append(run)
    return [_score_row(result["learner"], runs) for runs in groups.values()]


def _score_row(learner: str, runs: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    task, level, steps = (runs[0][name] for name in KEY[:3])
    scores: list[Scores] = [
        {name: np.array(run[f"{name}s"], dtype=float) for name in ("return", "metric")} for run in runs
    ]
    ends = interval(scores, "return", np.random.default_rng(0))
    score, low, high = (protocols.normalised_score(task, level, value) for value in ends)
    failed, held_out, seconds = (
        float(np.mean([run[name] for run in runs])) for name in ("failed", "held_out", "processor_seconds")
    )
    numbers = {
        "score": score, "low": low, "high": high, "return": mean_over_seeds(scores, "return"),
        "value": mean_over_seeds(scores, "metric"), "failed": failed,
        "held_out": protocols.normalised_score(task, level, held_out), "seconds": seconds,
    }  # fmt: skip
    about = {"learner": learner, "task": task, "level": level, "steps": steps, "seeds": len(runs)}
    return about | {"metric": TASKS[task][1]} | {name: round(value, 3) for name, value in numbers.items()}
