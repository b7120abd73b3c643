"""Find the tables of the motor controllers (`fish_env/control/motor.py`) for the default fish.

A fish at cruise is turned at each phase of its beat, since it yaws with every stroke. The search (CMA-ES) minimises the
time to 90 % of the angle, the error of the mean heading afterwards, the overshoot, the way lost and the tilt, averaged
over the phases and over angles at and between the rows of the table, so that what is read between rows is good too.
The search of the fast starts maximises what is made good along the command in episodes of FastStart-v0, on average over
directions and speeds at the start.
"""

from collections.abc import Callable
from dataclasses import asdict, replace
from itertools import product
from typing import NamedTuple

import numpy as np
from tqdm import tqdm

from benchmarks.calibration.keep import kept, publish, rounded
from benchmarks.common.search import minimise
from fish_env import Tank, make_fish
from fish_env.bodies.fitted import read_calibration
from fish_env.control import MotorTables, best_gait, scripted
from fish_env.control.motor import MOTOR_FILE, Start, Swim, Table, Turn, scaled_turns, spread, swim_mc, turn_mc
from fish_env.envs import FishVectorEnv
from fish_env.physics.tank_options import whole_steps

BETWEEN = (22.0, 30.0, 37.5, 45.0, 52.5, 60.0, 75.0, 90.0)  # degrees, at which the search of turns tries its table
SPEEDS = (0.25, 0.5, 1.0, 1.5, 2.0)  # body lengths a second, rows of swimming's table between rest and the gait
PHASES = 13  # control intervals in a beat
WARM, AFTER, SETTLE = 75, 60, 26  # control intervals: until the turn, from then on, the last of them
NOISE = 0.1  # body lengths a second: node velocities added when a turn begins: a turn in which fish roll over shows it
GENERATIONS = 40  # of 16 tables, in each of two stages
NEVER = 1.5  # s, counted for a turn that never gets to 90 %
START_BETWEEN = (0.0, 30.0, 60.0, 90.0, 120.0, 150.0, 179.0)  # degrees, at which the search of starts tries its table
START_SPEEDS = (0.0, 1.0, 2.0)  # body lengths a second, of the glide before


class Rows(NamedTuple):
    """The rows of a table, one an angle, and how they are searched."""

    kind: type
    angles: tuple[float, ...]
    """Degrees."""
    low: list[float]
    """Least value of each number of a row but its angle."""
    high: list[float]
    steps: list[float]
    """Relative to each other."""
    first: tuple[list[float], list[float]]
    """Rows to begin with, at the smallest and at the largest angle."""

    def table(self, point: np.ndarray) -> tuple[Table, float]:
        """The table at a point of the search, and how far that lies outside of what is allowed."""
        numbers = point.reshape(len(self.angles), -1)
        inside = np.clip(numbers, self.low, self.high)
        rows = [self.kind(np.radians(angle), *row) for angle, row in zip(self.angles, inside, strict=True)]
        return Table(rows), float(np.sum((numbers - inside) ** 2))

    def search(self, cost: Callable[[Table], float], spread: float, generations: int, seed: int) -> list:
        """The best rows: first on a line between the ends, then each row on its own, changed by `spread` at first."""
        part = ((np.array(self.angles) - self.angles[0]) / (self.angles[-1] - self.angles[0]))[:, None]

        def total(point) -> float:
            table, outside = self.table(point)
            return float(cost(table) + 10 * outside)

        def on_a_line(ends) -> np.ndarray:
            low, high = np.split(ends, 2)
            return (low * (1.0 - part) + high * part).ravel()

        ends, _ = minimise(lambda ends: total(on_a_line(ends)), np.concatenate(self.first), 0.2, generations, seed,
                           CMA_stds=self.steps * 2)  # fmt: skip
        point, _ = minimise(total, on_a_line(ends), spread, generations, seed, CMA_stds=self.steps * len(self.angles))
        return list(self.table(point)[0].rows)


TURNS = Rows(  # front, middle, tail, strokes, hold, straighten and phase
    Turn, (30.0, 45.0, 60.0, 90.0), [0.0, 0.0, -1.0, 0.0, 0.02, 0.04, -9.0], [1.0, 1.0, 1.0, 1.0, 0.8, 0.6, 9.0],
    [1.0, 1.0, 1.0, 1.0, 0.3, 0.3, 0.7],
    ([0.8, 0.8, 0.2, 0.5, 0.15, 0.15, 0.0], [0.8, 0.8, 0.3, 0.5, 0.6, 0.2, 0.0]),
)  # fmt: skip
STARTS = Rows(  # front, middle, tail, bend, front_back, middle_back, tail_back, strike and phase
    Start, (0.0, 60.0, 120.0, 180.0), [0.0] * 8 + [-9.0], [1.0, 1.0, 1.0, 0.4, 1.0, 1.0, 1.0, 0.4, 9.0],
    [1.0, 1.0, 1.0, 0.3, 1.0, 1.0, 1.0, 0.3, 0.7],
    ([0.5, 0.5, 0.5, 0.06, 0.8, 0.8, 0.8, 0.08, 0.0], [0.9, 0.9, 0.9, 0.3, 0.8, 0.8, 0.8, 0.1, 0.0]),
)  # fmt: skip


def gait_tables(water: str) -> MotorTables:
    """Tables with the best open-loop gait as full speed, and no turns yet."""
    gait = best_gait(water)
    (front, r1, r2), s = gait.amplitude, gait.frequency
    swims = Table([Swim(0.0, 0.0, 0.0, 0.0, 0.0), Swim(2.0, r1, s, r2, s)])
    return MotorTables(swims, swims, front / r1, gait.lag)


class Cruise:
    """Fish at full speed, PHASES of them for each angle to be turned by, one at each phase of the beat."""

    def __init__(self, angles, water: str):
        self.fish, self.tables = make_fish(water=water), gait_tables(water)
        self.angle = np.repeat(np.radians(angles), PHASES)
        self.shape = len(angles), PHASES
        b = self.angle.size
        self.tank = Tank(self.fish, b, water=self.fish.water, threads=1)
        self.interval = self.fish.control_interval
        self.steps = whole_steps(self.interval, self.tank.dt, "control_interval")
        self.swims = np.repeat(self.tables.swims.values[-1:], b, axis=0)
        offset = np.tile(np.arange(PHASES), len(angles))
        yaws = [self.drive(swim_mc(self.tables, self.swims, self.beats(k + 1 + offset))) for k in range(WARM)]
        noise = np.random.default_rng(0).normal(0.0, NOISE * self.fish.length, self.tank.velocity.shape)
        self.tank.velocity[:] += noise
        self.start, self.heading = self.tank.get_state(), np.mean(yaws[-PHASES:], axis=0)

    def beats(self, intervals) -> np.ndarray:
        """Clocks (B,2) of the strokes after so many control intervals (B,)."""
        return np.outer(intervals * self.interval, self.swims[0, (2, 4)])

    def drive(self, pairs) -> np.ndarray:
        """A control interval with contractions (B,3,2): where the fish point then, (B,) rad."""
        self.tank.drive(np.clip(spread(self.fish, pairs), 0.0, 1.0), self.steps)
        forward = self.fish.line @ self.tank.position
        return np.arctan2(forward[:, 1], forward[:, 0])

    def tilt(self) -> np.ndarray:
        """How far the fish lie over or point up or down, (B,) degrees."""
        x, fish = self.tank.position, self.fish
        forward, left = fish.line @ x, (x[:, fish.left] - x[:, fish.right]).sum(axis=1)
        slopes = [a[:, 2] / np.linalg.norm(a, axis=1) for a in (forward, left)]
        return np.degrees(np.hypot(*slopes))

    def centre(self) -> np.ndarray:
        """Centres of mass (B,2) in body lengths."""
        mass = self.fish.body.mass
        return (mass @ self.tank.position)[:, :2] / mass.sum() / self.fish.length

    def turn(self, table: Table):
        """Turn every fish to the left: degrees turned after each interval (T,B), body lengths made good (B,)."""
        self.tank.set_state(self.start)
        rows, before, yaws = scaled_turns(table, self.angle), self.centre(), [self.heading]
        for k in range(AFTER):
            since = np.full(self.angle.size, (k + 1) * self.interval)
            bend, part = turn_mc(rows, np.ones_like(since), since)
            beats = rows[:, 7:] + since[:, None] * self.swims[:, (2, 4)]
            yaws.append(self.drive(bend + part[:, None, None] * swim_mc(self.tables, self.swims, beats)))
        way, wanted = self.centre() - before, self.heading + self.angle
        made_good = way[:, 0] * np.cos(wanted) + way[:, 1] * np.sin(wanted)
        return np.degrees(np.unwrap(yaws, axis=0)[1:] - self.heading), made_good

    def measure(self, table: Table):
        """Time to 90 % (s), mean heading change afterwards and overshoot (degrees), way made good: (angles,PHASES)."""
        turned, made_good = self.turn(table)
        wanted = np.degrees(self.angle)
        there = turned >= 0.9 * wanted
        reached = np.where(there.any(axis=0), (there.argmax(axis=0) + 1) * self.interval, NEVER)
        mean = np.lib.stride_tricks.sliding_window_view(turned, PHASES, axis=0).mean(axis=-1)
        overshoot = np.maximum(mean.max(axis=0) - wanted, 0.0)
        return [a.reshape(self.shape) for a in (reached, turned[-SETTLE:].mean(axis=0), overshoot, made_good)]

    def cost(self, table: Table) -> float:
        """What the search minimises."""
        reached, final, overshoot, made_good = self.measure(table)
        error = np.sqrt(np.mean((final - np.degrees(self.angle).reshape(self.shape)) ** 2, axis=1))
        tilt = np.sqrt(np.mean(self.tilt() ** 2))
        return np.mean(reached + 0.01 * overshoot - 0.15 * made_good) + 0.02 * error.mean() + 0.02 * tilt


class Starts:
    """Fish of FastStart-v0 that are told at once where to: one for each direction to the left and speed before."""

    def __init__(self, tables: MotorTables, water: str):
        each = list(product(np.radians(START_BETWEEN), START_SPEEDS))
        self.tables = tables
        self.env = FishVectorEnv(len(each), task="fast_start", water=water, wait=0.0, threads=1)
        for i, (angle, speed) in enumerate(each):
            options = {"yaw": 0.0, "turn": angle, "speed": speed, "reset_mask": np.arange(len(each)) == i}
            self.env.reset(seed=0, options=options)
        self.start = self.env.get_state()

    def cost(self, starts: Table) -> float:
        """What the search minimises: less for more way; a fish whose physics fails gets nowhere."""
        env, control = self.env, scripted(self.env, replace(self.tables, starts=starts))
        obs = env.set_state(self.start)
        for k in range(env.task.episode_steps - 1):  # the last step would begin the next episode
            obs, *_ = env.step(control(obs, k * env.control_interval))
        away = np.array([env.episode_info(i)["escape_distance"] for i in range(env.num_envs)], float)
        return -np.nan_to_num(away, nan=-10.0).mean()


def search_swims(water: str) -> list[Swim]:
    """Rows of swimming's table: of all amplitudes and frequencies on a grid, the least effort for each speed."""
    tables = gait_tables(water)
    full = tables.swims.values[-1]
    scale, frequency = (a.ravel() for a in np.meshgrid(np.arange(0.05, 1.01, 0.025), np.arange(1.1, full[2], 0.2)))
    swims = np.stack([0 * scale, scale * full[1], frequency, scale * full[3], frequency], axis=1)
    swims = np.vstack([swims, full])
    speed, effort = steady(tables, swims, water)
    costs = [np.where(np.abs(speed - wanted) < 0.03, effort, np.inf) for wanted in SPEEDS]
    for wanted, cost in zip(SPEEDS, costs, strict=True):
        if not np.isfinite(cost).any():
            raise RuntimeError(f"no swimming on the grid goes at {wanted} body lengths/s; make the grid finer")
    near = [cost.argmin() for cost in costs]
    rows = [Swim(speed[k], *swims[k, 1:]) for k in (*near, -1)]
    return [Swim(0.0, 0.0, rows[0].s1, 0.0, rows[0].s2), *rows]


def steady(tables, swims, water, seconds=6.0, measured=2.0):
    """Speed (B,) in body lengths per second and effort (B,) at the end of a long swim, for table rows (B,5)."""
    fish = make_fish(water=water)
    tank = Tank(fish, len(swims), water=fish.water, threads=1)
    steps, mass = whole_steps(fish.control_interval, tank.dt, "control_interval"), fish.body.mass / fish.body.mass.sum()
    effort, count = np.zeros(len(swims)), round(seconds / fish.control_interval)
    last = round(measured / fish.control_interval)
    for k in tqdm(range(count), desc="swims"):
        beats = (k + 1) * fish.control_interval * swims[:, (2, 4)]
        tank.drive(np.clip(spread(fish, swim_mc(tables, swims, beats)), 0.0, 1.0), steps)
        if k == count - last - 1:
            before = mass @ tank.position
        effort += tank.effort * (k >= count - last)
    return np.linalg.norm(mass @ tank.position - before, axis=1) / fish.length / measured, effort / last


def as_dict(row) -> dict:
    """A row of a table as it is written: angles in degrees."""
    found = asdict(row)
    return rounded(found if isinstance(row, Swim) else found | {"angle": float(np.degrees(row.angle))})


def search(water: str, generations: int, seed: int, _fish: dict, _gait: dict) -> dict:
    """Search all tables, as they are written."""
    tables = gait_tables(water)
    swims = search_swims(water)
    turns = TURNS.search(Cruise(BETWEEN, water).cost, 0.06, generations, seed)
    tables = replace(tables, turns=Table(turns), swims=Table(swims))
    # five times as many generations as for turns: starts are as much shorter, and the rows have more numbers
    starts = STARTS.search(Starts(tables, water).cost, 0.1, 5 * generations, seed)
    rows = {"turns": turns, "swims": swims, "starts": starts}
    found = {name: [as_dict(row) for row in each] for name, each in rows.items()}
    return found | {"front": round(tables.front, 4), "lag": list(tables.lag)}


def calibrate(water: str, generations=GENERATIONS, seed=1) -> None:
    """Ship the tables."""
    fish, gait = read_calibration("mass_spring", water)["parameters"], asdict(best_gait(water))
    publish(MOTOR_FILE, water, kept("motor", search, water, generations, seed, fish, gait))
