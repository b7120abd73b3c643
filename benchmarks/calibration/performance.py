"""What a fish does with three gaits and with all its strength, and how far that is from living fish.

It cruises at the frequencies and speeds of a trout of 19.6 cm (Drucker & Lauder), turns while it cruises, starts from
rest, and bears commands that change from one side to the other. The midline is the carangiform envelope of Videler &
Hess (1984), scaled to the trout's sweep; sources of the other aims are on the page beside living fish.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from benchmarks.calibration.midline import Midline, swim_midlines
from benchmarks.common import scenes
from benchmarks.common.motion import areas
from fish_env import Fish, Tank
from fish_env.bodies import mass_spring as tu
from fish_env.control import Gait
from fish_env.control.chart import steps_of

SECONDS, BEATS = 2.4, 2  # of a cruise, and of its end that is measured
PHASES, SETTLING = 4, 2.0  # of the cruise before a turn: how many, s
STAGES = (2, 3, 4, 5, 7), (0, 4, 8, 11)  # control intervals of the two stages of starts
FISH, INTERVALS = 12, 50  # that bear changing commands, and for how many control intervals


@dataclass(frozen=True)
class Trout:
    """A row of Table 1 of Drucker & Lauder (2005, J. Exp. Biol. 208:4479), of rainbow trout of 19.6 cm."""

    speed: float  # body lengths/s
    frequency: float  # Hz
    sweep: float  # body lengths


TROUT = tuple(Trout(u, f, cm / 19.6) for u, f, cm in ((0.5, 2.48, 1.80), (1.0, 3.18, 2.55), (2.0, 4.23, 2.85)))
STATION = np.array([0.0, *tu.calibrated()["layer_position"], 1.0])
"""Of the midline, body lengths from the nose."""
ENVELOPE = (0.02 - 0.0825 * STATION + 0.1625 * STATION**2) / 0.1
"""Half the sway of each station over the tail tip's (Videler & Hess 1984)."""
WORK = {1: (0.6, 2.0), 2: (0.9, 1.4)}
"""Published work of thrust at the second and the third speed, J/kg/m, and the factor by which ours may be off:
elongated-body theory gives the trout's own sweep at 1 BL/s less than two thirds of it."""
RATE, RADIUS = 434.0, 0.24
"""Aims of a turn, degrees/s and body lengths."""
ANGLE, SNOUT, ACCELERATION = 88.0, 105.0, 18.0
"""Aims of a start: degrees in 0.3 s, of the line of best fit and of the snout, and m/s2, of trout that were filmed."""
COASTING, FORCE, STRAIN = 0.0205, 1.6, 0.14
"""Aims of the drag coefficient of a glide, of the force, N, of the muscles of one side, and of strain in a burst."""
BURST, BURSTING = Gait(8.0, (1.0, 1.0, 1.0), (0.0, 0.9, 1.8)), 1.0
"""The gait of a burst, and how long it is swum, s."""
KEPT = 0.3
"""Part of its area that a section is to keep: one that is inverted may never come back."""
LOST = 1 / 3
"""Part of the muscles' work that may be lost in the body."""


class Performance(NamedTuple):
    """What a fish did."""

    midlines: list[Midline]
    turn: dict[str, float]
    start: dict[str, float]
    coasting: float
    """Drag coefficient of a glide on the wetted surface."""
    force: float
    """Of the muscles of one side at the base of the tail fin, N."""
    strain: float
    """Half the swing of the muscles' strain in a burst."""
    kept: np.ndarray
    """(FISH,4) least part of its area, seen from above, that each section kept under changing commands."""
    volume: np.ndarray
    """(FISH,6) least part of its volume that an element of each section kept; ones where there are none."""
    failed: float
    """Part of the time of these commands that was lost by failures."""


def perform(fish: Fish, gaits: list[Gait]) -> Performance:
    """Let a fish cruise with three gaits, turn in the second one, start and bear changing commands.

    Raises:
        ArithmeticError: if no fish lives at the end of a scene.
    """
    cruises = swim_midlines(fish, gaits, [row.speed for row in TROUT], SECONDS, BEATS, energy=True)
    if any(each.failure for each in cruises):
        raise ArithmeticError(f"a fish failed while it cruised: {[each.failure for each in cruises]}")
    turned = scenes.turn(fish, gaits[1], count=PHASES, settling=SETTLING)
    coasting, force = scenes.coast(fish)["drag coefficient"], scenes.contract(fish, np.inf)[0]
    return Performance(cruises, turned, scenes.start(fish, *STAGES), coasting, force, burst(fish), *bear(fish))


def burst(fish: Fish) -> float:
    """Half the swing of the strain of the muscles, their mean over the last beats of a burst; nan if the fish fails."""
    tank, ends = scenes.tank_of(fish, 1, 3.0), fish.landmarks.muscles
    natural, strains = np.linalg.norm(np.diff(fish.points(fish.body.position)[ends], axis=1)[:, 0], axis=1), []
    for goal in scenes.beats(fish, [BURST], BURSTING):
        tank.drive(goal, steps_of(fish))
        apart = np.diff(fish.points(tank.position)[0, ends], axis=1)[:, 0]
        strains.append(np.linalg.norm(apart, axis=1) / natural)
    last = round(BEATS / BURST.frequency / fish.control_interval) + 1
    return float(0.5 * np.ptp(strains[-last:], axis=0).mean()) if tank.alive[0] else np.nan


def bear(fish: Fish) -> tuple[np.ndarray, np.ndarray, float]:
    """`kept`, `volume` and `failed` of fish of which one side pulls, then the other: square waves, and at random."""
    times, goals = fish.control_interval * np.arange(INTERVALS), []
    for k in range(FISH):
        generator = np.random.default_rng([7, k])
        wave = np.sin(2 * np.pi * generator.uniform(1.0, 12.0) * times) >= 0.0
        side = wave if k % 2 else np.cumsum(generator.random(INTERVALS) < 0.2) % 2 == 1
        goals.append(np.where(side[:, None], fish.sides > 0, fish.sides < 0).astype(float))
    tank = Tank(fish, FISH, water=fish.water, threads=1)
    rest, kept, dead = areas(fish.points(fish.body.position[None])), np.ones((FISH, 4)), 0
    natural, volume = volumes(fish, fish.body.position[None]), np.ones((FISH, 6))
    for goal in np.stack(goals, axis=1):
        tank.drive(goal, steps_of(fish))
        kept = np.minimum(kept, areas(fish.points(tank.position)) / rest)
        volume = np.minimum(volume, volumes(fish, tank.position) / natural)
        dead += (~tank.alive).sum()
    return np.nan_to_num(kept, nan=-1.0), np.clip(np.nan_to_num(volume, nan=-1.0), -1.0, 1.0), dead / FISH / INTERVALS


def volumes(fish: Fish, position: np.ndarray) -> np.ndarray:
    """Least volume (B,6) of an element of each section, over its mean there at rest; ones for a fish without any."""
    tets = fish.body.tets
    if tets is None:
        return np.ones((len(position), 6))
    rest = fish.body.position
    layers = np.array([rest[fish.landmarks.node[nodes[0]], 0] for nodes in tu.LAYERS])
    section = np.clip(np.searchsorted(-layers, -rest[tets.nodes, 0].mean(axis=1)) - 1, 0, 5)
    a, b, c, d = (position[:, tets.nodes[:, k]] for k in range(4))
    each = (np.cross(b - a, c - a) * (d - a)).sum(axis=2) / (6.0 * tets.volume)
    return np.stack([each[:, section == k].min(axis=1) for k in range(6)], axis=1)


def beyond(value, limit):
    """How far a value is above a limit."""
    return np.maximum(value - limit, 0.0)


def residuals(found: Performance) -> np.ndarray:
    """What is beyond the aims, and a little of what is within them, (SIZE,): a calibration minimises the squares."""
    rows = []
    for k, (one, real) in enumerate(zip(found.midlines, TROUT, strict=True)):
        off = np.log([max(one.speed, 0.02) / real.speed, max(one.sweep, 0.005) / real.sweep])
        sway = one.amplitude[:6] - 0.5 * real.sweep * ENVELOPE[:6]
        rows += [8.0 * outside(off, 0.05) + 1.4 * off, 55.0 * outside(sway, 0.009) + 6.0 * sway]
        nose = beyond(one.nose, 0.15) - beyond(0.10, one.nose)
        wanted, factor = WORK.get(k, (one.thrust, 2.0))
        work = abs(np.log(max(one.thrust, 1e-3) / wanted)) - np.log(factor)
        lost = one.lost if one.work > 0.0 else 1.0
        rows.append([
            12.0 * nose, 2.0 * beyond(one.wobble, 0.1), 6.0 * beyond(work, 0.0), 4.5 * beyond(lost, 0.9 * LOST),
        ])  # fmt: skip
    turn, start = found.turn, found.start
    radius = 9.0 if np.isnan(turn["radius"]) else turn["radius"]
    rows.append([
        2.0 * beyond(np.log(1.05 * RATE / max(turn["rate"], 1.0)), 0.0), 2.0 * beyond(np.log(radius / RADIUS), -0.05),
        1.5 * beyond(np.log(1.05 * ANGLE / max(start["best angle"], 1.0)), 0.0),
        1.5 * beyond(np.log(1.05 * SNOUT / max(start["best snout"], 1.0)), 0.0),
        1.5 * beyond(np.log(1.05 * ACCELERATION / start["best acceleration"]), 0.0), 5.5 * np.sqrt(found.failed),
        8.0 * beyond(np.log(max(found.coasting, 1e-4) / COASTING), 0.0),
        1.5 * beyond(np.log(1.05 * FORCE / max(found.force, 1e-3)), 0.0),
        3.0 * beyond(np.log(np.nan_to_num(found.strain, nan=1.0) / STRAIN), 0.0),
    ])  # fmt: skip
    folded = (weight * np.sqrt((beyond(KEPT, part) ** 2).mean(axis=0)) for weight, part in (
        (5.0, found.kept), (3.0, found.volume)
    ))  # fmt: skip
    return np.concatenate([*rows, *folded])


def outside(value, free):
    """What is beyond -free to free."""
    return value - np.clip(value, -free, free)
