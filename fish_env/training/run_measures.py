"""Data for the report of a training run: its files, episodes on the fixed seeds, and the motion of a few of them."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from fish_env.bodies import Fish
from fish_env.control import (
    FIRST_SEED,
    Policy,
    Recording,
    Scores,
    evaluate,
    load_policy,
    make_policy_env,
    record,
)
from fish_env.control.environments import make_checked_env
from fish_env.control.evaluation import environment_for
from fish_env.envs import FishEnv
from fish_env.training.saved_run import CURVE, read_curve, read_record

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

    @property
    def steps(self) -> int:
        """Number of environment steps at the end of the learning curve."""
        return int(self.curve["timesteps"][-1]) if len(self.curve["timesteps"]) else 0


def read_run(folder: str | Path) -> Run:
    """A run by its folder.

    Raises:
        ValueError: if the folder contains no run, or one whose files are damaged or of another version.
    """
    folder = Path(folder)
    missing = [name for name in FILES if not (folder / name).is_file()]
    if missing:
        what = f"holds no {', '.join(missing)}" if folder.is_dir() else "is not a folder"
        raise ValueError(f"{folder} is not a training run: it {what}; give a folder that `fish_env train` has written")
    saved, names = read_record(folder / "config.json"), CURVE.split(",")
    rows = [[float(value) for value in row.split(",")] for row in read_curve(folder / "curve.csv")]
    table = np.array(rows).reshape(-1, len(names))
    curve = {name: table[:, k] for k, name in enumerate(names)}
    return Run(folder, saved, curve, load_policy(folder / "policy.npz", saved["config"]["env_id"]))


def measure_episodes(run: Run, count: int) -> Scores:
    """Run so many episodes, with the seeds of every evaluation."""
    env = make_policy_env(run.policy, count)
    scores = evaluate(env, run.policy)
    env.close()
    return scores


class Motion(NamedTuple):
    """Motion of a fish in one episode, T + 1 states."""

    time: np.ndarray  # (T+1,) s
    path: np.ndarray  # (T+1,2) centre of mass, body lengths, from the start, the first command along +x
    contraction: np.ndarray  # (T+1,M) 0 natural, 1 full
    spheres: np.ndarray  # (K,3) places and radii, body lengths, as the path


def record_episodes(run: Run, count: int = SHOWN) -> tuple[list[Recording], Fish]:
    """Record the first episodes of the evaluation; return them and the fish that swam."""
    env = make_checked_env(*environment_for(run.policy, {}))
    bare = env.unwrapped
    assert isinstance(bare, FishEnv)
    found = [record(env, run.policy, FIRST_SEED + k) for k in range(count)]
    env.close()
    return found, bare.tank.fish


def measure_motion(one: Recording, fish: Fish) -> Motion:
    """Measure the motion in a recorded episode of this fish."""
    mass = fish.body.mass / fish.body.mass.sum()
    centre = np.einsum("n,tnk->tk", mass, one.position) / fish.length
    commanded = one.directions[0, 0, :2] if one.directions.shape[1] else np.zeros(2)
    x, y = commanded if commanded.any() else fish.line @ one.position[0, :, :2]
    along = np.arctan2(y, x)
    turn = np.array([[np.cos(along), -np.sin(along)], [np.sin(along), np.cos(along)]])
    natural = fish.body.springs.rest_length[fish.muscles]
    shortened = (natural - one.rest_length[:, fish.muscles]) / ((1.0 - fish.contracted) * natural)
    spheres = one.spheres[one.spheres[..., 3] > 0.0]
    places = np.unique(np.round(spheres, 9), axis=0).reshape(-1, 4)
    around = (places[:, :2] / fish.length - centre[0, :2]) @ turn
    path = (centre[:, :2] - centre[0, :2]) @ turn
    return Motion(one.time, path, np.clip(shortened, 0.0, 1.0), np.column_stack([around, places[:, 3]]))
