"""Turn-v0: swim, then turn to a commanded heading."""

import numpy as np

from fish_env.tasks import turns
from fish_env.tasks.start import POSE_OPTIONS
from fish_env.tasks.turns import ANGLE, ANGLE_SIGNED, WAIT, CommandedTurns

OVERSHOOT_WEIGHT = turns.OVERSHOOT_WEIGHT._replace(default=15.0)  # with 60, fish stop short of the command


class TurnTask(CommandedTurns):
    """Swim straight, then follow one commanded change of heading to either side.

    Args:
        angle: size of the turn, rad, a number or a pair (lowest, highest) to draw it from; the side is drawn too.
        wait: time from the start to the command, s, a number or a pair.
        weights: of the reward, such as `overshoot_weight`: keys of `weights`.

    Raises:
        ValueError: for a number out of range, saying what is allowed.
    """

    weights = {**CommandedTurns.weights, "overshoot_weight": OVERSHOOT_WEIGHT}
    settable = ("angle", "wait", *weights)
    reset_options = {**POSE_OPTIONS, "turn": ANGLE_SIGNED, "wait": WAIT}

    def __init__(self, angle=(np.pi / 6, np.pi), wait=(0.8, 1.6), **weights):
        super().__init__(**weights)
        self.angle = ANGLE.checked_range("angle", angle)
        self.wait = WAIT.checked_range("wait", wait)
