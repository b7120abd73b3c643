"""LeftAfterRight-v0: a turn to one side is commanded, and before it is complete one to the other."""

import numpy as np

from fish_env.tasks.options import Option, check_choice
from fish_env.tasks.start import POSE_OPTIONS
from fish_env.tasks.turns import ANGLE, PATIENCE, WAIT, CommandedTurns

SEVERITY = Option(0.1, 2.0, "factor on the angles of the turns")
PART = Option(0.0, 1.0, "part of a turn after which the next one is commanded")
DWELL = Option(0.02, 2.0, "time after which the next turn is commanded, s")
SIDE = Option(-1.0, 1.0, "side of the first turn: below zero right first, else left first")


class LeftAfterRightTask(CommandedTurns):
    """Swim straight; a turn is commanded, and while the fish is still turning, one to the other side.

    The second turn is counted from where the fish points when it is commanded: after a random part of the first one,
    or (in half of the episodes) after a random time. Left after right and right after left are equally frequent.

    Args:
        angle: size of each turn before `severity`, rad, a number or a pair (lowest, highest) to draw it from.
        severity: factor on the angles; a turn is never more than pi.
        part: part of a turn after which the next one is commanded, a number or a pair.
        dwell: time after which the next one is commanded instead, s, a number or a pair.
        wait: time from the start to the first command, s, a number or a pair.
        reversals: 1 for left after right, 2 for right, left and right again.
        weights: of the reward, such as `overshoot_weight`: keys of `weights`.

    Raises:
        ValueError: for a number out of range, saying what is allowed.
    """

    most_turns = 3
    settable = ("angle", "severity", "part", "dwell", "wait", "reversals", *CommandedTurns.weights)
    reset_options = {**POSE_OPTIONS, "first": ANGLE, "second": ANGLE, "side": SIDE, "part": PART, "dwell": DWELL,
                     "wait": WAIT}  # fmt: skip

    def __init__(self, angle=(np.pi / 4, np.pi / 2), severity: float = 1.0, part=(0.2, 0.8), dwell=(0.06, 0.3),
                 wait=(0.6, 1.2), reversals: int = 1, **weights):  # fmt: skip
        super().__init__(**weights)
        self.angle = ANGLE.checked_range("angle", angle)
        self.severity = SEVERITY.checked("severity", severity)
        self.part = PART.checked_range("part", part)
        self.dwell = DWELL.checked_range("dwell", dwell)
        self.wait = WAIT.checked_range("wait", wait)
        self.reversals = check_choice("reversals", reversals, (1, 2))

    def draw_turns(self, i, generator, options):
        """Draw turns to one side and the other, each commanded before the one before it is complete."""
        course = self.course
        side = -1.0 if options.get("side", generator.choice([-1.0, 1.0])) < 0 else 1.0
        course.count[i] = 1 + self.reversals
        course.wait[i, 0] = options.get("wait", generator.uniform(*self.wait))
        for k in range(1 + self.reversals):
            angle = options.get(("first", "second")[k % 2], generator.uniform(*self.angle))
            course.angle[i, k] = side * (-1.0) ** k * min(self.severity * angle, np.pi)
            if k > 0:
                by_time = generator.random() < 0.5
                part, dwell = generator.uniform(*self.part), generator.uniform(*self.dwell)
                if "dwell" in options or (by_time and "part" not in options):
                    course.wait[i, k] = options.get("dwell", dwell)
                else:
                    course.part[i, k], course.wait[i, k] = options.get("part", part), PATIENCE
