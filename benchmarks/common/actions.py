"""Commands under which stability is tested: random, bang-bang, the gait, and the abrupt manoeuvre."""

import numpy as np

from benchmarks.common.problems import left_after_right, swimming
from fish_env.bodies import Fish

STIFFNESS = (0.5, 0.7, 1.0, 1.4, 2.0)
"""Factors on the default fish's stiffness."""
FISH, INTERVALS = 16, 150
"""Fish and control intervals of random and bang-bang commands."""
REFERENCE_SUBSTEPS = 64
"""Steps a control interval of RK4, the reference."""
BOUND = 10.0
"""Times RK4's highest energy: what has more is not stable."""


def actions(fish: Fish, kind: str) -> np.ndarray:
    """Actions (K,B,M) of one kind: the same for every step, so that only the step differs."""
    generator = np.random.default_rng(0)
    if kind == "random":
        return generator.uniform(-1.0, 1.0, (INTERVALS, FISH, fish.num_muscles))
    if kind == "bang-bang":
        duration = generator.integers(1, 14, FISH)  # control intervals between switches
        sides = generator.choice([-1.0, 1.0], (INTERVALS, FISH, fish.num_muscles))
        return sides[np.arange(INTERVALS)[:, None] // duration, np.arange(FISH)]
    goals = swimming(fish, INTERVALS) if kind == "gait" else left_after_right(fish)
    return 2.0 * goals[:, None] - 1.0
