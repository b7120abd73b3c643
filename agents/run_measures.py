"""Data for the report of a training run: its files, episodes on the fixed seeds, and the motion of a few of them."""

from collections import Counter
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from agents.saved_run import CURVE, check_name, read_curve, read_record
from fish_env.bodies import Fish
from fish_env.control import (
    FIRST_SEED,
    Policy,
    Recording,
    evaluation_options,
    load_policy,
    make_policy_env,
    policy_controller,
    record,
    run_episodes,
)
from fish_env.control.environments import environment_of, make_checked_env
from fish_env.control.evaluation import Scores, episode_scores, scores_by_name
from fish_env.envs import FishEnv

FILES = ("config.json", "curve.csv", "policy.npz")
SHOWN = 3  # episodes whose motion is drawn


@dataclass(frozen=True, eq=False)
class Run:
    """A finished or interrupted training run."""

    folder: Path
    record: dict[str, Any]
    """config.json."""
    curve: dict[str, np.ndarray]
    """The columns of curve.csv."""
    policy: Policy

    @property
    def task(self) -> str:
        return self.record["task"]

    @property
    def seed(self) -> int:
        return self.record["seed"]


def read_run(folder: str | Path) -> Run:
    """A run by its folder.

    Raises:
        ValueError: if the folder contains no run, or one whose files are damaged or of another version.
    """
    folder = Path(folder)
    missing = [name for name in FILES if not (folder / name).is_file()]
    if missing:
        what = f"holds no {', '.join(missing)}" if folder.is_dir() else "is not a folder"
        raise ValueError(f"{folder} is not a training run: it {what}; give a folder that train.py TASK has written")
    check_name(folder)
    saved, names = read_record(folder / "config.json"), CURVE.split(",")
    rows = [[float(value) for value in row.split(",")] for row in read_curve(folder / "curve.csv")]
    table = np.array(rows).reshape(-1, len(names))
    curve = {str(name): table[:, k] for k, name in enumerate(names)}
    return Run(folder, saved, curve, load_policy(folder / "policy.npz", saved["config"]["env_id"]))


@dataclass(frozen=True, eq=False)
class Episodes:
    """Episodes of one policy on the fixed seeds."""

    scores: Scores
    terms: dict[str, np.ndarray]
    """Sum of every reward term over each episode, (B,)."""
    failures: Counter
    """Number of episodes that ended for each reason."""


def measured_episodes(run: Run, count: int) -> Episodes:
    """Run so many episodes, with the seeds of every evaluation."""
    env = make_policy_env(run.policy, count)
    results: list[dict[str, float]] = [{}] * count
    terms: list[dict[str, float]] = [{}] * count
    failures: Counter = Counter()
    for ended, _, infos in run_episodes(policy_controller(run.policy, env), env):
        for i in np.flatnonzero(ended).tolist():
            final = infos["final_info"]
            results[i] = episode_scores(final, i)
            terms[i] = {name: float(v[i]) for name, v in final["terms"].items() if not name.startswith("_")}
            if results[i]["failed"]:
                failures[str(final["failure"][i]).partition(":")[0]] += 1
    env.close()
    return Episodes(scores_by_name(results), scores_by_name(terms), failures)


@dataclass(frozen=True, eq=False)
class Motion:
    """Motion of a fish in one episode, T + 1 states."""

    time: np.ndarray  # (T+1,) s
    path: np.ndarray  # (T+1,2) centre of mass, body lengths, from the start, the first command along +x
    heading: np.ndarray  # (T+1,) rad, continuous, from the first command
    command: np.ndarray  # (T+1,) rad, continuous, from the first command; NaN where there is none
    contraction: np.ndarray  # (T+1,M) 0 natural, 1 full
    tail: np.ndarray  # (T+1,) how far the tail is to the left of the body's axis, body lengths
    spheres: np.ndarray  # (K,3) places and radii, body lengths, as the path
    terms: np.ndarray  # (T,K) terms of the reward


def recorded_episodes(run: Run, count: int = SHOWN) -> tuple[list[Recording], Fish]:
    """Recordings of the first episodes of the evaluation, and the fish that swam."""
    env_id, options = environment_of(run.policy.about)
    env = make_checked_env(env_id, evaluation_options(options))
    bare = env.unwrapped
    assert isinstance(bare, FishEnv)  # the tasks of `RESULTS` are
    found = [record(env, run.policy, FIRST_SEED + k) for k in range(count)]
    env.close()
    return found, bare.tank.fish


def motion(one: Recording, fish: Fish) -> Motion:
    """The motion in a recorded episode of this fish."""
    mass = fish.body.mass / fish.body.mass.sum()
    centre = np.einsum("n,tnk->tk", mass, one.position) / fish.length
    forward = np.einsum("n,tnk->tk", fish.line, one.position)[:, :2]
    forward /= np.linalg.norm(forward, axis=1, keepdims=True)
    left = np.stack([-forward[:, 1], forward[:, 0]], axis=1)
    offset = one.position[:, fish.tail].mean(axis=1)[:, :2] / fish.length - centre[:, :2]
    asked = one.directions[:, 0, :2] if one.directions.shape[1] else np.zeros((one.steps + 1, 2))
    zero = np.arctan2(*asked[0, ::-1]) if asked[0].any() else np.arctan2(*forward[0, ::-1])
    turn = np.array([[np.cos(zero), -np.sin(zero)], [np.sin(zero), np.cos(zero)]])
    heading = np.unwrap(np.arctan2(forward[:, 1], forward[:, 0])) - zero
    command = np.unwrap(np.arctan2(asked[:, 1], asked[:, 0])) - zero
    natural = fish.body.springs.rest_length[fish.muscles]
    shortened = (natural - one.rest_length[:, fish.muscles]) / ((1.0 - fish.contracted) * natural)
    spheres = one.spheres[one.spheres[..., 3] > 0.0]
    places = np.unique(np.round(spheres, 9), axis=0).reshape(-1, 4)
    around = (places[:, :2] / fish.length - centre[0, :2]) @ turn
    return Motion(
        time=one.time,
        path=(centre[:, :2] - centre[0, :2]) @ turn,
        heading=heading - 2 * np.pi * np.round(heading[0] / (2 * np.pi)),
        command=np.where(asked.any(axis=1), command, np.nan),
        contraction=np.clip(shortened, 0.0, 1.0),
        tail=(offset * left).sum(axis=1),
        spheres=np.column_stack([around, places[:, 3]]),
        terms=one.terms,
    )


def spectrum(values: np.ndarray, interval: float) -> tuple[np.ndarray, np.ndarray]:
    """Frequencies, Hz, and amplitudes of an oscillation (T,) that is sampled every `interval` s.

    The mean is taken off and a Hann window laid over it; a sine wave of amplitude a that has whole periods has the
    amplitude a at its frequency.
    """
    window = np.hanning(len(values) + 1)[:-1]
    amplitude = np.abs(np.fft.rfft((values - values.mean()) * window)) * 2.0 / window.sum()
    return np.fft.rfftfreq(len(values), interval), amplitude


def tail_beat(found: Motion, interval: float) -> tuple[float, float]:
    """Frequency of the tail beat, Hz, the peak of the spectrum between its samples; and its amplitude, body lengths.

    The amplitude is that of a sine wave with the mean square of the tail's oscillation about its mean.
    """
    frequency, amplitude = spectrum(found.tail, interval)
    k = int(amplitude[1:].argmax()) + 1
    shift = 0.0
    if 1 < k < len(amplitude) - 1:
        a, b, c = np.log(np.maximum(amplitude[k - 1 : k + 2], 1e-300))
        shift = 0.5 * (a - c) / (a - 2 * b + c) if a - 2 * b + c else 0.0
    return float(frequency[1] * (k + shift)), float(np.sqrt(2.0) * found.tail.std())
