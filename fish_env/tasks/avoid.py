"""Avoid-v0: a sphere appears ahead, perhaps in the middle of a turn; pass it untouched and come back to the heading."""

import numpy as np

from fish_env._jit import njit
from fish_env.tasks.options import Direction, Option
from fish_env.tasks.start import POSE_OPTIONS
from fish_env.tasks.turns import ANGLE, ANGLE_SIGNED, WAIT, CommandedTurns

ALIGNMENT_WEIGHT = 2.0  # body lengths a second, as for turns, but a detour must not cost too much
TOUCH_PENALTY = 5.0  # body lengths: what touching the obstacle costs

CHANCE = Option(0.0, 1.0, "chance of it")
RADIUS = Option(0.05, 1.0, "radius of the obstacle, body lengths")
GAP = Option(0.2, 5.0, "water between the nose and the obstacle where they would meet, body lengths")
ASIDE = Option(0.0, 1.0, "largest distance of the obstacle from the fish's line, as a part of its radius")
ASIDE_SIGNED = Option(-1.0, 1.0, "distance of the obstacle to the left of the fish's line, as a part of its radius")
DRIFT = Option(0.0, 3.0, "speed of the obstacle, body lengths per second")
DRIFT_SIGNED = Option(-3.0, 3.0, "speed of the obstacle to the left, body lengths per second")
LEAD = (0.1, 0.4)  # s before the obstacle appears at which a turn is commanded
CRUISE = 2.0  # body lengths a second: the speed of the fish for which a sweeping obstacle is aimed


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

    Raises:
        ValueError: for a number out of range, saying what is allowed.
    """

    alignment_weight = ALIGNMENT_WEIGHT
    term_names = ("progress", "alignment", "effort", "touch")
    directions = (
        *CommandedTurns.directions,
        Direction("obstacle's nearness", "1 / (1 + gap in body lengths), towards it, in the body frame", 1.0, 0.3),
        Direction("obstacle's velocity", "body lengths/s, in the body frame", DRIFT.high, 1.0),
    )
    reset_options = {
        **POSE_OPTIONS,
        "turn": ANGLE_SIGNED,
        "wait": WAIT,
        "gap": GAP,
        "aside": ASIDE_SIGNED,
        "drift": DRIFT_SIGNED,
    }

    def __init__(
        self,
        radius: float = 0.3,
        gap=(0.6, 1.5),
        aside: float = 0.5,
        drift=(0.3, 1.0),
        sweeping: float = 0.5,
        turning: float = 0.5,
        angle=(np.pi / 6, np.pi / 2),
        wait=(1.0, 2.0),
    ):
        self.radius = RADIUS.checked("radius", radius)
        self.gap = GAP.checked_range("gap", gap)
        self.aside = ASIDE.checked("aside", aside)
        self.drift = DRIFT.checked_range("drift", drift)
        self.sweeping = CHANCE.checked("sweeping", sweeping)
        self.turning = CHANCE.checked("turning", turning)
        self.angle = ANGLE.checked_range("angle", angle)
        self.wait = WAIT.checked_range("wait", wait)

    def prepare(self, tank, interval):
        """Make the arrays for the fish of a tank."""
        super().prepare(tank, interval)
        b = tank.num_fish
        self._appears, self._gap, self._aside, self._drift = np.zeros((4, b))
        self.obstacle, self.obstacle_velocity = np.zeros((2, b, 3))
        self.present, self.touched = np.zeros((2, b), dtype=bool)
        self.clearance, self._time = np.zeros((2, b))
        self._vectors = np.zeros((b, 3, 3))

    def plan(self, i, generator, options):
        """When the sphere appears, where, how fast it drifts, and whether a turn is under way then."""
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

    def vectors(self, tank, pose):
        """Commanded heading; towards the obstacle, the longer the nearer; its velocity. Zero while there is none."""
        see(
            pose.centre, self._heading, self.obstacle, self.obstacle_velocity, self.present, self.radius,
            tank.fish.length, self._vectors,
        )  # fmt: skip
        return self._vectors

    def spheres(self, i) -> np.ndarray:
        """For pictures of fish i: centre of the obstacle, m, and its radius, body lengths, (1,4); (0,4) without one."""
        return np.array([[*self.obstacle[i], self.radius]])[: int(self.present[i])]

    def reward(self, tank, pose):
        """As for commanded turns, less what touching the obstacle costs; then the obstacle moves or appears."""
        terms = super().reward(tank, pose)
        loom(
            tank.position, pose.axes, self._heading, tank.fish.nose, tank.fish.length, self.radius, self.interval,
            self._appears, self._gap, self._aside, self._drift, self._time, self.obstacle, self.obstacle_velocity,
            self.present, self.touched, self.clearance,
        )  # fmt: skip
        terms["touch"] = self.touched * -TOUCH_PENALTY
        return terms

    def done(self, tank, pose):
        """True where the obstacle is touched."""
        return self.touched

    def metrics(self, tank, i, seconds):
        """Whether the obstacle was avoided and passed and the heading found again; the rest as for commanded turns."""
        found = super().metrics(tank, i, seconds)
        avoided = bool(self.present[i] and not self.touched[i])
        passed = bool(avoided and (self._before[i] - self.obstacle[i]) @ self._heading[i] > 0.0)
        return found | {
            "success": passed and found["settled"],
            "avoided": avoided,
            "passed": passed,
            "clearance": float(self.clearance[i]) if self.present[i] else np.nan,
        }


@njit
def see(centre, heading, obstacle, drift, present, radius, length, out):
    """Fill out (B,3,3): commanded heading, towards the obstacle by 1 / (1 + gap), and its velocity, body lengths/s."""
    for b in range(present.size):
        out[b, 0] = heading[b]
        out[b, 1:] = 0.0
        if present[b]:
            way = obstacle[b] - centre[b]
            distance = np.sqrt(way[0] ** 2 + way[1] ** 2 + way[2] ** 2)
            gap = max(distance / length - radius, 0.0)
            for k in range(3):
                out[b, 1, k] = way[k] / (distance * (1.0 + gap))  # (44)
                out[b, 2, k] = drift[b, k] / length


@njit
def loom(x, axes, heading, nose, length, radius, interval, appears, gap, aside, drift,
         time, obstacle, velocity, present, touched, clearance):  # fmt: skip
    """Move every obstacle, let those appear that are due, and measure how near each comes to its fish x (B,N,3) m.

    The obstacle stands `gap` body lengths of water ahead of the nose, on the line half way between where the fish
    points and where it is told to; a drifting one would be there when a cruising fish arrives.
    """
    for b in range(time.size):
        time[b] += interval
        if present[b]:
            for k in range(3):
                obstacle[b, k] += interval * velocity[b, k]
        elif time[b] >= appears[b] - 1e-9:
            present[b] = True
            fx, fy = axes[b, 0, 0] + heading[b, 0], axes[b, 0, 1] + heading[b, 1]
            if np.hypot(fx, fy) < 0.1:  # it is told to turn right round
                fx, fy = axes[b, 0, 0], axes[b, 0, 1]
            size = max(np.hypot(fx, fy), 1e-9)
            fx, fy = fx / size, fy / size
            ahead, left = gap[b] + radius, aside[b] * radius
            left -= drift[b] * ahead / CRUISE
            obstacle[b, 0] = x[b, nose, 0] + length * (ahead * fx - left * fy)
            obstacle[b, 1] = x[b, nose, 1] + length * (ahead * fy + left * fx)
            obstacle[b, 2] = x[b, nose, 2]
            velocity[b, 0], velocity[b, 1], velocity[b, 2] = -length * drift[b] * fy, length * drift[b] * fx, 0.0
        if present[b]:
            nearest = np.inf
            for i in range(x.shape[1]):
                square = 0.0
                for k in range(3):
                    square += (x[b, i, k] - obstacle[b, k]) ** 2
                nearest = min(nearest, square)
            room = np.sqrt(nearest) / length - radius
            clearance[b] = min(clearance[b], room)
            if room <= 0.0:
                touched[b] = True
