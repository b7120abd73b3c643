"""Tu's motor controllers one after another, by what the fish observes: a baseline without learning for every task.

Legend: b fish. Angles are positive to the left, rad; times are seconds.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any, NamedTuple

import numpy as np

from fish_env.bodies.fitted import level_of
from fish_env.control import motor
from fish_env.control.motor import MotorTables
from fish_env.envs import FishVectorEnv, Layout
from fish_env.tasks.avoid import AvoidTask
from fish_env.tasks.fast_start import FastStartTask
from fish_env.tasks.rewards import wrap_angle
from fish_env.tasks.swim import SwimTask
from fish_env.tasks.target import TargetTask
from fish_env.tasks.turns import CommandedTurns


class Aim(NamedTuple):
    """Directions and speeds that B fish aim at, in their own frames."""

    error: np.ndarray  # (B,) rad, angle from where they point to where they are to go
    climb: np.ndarray  # (B,) rad, the same upwards
    speed: np.ndarray  # (B,) wanted, body lengths per second


AimFunction = Callable[[np.ndarray], Aim]
"""observations (B,D) -> `Aim`"""


@dataclass(frozen=True)
class SequencerConfig:
    """When the sequencer begins a turn, and how it corrects small errors."""

    threshold: float = np.radians(22.0)
    """Mean heading error from which a turn is begun, rad; smaller ones are corrected while swimming."""
    chain_threshold: float = np.radians(40.0)
    """Heading error at the end of a turn's hold from which the next turn begins at once, without straightening, rad."""
    command_jump: float = np.radians(20.0)
    """Change of the error between two environment steps that only a new command can cause, rad."""
    lead: float = 0.12
    """Time over which the turning of a fish that must break off a turn is extrapolated, s."""
    trim: float = 2.5
    """Contraction, per rad of mean error, added to one side of the anterior segments while swimming."""
    max_trim: float = 2.5
    """Largest such contraction."""
    strokes: float = 0.3
    """Least part of swimming's strokes that continues in a turn: 0 takes the table's, 1 maintains the speed."""
    beat: float = 0.26
    """Time over which the error is averaged, s: about a beat."""
    pitch: float = 1.0
    """Contraction, per rad of climb, added to the upper (or lower) muscles."""
    max_pitch: float = 0.6
    """Largest such contraction."""


class Sequencer:
    """Runs swim-, turn- and glide-MC one after another, from nothing but the observation and the time.

    Its memory has a row for each fish: the errors of the last beat, the turn under way and the clocks of the strokes.
    It is cleared by a call with time 0.

    Args:
        env: the environment that it is to act in.
        aim: from observations (B,D) to an `Aim`.
        tables: of the motor controllers.
        config: when turns begin, and how small errors are corrected.
    """

    def __init__(self, env: FishVectorEnv, aim: AimFunction, tables: MotorTables, config: SequencerConfig):
        fish = env.tank.fish
        self.aim, self.tables, self.config, self.interval = aim, tables, config, env.control_interval
        self.muscle = env.first_muscle_of_group
        self.can_pitch = self.muscle.size == fish.num_muscles  # pairs contract above and below together
        self.fish, self.level = fish, np.where(fish.heights > 0, 0, 1)
        self.window = max(1, round(config.beat / self.interval))

    def __call__(self, obs: np.ndarray, time: float) -> np.ndarray:
        """Actions (B,A) for observations (B,D) at `time` s."""
        aim = self.aim(obs)
        if time == 0:
            self.reset(aim.error)
        self.record_error(aim.error)
        self.decide(aim.error)
        return 2.0 * self.contract(aim)[:, self.muscle] - 1.0

    def reset(self, error: np.ndarray) -> None:
        """Clear the memory: the fish swim, and have seen the error (B,) for a beat."""
        b = error.size
        self.last, self.rate = error.copy(), np.zeros(b)
        self.errors = np.repeat(error[:, None], self.window, axis=1)
        self.jumped, self.turning = np.zeros((2, b), dtype=bool)
        self.rows = self.tables.turns.at(np.zeros(b))
        self.side, self.since = np.ones(b), np.full(b, np.inf)
        self.beats = np.zeros((b, 2))

    def record_error(self, error: np.ndarray) -> None:
        """Record the error (B,); a jump of it is a new command, by which the errors of the beat are shifted."""
        change = wrap_angle(error - self.last)
        self.jumped = np.abs(change) > self.config.command_jump
        self.rate = np.where(self.jumped, self.rate, change / self.interval)
        self.errors += np.where(self.jumped, change, 0.0)[:, None]
        self.errors = np.column_stack([self.errors[:, 1:], error])
        self.last = error

    def mean_error(self) -> np.ndarray:
        """Heading error averaged over a beat, (B,) rad."""
        return wrap_angle(self.last + wrap_angle(self.errors - self.last[:, None]).mean(axis=1))

    def decide(self, error: np.ndarray) -> None:
        """Begin and end turns: when the error is large, when a new command comes, when one is over."""
        more = np.abs(error) > self.config.chain_threshold  # a successive turn follows at once, without straightening
        over = self.turning & (self.since >= self.rows[:, 5] + self.rows[:, 6] * ~more - 1e-9)
        self.errors[over] = error[over, None]  # what was seen in the turn no longer counts
        self.turning &= ~over
        broken = self.turning & self.jumped
        wanted = np.where(broken, wrap_angle(error + self.config.lead * self.rate), self.mean_error())
        self.turning &= ~broken
        self.begin_turns(~self.turning & (np.abs(wanted) > self.config.threshold), wanted)

    def begin_turns(self, which: np.ndarray, wanted: np.ndarray) -> None:
        """Begin a turn by `wanted` (B,) rad, or by as much of it as the table has, for the fish of the mask (B,)."""
        turns = self.tables.turns
        rows = motor.scaled_turns(turns, np.minimum(np.abs(wanted), turns.values[-1, 0]))
        side = np.sign(wanted)
        self.rows = np.where(which[:, None], rows, self.rows)
        self.side = np.where(which, side, self.side)
        self.since = np.where(which, 0.0, self.since)
        self.turning |= which
        start = rows[:, 7] + 0.25 * (1.0 - side)  # a right turn is the mirror image: half a beat later
        self.beats = np.where(which[:, None], start[:, None], self.beats)

    def contract(self, aim: Aim) -> np.ndarray:
        """Contraction of every muscle at the end of the coming interval, (B,M) in [0, 1]."""
        config = self.config
        swims = self.tables.swims.at(aim.speed)
        swims[self.turning] = self.tables.swims.values[-1]
        self.since += self.interval
        self.beats += self.interval * swims[:, (2, 4)]
        bend, part = motor.turn_mc(self.rows, self.side, self.since)
        part = np.maximum(part, config.strokes)
        trim = np.clip(config.trim * self.mean_error(), -config.max_trim, config.max_trim) * ~self.turning
        pairs = bend + part[:, None, None] * motor.swim_mc(self.tables, swims, self.beats)
        pairs[:, :2, 0] += np.maximum(trim, 0.0)[:, None]
        pairs[:, :2, 1] += np.maximum(-trim, 0.0)[:, None]
        pairs[(aim.speed <= 0.0) & ~self.turning] = 0.0  # glide-MC: every muscle relaxed
        pitch = np.clip(config.pitch * aim.climb, -config.max_pitch, config.max_pitch) * self.can_pitch
        lift = np.maximum(np.stack([pitch, -pitch], axis=1), 0.0)
        return np.clip(motor.spread(self.fish, pairs) + lift[:, self.level], 0.0, 1.0)


class FastStartSequencer(Sequencer):
    """Glides until it is told where to; then a C-start, then as the sequencer; ValueError for tables without."""

    def __init__(self, env: FishVectorEnv, aim: AimFunction, tables: MotorTables, config: SequencerConfig):
        if tables.starts is None:
            raise ValueError(
                "the tables of the motor controllers have no fast starts; search them: python -m benchmarks.calibrate"
            )
        self.starts: motor.Table = tables.starts
        super().__init__(env, aim, tables, config)

    def reset(self, error: np.ndarray) -> None:
        """Clear the memory: the fish wait for a command."""
        super().reset(error)
        self.commanded = np.zeros(error.size, dtype=bool)
        self.start, self.start_side = self.starts.at(np.zeros(error.size)), np.ones(error.size)
        self.elapsed = np.full(error.size, np.inf)

    def contract(self, aim: Aim) -> np.ndarray:
        """Contraction of every muscle at the end of the coming interval, (B,M) in [0, 1]."""
        usual = super().contract(aim)
        new = ~self.commanded & (aim.speed > 0.0)
        self.commanded |= new
        self.start = np.where(new[:, None], self.starts.at(np.abs(aim.error)), self.start)
        self.start_side = np.where(new, np.where(aim.error < 0.0, -1.0, 1.0), self.start_side)
        self.elapsed = np.where(new, 0.0, self.elapsed) + self.interval
        pairs, going = motor.start_mc(self.start, self.start_side, self.elapsed)
        self.turning &= ~going  # what it has seen until now is no reason to turn
        self.errors[going] = aim.error[going, None]
        phase = self.start[:, 9] + 0.25 * (1.0 - self.start_side)  # the mirror image: half a beat later
        self.beats = np.where(going[:, None], phase[:, None], self.beats)
        return np.where(going[:, None], motor.spread(self.fish, pairs), usual)


def bearing(vector: np.ndarray) -> np.ndarray:
    """Angle (B,) rad of vectors (B,3) from straight ahead, positive to the left."""
    return np.arctan2(vector[:, 1], vector[:, 0])


def climb(vector: np.ndarray) -> np.ndarray:
    """Pitch (B,) rad with which fish point along vectors (B,3); 0 for vectors abeam or behind: turn first."""
    size = np.linalg.norm(vector, axis=1) + 1e-9
    return np.arcsin(vector[:, 2] / size) * np.clip(vector[:, 0] / size, 0.0, 1.0)


def aim_heading(obs: np.ndarray, layout: Layout) -> Aim:
    """Aim at the commanded heading, as fast as possible."""
    wanted = layout.read(obs, "commanded heading").astype(float)
    return Aim(bearing(wanted), climb(wanted), np.full(len(obs), np.inf))


def aim_start(obs: np.ndarray, layout: Layout) -> Aim:
    """Aim at the commanded heading, as fast as possible, and glide while there is none."""
    commanded = np.linalg.norm(layout.read(obs, "commanded heading").astype(float), axis=1) > 0.5
    return aim_heading(obs, layout)._replace(speed=np.where(commanded, np.inf, 0.0))


def aim_velocity(obs: np.ndarray, layout: Layout, mass: np.ndarray, gain: float = 2.0) -> Aim:
    """Aim at the commanded velocity; `mass` (L,) of the landmarks. Fish that are too slow swim faster."""
    wanted = layout.read(obs, "commanded velocity").astype(float)
    speed = np.linalg.norm(wanted, axis=1)
    if layout.observation == "sensors":
        own = layout.read(obs, "body velocity").astype(float)
    else:
        own = mass @ layout.read(obs, "velocity").astype(float) / mass.sum()
    along = (own * wanted).sum(axis=1) / speed
    return Aim(bearing(wanted), climb(wanted), np.maximum(speed + gain * (speed - along), 0.0))


def aim_target(obs: np.ndarray, layout: Layout, dimensions: int, ahead: float = 0.65) -> Aim:
    """Aim at the target from a point up to `ahead` body lengths in front of the fish, which swims while it turns."""
    way = layout.read(obs, "way to the target").astype(float)
    nearer = way.copy()
    nearer[:, 0] -= ahead * np.clip(np.abs(bearing(way)) / (np.pi / 2), 0.0, 1.0)
    return Aim(bearing(nearer), climb(way) * (dimensions == 3), np.full(len(obs), np.inf))


@dataclass(frozen=True)
class ObstacleMargins:
    """Margins with which an obstacle is passed."""

    radius: float  # of the obstacle, body lengths
    room: float = 0.35  # least distance of its surface from the line on which the fish's centre will pass
    speed: float = 1.8  # at which the fish is assumed to swim on, body lengths per second
    horizon: float = 1.2  # s, over which the nearest approach is predicted


COURSES = np.radians(np.arange(-105.0, 106.0, 15.0))  # rad off the commanded heading, from which one is chosen


def aim_past(obs: np.ndarray, layout: Layout, margins: ObstacleMargins) -> Aim:
    """Along the course nearest to the commanded heading that passes the obstacle; the heading itself without one."""
    # For each of the COURSES the nearest approach of a fish that swims straight on to an obstacle that drifts on is
    # predicted; a course that is too near costs the more the nearer it passes.
    commanded = layout.read(obs, "commanded heading").astype(float)
    heading, near, drift = (
        layout.read(obs, name).astype(float)[:, None, :2]
        for name in ("commanded heading", "obstacle's nearness", "obstacle's velocity")
    )  # (B,1,2)
    nearness = np.hypot(*np.moveaxis(near, -1, 0))  # (B,1)
    seen = nearness > 0
    safe = np.where(seen, nearness, 1.0)
    way = near / safe[..., None] * (1.0 / safe - 1.0 + margins.radius)[..., None]
    course = np.arctan2(heading[..., 1], heading[..., 0]) + COURSES  # (B,K)
    closing = margins.speed * np.stack([np.cos(course), np.sin(course)], axis=-1) - drift
    when = np.clip((way * closing).sum(-1) / np.maximum((closing**2).sum(-1), 1e-9), 0.0, margins.horizon)
    miss = np.linalg.norm(way - closing * when[..., None], axis=-1)
    short = np.maximum(margins.radius + margins.room - miss, 0.0) * seen
    cost = np.abs(COURSES) + 0.3 * np.abs(wrap_angle(course)) + 20.0 * short
    best = course[np.arange(len(obs)), np.where(seen[:, 0], cost.argmin(axis=1), COURSES.size // 2)]
    return Aim(wrap_angle(best), climb(commanded), np.full(len(obs), np.inf))


SEQUENCERS: dict[type, tuple[SequencerConfig, Callable[[Any, Any], Callable[..., Aim]]]] = {
    TargetTask: (SequencerConfig(pitch=2.0), lambda env, task: partial(aim_target, dimensions=task.dimensions)),
    AvoidTask: (SequencerConfig(), lambda env, task: partial(aim_past, margins=ObstacleMargins(task.radius))),
    SwimTask: (
        SequencerConfig(trim=0.8),
        lambda env, task: partial(aim_velocity, mass=env.tank.fish.landmarks.mass) if task.speed else aim_heading,
    ),
    FastStartTask: (SequencerConfig(), lambda env, task: aim_start),
    CommandedTurns: (SequencerConfig(), lambda env, task: aim_heading),  # of which some of the others are, too
}
"""The best settings for each task, tried by hand on episodes of neither training nor evaluation; what it aims at."""


def scripted(env: FishVectorEnv, tables: MotorTables | None = None, config: SequencerConfig | None = None) -> Sequencer:
    """The sequenced motor controllers for the task of an environment, as a controller (`evaluation.Controller`).

    Args:
        env: the environment that it is to act in.
        tables: of the motor controllers; None for those of the default fish in water of that level.
        config: when turns begin, and how small errors are corrected; None for those of the task.

    Raises:
        ValueError: for a task that they cannot do, or a fast start with tables that have none.
    """
    kind = next((kind for kind in SEQUENCERS if isinstance(env.task, kind)), None)
    if kind is None:
        names = ", ".join(sorted(cls.__name__ for cls in SEQUENCERS))
        raise ValueError(f"no motor controllers for the task {type(env.task).__name__}; they can do {names}")
    standard, aim_of = SEQUENCERS[kind]
    aim = partial(aim_of(env, env.task), layout=env.layout)
    make = FastStartSequencer if kind is FastStartTask else Sequencer
    tables = motor.load_tables(water=level_of(env.tank.world)) if tables is None else tables
    return make(env, aim, tables, standard if config is None else config)


def random_actions(env: FishVectorEnv, seed: int = 0) -> Callable[[np.ndarray, float], np.ndarray]:
    """A controller that draws every action uniformly from the whole range, whatever the fish sees."""
    generator = np.random.default_rng(seed)

    def act(obs: Any, time: float) -> np.ndarray:
        count = len(obs["observation"] if isinstance(obs, dict) else obs)  # `env` may be one fish of a batch
        return generator.uniform(-1.0, 1.0, (count, *env.single_action_space.shape))

    return act
