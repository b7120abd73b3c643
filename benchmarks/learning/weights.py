"""Swim with other weights of effort and of a swaying head: what each costs in speed, and how the fish then moves."""

import tempfile
from pathlib import Path

from tqdm import tqdm

from benchmarks.common.tables import publish
from benchmarks.learning import kinematics
from fish_env.control import load_policy
from fish_env.training.config import Request
from fish_env.training.train import train

WEIGHTS = ((0.1, 0.0), (0.1, 1.5), (1.0, 1.5), (2.2, 0.0), (2.2, 0.5), (2.2, 1.5), (2.2, 4.0), (4.0, 1.5))
"""Effort and sway."""


def rows() -> list[dict]:
    """A row for each pair of weights, of one training with seed 0."""
    found = []
    for effort, sway in tqdm(WEIGHTS, unit="training"):
        weights = {"effort_weight": effort, "sway_weight": sway}
        with tempfile.TemporaryDirectory() as folder:
            run = train(Request("swim", folder=Path(folder) / "run", env_options=weights, pictures=False))
            policy = load_policy(run / "policy.npz", "FishEnv/Swim-v0")
        found.append(weights | kinematics.row_of("swim", policy))
    return found


if __name__ == "__main__":
    publish(__doc__, {"learning/weights.csv": rows})
