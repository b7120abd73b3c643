"""Fish that are steered while they swim, by one batched call of a policy, of motor controllers, of a gait, or by hand.

Each fish is alone in its own water; they are only shown side by side.

Legend: B fish. Angles are rad, positive to the left.
"""

from collections import deque
from collections.abc import Callable
from typing import Any

import numpy as np

from fish_env.bodies.fitted import level_of
from fish_env.control.evaluation import gait_controller, policy_controller
from fish_env.control.gait import best_gait
from fish_env.control.policy import load_policy, shipped_policy
from fish_env.control.sequencer import scripted
from fish_env.envs import FishVectorEnv
from fish_env.lab.measures import most_strained, spring_strain
from fish_env.lab.stage import Control, Plot, Pointer, Stage, muscle_names, sliders
from fish_env.scene.frame import Arrow, Body, Frame, command_arrows
from fish_env.scene.look import look_of
from fish_env.tasks.avoid import AvoidTask
from fish_env.tasks.rewards import wrap_angle
from fish_env.tasks.start import POSE_OPTIONS, heading_vector
from fish_env.tasks.target import TargetTask
from fish_env.tasks.turns import CommandedTurns

MOST_FISH, MOST_OBSTACLES = 64, 12
FEW, LEVELS = 4, 1  # fish up to which skins are fine; subdivisions of the skins of more
BEAT = 0.26  # s, over which headings are averaged
TURN = np.pi / 6  # one press of an arrow key
SWERVE, BETWEEN = np.pi / 3, 0.2  # left after right: each of the two turns, and s between their commands
AWAY = np.pi / 2  # the commanded turn of a fast start
APART = 1.4  # body lengths, between fish that are shown side by side
PATIENCE = 60.0  # s, after which a target that is not reached is replaced
NEAR = 0.6  # body lengths: a pointer that is nearer to a fish gives no direction
FILMED = 20.0  # s that are kept for a film


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
    "policy for turns": ("heading", "turn"),
    "policy for abrupt turns": ("heading", "left_after_right"),
    "policy for fast starts": ("heading", "fast_start"),
    "policy for speed": ("heading", "swim"),
    "policy for obstacles": ("obstacle", "avoid"),
    "policy for targets": ("target", "target"),
    "motor controllers": ("heading", ""),
    "motor controllers, obstacles": ("obstacle", ""),
    "motor controllers, targets": ("target", ""),
    "best gait, cannot steer": ("heading", ""),
    "you, muscle by muscle": ("heading", ""),
}
"""Who steers, to what (a key of `Waters.tasks`), and the shipped policy that does."""
GAIT, YOU = "best gait, cannot steer", "you, muscle by muscle"


class Swimmers(Stage):
    """B fish, 1 to MOST_FISH, that a driver, a key of DRIVERS, steers; `follow`: whether to where the pointer is."""

    follows = True

    def __init__(self, title, hint, driver="policy for turns", num_fish=1, follow=True):
        self.title, self.hint, self.follow, self.version = title, hint, follow, 0
        self.show = {"skin": True, "springs": False}
        self.plots = [Plot("heading (degrees)", ["heading", "command"]), Plot("speed (lengths/s)", ["speed"])]
        self.choose(driver, num_fish)

    def choose(self, driver: str, num_fish: int) -> None:
        """Have so many fish, and somebody who steers them."""
        goal, task = DRIVERS[driver]
        policy = load_policy(shipped_policy(task)) if task else None
        groups = policy.about["env_options"].get("muscle_groups", "muscles") if policy else "muscles"
        given: dict[str, Any] = {"patience": PATIENCE} if goal == "target" else {}
        waters = Waters(num_fish, task=goal, threads=1, autoreset_mode="Disabled", muscle_groups=groups, **given)
        self.by_hand = np.zeros(waters.tank.fish.num_muscles)
        if policy is not None:
            self.controller = policy_controller(policy, waters)
        elif driver == YOU:
            self.controller = lambda obs, time: (2.0 * self.by_hand - 1.0).astype(np.float32)
        elif driver == GAIT:
            self.controller = gait_controller(best_gait(level_of(waters.tank.world)), waters)
        else:
            self.controller = scripted(waters)
        self.driver, self.goal, self.num_fish, self.waters = driver, goal, num_fish, waters
        self.fish, self.task, self.interval = waters.tank.fish, waters.task, waters.control_interval
        self.looks = [look_of(self.fish, *([] if num_fish <= FEW else [LEVELS]))]
        columns = int(np.ceil(np.sqrt(num_fish)))
        place = np.stack(np.divmod(np.arange(num_fish), columns), axis=1) - (0.0, 0.5 * (columns - 1))
        self.offset = APART * self.fish.length * np.column_stack([-place[:, 0], place[:, 1], np.zeros(num_fish)])
        """Offset at which each fish is shown, from its position in its own water, (B,3) m."""
        self.distance = 2.6 + 1.5 * APART * (np.sqrt(num_fish) - 1.0)
        self.films, self.version = num_fish == 1, self.version + 1
        self.reset()

    def reset(self) -> None:
        """Start again: all fish at rest along x, with commanded headings along x, and no obstacles."""
        self.waters.reset(seed=0, options={"yaw": 0.0})
        self.due = self.time = 0.0
        self.failure, self.failed, self.goal_point = "", (-1, -1), None
        self.commanded, self.facing = np.zeros(self.num_fish), np.zeros(self.num_fish)
        self.obstacles: list[np.ndarray] = []
        """Centres of the obstacles where they are shown, (3,) m each."""
        self._past: deque[np.ndarray] = deque(maxlen=round(BEAT / self.interval))
        self._planned: tuple[float, Callable[[], None]] | None = None
        self._before = self.waters.tank.position.copy()
        self._states: deque[tuple] = deque(maxlen=round(FILMED / self.interval))
        self._path: deque[np.ndarray] = deque(maxlen=300)
        self._send_commands()

    @property
    def heading(self) -> np.ndarray:
        """Mean heading of each fish over the last beat, (B,) rad, counted on beyond pi."""
        return np.mean(self._past, axis=0) if self._past else self.facing

    def turn(self, angle: float) -> None:
        """Change the commanded heading of all fish by an angle, rad, from where they head if the pointer led them."""
        if self.goal_point is not None:
            self.commanded = self.heading.copy()
        self._planned, self.goal_point = None, None
        self.commanded = self.commanded + angle
        self._send_commands()

    def left_after_right(self) -> None:
        """Command a turn to the right, and before it is complete one to the left of where each fish then points."""
        self.turn(-SWERVE)

        def left() -> None:
            self.commanded = self.facing + SWERVE
            self._send_commands()

        self._planned = (self.time + BETWEEN, left)

    def fast_start(self) -> None:
        """Begin again at rest, with a sudden command to get away to the left."""
        self.reset()
        self.turn(AWAY)

    def point(self, pointer: Pointer) -> None:
        """Lead the fish to where the pointer is, or put a target or an obstacle there on a click."""
        point = pointer.point * (1.0, 1.0, 0.0)
        if pointer.phase == "start" and isinstance(self.task, PlacedTask):
            self.task.target[:] = point - self.offset
        elif pointer.phase == "start" and isinstance(self.task, ObstacleTask):
            self.obstacles = [*self.obstacles, point][-MOST_OBSTACLES:]
        elif self.follow and self.goal == "heading" and pointer.phase != "end":
            self.goal_point, self._planned = point, None

    def step(self) -> None:
        """Move on by an environment step."""
        if self._planned and self.time >= self._planned[0] - 1e-9:
            act, self._planned = self._planned[1], None
            act()
        self._follow()
        self._assign_obstacles()
        tank = self.waters.tank
        self._before = tank.position.copy()
        action = self.controller(self.waters.observe(), self.time)
        self.waters.advance(np.broadcast_to(action, (self.num_fish, *np.shape(action)[-1:])))
        self.time += self.interval
        self.due = max(self.due, self.time)
        yaw = np.array([self.waters.step_info(i)["heading"] for i in range(self.num_fish)])
        self.facing = self.facing + wrap_angle(yaw - self.facing)
        self._past.append(self.facing)
        self._path.append(self._centres()[0])
        if self.num_fish == 1:
            self._states.append((tank.position[0].copy(), tank.velocity[0].copy(), self._contraction()[0],
                                 heading_vector(self.aim()[0]), self._spheres().copy()))  # fmt: skip
        lost = np.flatnonzero(~tank.alive)
        if lost.size:
            springs, first = self.fish.body.springs, lost[0]
            strain = spring_strain(springs, tank.rest_length[first], tank.position[first])
            reason, self.failed = str(tank.failure[first]), (int(first), most_strained(springs.nodes, strain))
            self.failure = f"{lost.size} of {self.num_fish} fish failed after {self.time:.2f} s: {reason}"

    def _follow(self) -> None:
        """Command the direction of the pointer, unless it is at the fish."""
        if self.goal_point is None:
            return
        way = self.goal_point - self._centres()
        far = np.hypot(way[:, 0], way[:, 1]) > NEAR * self.fish.length
        aim = self.facing + wrap_angle(np.arctan2(way[:, 1], way[:, 0]) - self.facing)
        self.commanded = np.where(far, aim, self.commanded)
        self._send_commands()

    def _centres(self) -> np.ndarray:
        return self.waters.tank.position.mean(axis=1) + self.offset

    def _contraction(self) -> np.ndarray:
        return np.clip(self.waters.tank.contraction, 0.0, 1.0)

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
        for i, centre in enumerate(self._centres()):
            away = [float(np.linalg.norm(point - centre)) for point in self.obstacles]
            self.task.put(i, self.obstacles[int(np.argmin(away))] - self.offset[i] if away else None)

    def _send_commands(self) -> None:
        if isinstance(self.task, HeadingTask | ObstacleTask):
            self.task.command(self.commanded)

    def shown_positions(self) -> np.ndarray:
        """Positions at which the nodes are shown, (B,N,3) m: interpolated between the last two environment steps."""
        part = np.clip((self.due - self.time) / self.interval, 0.0, 1.0)
        now = self.waters.tank.position
        return self._before + part * (now - self._before) + self.offset[:, None]

    # For the page

    def _spheres(self) -> np.ndarray:
        """Targets and obstacles, (S,4): m, and radii in lengths."""
        if isinstance(self.task, PlacedTask):
            points = self.task.target + self.offset
        else:
            points = np.reshape(self.obstacles, (-1, 3))
        return np.column_stack([points, np.full(len(points), getattr(self.task, "radius", 0.0))])

    def frame(self) -> Frame:
        """Every fish with where it is to go, targets and obstacles, and the path of a single fish."""
        x, contraction, touchable = self.shown_positions(), self._contraction(), self.goal == "target"
        spheres, arrows = self._spheres(), list[Arrow]()
        for i, (centre, aim) in enumerate(zip(x.mean(axis=1), self.aim(), strict=True)):
            arrows += command_arrows(centre, heading_vector(aim), self.length, spheres[i : i + 1], touchable)
        return Frame(
            [Body(self.looks[0], *each) for each in zip(x, contraction, strict=True)], x.mean(axis=(0, 1)), arrows,
            path=np.reshape(list(self._path)[::4] if self.num_fish == 1 else [], (-1, 3)), spheres=spheres,
            touchable=touchable, floor=-0.5 * self.length, show=self.shown(), time=self.time,
        )  # fmt: skip

    def readings(self) -> list[list[float]]:
        """Heading and command of the first fish, and its speed."""
        velocity = self.waters._pose.velocity[0]
        return [np.degrees([self.heading[0], self.aim()[0]]).tolist(), [float(np.linalg.norm(velocity)) / self.length]]

    def controls(self) -> list[Control]:
        """Those of the fish, its driver, and what is shown."""
        found, steered, choose = [], self.driver not in (GAIT, YOU), self.choose
        if self.goal != "target" and steered:
            found += [
                Control("button", "left", "Left 30°", lambda _: self.turn(TURN), key="ArrowLeft"),
                Control("button", "right", "Right 30°", lambda _: self.turn(-TURN), key="ArrowRight"),
                Control("button", "left_after_right", "Left after right", lambda _: self.left_after_right(), key="l",
                        help="commands a right turn, and a left one before it is complete"),
            ]  # fmt: skip
        if self.goal == "heading" and steered:
            found += [
                Control("button", "fast_start", "Fast start", lambda _: self.fast_start(), key="f",
                        help="begins again at rest, with a command to get away to the left"),
                Control("switch", "follow", "Follow the pointer", self._set_follow, value=self.follow, default=True),
            ]  # fmt: skip
        if self.goal == "obstacle":
            found.append(Control("button", "clear", "Take obstacles away", lambda _: self.obstacles.clear()))
        found += [
            Control("choice", "driver", "Steered by", lambda value: choose(value, self.num_fish), "Fish", self.driver,
                    "policy for turns", options=list(DRIVERS)),
            Control("slider", "fish", "Number of fish", lambda value: choose(self.driver, int(value)), "Fish",
                    self.num_fish, 1, 1, MOST_FISH, 1, help="all by one call of the policy"),
            *(sliders(muscle_names(self.fish), self.by_hand) if self.driver == YOU else []),
        ]  # fmt: skip
        return found + self.view_controls()

    def _set_follow(self, on: bool) -> None:
        self.follow, self.goal_point = on, None

    def film(self) -> dict[str, str]:
        """The last seconds of a single fish as a film that turns in 3-D: name and text of a page."""
        from fish_env.control.film import FilmData, FilmEpisode, page_text

        if self.num_fish > 1 or len(self._states) < 2:
            raise ValueError("a film shows one fish that has swum; choose one fish, and let it swim")
        x, velocity, contraction, command, spheres = (list(part) for part in zip(*self._states, strict=True))
        most, share = max(map(len, spheres)), self.fish.body.mass / self.fish.body.mass.sum()
        filled = [np.concatenate([s, np.zeros((most - len(s), 4))]) for s in spheres]
        centre, way = (np.einsum("n,tnk->tk", share, np.array(part)) for part in (x, velocity))
        episode = FilmEpisode(
            "from the laboratory", self.interval, self.interval * np.arange(len(x)), self.fish.points(np.array(x)),
            centre, np.linalg.norm(way, axis=1) / self.length, np.array(contraction), np.array(command),
            np.reshape(filled, (len(x), most, 4)), np.zeros(len(x)), "",
        )  # fmt: skip
        film = FilmData(self.fish, self.goal == "target", self.goal, {}, [episode])
        return {"name": "fish.html", "text": page_text(film)}

    def close(self) -> None:
        """End its threads."""
        self.waters.close()
