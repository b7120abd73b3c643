"""Avoid-v0: a sphere appears ahead, perhaps in the middle of a turn; pass it untouched and come back to the heading."""

import math

import numpy as np

from fish_env.kernels.compile import INDEX, kernel
from fish_env.kernels.simd import Kind, Vectors, dot, sqrt, vec3
from fish_env.physics.pose import FORWARD
from fish_env.physics.tank import Tank
from fish_env.tasks import rewards, turns
from fish_env.tasks.options import Direction, Option, weight
from fish_env.tasks.start import POSE_OPTIONS
from fish_env.tasks.turns import ANGLE, ANGLE_SIGNED, WAIT, CommandedTurns

ALIGNMENT_WEIGHT = turns.ALIGNMENT_WEIGHT._replace(default=2.0)  # a detour must not cost too much
TOUCH_PENALTY = weight(5.0, "weight of touching the obstacle, body lengths")

CHANCE = Option(0.0, 1.0, "chance of it")
RADIUS = Option(0.05, 1.0, "radius of the obstacle, body lengths")
GAP = Option(0.2, 5.0, "water between the nose and the obstacle where they would meet, body lengths")
ASIDE = Option(0.0, 1.0, "largest distance of the obstacle from the fish's line, as a part of its radius")
ASIDE_SIGNED = Option(-1.0, 1.0, "distance of the obstacle to the left of the fish's line, as a part of its radius")
DRIFT = Option(0.0, 3.0, "speed of the obstacle, body lengths per second")
DRIFT_SIGNED = Option(-3.0, 3.0, "speed of the obstacle to the left, body lengths per second")
LEAD = (0.1, 0.4)  # s before the obstacle appears at which a turn is commanded
CRUISE = 2.0  # body lengths a second: the speed of the fish for which a sweeping obstacle is aimed


@kernel
def write_vectors(tank, pose, task, b, out):
    """Write the commanded heading; the way to the obstacle, the longer the nearer; its velocity. Zero without one."""
    out[b, 0] = task.heading[b]
    out[b, 1] = out[b, 2] = vec3(0.0, 0.0, 0.0)
    if task.present[b]:
        way = task.obstacle[b] - pose.centre[b]
        distance = sqrt(dot(way, way))
        gap = max(distance / tank.length - task.radius, 0.0)
        out[b, 1] = way / (distance * (1.0 + gap))  # (54)
        out[b, 2] = task.velocity[b] / tank.length


@kernel
def write_terms(tank, pose, task, b, terms):
    """Write the reward as for commanded turns and the cost of touching the obstacle; move the obstacle."""
    turns.write_terms(tank, pose, task, b, terms)
    update_obstacle(tank, pose, task, b)
    terms[3, b] = -task.touch_penalty if task.over[b] else 0.0


@kernel
def update_obstacle(tank, pose, task, b):
    """Move the obstacle, or let it appear if it is due, and measure how near it comes to the fish."""
    # It stands `gap` body lengths of water ahead of the nose, on the line half way between where the fish points and
    # where it is told to; a drifting one would be there when a cruising fish arrives.
    task.time[b] += task.interval
    if task.present[b]:
        task.obstacle[b] += task.interval * task.velocity[b]
    elif task.time[b] >= task.appears[b] - 1e-9:
        task.present[b] = True
        forward, heading = pose.axes[b, FORWARD], task.heading[b]
        fx, fy = forward.x + heading.x, forward.y + heading.y
        if math.hypot(fx, fy) < 0.1:  # the command is to turn right round
            fx, fy = forward.x, forward.y
        size = max(math.hypot(fx, fy), 1e-9)
        along, across = vec3(fx / size, fy / size, 0.0), vec3(-fy / size, fx / size, 0.0)
        ahead = task.gap[b] + task.radius
        left = task.aside[b] * task.radius - task.drift[b] * ahead / CRUISE
        task.obstacle[b] = tank.position[b, INDEX(tank.nose)] + tank.length * (ahead * along + left * across)
        task.velocity[b] = (tank.length * task.drift[b]) * across
    if task.present[b]:
        nearest = np.inf
        for i in range(tank.mass.size):
            way = tank.position[b, i] - task.obstacle[b]
            nearest = min(nearest, dot(way, way))
        room = sqrt(nearest) / tank.length - task.radius
        task.clearance[b] = min(task.clearance[b], room)
        if room <= 0.0:
            task.over[b] = True


class AvoidTask(CommandedTurns):
    """Keep to the commanded heading; when a sphere appears ahead, or sweeps in from the side, get past it untouched.

    In some episodes a turn is commanded shortly before, so that the sphere appears in the middle of it. Touching the
    sphere ends the episode.

    Args:
        radius: of the sphere, body lengths.
        gap: water between the nose and the sphere when it appears (for a sweeping one: where it will be when the fish
            would meet it), body lengths, a number or a pair (lowest, highest).
        aside: largest distance of its centre from the fish's line, as a part of its radius, either side.
        drift: speed of a sweeping sphere, body lengths per second, a number or a pair; the side is drawn.
        sweeping: chance that the sphere sweeps in from the side instead of standing still.
        turning: chance that a turn is commanded before.
        angle: size of that turn, rad, a number or a pair.
        wait: time from the start until the sphere appears, s, a number or a pair.
        weights: of the reward, such as `touch_penalty`: keys of `weights`.

    Raises:
        ValueError: for a number out of range, saying what is allowed.
    """

    weights = {
        "alignment_weight": ALIGNMENT_WEIGHT,
        "effort_weight": rewards.EFFORT_WEIGHT,
        "touch_penalty": TOUCH_PENALTY,
    }
    term_names = ("progress", "alignment", "effort", "touch")
    episode_steps = 300
    settable = ("gap", "aside", "drift", "sweeping", "turning", "angle", "wait", *weights)
    write_vectors, write_terms = write_vectors, write_terms
    directions = (
        *CommandedTurns.directions,
        Direction("obstacle's nearness", "1 / (1 + gap in body lengths), towards it, in the body frame", 1.0, 0.3),
        Direction("obstacle's velocity", "body lengths/s, in the body frame", DRIFT.high, 1.0),
    )
    reset_options = {**POSE_OPTIONS, "turn": ANGLE_SIGNED, "wait": WAIT, "gap": GAP, "aside": ASIDE_SIGNED,
                     "drift": DRIFT_SIGNED}  # fmt: skip

    def __init__(self, radius: float = 0.3, gap=(0.6, 1.5), aside: float = 0.5, drift=(0.3, 1.0), sweeping: float = 0.5,
                 turning: float = 0.5, angle=(np.pi / 6, np.pi / 2), wait=(1.0, 2.0), **weights):  # fmt: skip
        super().__init__(**weights)
        self.radius = RADIUS.checked("radius", radius)
        self.gap = GAP.checked_range("gap", gap)
        self.aside = ASIDE.checked("aside", aside)
        self.drift = DRIFT.checked_range("drift", drift)
        self.sweeping = CHANCE.checked("sweeping", sweeping)
        self.turning = CHANCE.checked("turning", turning)
        self.angle = ANGLE.checked_range("angle", angle)
        self.wait = WAIT.checked_range("wait", wait)

    def fields(self):
        """Data that the kernels read and write."""
        b = len(self._before)
        self._appears, self._gap, self._aside, self._drift = (np.zeros(b) for _ in range(4))
        self.obstacle, self.obstacle_velocity = (np.zeros((b, 3)) for _ in range(2))
        self.present, self.touched = (np.zeros(b, dtype=bool) for _ in range(2))
        self.clearance, self._time = (np.zeros(b) for _ in range(2))
        return super().fields() | {
            "appears": self._appears, "gap": self._gap, "aside": self._aside, "drift": self._drift,
            "obstacle": Vectors(self.obstacle, Kind(1)), "velocity": Vectors(self.obstacle_velocity, Kind(1)),
            "present": self.present, "over": self.touched, "clearance": self.clearance, "time": self._time,
            "radius": float(self.radius),
        }  # fmt: skip

    def draw_turns(self, i, generator, options):
        """Draw when the sphere appears, where, how fast it drifts, and whether a turn is under way then."""
        self._appears[i] = options.get("wait", generator.uniform(*self.wait))
        self._gap[i] = options.get("gap", generator.uniform(*self.gap))
        self._aside[i] = options.get("aside", generator.uniform(-self.aside, self.aside))
        sweeping, turning = generator.random(2) < (self.sweeping, self.turning)
        drift = generator.uniform(*self.drift) * generator.choice([-1.0, 1.0])
        self._drift[i] = options.get("drift", drift * sweeping)
        turn, lead = generator.uniform(*self.angle) * generator.choice([-1.0, 1.0]), generator.uniform(*LEAD)
        self.course.count[i] = int(options["turn"] != 0.0 if "turn" in options else turning)
        self.course.angle[i, 0] = options.get("turn", turn)
        self.course.wait[i, 0] = max(0.0, self._appears[i] - lead)
        self.present[i] = self.touched[i] = False
        self.obstacle[i] = self.obstacle_velocity[i] = self._time[i] = 0.0
        self.clearance[i] = np.inf

    def spheres(self, i) -> np.ndarray:
        """For pictures of fish i: centre of the obstacle, m, and its radius, body lengths, (1,4); (0,4) without one."""
        return np.array([[*self.obstacle[i], self.radius]])[: int(self.present[i])]

    def metrics(self, tank: Tank, i, seconds):
        """Metrics of the obstacle: avoided, passed, and the heading recovered; the rest as for commanded turns."""
        found = super().metrics(tank, i, seconds)
        avoided = bool(self.present[i] and not self.touched[i])
        passed = bool(avoided and (self._before[i] - self.obstacle[i]) @ self._heading[i] > 0.0)
        return found | {
            "success": passed and found["settled"],
            "avoided": avoided,
            "passed": passed,
            "clearance": float(self.clearance[i]) if self.present[i] else np.nan,
        }
