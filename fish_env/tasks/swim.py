"""Swim-v0: swim along a commanded heading, as fast as possible or at a commanded speed."""

import numpy as np

from fish_env.kernels.compile import kernel
from fish_env.kernels.simd import Kind, Pack, Vectors
from fish_env.physics.tank import Tank
from fish_env.tasks import rewards
from fish_env.tasks.base import CompiledTask
from fish_env.tasks.options import Direction, Option
from fish_env.tasks.start import POSE_OPTIONS, heading_vector, place

HEADING_ERROR = Option(0.0, np.pi, "largest angle between the commanded heading and the fish's own at the start, rad")
SPEED = Option(0.1, 3.0, "commanded speed, body lengths per second")


@kernel
def write_vectors(tank, pose, task, b, out):
    """Write the commanded heading, a unit vector, or the commanded velocity, body lengths per second."""
    out[b, 0] = task.speed[b] * task.heading[b]


@kernel
def write_terms(tank, pose, task, b, terms):
    """Write the progress along the heading, body lengths, and the costs of moving the muscles and the head."""
    progress = rewards.progress(tank, pose, task.before, task.heading, b)  # (46)
    if task.commanded:
        wanted = task.speed[b] * task.interval
        progress = wanted - abs(progress - wanted)  # (47)
    terms[0, b] = progress
    terms[1, b] = rewards.effort(tank, task.effort_weight, task.interval, b)  # (48)
    terms[2, b] = rewards.sway(tank, pose, task.sway_weight, task.interval, b)  # (49)
    task.before[b] = pose.centre[b]


class SwimTask(CompiledTask):
    """Cover as many body lengths along the commanded heading as the episode allows, or keep to a commanded speed.

    Args:
        heading_error: the largest angle between the commanded heading and the fish's own at the start, rad; drawn
            uniformly to either side.
        speed: commanded speed, body lengths per second, or a pair (lowest, highest) to draw it from; None: as fast as
            possible.
        weights: of the reward, such as `effort_weight`: keys of `weights`.

    Raises:
        ValueError: for a number out of range, saying what is allowed.
    """

    term_names = ("progress", "effort", "sway")
    episode_steps = 250
    write_vectors, write_terms = write_vectors, write_terms
    weights = {  # without them, the fastest gaits strain muscles and sway heads as no living fish does
        "effort_weight": rewards.EFFORT_WEIGHT._replace(default=2.2),
        "sway_weight": rewards.SWAY_WEIGHT._replace(default=1.5),
    }
    settable = ("heading_error", "speed", *weights)

    def __init__(self, heading_error: float = 0.5, speed: float | tuple[float, float] | None = None, **weights):
        super().__init__(**weights)
        self.heading_error = HEADING_ERROR.checked("heading_error", heading_error)
        self.speed = None if speed is None else SPEED.checked_range("speed", speed)
        self.reset_options = {**POSE_OPTIONS, "heading": Option(-np.pi, np.pi, "the commanded heading, rad")}
        self.directions = (Direction("commanded heading", "in the body frame", 1.0, 0.3),)
        if self.speed is not None:
            self.reset_options["speed"] = SPEED
            self.directions = (Direction("commanded velocity", "body lengths/s, in the body frame", SPEED.high, 0.5),)

    def prepare(self, tank: Tank, interval):
        """Make the arrays for the fish of a tank."""
        self.interval = interval
        b = tank.num_fish
        self._heading, self._before, self._start = (np.zeros((b, 3)) for _ in range(3))
        self._speed = np.ones(b)
        self.pack = Pack(
            "swim",
            heading=Vectors(self._heading, Kind(1)), before=Vectors(self._before, Kind(1)), speed=self._speed,
            commanded=self.speed is not None, interval=float(interval), over=np.zeros(b, dtype=bool),
            **self.weight_values(),
        )  # fmt: skip

    def start(self, tank: Tank, i, generator, options):
        """Place the fish at the origin with a random yaw, almost at rest, and draw its commanded heading."""
        yaw, error = generator.uniform(-1.0, 1.0, 2) * (np.pi, self.heading_error)
        self._before[i] = self._start[i] = place(tank, i, generator, yaw, options)
        self._heading[i] = heading_vector(options.get("heading", options.get("yaw", yaw) + error))
        if self.speed is not None:
            self._speed[i] = options.get("speed", generator.uniform(*self.speed))

    def metrics(self, tank: Tank, i, seconds):
        """Mean speed along the commanded heading and across it, and its error, body lengths/s."""
        travel = (self._before[i] - self._start[i]) / tank.fish.length / seconds
        along = float(travel @ self._heading[i])
        found = {"speed": along, "sideways": float(np.linalg.norm(travel - along * self._heading[i]))}
        if self.speed is not None:
            found |= {"commanded_speed": float(self._speed[i]), "speed_error": abs(along - float(self._speed[i]))}
        return found
