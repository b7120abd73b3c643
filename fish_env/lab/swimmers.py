"""Fish that are steered while they swim, by one batched call of a policy, of motor controllers, of a gait, or by hand.

Each fish is alone in its own water; they are only shown side by side.

Legend: B fish. Angles are rad, positive to the left.
"""

from collections import deque
from collections.abc import Sequence
from typing import Any

import numpy as np

from fish_env.bodies.fitted import level_of
from fish_env.control.env_spec import environment_of, make_checked_batch
from fish_env.control.evaluation import Controller, as_controller, environment_for, gait_controller, policy_controller
from fish_env.control.film import FilmData, FilmEpisode, page_text
from fish_env.control.gait import best_gait
from fish_env.control.policy import Policy, load_policy, shipped_policy
from fish_env.control.sequencer import scripted
from fish_env.envs import FishVectorEnv
from fish_env.lab.scene import Control, Scene
from fish_env.scene.frame import Body, Frame, make_frame
from fish_env.scene.look import look_of
from fish_env.scene.skin import LEVELS
from fish_env.tasks.avoid import AvoidTask
from fish_env.tasks.rewards import wrap_angle
from fish_env.tasks.start import POSE_OPTIONS, heading_vector
from fish_env.tasks.target import TargetTask
from fish_env.tasks.turns import MEAN_TIME, CommandedTurns

MOST_FISH = 64
FEW = 4  # fish up to which skins are fine
TURN = np.pi / 6  # one press of an arrow key
SWERVE, BETWEEN = np.pi / 3, 0.12  # left after right: each of the two turns, and s between their commands
AWAY = np.pi / 2  # the commanded turn of a fast start
APART = 1.4  # body lengths, between fish that are shown side by side
PATIENCE = 60.0  # s, after which a target that is not reached is replaced
NEAR = 0.6  # body lengths: a pointer that is nearer to a fish gives no direction
FILMED = 20.0  # s that are kept for a film


class FishScene(Scene):
    """B fish of an environment, which a controller steers, or by default a slider for every action."""

    start: dict[str, float] | None = None  # options of a reset

    def use(self, env: FishVectorEnv, controller: Controller | None = None) -> None:
        """Show the fish of an environment."""
        self.env, self.tank, self.fish, self.interval = env, env.tank, env.tank.fish, env.control_interval
        self.task: Any = env.task
        self.slider_values = np.zeros(env.single_action_space.shape)
        self.sliders = controller is None
        self.controller = controller or (lambda obs, time: (2.0 * self.slider_values - 1.0).astype(np.float32))
        self.looks = [look_of(self.fish, LEVELS if env.num_envs <= FEW else 1)]
        columns = int(np.ceil(np.sqrt(env.num_envs)))
        place = np.stack(np.divmod(np.arange(env.num_envs), columns), axis=1) - (0.0, 0.5 * (columns - 1))
        self.offset = APART * self.fish.length * np.column_stack([-place[:, 0], place[:, 1], np.zeros(env.num_envs)])
        """Offset at which each fish is shown, from its position in its own water, (B,3) m."""
        self.show = {"skin": True, "springs": False}
        self.reset()

    def reset(self) -> None:
        """Begin the first episode again."""
        self.env.reset(seed=0, options=self.start)
        self.due = self.time = self.since = self.reward = 0.0
        self.failure = self.note = ""
        self._before, self._path = self._state(), deque[np.ndarray](maxlen=300)

    def step(self) -> None:
        """Move on by an environment step."""
        self._before = self._state()
        action = self.controller(self.env.observe(), self.since)
        reward, *self.over = self.act(np.broadcast_to(action, (self.env.num_envs, *np.shape(action)[-1:])))
        self.reward, self.since, self.time = float(reward[0]), self.since + self.interval, self.time + self.interval
        self.due = max(self.due, self.time)
        self._path.append(self.env._pose.centre[0].copy())

    def act(self, action: np.ndarray) -> Sequence[np.ndarray]:
        """Rewards (B,) of an environment step, and which episodes have been terminated and truncated, (B,)."""
        return self.env.advance(action)

    def _state(self) -> tuple[np.ndarray, np.ndarray]:
        """Positions (B,N,3) m and contractions (B,M) of all fish."""
        return self.tank.position.copy(), np.clip(self.tank.contraction, 0.0, 1.0)

    def speed(self) -> float:
        """Speed of the first fish, BL/s."""
        return float(np.linalg.norm(self.env._pose.velocity[0])) / self.length

    def frame(self) -> Frame:
        """Every fish, between its last two environment steps, its command, target or obstacle, and the path of one."""
        ahead = 1.0 - np.clip((self.due - self.time) / self.interval, 0.0, 1.0)
        moved, contracted = (ahead * (then - now) for then, now in zip(self._before, self._state(), strict=True))
        ways = self.offset[:, None] + moved
        found = [make_frame(self.env, i, look=self.looks[0]) for i in range(self.env.num_envs)]
        bodies, arrows, spheres = [], [], []
        for each, way, change, offset in zip(found, ways, contracted, self.offset, strict=True):
            look, x, contraction, tone = each.bodies[0]
            bodies.append(Body(look, x + way, contraction + change, tone))
            arrows += [arrow._replace(start=arrow.start + way.mean(axis=0)) for arrow in each.arrows]
            spheres.append(each.spheres + np.append(offset, 0.0))
        return found[0]._replace(
            bodies=bodies, middle=np.mean([body.position.mean(axis=0) for body in bodies], axis=0), arrows=arrows,
            spheres=np.unique(np.concatenate(spheres).round(9), axis=0),
            path=np.reshape(list(self._path)[::4] if len(found) == 1 else [], (-1, 3)),
        )  # fmt: skip

    def controls(self) -> list[Control]:
        """A slider for every action, if there is no controller, and what is shown."""
        if not self.sliders:
            return super().controls()
        names = [
            f"{'left' if side > 0 else 'right'}, segment {segment + 1}, {'upper' if height > 0 else 'lower'}"
            for side, segment, height in zip(self.fish.sides, self.fish.segments, self.fish.heights, strict=True)
        ]
        values = self.slider_values
        names = names if len(names) == values.size else [f"action {m}" for m in range(values.size)]
        found = [
            Control("slider", f"muscle {m}", name, lambda value, m=m: values.__setitem__(m, value), "Muscles",
                    float(values[m]), 0.0)
            for m, name in enumerate(names)
        ]  # fmt: skip
        return found + super().controls()

    def close(self) -> None:
        """End its threads."""
        self.env.close()


class HeadingTask(CommandedTurns):
    """A commanded heading, which the scene sets."""

    reset_options = POSE_OPTIONS

    def draw_turns(self, i, generator, options):
        """No turn is scheduled."""
        self.course.count[i] = 0


class ObstacleTask(AvoidTask):
    """A commanded heading and an obstacle, which the scene sets."""

    def draw_turns(self, i, generator, options):
        """No turn is scheduled, and no obstacle appears."""
        super().draw_turns(i, generator, options)
        self.course.count[i] = 0
        self._appears[i] = np.inf


class SteeredEnv(FishVectorEnv):
    """The environment of fish that are steered."""

    tasks = {"heading": HeadingTask, "obstacle": ObstacleTask, "target": TargetTask}  # type: ignore[assignment]


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
"""Who steers, to what (a key of `SteeredEnv.tasks`), and the shipped policy that does."""
GAIT, YOU = "best gait, cannot steer", "you, muscle by muscle"


class SwimmerScene(FishScene):
    """Up to MOST_FISH fish that a driver, a key of DRIVERS, steers; `follow`: whether to where the pointer is."""

    follows, start = True, {"yaw": 0.0}
    plots = {"heading (degrees)": ["heading", "command"], "speed (BL/s)": ["speed"]}

    def __init__(self, title, hint, driver="policy for turns", num_fish=1, follow=True):
        self.title, self.hint, self.follow = title, hint, follow
        self.choose(driver, num_fish)

    def choose(self, driver: str, num_fish: int) -> None:
        """Have so many fish, and somebody who steers them."""
        self.driver, (self.goal, shipped), self.films = driver, DRIVERS[driver], num_fish == 1
        policy = load_policy(shipped_policy(shipped)) if shipped else None
        groups = policy.about["env_options"].get("muscle_groups", "muscles") if policy else "muscles"
        given: dict[str, Any] = {"patience": PATIENCE} if self.goal == "target" else {}
        env = SteeredEnv(num_fish, task=self.goal, threads=1, muscle_groups=groups, panel=False, **given)
        if policy is not None:
            controller = policy_controller(policy, env)
        elif driver == GAIT:
            controller = gait_controller(best_gait(level_of(env.tank.world)), env)
        else:
            controller = None if driver == YOU else scripted(env)
        self.use(env, controller)

    def reset(self) -> None:
        """Start again: all fish at rest along x, with commanded headings along x, and no obstacles."""
        super().reset()
        self.goal_point, self.left_at = None, np.inf
        self.commanded = np.zeros(self.env.num_envs)
        self._yaws: deque[np.ndarray] = deque([self.facing], maxlen=round(MEAN_TIME / self.interval))
        self._states: deque[tuple] = deque(maxlen=round(FILMED / self.interval))

    @property
    def facing(self) -> np.ndarray:
        """Directions in which the fish point, (B,) rad."""
        return np.array([self.env.step_info(i)["heading"] for i in range(self.env.num_envs)])

    def turn(self, angle: float) -> None:
        """Change the commanded heading of all fish by an angle, rad."""
        self.commanded, self.goal_point, self.left_at = self.commanded + angle, None, np.inf

    def left_after_right(self) -> None:
        """Command a turn to the right, and before it is complete one to the left of where each fish then points."""
        self.turn(-SWERVE)
        self.left_at = self.time + BETWEEN

    def fast_start(self) -> None:
        """Begin again at rest, with a sudden command to get away to the left."""
        self.reset()
        self.turn(AWAY)

    def point(self, phase: str, point: np.ndarray, body: int) -> None:
        """Lead the fish to where the pointer is, or put a target or an obstacle there on a click."""
        point = point * (1.0, 1.0, 0.0)
        if phase == "start" and self.goal == "target":
            self.task._target[:] = point - self.offset
        elif phase == "start" and self.goal == "obstacle":
            self.task.present[:], self.task.obstacle[:] = True, point - self.offset
        elif self.follow and self.goal == "heading" and phase != "end":
            self.goal_point, self.left_at = point, np.inf

    def step(self) -> None:
        """Move on by an environment step, under present commands."""
        self._command()
        super().step()
        self._yaws.append(self.facing)
        if self.films:
            frame = make_frame(self.env, look=self.looks[0])
            body = frame.bodies[0]
            self._states.append((self.fish.points(body.position), frame.middle, frame.speed, body.contraction,
                                 self.env._vectors[0, 0].copy(), frame.spheres))  # fmt: skip
        lost = np.flatnonzero(~self.tank.alive)
        if lost.size:
            reason = self.tank.failure[lost[0]]
            self.failure = f"{lost.size} of {self.env.num_envs} fish failed after {self.time:.2f} s: {reason}"

    def _command(self) -> None:
        """Command the second turn if it is due, or the direction of the pointer."""
        if self.time >= self.left_at - 1e-9:
            self.commanded, self.left_at = self.facing + SWERVE, np.inf
        if self.follow and self.goal_point is not None:  # one that is at a fish gives no direction
            way = self.goal_point - self.env._pose.centre - self.offset
            far = np.hypot(way[:, 0], way[:, 1]) > NEAR * self.length
            self.commanded = np.where(far, np.arctan2(way[:, 1], way[:, 0]), self.commanded)
        if self.goal != "target":
            self.task.course.heading[:] = wrap_angle(self.commanded)
            self.task._heading[:] = [heading_vector(angle) for angle in self.commanded]

    def readings(self) -> list[list[float]]:
        """Mean heading of the first fish over a beat, the command nearest to it, degrees, and its speed."""
        heading = float(np.angle(np.exp(1j * np.array(self._yaws)).mean(axis=0))[0])
        x, y, _ = self.env._vectors[0, 0]
        return [np.degrees([heading, heading + wrap_angle(np.arctan2(y, x) - heading)]).tolist(), [self.speed()]]

    def controls(self) -> list[Control]:
        """Those of the fish, its driver, and what is shown."""
        found, steered, choose, count = [], self.driver not in (GAIT, YOU), self.choose, self.env.num_envs
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
                Control("switch", "follow", "Follow the pointer", lambda on: setattr(self, "follow", on),
                        value=self.follow, default=True),
            ]  # fmt: skip
        return [
            *found,
            Control("choice", "driver", "Steered by", lambda value: choose(value, count), "Fish", self.driver,
                    "policy for turns", options=list(DRIVERS)),
            Control("slider", "fish", "Number of fish", lambda value: choose(self.driver, int(value)), "Fish", count,
                    1, 1, MOST_FISH, 1, help="all by one call of the policy"),
            *super().controls(),
        ]  # fmt: skip

    def film(self) -> dict[str, str]:
        """The last seconds of a single fish as a film that turns in 3-D: name and text of a page."""
        if len(self._states) < 2:
            raise ValueError("a film shows one fish that has swum; choose one fish, and let it swim")
        *parts, spheres = zip(*self._states, strict=True)
        points, centre, speed, contraction, command = map(np.array, parts)
        filled = np.zeros((len(points), max(map(len, spheres)), 4))
        for row, each in zip(filled, spheres, strict=True):
            row[: len(each)] = each
        episode = FilmEpisode(
            "from the laboratory", self.interval, self.interval * np.arange(len(points)), points, centre, speed,
            contraction, command, filled, np.zeros(len(points)), "",
        )  # fmt: skip
        film = FilmData(self.fish, self.goal == "target", self.goal, {}, [episode])
        return {"name": "fish.html", "text": page_text(film)}


class UserScene(FishScene):
    """One fish in an environment of the user, episode after episode; raises what making the environment raises."""

    hint = "Episodes follow one another. Without a policy, every muscle has a slider."
    plots = {"reward of a step": ["reward"], "speed (BL/s)": ["speed"]}

    def __init__(self, task: str | None, policy: Policy | None):
        if policy is not None and task in (None, policy.about.get("env_id")):
            name, options = environment_for(policy, {})
        else:
            name, options = environment_of({"env_id": task})
        env = make_checked_batch(name, options, 1)
        self.title = f"Your own: {name}"
        self.use(env, None if policy is None else as_controller(policy, env))

    def act(self, action: np.ndarray) -> Sequence[np.ndarray]:
        """Act as `FishScene.act`; the next episode begins in the step that ends one."""
        _, *found, self.infos = self.env.step(action)
        return found

    def step(self) -> None:
        """Move on by an environment step."""
        super().step()
        if any(ended[0] for ended in self.over):
            reason = np.ravel(self.infos.get("final_info", {}).get("failure", [""]))[0]
            self.note = f"An episode ended after {self.time:.1f} s. {reason}".strip()
            self.since, self._before = 0.0, self._state()
            self._path.clear()

    def readings(self) -> list[list[float]]:
        """Reward and speed."""
        return [[self.reward], [self.speed()]]
