"""Tu's motor controllers: swim, turn and glide by tables (Tu 1996, ch. 5), and a C-start, which he had not.

`sequencer.py` decides when each acts.

swim-MC has an amplitude r and a frequency s for the anterior and one for the posterior swimming segment, read from a
table of speeds; the foremost segment takes a part of r1, since the best gait does. The turns are read from a table of
angles; larger ones are successive turns. Errors too small for a turn are corrected while swimming, by contracting one
side a little. Upper or lower muscles contracted alone make the fish pitch; nothing steers its roll.

Legend: b fish; segment 0 the foremost of three; side 0 left, 1 right; level 0 upper, 1 lower muscle. Angles are
positive to the left, rad; times are seconds. The numbers in the tables were found by
`benchmarks/calibration/motor_controllers.py`.
"""

import json
from dataclasses import dataclass, fields
from pathlib import Path

import numpy as np

from fish_env.bodies import Fish
from fish_env.bodies.fitted import check_level
from fish_env.checks import finite_array, positive_array, real
from fish_env.kernels.data import data

MOTOR_FILE = data("fish_env.control", "motor_controllers.json")


@dataclass(frozen=True)
class Turn:
    """One row of left-turn-MC's table: bend to the left, hold, straighten more slowly.

    Some of the strokes of swimming continue: a fish that only bends loses its speed, and then no longer turns.
    """

    angle: float  # rad: change of the mean heading that it makes
    front: float  # contraction added to the left muscles of segment 0, 0 to 1, as fast as they can
    middle: float  # the same of segment 1
    tail: float  # the same of segment 2, -1 to 1; negative: of its right muscles
    strokes: float  # part of swimming's strokes that continues during the turn, 0 to 1
    hold: float  # s, from the start until the fish begins to straighten: contraction and hold
    straighten: float  # s, over which the bend is released and the strokes grow to their full size
    phase: float  # beats: phase of the beat at which the strokes continue when the turn begins

    def __post_init__(self):
        numbers = [real(getattr(self, field.name)) for field in fields(self)]
        if not np.isfinite(numbers).all():
            raise ValueError(f"{self}; give finite numbers")
        if not (self.angle > 0 and self.hold > 0 and self.straighten > 0):
            raise ValueError(f"{self}; give a positive angle, hold and straightening time")
        if not (min(self.front, self.middle, self.strokes) >= 0 and self.tail >= -1 and max(numbers[1:5]) <= 1):
            raise ValueError(f"{self}; give contractions and strokes from 0 to 1, the tail's contraction from -1 to 1")


@dataclass(frozen=True)
class Start:
    """One row of left-start-MC's table: a C-start in two stages, after which the fish swims (Weihs 1973).

    First the fish bends to the left, then it strikes to the right.
    """

    angle: float  # rad: direction in which it is to get away
    front: float  # contraction of the left muscles of segment 0 in the first stage, 0 to 1
    middle: float  # the same of segment 1
    tail: float  # the same of segment 2
    bend: float  # s, duration of the first stage
    front_back: float  # contraction of the right muscles of segment 0 in the second stage, 0 to 1
    middle_back: float  # the same of segment 1
    tail_back: float  # the same of segment 2
    strike: float  # s, duration of the second stage
    phase: float  # beats: phase of the beat with which swimming begins

    def __post_init__(self):
        numbers = np.array([real(getattr(self, field.name)) for field in fields(self)])
        if not np.isfinite(numbers).all() or (numbers[:-1] < 0).any() or (numbers[[1, 2, 3, 5, 6, 7]] > 1).any():
            raise ValueError(f"{self}; give contractions from 0 to 1, finite times and an angle, none of them negative")


@dataclass(frozen=True)
class Swim:
    """One row of swim-MC's table: amplitude r and frequency s of the anterior and the posterior swimming segment."""

    speed: float  # resulting speed, body lengths per second
    r1: float  # contraction amplitude of segment 1, 0 to 1
    s1: float  # beats a second of segment 1
    r2: float  # amplitude of segment 2
    s2: float  # beats a second of segment 2

    def __post_init__(self):
        if not (0 <= self.r1 <= 1 and 0 <= self.r2 <= 1):
            raise ValueError(f"{self}; give amplitudes r1 and r2 from 0 to 1")
        if not all(0 <= number < np.inf for number in (self.speed, self.s1, self.s2)):
            raise ValueError(f"{self}; give a finite speed and frequencies s1 and s2, none negative")


class Table:
    """Rows of one dataclass, in the order of its first field, read in between by linear interpolation."""

    def __init__(self, rows):
        if len(rows) < 2:
            raise ValueError(f"a table of {len(rows)} rows; give at least two")
        self.rows = tuple(rows)
        self.names = [field.name for field in fields(rows[0])]
        self.values = np.array([[getattr(row, name) for name in self.names] for row in rows])
        if np.any(np.diff(self.values[:, 0]) <= 0):
            raise ValueError(f"{self.names[0]} is {self.values[:, 0].tolist()}; give rows in increasing order")

    def at(self, wanted: np.ndarray) -> np.ndarray:
        """Parameters (B,P) at values `wanted` (B,) of the first field, constant beyond the ends of the table."""
        key = self.values[:, 0]
        return np.stack([np.interp(wanted, key, column) for column in self.values.T], axis=1)


@dataclass(frozen=True)
class MotorTables:
    """The tables of the motor controllers of a fish."""

    turns: Table
    swims: Table
    front: float
    """Amplitude of segment 0 when swimming, as a part of r1."""
    lag: tuple[float, float, float]
    """Phase lags of the three segments when swimming, rad."""
    starts: Table | None = None
    """None where a file has no fast starts."""

    def __post_init__(self):
        positive_array(self.front, (), "front", zero=True)
        finite_array(self.lag, (3,), "lag (rad)")


def load_tables(path: Path = MOTOR_FILE, water: str | None = None) -> MotorTables:
    """The tables of a file, by default those of the default fish, in "drag", "reactive" or by default its own water.

    FileNotFoundError if there is no such file, ValueError if it contains no tables of motor controllers.
    """
    try:
        found = json.loads(path.read_text("utf-8"))
        found = found if "turns" in found else found[check_level(water)]
        turns, starts = (
            [kind(np.radians(row["angle"]), *(row[f.name] for f in fields(kind)[1:])) for row in rows]
            for kind, rows in ((Turn, found["turns"]), (Start, found.get("starts", [])))
        )
        swims = [Swim(**row) for row in found["swims"]]
        lag, started = tuple(found["lag"]), Table(starts) if "starts" in found else None
        return MotorTables(Table(turns), Table(swims), found["front"], lag, started)
    except FileNotFoundError:
        raise
    except (OSError, ValueError, TypeError, LookupError, ArithmeticError, RecursionError) as error:
        raise ValueError(f"{path} holds no tables of motor controllers: {error!r}") from error


def swim_mc(tables: MotorTables, rows: np.ndarray, beats: np.ndarray) -> np.ndarray:
    """swim-MC: contractions (B,3,2) of segments and sides, for table rows (B,5) and clocks `beats` (B,2) of s1, s2."""
    r1, r2 = rows[:, 1], rows[:, 3]
    amplitude = np.stack([tables.front * r1, r1, r2], axis=1)
    wave = np.sin(2 * np.pi * beats[:, (0, 0, 1)] - np.array(tables.lag))
    return 0.5 * amplitude[:, :, None] * (1.0 + np.stack([wave, -wave], axis=2))


def turn_mc(rows: np.ndarray, side: np.ndarray, since: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """left-turn-MC (side +1) and right-turn-MC (side -1), `since` (B,) s after their start, for table rows (B,8)."""
    # Contractions (B,3,2), and the part (B,) of swimming's strokes that is to be added to them.
    _, front, middle, tail, strokes, hold, straighten, _ = rows.T
    done = np.clip((since - hold) / straighten, 0.0, 1.0)
    bend = np.zeros((len(rows), 3, 2))
    inside, b = np.where(side > 0, 0, 1), np.arange(len(rows))
    bend[b, 0, inside], bend[b, 1, inside] = front, middle
    bend[b, 2, np.where(tail > 0, inside, 1 - inside)] = np.abs(tail)
    return bend * (1.0 - done)[:, None, None], strokes + (1.0 - strokes) * done


def start_mc(rows: np.ndarray, side: np.ndarray, since: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """left-start-MC (side +1) and right-start-MC (side -1), `since` (B,) s after their start, for rows (B,10)."""
    # Contractions (B,3,2), and whether (B,) the second stage is not over yet.
    bend, strike = rows[:, 4], rows[:, 8]
    stages = np.stack([rows[:, 1:4], rows[:, 5:8]], axis=2)  # (B,3,2) as if each side had a stage of its own
    first, second = since <= bend + 1e-9, since <= bend + strike + 1e-9
    going = np.stack([first, second & ~first], axis=1)[:, None]
    left = stages * going
    return np.where((side > 0)[:, None, None], left, left[:, :, ::-1]), second


def scaled_turns(table: Table, angle: np.ndarray) -> np.ndarray:
    """Rows (B,8) for turns by `angle` (B,) rad >= 0; below the smallest of the table the fish bends in proportion."""
    rows = table.at(angle)
    part = np.minimum(angle / table.values[0, 0], 1.0)[:, None]
    rows[:, 1:4] *= part
    rows[:, 4:5] = 1.0 - part * (1.0 - rows[:, 4:5])
    return rows


def spread(fish: Fish, pairs: np.ndarray) -> np.ndarray:
    """Contractions (B,M) of the muscles, for those of segments and sides (B,3,2): the upper as the lower."""
    return pairs[:, fish.thirds, np.where(fish.sides > 0, 0, 1)]
