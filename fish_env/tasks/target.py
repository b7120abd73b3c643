"""Target-v0: reach targets one after another, in the plane or in three dimensions."""

import numpy as np

from fish_env._jit import njit
from fish_env.tasks import rewards
from fish_env.tasks.options import Direction, Option, checked_choice
from fish_env.tasks.start import POSE_OPTIONS, place

ALIGNMENT_WEIGHT = 1.0  # body lengths a second, the price of pointing across the way to the target
REACH_BONUS = 1.0  # body lengths: what reaching a target is worth beside the way to it
DRAWN = 50  # targets drawn at the start of an episode, the first again after the last

DISTANCE = Option(0.8, 5.0, "distance of a target from the fish's centre when it appears, body lengths")
BEARING = Option(0.0, np.pi, "largest angle between the fish's heading and a new target, rad")
BEARING_SIGNED = Option(-np.pi, np.pi, "bearing of the first target from the fish's heading, rad, positive to the left")
ELEVATION = Option(0.0, 1.2, "largest angle of a new target above or below the fish, rad")
ELEVATION_SIGNED = Option(-1.2, 1.2, "elevation of the first target above the fish, rad")
RADIUS = Option(0.05, 0.25, "how near the nose must come, body lengths")
PATIENCE = Option(0.5, 60.0, "time after which a target is given up, s")


class TargetTask:
    """Touch a target with the nose; then the next one appears.

    Args:
        dimensions: 2 for targets at the fish's own height, 3 for targets above and below it too.
        distance: of a new target from the fish's centre, body lengths, a number or a pair (lowest, highest).
        bearing: largest angle to either side between the fish's heading and a new target, rad.
        elevation: largest angle up or down to a new target, rad; only in three dimensions.
        radius: how near the nose must come, body lengths.
        patience: time after which a target counts as missed and the next one appears, s.

    Raises:
        ValueError: for a number out of range, saying what is allowed.
    """

    term_names = ("progress", "alignment", "reached", "effort")
    directions = (
        Direction("direction of the target", "in the body frame", 1.0, 0.3),
        Direction("way to the target", "body lengths, in the body frame", 10.0, 1.0),
    )
    touchable = True  # pictures show its spheres as targets

    def __init__(self, dimensions=2, distance=(1.0, 2.5), bearing=np.pi / 2, elevation=0.6, radius=0.15, patience=5.0):
        self.dimensions = checked_choice("dimensions", dimensions, (2, 3))
        self.distance = DISTANCE.checked_range("distance", distance)
        self.bearing = BEARING.checked("bearing", bearing)
        self.elevation = ELEVATION.checked("elevation", elevation) * (self.dimensions == 3)
        self.radius = RADIUS.checked("radius", radius)
        self.patience = PATIENCE.checked("patience", patience)
        self.reset_options = {**POSE_OPTIONS, "distance": DISTANCE, "bearing": BEARING_SIGNED}
        if dimensions == 3:
            self.reset_options["elevation"] = ELEVATION_SIGNED

    def prepare(self, tank, interval):
        """Make the arrays for the fish of a tank."""
        if self.dimensions == 3 and tank.fish.flat:
            raise ValueError(f"dimensions is 3, but the {tank.fish.name!r} fish is flat; give 2 or take another body")
        b = tank.num_fish
        self.interval = interval
        self._offers = np.zeros((b, DRAWN, 3))  # distance, bearing, elevation
        self._target, self._gap, self._waited = np.zeros((b, 3)), np.zeros(b), np.zeros(b)
        self.reached, self.missed = np.zeros((2, b), dtype=np.int64)
        self._never = np.zeros(b, dtype=bool)

    def start(self, tank, i, generator, options):
        """Place the fish at the origin with a random yaw, almost at rest, and draw its targets."""
        yaw = options.get("yaw", generator.uniform(-np.pi, np.pi))
        centre = place(tank, i, generator, yaw, options)
        offers = self._offers[i]
        offers[:, 0] = generator.uniform(*self.distance, DRAWN)
        offers[:, 1] = generator.uniform(-self.bearing, self.bearing, DRAWN)
        if self.dimensions == 3:
            offers[:, 2] = generator.uniform(-self.elevation, self.elevation, DRAWN)
        for k, name in enumerate(("distance", "bearing", "elevation")):
            offers[0, k] = options.get(name, offers[0, k])
        self.reached[i] = self.missed[i] = self._waited[i] = 0
        offer(offers[0], centre, yaw, tank.fish.length, self._target[i])
        self._gap[i] = np.linalg.norm(self._target[i] - tank.position[i, tank.fish.nose]) / tank.fish.length

    def vectors(self, tank, pose):
        """From the fish's centre to its target, a unit vector and the whole way in body lengths, (B,2,3)."""
        way = (self._target - pose.centre) / tank.fish.length
        return np.stack([unit(way), way], axis=1)

    def spheres(self, i) -> np.ndarray:
        """For pictures of fish i: centre of its target, m, and how near the nose must come, body lengths, (1,4)."""
        return np.array([[*self._target[i], self.radius]])

    def reward(self, tank, pose):
        """How much nearer the nose has come, pointing at the target, reaching it, less effort; then the next one."""
        way = unit(self._target - pose.centre)
        alignment = rewards.alignment(pose.axes, way) * (ALIGNMENT_WEIGHT * self.interval)  # (40)
        progress, reached = np.empty((2, tank.num_fish))
        pursue(
            tank.position[:, tank.fish.nose], pose.centre, pose.axes, tank.fish.length, self.radius, self.patience,
            self.interval, self._offers, self._target, self._gap, self._waited, self.reached, self.missed,
            progress, reached,
        )  # fmt: skip
        effort = rewards.effort(tank, self.interval)  # (20)
        return {
            "progress": progress,
            "alignment": alignment,
            "reached": REACH_BONUS * reached,
            "effort": effort,
        }  # (42)

    def done(self, tank, pose):
        """Never: the episode ends at the time limit."""
        return self._never

    def metrics(self, tank, i, seconds):
        """Targets reached and missed, the part reached of those decided, and the time each took, s."""
        reached, missed = int(self.reached[i]), int(self.missed[i])
        return {
            "targets": reached,
            "missed": missed,
            "success": reached / (reached + missed) if reached + missed else 0.0,
            "time_per_target": seconds / reached if reached else np.nan,
        }


def unit(vectors: np.ndarray) -> np.ndarray:
    """Vectors (B,3) scaled to length 1."""
    return vectors / np.maximum(np.linalg.norm(vectors, axis=1, keepdims=True), 1e-9)


@njit
def pursue(nose, centre, axes, length, radius, patience, interval, offers, target, gap, waited, reached, missed,
           progress, hit):  # fmt: skip
    """Measure how far each fish's nose (B,3) m is from its target, and put up the next target where it is due.

    gap (B,) body lengths, waited (B,) s, and the counts are updated; progress (B,) body lengths and hit (B,) 0 or 1 are
    overwritten.
    """
    for b in range(gap.size):
        now = separation(nose[b], target[b]) / length
        waited[b] += interval
        progress[b] = gap[b] - now
        hit[b] = 1.0 if now <= radius else 0.0
        if now <= radius or waited[b] >= patience - 1e-9:
            if now <= radius:
                reached[b] += 1
            else:
                missed[b] += 1
            waited[b] = 0.0
            yaw = np.arctan2(axes[b, 0, 1], axes[b, 0, 0])
            offer(offers[b, (reached[b] + missed[b]) % offers.shape[1]], centre[b], yaw, length, target[b])
            now = separation(nose[b], target[b]) / length
        gap[b] = now


@njit
def offer(polar, centre, yaw, length, target):
    """Put a target (3,) m at a distance (body lengths), bearing from the yaw and elevation (rad) from a centre."""
    distance, bearing, elevation = polar
    target[0] = centre[0] + length * distance * np.cos(elevation) * np.cos(yaw + bearing)
    target[1] = centre[1] + length * distance * np.cos(elevation) * np.sin(yaw + bearing)
    target[2] = centre[2] + length * distance * np.sin(elevation)


@njit
def separation(a, b):
    """Distance between two points (3,)."""
    return np.sqrt((a[0] - b[0]) ** 2 + (a[1] - b[1]) ** 2 + (a[2] - b[2]) ** 2)
