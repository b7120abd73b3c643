"""Fish that are steered while they swim, by one batched call of a shipped policy, of motor controllers or of a gait.

It knows nothing of the page. Each fish is alone in its own water; they are only shown side by side.

Legend: B fish. Angles are rad, positive to the left.
"""

from collections import deque
from collections.abc import Callable
from typing import Any

import numpy as np

from fish_env.bodies.fitted import level_of
from fish_env.control.evaluation import Controller, gait_controller, policy_controller
from fish_env.control.gait import best_gait
from fish_env.control.policy import load_policy, shipped_policy
from fish_env.control.sequencer import scripted
from fish_env.envs import FishVectorEnv
from fish_env.lab.settings import checked_choice, checked_point
from fish_env.tasks.avoid import AvoidTask
from fish_env.tasks.rewards import wrap_angle
from fish_env.tasks.start import POSE_OPTIONS, heading_vector
from fish_env.tasks.target import TargetTask
from fish_env.tasks.turns import CommandedTurns

MOST_FISH = 64
MOST_OBSTACLES = 12
BEAT = 0.26  # s, over which headings are averaged
TURN = np.pi / 6  # one press of an arrow key
SWERVE = np.pi / 3  # of left after right, each of the two turns
BETWEEN = 0.2  # s between the two commands of left after right
APART = 1.4  # body lengths, between fish that are shown side by side
PATIENCE = 60.0  # s, after which a target that is not reached is replaced
KEPT = 500  # headings that are plotted
REACH = 100.0  # body lengths from where a fish is: a point of the page further away is not accepted


class HeadingTask(CommandedTurns):
    """A commanded heading that comes from outside at any time."""

    reset_options = POSE_OPTIONS

    def draw_turns(self, i, generator, options):
        """No turn is planned."""
        self.course.count[i] = 0

    def command(self, heading: np.ndarray) -> None:
        """Command headings (B,), rad, from the next step on."""
        self.course.heading[:] = wrap_angle(heading)
        for i, angle in enumerate(heading):
            self._heading[i] = heading_vector(angle)


class ObstacleTask(AvoidTask):
    """A commanded heading and an obstacle, both from outside."""

    command = HeadingTask.command

    def draw_turns(self, i, generator, options):
        """No turn is scheduled, and no obstacle appears without a command."""
        super().draw_turns(i, generator, options)
        self.course.count[i] = 0
        self._appears[i] = np.inf

    def put(self, i: int, point) -> None:
        """Put the obstacle of fish i, at rest, at a point (3,) m; None for no obstacle."""
        self.present[i] = point is not None
        self.obstacle[i] = 0.0 if point is None else point


class PlacedTask(TargetTask):
    """Targets from outside; when one is reached, the next one is drawn."""

    @property
    def target(self) -> np.ndarray:
        """Targets, (B,3) m: live and writable."""
        return self._target


class Waters(FishVectorEnv):
    """The environment of fish that are steered."""

    tasks = {"heading": HeadingTask, "obstacle": ObstacleTask, "target": PlacedTask}  # type: ignore[assignment]


DRIVERS: dict[str, tuple[str, str]] = {
    "policy turn": ("heading", "turn"),
    "policy left_after_right": ("heading", "left_after_right"),
    "policy swim": ("heading", "swim"),
    "policy avoid": ("obstacle", "avoid"),
    "policy target": ("target", "target"),
    "motor controllers, heading": ("heading", ""),
    "motor controllers, obstacles": ("obstacle", ""),
    "motor controllers, targets": ("target", ""),
    "gait, which nothing steers": ("heading", ""),
}
"""Who steers, to what (a key of `Waters.tasks`), and the shipped policy that does."""


def make_driver(name: str, num_fish: int) -> tuple[Waters, Controller]:
    """The environment and the controller of an entry of DRIVERS."""
    goal, task = DRIVERS[name]
    options: dict[str, Any] = {"patience": PATIENCE} if goal == "target" else {}
    policy = load_policy(shipped_policy(task)) if task else None
    if policy is not None:
        options["muscle_groups"] = policy.about["env_options"].get("muscle_groups", "muscles")
    waters = Waters(num_fish, task=goal, threads=1, autoreset_mode="Disabled", **options)
    if policy is not None:
        return waters, policy_controller(policy, waters)
    return waters, gait_controller(best_gait(level_of(waters.tank.world)), waters) if name.startswith(
        "gait"
    ) else scripted(waters)


class School:
    """B fish, 1 to MOST_FISH, that a driver, a key of DRIVERS, steers."""

    def __init__(self, driver: str = "policy turn", num_fish: int = 1):
        checked_choice(driver, DRIVERS, "driver")
        if isinstance(num_fish, bool) or not (isinstance(num_fish, int) and 1 <= num_fish <= MOST_FISH):
            raise ValueError(f"number of fish is {num_fish!r}; give a whole number from 1 to {MOST_FISH}")
        self.driver, self.goal, self.num_fish = driver, DRIVERS[driver][0], num_fish
        self.waters, self.controller = make_driver(driver, num_fish)
        self.fish, self.task = self.waters.tank.fish, self.waters.task
        self.messages: deque[str] = deque(maxlen=20)
        columns = int(np.ceil(np.sqrt(num_fish)))
        place = np.stack(np.divmod(np.arange(num_fish), columns), axis=1) - (0.0, 0.5 * (columns - 1))
        self.offset = APART * self.fish.length * np.column_stack([-place[:, 0], place[:, 1], np.zeros(num_fish)])
        """Offset at which each fish is shown, from its position in its own water, (B,3) m."""
        self.obstacles: list[np.ndarray] = []
        """Centres of the obstacles where they are shown, (3,) m each."""
        self.reset()

    @property
    def interval(self) -> float:
        """Time of an environment step, s."""
        return self.waters.control_interval

    @property
    def radius(self) -> float:
        """Radius of an obstacle, or of a target (to which the nose must come), m."""
        return getattr(self.task, "radius", 0.0) * self.fish.length

    def reset(self) -> None:
        """Start again: all fish at rest along x, with commanded headings along x."""
        self.waters.reset(seed=0, options={"yaw": 0.0})
        self.clock = self.time = 0.0
        self.commanded, self.facing = np.zeros(self.num_fish), np.zeros(self.num_fish)
        self._past: deque[np.ndarray] = deque(maxlen=round(BEAT / self.interval))
        self._planned: list[tuple[float, Callable[[], None]]] = []
        self.history: deque[tuple[float, float, float]] = deque(maxlen=KEPT)
        """Time, s, mean heading of the first fish over a beat and its command, rad, both counted on beyond pi."""
        self._before = self.waters.tank.position.copy()
        self._send_commands()

    @property
    def heading(self) -> np.ndarray:
        """Mean heading of each fish over the last beat, (B,) rad, counted on beyond pi."""
        return np.mean(self._past, axis=0) if self._past else self.facing

    def turn(self, angle: float) -> None:
        """Change the commanded heading of all fish by an angle, rad; ValueError unless it is at most half a turn."""
        if not (isinstance(angle, int | float) and abs(angle) <= np.pi):
            raise ValueError(f"angle is {angle!r}; give a number from -pi to pi, rad")
        self._planned = []
        self.commanded = self.commanded + float(angle)
        self._send_commands()

    def left_after_right(self) -> None:
        """Command a turn to the right, and before it is complete one to the left of where each fish then points."""
        self.turn(-SWERVE)

        def left() -> None:
            self.commanded = self.facing + SWERVE
            self._send_commands()

        self._planned = [(self.time + BETWEEN, left)]

    def put(self, point) -> None:
        """Put the target, or one more obstacle, at a point (3,) m of the picture; ValueError if it cannot be."""
        near = np.abs(self.shown_positions().mean(axis=1)).max()
        point = checked_point(point, REACH * self.fish.length + float(near))
        if isinstance(self.task, PlacedTask):
            self.task.target[:] = point - self.offset
        elif isinstance(self.task, ObstacleTask):
            self.obstacles = [*self.obstacles, point][-MOST_OBSTACLES:]
        else:
            raise ValueError(f"{self.driver!r} observes neither targets nor obstacles; choose one that does")

    def clear(self) -> None:
        """Take all obstacles away."""
        self.obstacles = []

    def advance(self, seconds: float) -> None:
        """Move on by a part of a second, by whole environment steps."""
        self.clock += seconds
        while self.time + self.interval <= self.clock + 1e-9:
            self._step()

    def _step(self) -> None:
        for due, act in list(self._planned):
            if self.time >= due - 1e-9:
                self._planned = []
                act()
        self._assign_obstacles()
        self._before = self.waters.tank.position.copy()
        action = self.controller(self.waters.observe(), self.time)
        self.waters.advance(np.broadcast_to(action, (self.num_fish, *np.shape(action)[-1:])))
        self.time += self.interval
        yaw = np.array([self.waters.step_info(i)["heading"] for i in range(self.num_fish)])
        self.facing = self.facing + wrap_angle(yaw - self.facing)
        self._past.append(self.facing)
        self.history.append((self.time, float(self.heading[0]), float(self.aim()[0])))
        failed = ~self.waters.tank.alive
        if failed.any():
            self.messages.append(
                f"{failed.sum()} fish failed ({self.waters.tank.failure[failed][0]}). All begin again."
            )
            self.reset()

    def aim(self) -> np.ndarray:
        """Direction of each fish's goal, (B,) rad: the commanded heading, or the direction of its target."""
        if not isinstance(self.task, PlacedTask):
            return self.commanded
        way = self.task.target - self.waters.tank.position.mean(axis=1)
        return self.facing + wrap_angle(np.arctan2(way[:, 1], way[:, 0]) - self.facing)

    def _assign_obstacles(self) -> None:
        """Give every fish the obstacle that is nearest to it."""
        if not isinstance(self.task, ObstacleTask):
            return
        centre = self.waters.tank.position.mean(axis=1) + self.offset
        for i in range(self.num_fish):
            away = [float(np.linalg.norm(point - centre[i])) for point in self.obstacles]
            self.task.put(i, self.obstacles[int(np.argmin(away))] - self.offset[i] if away else None)

    def _send_commands(self) -> None:
        if isinstance(self.task, HeadingTask | ObstacleTask):
            self.task.command(self.commanded)

    def shown_positions(self) -> np.ndarray:
        """Positions at which the nodes are shown, (B,N,3) m: interpolated between the last two environment steps."""
        part = np.clip((self.clock - self.time) / self.interval, 0.0, 1.0)
        now = self.waters.tank.position
        return self._before + part * (now - self._before) + self.offset[:, None]

    def targets(self) -> np.ndarray:
        """Positions at which targets are shown, (K,3) m."""
        return self.task.target + self.offset if isinstance(self.task, PlacedTask) else np.zeros((0, 3))

    def close(self) -> None:
        """End its threads."""
        self.waters.close()
