"""Target-v0: reach targets one after another, in the plane or in three dimensions."""

import math
from typing import Any

import numpy as np

from fish_env.kernels.compile import INDEX, kernel
from fish_env.kernels.simd import Kind, Pack, Vectors, dot, sqrt, vec3
from fish_env.physics.pose import FORWARD
from fish_env.physics.tank import Tank
from fish_env.tasks import rewards
from fish_env.tasks.base import CompiledTask
from fish_env.tasks.options import Direction, Option, check_choice, weight
from fish_env.tasks.start import POSE_OPTIONS, place

ALIGNMENT_WEIGHT = weight(1.0, "weight of pointing across the way to the target, body lengths/s")
REACH_BONUS = weight(1.0, "bonus for reaching a target, in addition to the approach, body lengths")
DRAWN = 50  # targets drawn at the start of an episode, the first again after the last

DISTANCE = Option(0.8, 5.0, "distance of a target from the fish's centre when it appears, body lengths")
BEARING = Option(0.0, np.pi, "largest angle between the fish's heading and a new target, rad")
BEARING_SIGNED = Option(-np.pi, np.pi, "bearing of the first target from the fish's heading, rad, positive to the left")
ELEVATION = Option(0.0, 1.2, "largest angle of a new target above or below the fish, rad")
ELEVATION_SIGNED = Option(-1.2, 1.2, "elevation of the first target above the fish, rad")
RADIUS = Option(0.05, 0.25, "how near the nose must come, body lengths")
PATIENCE = Option(0.5, 60.0, "time after which a target is given up, s")


@kernel
def write_vectors(tank, pose, task, b, out):
    """Write the way from the fish's centre to its target: as a unit vector, and in body lengths."""
    way = (task.target[b] - pose.centre[b]) / tank.length
    out[b, 0] = pointing(way)
    out[b, 1] = way


@kernel
def write_terms(tank, pose, task, b, terms):
    """Write the reward for approaching, pointing at and reaching the target, and effort; set the next target."""
    way = pointing(task.target[b] - pose.centre[b])
    now = gap(tank, task, b)
    hit = now <= task.radius
    terms[0, b] = task.gap[b] - now
    terms[1, b] = rewards.alignment(pose, way, b) * (task.alignment_weight * task.interval)  # (50)
    terms[2, b] = task.reach_bonus if hit else 0.0  # (52)
    terms[3, b] = rewards.effort(tank, task.effort_weight, task.interval, b)  # (48)
    task.waited[b] += task.interval
    if hit or task.waited[b] >= task.patience - 1e-9:
        if hit:
            task.reached[b] += 1
        else:
            task.missed[b] += 1
        task.waited[b] = 0.0
        forward = pose.axes[b, FORWARD]
        yaw = math.atan2(forward.y, forward.x)
        number = (task.reached[b] + task.missed[b]) % task.offers.shape[1]
        distance, bearing, elevation = task.offers[b, number, 0], task.offers[b, number, 1], task.offers[b, number, 2]
        task.target[b] = pose.centre[b] + target_offset(distance, bearing, elevation, yaw, tank.length)
        now = gap(tank, task, b)
    task.gap[b] = now


@kernel
def write_goal_terms(tank, pose, task, b, terms):
    """Write -1 while the nose is not at the only target of the episode, else 0."""
    hit = gap(tank, task, b) <= task.radius
    terms[0, b] = 0.0 if hit else -1.0
    if task.reached[b] == 0:
        task.waited[b] += task.interval
        task.reached[b] = 1 if hit else 0


@kernel
def pointing(way):
    """A vector scaled to length 1, unless it is shorter than a nanometre."""
    return way / max(sqrt(dot(way, way)), 1e-9)


@kernel
def gap(tank, task, b):
    """Distance of the nose from the target, body lengths."""
    way = tank.position[b, INDEX(tank.nose)] - task.target[b]
    return sqrt(dot(way, way)) / tank.length


@kernel
def target_offset(distance, bearing, elevation, yaw, length):
    """The way, m, to a target at a distance (body lengths), a bearing from the yaw and an elevation (rad)."""
    level = length * distance * math.cos(elevation)
    height = length * distance * math.sin(elevation)
    return vec3(level * math.cos(yaw + bearing), level * math.sin(yaw + bearing), height)


class TargetTask(CompiledTask):
    """Touch a target with the nose; then the next one appears.

    Args:
        dimensions: 2 for targets at the fish's own height, 3 for targets above and below it too.
        distance: of a new target from the fish's centre, body lengths, a number or a pair (lowest, highest).
        bearing: largest angle to either side between the fish's heading and a new target, rad.
        elevation: largest angle up or down to a new target, rad; only in three dimensions.
        radius: how near the nose must come, body lengths.
        patience: time after which a target counts as missed and the next one appears, s.
        goal_env: one target an episode, observations as a dict with goals, and the reward of their distance alone:
            then the task is a `GoalTask`.
        weights: of the reward, such as `reach_bonus`: keys of `weights`.

    Raises:
        ValueError: for a number out of range, saying what is allowed.
    """

    term_names = ("progress", "alignment", "reached", "effort")
    episode_steps = 500
    directions = (
        Direction("direction of the target", "in the body frame", 1.0, 0.3),
        Direction("way to the target", "body lengths, in the body frame", 10.0, 1.0),
    )
    touchable = True  # pictures show its spheres as targets
    write_vectors, write_terms = write_vectors, write_terms
    weights = {"alignment_weight": ALIGNMENT_WEIGHT, "reach_bonus": REACH_BONUS, "effort_weight": rewards.EFFORT_WEIGHT}
    settable: tuple[str, ...] = ("distance", "bearing", *weights)

    def __new__(cls, *_, goal_env: bool = False, **__):
        """An instance of the class for these keywords."""
        if not isinstance(goal_env, bool | np.bool_) or (goal_env and not issubclass(GoalTask, cls)):
            raise ValueError(f"goal_env is {goal_env!r}; give True or False, and False to a class made of this one")
        chosen: Any = GoalTask if goal_env else cls
        return super().__new__(chosen)

    def __init__(self, dimensions=2, distance=(1.0, 2.5), bearing=np.pi / 2, elevation=0.6, radius=0.15, patience=5.0,
                 *, goal_env: bool = False, **weights):  # fmt: skip
        super().__init__(**weights)
        self.dimensions = check_choice("dimensions", dimensions, (2, 3))
        self.distance = DISTANCE.checked_range("distance", distance)
        self.bearing = BEARING.checked("bearing", bearing)
        self.elevation = ELEVATION.checked("elevation", elevation) * (self.dimensions == 3)
        self.radius = RADIUS.checked("radius", radius)
        self.patience = PATIENCE.checked("patience", patience)
        self.reset_options = {**POSE_OPTIONS, "distance": DISTANCE, "bearing": BEARING_SIGNED}
        if dimensions == 3:
            self.reset_options["elevation"] = ELEVATION_SIGNED
            self.settable = (*self.settable, "elevation")

    def prepare(self, tank: Tank, interval):
        """Make the arrays for the fish of a tank."""
        if self.dimensions == 3 and tank.fish.flat:
            raise ValueError(f"dimensions is 3, but the {tank.fish.name!r} fish is flat; give 2 or take another body")
        b = tank.num_fish
        self.interval = interval
        self._offers = np.zeros((b, DRAWN, 3))  # distance, bearing, elevation
        self._target, self._gap, self._waited = np.zeros((b, 3)), np.zeros(b), np.zeros(b)
        self.reached, self.missed = (np.zeros(b, dtype=np.int64) for _ in range(2))
        self.pack = Pack(
            "target",
            offers=self._offers, target=Vectors(self._target, Kind(1)), gap=self._gap, waited=self._waited,
            reached=self.reached, missed=self.missed, radius=float(self.radius), patience=float(self.patience),
            interval=float(interval), over=np.zeros(b, dtype=bool), **self.weight_values(),
        )  # fmt: skip

    def start(self, tank: Tank, i, generator, options):
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
        away, bearing, elevation = offers[0]
        self._target[i] = centre + tuple(target_offset(away, bearing, elevation, yaw, tank.fish.length))
        self._gap[i] = np.linalg.norm(self._target[i] - tank.position[i, tank.fish.nose]) / tank.fish.length

    def spheres(self, i) -> np.ndarray:
        """For pictures of fish i: centre of its target, m, and how near the nose must come, body lengths, (1,4)."""
        return np.array([[*self._target[i], self.radius]])

    def metrics(self, tank: Tank, i, seconds):
        """Targets reached and missed, the part reached of those decided, and the time each took, s."""
        reached, missed = int(self.reached[i]), int(self.missed[i])
        return {
            "targets": reached,
            "missed": missed,
            "success": reached / (reached + missed) if reached + missed else 0.0,
            "time_per_target": seconds / reached if reached else np.nan,
        }


class GoalTask(TargetTask):
    """Bring the nose to the target of the episode, and keep it there: goals for hindsight experience replay.

    An observation is a dict: "observation", "achieved_goal", the place of the nose (3,), and "desired_goal", that of
    the target (3,), both in body lengths from the start, without noise and delay. The reward is -1 as long as they are
    further apart than `radius`, else 0 (Andrychowicz et al. 2017).
    """

    term_names = ("goal",)
    weights = {}
    settable = ("distance", "bearing")
    write_vectors, write_terms = write_vectors, write_goal_terms
    farthest = 1000.0  # body lengths: the bound of a goal

    def goals(self, tank: Tank) -> dict[str, np.ndarray]:
        """What is achieved and what is desired, both (B,3) float32."""
        found = {"achieved_goal": tank.position[:, tank.fish.nose], "desired_goal": self._target}
        return {
            name: np.clip(place / tank.fish.length, -self.farthest, self.farthest).astype(np.float32)
            for name, place in found.items()
        }

    def compute_reward(self, achieved_goal: np.ndarray, desired_goal: np.ndarray, info: Any = None) -> np.ndarray:
        """Reward (...) of achieved for desired goals, both (...,3); the environment has this method too."""
        apart = np.linalg.norm(np.asarray(achieved_goal, float) - np.asarray(desired_goal, float), axis=-1)
        return np.where(apart <= self.radius, 0.0, -1.0)

    def metrics(self, tank: Tank, i, seconds):
        """Whether the nose is at the target at the end, whether it was there, and when it first was, s."""
        reached = bool(self.reached[i])
        at_goal = bool(self.compute_reward(*(place[i] for place in self.goals(tank).values())) == 0.0)
        return {"success": at_goal, "reached": reached, "time_to_target": float(self._waited[i]) if reached else np.nan}
