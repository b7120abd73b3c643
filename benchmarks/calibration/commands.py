"""Commands under which bodies are compared in motion: scenes of `benchmarks/common/families.py`, drawn from seeds.

A scene is contractions (K,12), a control interval each. What the motor controllers command in each task is recorded on
the fish of its day and added to `task_commands.npz`: a fit that read the controllers as they are would change them, and
then itself. Earlier recordings are kept: a body that is fitted to one fish's controllers is good at these, and its own
go where it exaggerates.

python -m benchmarks.calibration.commands     adds what the motor controllers command today to task_commands.npz
"""

import json
from pathlib import Path

import numpy as np

from benchmarks.common.families import bends, chirp, held, reversals, wandering
from benchmarks.common.motion import SECONDS, record
from benchmarks.common.tables import make_parser, provenance
from fish_env import make_fish
from fish_env.control.chart import bang_bang, gaits, sprints, square

FILE = Path(__file__).with_name("task_commands.npz")
RECORDED = ("swim", "turn", "left_after_right", "target", "avoid")  # tasks, in the order of the file
FIRST_SEED, SEEDS = 7_000, 8  # of the recorded scenes of each task
WEIGHTS = {"left_after_right": 2.0, "sprints": 2.0}
"""On the errors of a task's or a family's scenes: the manoeuvre in which methods are compared, and what a search for
the fastest gait tries."""


TRAINING = {"gaits": gaits, "held": held, "bang-bang": bang_bang, "reversals": reversals, "sprints": sprints}
EACH = {"gaits": 16, "held": 8, "bang-bang": 8, "reversals": 12, "sprints": 32}
"""Families that bodies are fitted to, and how many scenes of each."""
UNSEEN = {"square": square, "chirp": chirp, "wandering": wandering, "bends": bends}
"""Families that they are only tested on."""


def drawn(family, seed: int, count: int) -> np.ndarray:
    """`count` scenes of a family, (S,K,12)."""
    fish = make_fish("tetrahedral")
    times = fish.control_interval * np.arange(1, round(SECONDS / fish.control_interval) + 1)
    return np.stack([family(fish, np.random.default_rng([seed, k]), times) for k in range(count)])


def recorded() -> np.ndarray:
    """What the motor controllers commanded in each task, (G,S,K,12): the fish of G days, the latest last."""
    return np.load(FILE)["contraction"].astype(float)


def training_scenes(seed: int, strength: float) -> np.ndarray:
    """What bodies are fitted to: recorded commands of tasks, times `strength`, and scenes of every family."""
    parts = list(strength * recorded())
    parts += [drawn(family, seed + k, EACH[name]) for k, (name, family) in enumerate(TRAINING.items())]
    return np.concatenate(parts)


def weights() -> np.ndarray:
    """Factors (scenes,) on the errors of the scenes of `training_scenes`."""
    names = [*np.tile(np.repeat(RECORDED, SEEDS), len(recorded())), *np.repeat(list(TRAINING), list(EACH.values()))]
    return np.array([WEIGHTS.get(name, 1.0) for name in names])


def main() -> None:
    """Record what the motor controllers command in the RECORDED tasks."""
    make_parser(__doc__).parse_args()
    found = np.concatenate([record(task, SEEDS, FIRST_SEED) for task in RECORDED])[None]
    found = np.concatenate([recorded(), found]) if FILE.exists() else found
    about = json.dumps(provenance("python -m benchmarks.calibration.commands"))
    np.savez_compressed(FILE, contraction=found.astype(np.float16), provenance=about)
    print(FILE, found.shape, FILE.stat().st_size)


if __name__ == "__main__":
    main()
