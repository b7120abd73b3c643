"""FastStart-v0: from rest or gliding, a direction is commanded; get away along it."""

import math

import numpy as np

from fish_env.kernels.compile import INDEX, kernel
from fish_env.kernels.simd import Kind, Vectors, dot, vec3
from fish_env.physics.tank import Tank
from fish_env.tasks import rewards, turns
from fish_env.tasks.options import Option
from fish_env.tasks.start import POSE_OPTIONS, heading_vector
from fish_env.tasks.turns import ANGLE_SIGNED, WAIT, CommandedTurns

ANGLE = Option(0.0, math.pi, "size of the commanded turn, rad")
SPEED = Option(0.0, 3.0, "speed of the glide at the start, body lengths per second")
AWAY, IN_TIME = 0.5, 0.8  # body lengths to be made good along the command, and s after it
START = 0.3  # s after the command in which the start is recorded
OVER = 0.04  # s over which the acceleration is averaged


@kernel
def write_terms(tank, pose, task, b, terms):
    """Write progress along the commanded heading, none before the command, and effort; record the start."""
    course = task.course
    terms[0, b] = rewards.progress(tank, pose, task.before, task.heading, b)  # (46)
    terms[1, b] = rewards.effort(tank, task.effort_weight, task.interval, b)  # (48)
    turns.measure_strain(tank, task.strain, b)
    turns.track_commands(pose, task, b)
    task.before[b] = pose.centre[b]
    if course.stage[b] > 0:
        task.heading[b] = vec3(math.cos(course.heading[b]), math.sin(course.heading[b]), 0.0)
        k = course.since[b] / task.interval + 0.5  # environment steps since the command
        if 0.0 <= k < task.facing.shape[1]:
            task.centre[b, INDEX(k)] = pose.centre[b]
            ahead = tank.position[b, INDEX(tank.nose)] - pose.centre[b]
            task.snout[b, INDEX(k)] = math.atan2(ahead.y, ahead.x)
            task.velocity[b, INDEX(k)] = pose.velocity[b]
            task.facing[b, INDEX(k)] = course.facing[b]
        if course.since[b] <= IN_TIME + 0.5 * task.interval:
            way = dot(pose.centre[b] - task.centre[b, 0], task.heading[b]) / tank.length
            task.farthest[b] = max(task.farthest[b], way)


class FastStartTask(CommandedTurns):
    """Get away in a commanded direction as fast as possible, from rest or from a glide.

    The vector of the commanded heading is null before the command, so that the fish sees when it comes.

    Args:
        angle: size of the turn to the commanded direction, rad, a number or a pair (lowest, highest) to draw it from;
            the side is drawn too.
        speed: at which the fish glides along its axis at the start, body lengths per second, a number or a pair.
        wait: time from the start to the command, s, a number or a pair; of less than half an environment step, it
            is there at the start.
        weights: of the reward, such as `effort_weight`: keys of `weights`.

    Raises:
        ValueError: for a number out of range, saying what is allowed.
    """

    term_names = ("progress", "effort")
    episode_steps = 60
    weights = {"effort_weight": rewards.EFFORT_WEIGHT}
    settable = ("angle", "speed", "wait", *weights)
    write_terms = write_terms
    reset_options = {**POSE_OPTIONS, "turn": ANGLE_SIGNED, "speed": SPEED, "wait": WAIT}

    def __init__(self, angle=(0.0, np.pi), speed=(0.0, 2.0), wait=(0.0, 0.3), **weights):
        super().__init__(**weights)
        self.angle = ANGLE.checked_range("angle", angle)
        self.speed = SPEED.checked_range("speed", speed)
        self.wait = WAIT.checked_range("wait", wait)

    def fields(self):
        """Data that the kernels read and write: after the command, the start is recorded, NaN until then."""
        b, steps = len(self._before), 1 + self.steps(START)
        self.centre, self.velocity = (np.zeros((b, steps, 3)) for _ in range(2))  # m and m/s, of the centre of mass
        self.facing = np.zeros((b, steps))  # rad
        self.snout = np.zeros((b, steps))  # rad, of the way from the centre of mass to the nose
        self.farthest = np.zeros(b)  # body lengths made good in time
        vectors = {name: Vectors(getattr(self, name), Kind(1)) for name in ("centre", "velocity")}
        return super().fields() | vectors | {"facing": self.facing, "snout": self.snout, "farthest": self.farthest}

    def steps(self, seconds: float) -> int:
        """Whole environment steps nearest to a time, at least one."""
        return max(1, math.floor(seconds / self.interval + 0.5))

    def start(self, tank: Tank, i, generator, options):
        """Place the fish at the origin with a random yaw, gliding along its axis or at rest."""
        super().start(tank, i, generator, options)
        body, course = tank.fish.body, self.course
        speed = options.get("speed", generator.uniform(*self.speed)) * tank.fish.length
        forward = tank.fish.line @ tank.position[i]
        tank.velocity[i] += speed * forward / np.linalg.norm(forward) * (body.inverse_mass > 0.0)
        self._heading[i] = 0.0
        for array in (self.centre, self.velocity, self.facing, self.snout):
            array[i] = np.nan
        self.farthest[i] = 0.0
        if course.wait[i, 0] < 0.5 * self.interval:
            course.stage[i] = 1
            course.heading[i] = rewards.wrap_angle(course.heading[i] + course.angle[i, 0])
            self._heading[i] = heading_vector(course.heading[i])
            self.centre[i, 0], self.facing[i, 0] = self._before[i], course.facing[i]
            ahead = tank.position[i, tank.fish.nose] - self._before[i]
            self.snout[i, 0] = math.atan2(ahead[1], ahead[0])
            self.velocity[i, 0] = body.mass @ tank.velocity[i] / body.mass.sum()

    def metrics(self, tank: Tank, i, seconds):
        """Angles, distance, speed and acceleration of the start, and how far it got; angles in degrees.

        An `angle` is that of the line of best fit, a `snout` that of the line from the centre of mass to the nose.
        """
        length, course = tank.fish.length, self.course
        path = np.cumsum(np.linalg.norm(np.diff(self.centre[i], axis=0), axis=1)) / length
        over = self.steps(OVER)
        change = np.linalg.norm(self.velocity[i, over:] - self.velocity[i, :-over], axis=1)
        side = 1.0 if course.angle[i, 0] > 0.0 else -1.0
        angles = {
            f"{name}_{ms}ms": float(np.degrees(side * (turned[self.steps(ms / 1000)] - turned[0])))
            for name, turned in (("angle", self.facing[i]), ("snout", np.unwrap(self.snout[i])))
            for ms in (100, 200, 300)
        }
        turning = super().metrics(tank, i, seconds)
        return {
            "success": bool(self.farthest[i] >= AWAY),
            "escape_distance": float((self._before[i] - self.centre[i, 0]) @ self._heading[i] / length),
            **angles,
            "distance_200ms": float(path[self.steps(0.2) - 1]),
            "speed_200ms": float(np.linalg.norm(self.velocity[i, self.steps(0.2)]) / length),
            "peak_acceleration": float(np.fmax.reduce(change) / (over * self.interval)),
            **{name: turning[name] for name in ("latency", "turning_rate", "turn", "peak_strain")},
        }
