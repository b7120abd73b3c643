"""Swim-v0: swim along a commanded heading, as fast as possible or at a commanded speed."""

import numpy as np

from fish_env.tasks import rewards
from fish_env.tasks.options import Direction, Option
from fish_env.tasks.start import POSE_OPTIONS, level, place

HEADING_ERROR = Option(0.0, np.pi, "largest angle between the commanded heading and the fish's own at the start, rad")
SPEED = Option(0.1, 3.0, "commanded speed, body lengths per second")


class SwimTask:
    """Cover as many body lengths along the commanded heading as the episode allows, or keep to a commanded speed.

    Args:
        heading_error: the largest angle between the commanded heading and the fish's own at the start, rad; drawn
            uniformly to either side.
        speed: commanded speed, body lengths per second, or a pair (lowest, highest) to draw it from; None: as fast as
            possible.

    Raises:
        ValueError: for a number out of range, saying what is allowed.
    """

    term_names = ("progress", "effort")

    def __init__(self, heading_error: float = 0.5, speed: float | tuple[float, float] | None = None):
        self.heading_error = HEADING_ERROR.checked("heading_error", heading_error)
        self.speed = None if speed is None else SPEED.checked_range("speed", speed)
        heading = Option(-np.pi, np.pi, "the commanded heading, rad")
        self.reset_options = {**POSE_OPTIONS, "heading": heading}
        self.directions = (Direction("commanded heading", "in the body frame", 1.0, 0.3),)
        if self.speed is not None:
            self.reset_options["speed"] = SPEED
            self.directions = (Direction("commanded velocity", "body lengths/s, in the body frame", SPEED.high, 0.5),)

    def prepare(self, tank, interval):
        """Make the arrays for the fish of a tank."""
        self.interval = interval
        self._heading, self._before, self._start = np.zeros((3, tank.num_fish, 3))
        self._speed = np.ones(tank.num_fish)
        self._never = np.zeros(tank.num_fish, dtype=bool)

    def start(self, tank, i, generator, options):
        """Place the fish at the origin with a random yaw, almost at rest, and draw its commanded heading."""
        yaw, error = generator.uniform(-1.0, 1.0, 2) * (np.pi, self.heading_error)
        self._before[i] = self._start[i] = place(tank, i, generator, yaw, options)
        self._heading[i] = level(options.get("heading", options.get("yaw", yaw) + error))
        if self.speed is not None:
            self._speed[i] = options.get("speed", generator.uniform(*self.speed))

    def vectors(self, tank, pose):
        """The commanded heading, a unit vector, or the commanded velocity, body lengths per second, (B,1,3)."""
        return (self._speed[:, None] * self._heading)[:, None]

    def reward(self, tank, pose):
        """Progress along the heading, body lengths, less the effort of moving the muscles."""
        progress = self.progress(tank, pose)
        if self.speed is not None:
            wanted = self._speed * self.interval
            progress = wanted - np.abs(progress - wanted)  # (39)
        self._before[:] = pose.centre
        return {"progress": progress, "effort": rewards.effort(tank, self.interval)}  # (20)

    def progress(self, tank, pose):
        """Body lengths covered along the heading in the last interval, (B,)."""
        return rewards.progress(pose.centre, self._before, self._heading, tank.fish.length)  # (19)

    def done(self, tank, pose):
        """Never: the episode ends at the time limit."""
        return self._never

    def metrics(self, tank, i, seconds):
        """Mean speed along the commanded heading and across it, and how far it is from the commanded one, lengths/s."""
        travel = (self._before[i] - self._start[i]) / tank.fish.length / seconds
        along = float(travel @ self._heading[i])
        found = {"speed": along, "sideways": float(np.linalg.norm(travel - along * self._heading[i]))}
        if self.speed is not None:
            found |= {"commanded_speed": float(self._speed[i]), "speed_error": abs(along - float(self._speed[i]))}
        return found
