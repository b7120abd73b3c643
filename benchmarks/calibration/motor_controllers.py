"""Find the tables of the motor controllers (`fish_env/control/motor.py`) for the default fish, and check what they do.

    python -m benchmarks.calibration.motor_controllers --water reactive    print what turns and fast starts do

A fish at cruise is turned at each phase of its beat, since it yaws with every stroke. The search (CMA-ES) minimises the
time to 90 % of the angle, the error of the mean heading afterwards, the overshoot, the way lost and the tilt, averaged
over the phases and over angles at and between the rows of the table, so that what is read between rows is good too.
The search of the fast starts maximises what is made good along the command in episodes of FastStart-v0, on average over
directions and speeds at the start.
"""

import argparse
from dataclasses import asdict, replace
from itertools import product

import numpy as np
from tqdm import tqdm

from benchmarks.calibration.keep import kept, publish, rounded
from benchmarks.common.search import minimise
from fish_env import make_fish
from fish_env.bodies.fitted import DEFAULT_WATER, WATERS, read_calibration
from fish_env.control import MotorTables, best_gait, load_tables, scripted
from fish_env.control.motor import MOTOR_FILE, Start, Swim, Table, Turn, scaled_turns, spread, swim_mc, turn_mc
from fish_env.envs import FishVectorEnv
from fish_env.physics.tank import Tank
from fish_env.physics.tank_options import whole_steps

ANGLES = (30.0, 45.0, 60.0, 90.0)  # degrees, rows of the turns' table
BETWEEN = (22.0, 30.0, 37.5, 45.0, 52.5, 60.0, 75.0, 90.0)  # degrees, at which the search tries it
SPEEDS = (0.25, 0.5, 1.0, 1.5, 2.0)  # body lengths a second, rows of swimming's table between rest and the gait
PHASES = 13  # control intervals in a beat
WARM, AFTER, SETTLE = (
    75,
    60,
    26,
)  # control intervals: until the turn, from then on, and the last of them, for the mean heading
NOISE = 0.1  # body lengths a second: node velocities added when a turn begins: a turn in which fish roll over shows it
GENERATIONS = 40  # of 16 tables, in each of two stages
NEVER = 1.5  # s, counted for a turn that never gets to 90 %
# of a row's front, middle, tail, strokes, hold, straighten and phase: bounds, relative steps and a start of the search
LOW = np.array([0.0, 0.0, -1.0, 0.0, 0.02, 0.04, -9.0])
HIGH = np.array([1.0, 1.0, 1.0, 1.0, 0.8, 0.6, 9.0])
STEPS = np.array([1.0, 1.0, 1.0, 1.0, 0.3, 0.3, 0.7])
FIRST = np.array([0.8, 0.8, 0.2, 0.5, 0.15, 0.15, 0.0]), np.array([0.8, 0.8, 0.3, 0.5, 0.6, 0.2, 0.0])  # 30, 90
START_ANGLES = (0.0, 60.0, 120.0, 180.0)  # degrees, rows of the table of fast starts
START_BETWEEN = (0.0, 30.0, 60.0, 90.0, 120.0, 150.0, 179.0)  # degrees, at which the search tries it
START_SPEEDS = (0.0, 1.0, 2.0)  # body lengths a second, of the glide before
# of a row's front, middle, tail, bend, front_back, middle_back, tail_back, strike and phase
START_LOW, START_HIGH = np.array([0.0] * 8 + [-9.0]), np.array([1.0, 1.0, 1.0, 0.4, 1.0, 1.0, 1.0, 0.4, 9.0])
START_STEPS = np.array([1.0, 1.0, 1.0, 0.3, 1.0, 1.0, 1.0, 0.3, 0.7])
START_FIRST = (  # at 0 and 180 degrees
    np.array([0.5, 0.5, 0.5, 0.06, 0.8, 0.8, 0.8, 0.08, 0.0]),
    np.array([0.9, 0.9, 0.9, 0.3, 0.8, 0.8, 0.8, 0.1, 0.0]),
)


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

    def cost(self, point: np.ndarray) -> float:
        """What the search minimises, for the rows' numbers (28,)."""
        table, outside = turns_table(point)
        reached, final, overshoot, made_good = self.measure(table)
        error = np.sqrt(np.mean((final - np.degrees(self.angle).reshape(self.shape)) ** 2, axis=1))
        tilt = np.sqrt(np.mean(self.tilt() ** 2))
        total = np.mean(reached + 0.01 * overshoot - 0.15 * made_good) + 0.02 * error.mean() + 0.02 * tilt
        return float(total + 10 * outside)


def turns_table(point: np.ndarray) -> tuple[Table, float]:
    """The table of turns at a point (28,) of the search, and how far that lies outside of what is allowed."""
    numbers = point.reshape(len(ANGLES), -1)
    inside = np.clip(numbers, LOW, HIGH)
    rows = [Turn(np.radians(angle), *row) for angle, row in zip(ANGLES, inside, strict=True)]
    return Table(rows), float(np.sum((numbers - inside) ** 2))


def search_turns(water: str, generations: int, seed: int) -> list[Turn]:
    """Rows of the turns' table: first on a line between 30 and 90 degrees, then each row on its own."""
    cruise = Cruise(BETWEEN, water)
    part = ((np.array(ANGLES) - ANGLES[0]) / (ANGLES[-1] - ANGLES[0]))[:, None]

    def on_a_line(ends):
        return (ends[:7] * (1.0 - part) + ends[7:] * part).ravel()

    ends, _ = minimise(lambda e: cruise.cost(on_a_line(e)), np.concatenate(FIRST), 0.2, generations, seed,
                       CMA_stds=[*STEPS] * 2)  # fmt: skip
    point, _ = minimise(cruise.cost, on_a_line(ends), 0.06, generations, seed, CMA_stds=[*STEPS] * len(ANGLES))
    return list(turns_table(point)[0].rows)


class Starts:
    """Fish of FastStart-v0 that are told at once where to: one for each direction to the left and speed before."""

    def __init__(self, tables: MotorTables, water: str):
        each = list(product(np.radians(START_BETWEEN), START_SPEEDS))
        self.tables, self.shape = tables, (len(START_BETWEEN), len(START_SPEEDS))
        self.env = FishVectorEnv(len(each), task="fast_start", water=water, wait=0.0, threads=1)
        for i, (angle, speed) in enumerate(each):
            options = {"yaw": 0.0, "turn": angle, "speed": speed, "reset_mask": np.arange(len(each)) == i}
            self.env.reset(seed=0, options=options)
        self.start = self.env.get_state()

    def measure(self, starts: Table) -> dict[str, np.ndarray]:
        """Metrics of an episode with a table of fast starts, (angles,speeds) each."""
        env, control = self.env, scripted(self.env, replace(self.tables, starts=starts))
        obs = env.set_state(self.start)
        for k in range(env.task.episode_steps - 1):  # the last step would begin the next episode
            obs, *_ = env.step(control(obs, k * env.control_interval))
        found = [env.episode_info(i) for i in range(env.num_envs)]
        names = ("escape_distance", "angle_300ms", "distance_200ms", "peak_acceleration", "success")
        return {name: np.array([one[name] for one in found], float).reshape(self.shape) for name in names}

    def cost(self, point: np.ndarray) -> float:
        """What the search minimises, for the rows' numbers (36,); a fish whose physics fails gets nowhere."""
        starts, outside = starts_table(point)
        away = np.nan_to_num(self.measure(starts)["escape_distance"], nan=-10.0)
        return float(10 * outside - away.mean())


def starts_table(point: np.ndarray) -> tuple[Table, float]:
    """The table of fast starts at a point (36,) of the search, and how far that lies outside of what is allowed."""
    numbers = point.reshape(len(START_ANGLES), -1)
    inside = np.clip(numbers, START_LOW, START_HIGH)
    rows = [Start(np.radians(angle), *row) for angle, row in zip(START_ANGLES, inside, strict=True)]
    return Table(rows), float(np.sum((numbers - inside) ** 2))


def search_starts(tables: MotorTables, water: str, generations: int, seed: int) -> list[Start]:
    """Rows of the table of fast starts: first on a line between 0 and 180 degrees, then each row on its own.

    Five times as many generations as for turns: they are as much shorter, and the rows have more numbers.
    """
    generations *= 5
    starts, part = Starts(tables, water), (np.array(START_ANGLES) / START_ANGLES[-1])[:, None]

    def on_a_line(ends):
        return (ends[:9] * (1.0 - part) + ends[9:] * part).ravel()

    ends, _ = minimise(lambda e: starts.cost(on_a_line(e)), np.concatenate(START_FIRST), 0.2, generations, seed,
                       CMA_stds=[*START_STEPS] * 2)  # fmt: skip
    point, _ = minimise(starts.cost, on_a_line(ends), 0.1, generations, seed,
                        CMA_stds=[*START_STEPS] * len(START_ANGLES))  # fmt: skip
    return list(starts_table(point)[0].rows)


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
    swims, turns = search_swims(water), search_turns(water, generations, seed)
    starts = search_starts(replace(tables, turns=Table(turns), swims=Table(swims)), water, generations, seed)
    rows = {"turns": turns, "swims": swims, "starts": starts}
    found = {name: [as_dict(row) for row in each] for name, each in rows.items()}
    return found | {"front": round(tables.front, 4), "lag": list(tables.lag)}


def calibrate(water: str, generations=GENERATIONS, seed=1) -> None:
    """Ship the tables."""
    fish, gait = read_calibration("mass_spring", water)["parameters"], asdict(best_gait(water))
    publish(MOTOR_FILE, water, kept("motor", search, water, generations, seed, fish, gait))
    check(water)


def check(water: str) -> None:
    """Print what the turns of the written table do to a fish at cruise, and its fast starts from rest and gliding."""
    tables = load_tables(water=water)
    cruise = Cruise(ANGLES, water)
    reached, final, overshoot, _ = cruise.measure(tables.turns)
    print("angle   mean heading change (degrees)   time to 90 % (s)   overshoot (degrees)")
    for k, angle in enumerate(ANGLES):
        print(f"{angle:5.0f}   {final[k].mean():12.1f} +- {final[k].std():4.1f}"
              f"{reached[k].mean():26.3f}{overshoot[k].mean():18.1f}")  # fmt: skip
    for name, found in Starts(tables, water).measure(tables.starts).items():
        print(f"\n{name}, at {', '.join(f'{speed:g}' for speed in START_SPEEDS)} body lengths/s before")
        for angle, row in zip(START_BETWEEN, found, strict=True):
            print(f"{angle:5.0f}   {'  '.join(f'{value:8.3f}' for value in row)}")


def main() -> None:
    """The command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--water", choices=WATERS, default=DEFAULT_WATER, help="the level that tables are for")
    check(parser.parse_args().water)


if __name__ == "__main__":
    main()
