"""Scenes for the levels of water: cruising, turning, reversing, starting, coasting, and a station in a current.

Every scene drives fish of one kind in their own water, B of them side by side, and returns quantities by their names.
"""

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from benchmarks.common.measures import pose_of
from benchmarks.common.search import minimise
from fish_env import Fish, Tank
from fish_env.bodies import mass_spring as tu
from fish_env.control import Gait
from fish_env.control.chart import steps_of
from fish_env.physics.world import VACUUM
from fish_env.soft.conditions import make_anchors

FREQUENCIES = (1.5, 6.0)  # Hz, of the gaits that are searched, where the frequency is free
GUESSES, POPULATION, GENERATIONS = 768, 48, 16
BEATS = 2  # at the end of a run that are measured
PHASES = 8  # of the gait at which a manoeuvre begins; values are means over them
PULL = 10  # control intervals that the muscles of one side pull
SETTLING = 4.0  # s of cruising before a manoeuvre
WITHIN = 0.015  # part by which a cruise may miss its speed
FRONT, BASE = np.arange(5), np.arange(17, 21)  # landmarks: the nose and the first layer, the peduncle
PULLING = 0.25  # s that the muscles of one side pull


class Motion(NamedTuple):
    """Fish at the start and after every control interval."""

    centre: np.ndarray  # (K+1,B,3) m
    velocity: np.ndarray  # (K+1,B,3) m/s, of the centre
    yaw: np.ndarray  # (K+1,B) rad, unwrapped
    nose: np.ndarray  # (K+1,B,3) m
    tail: np.ndarray  # (K+1,B,3) m
    work: np.ndarray  # (K+1,B) J, net, of the muscles


def drive(tank: Tank, goals: np.ndarray) -> Motion:
    """Drive a tank through contractions (K,B,M).

    Raises:
        ArithmeticError: if no fish lives at the end.
    """
    found = []
    for goal in (None, *goals):
        if goal is not None:
            tank.drive(goal, steps_of(tank.fish))
        pose, points = pose_of(tank), tank.fish.points(tank.position)
        yaw = np.arctan2(pose.axes[:, 0, 1], pose.axes[:, 0, 0])
        tail = points[:, list(tu.TAIL)].mean(axis=1)
        found.append((pose.centre.copy(), pose.velocity.copy(), yaw, points[:, tu.NOSE], tail, tank.work.copy()))
    if not tank.alive.any():
        raise ArithmeticError(f"no fish lives at the end of the scene: {tank.failure[0]}")
    centre, velocity, yaw, *rest = (np.array(part) for part in zip(*found, strict=True))
    return Motion(centre, velocity, np.unwrap(yaw, axis=0), *rest)


def tank_of(fish: Fish, count: int, speed=0.0, yaw=0.0) -> Tank:
    """A tank of fish that head along x, or turned by `yaw` rad, and move along x, body lengths/s."""
    tank = Tank(fish, count, water=fish.water, threads=1)
    c, s = np.cos(yaw), np.sin(yaw)
    tank.position[:] = tank.position @ np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])
    tank.velocity[:, :, 0] = speed * fish.length
    return tank


def beats(fish: Fish, gaits: list[Gait], seconds: float) -> np.ndarray:
    """Contractions (K,B,M) of gaits."""
    times = fish.control_interval * np.arange(1, round(seconds / fish.control_interval) + 1)
    return np.stack([gait.contraction(fish, times) for gait in gaits], axis=1)


def cruises(fish: Fish, gaits: list[Gait], speed: float, seconds: float, count=BEATS) -> list[dict[str, float]]:
    """Swim gaits from a speed, body lengths/s, and measure the last `count` beats of each; failed fish have nan."""
    tank, interval = tank_of(fish, len(gaits), speed), fish.control_interval
    swum, mass, found = drive(tank, beats(fish, gaits, seconds)), fish.body.mass.sum(), []
    for i, gait in enumerate(gaits):
        last = round(count / gait.frequency / interval) + 1
        centre, nose, tail, work = (getattr(swum, name)[-last:, i] for name in ("centre", "nose", "tail", "work"))
        path, time = centre[-1] - centre[0], (last - 1) * interval
        way = float(np.hypot(*path[:2])) if tank.alive[i] else np.nan
        across = np.array([-path[1], path[0], 0.0]) / max(way, 1e-12)
        sweep, sway = (float(np.ptp((part - centre[0]) @ across)) / fish.length for part in (tail, nose))
        reached = way / time / fish.length
        found.append({
            "speed": reached, "frequency": gait.frequency, "sweep": sweep, "nose over tail": sway / sweep,
            "Strouhal": gait.frequency * sweep / reached, "work": float(work[-1] - work[0]) / mass / way,
        })  # fmt: skip
    return found


def decoded(point: np.ndarray, frequencies: tuple[float, float]) -> Gait:
    """The gait of a point (6,) of the search: frequency, amplitudes and lags, each from 0 to 1."""
    (low, high), u = frequencies, np.clip(point, 0.0, 1.0)
    lag = 0.0, np.pi * (2 * u[4] - 1), 2 * np.pi * (2 * u[5] - 1)
    frequency, *rest = np.round([low + (high - low) * u[0], *u[1:4], *lag], 4).tolist()
    return Gait(frequency, tuple(rest[:3]), tuple(rest[3:]))


def thriftiest(fish: Fish, speed: float, frequency: float | None = None) -> Gait:
    """The gait of least net work a metre at a speed, and at a frequency if one is given.

    Random gaits are tried, then CMA-ES from the best of them. The fish begins at that speed, body lengths/s, and must
    still have it after 3 s.
    """
    frequencies = FREQUENCIES if frequency is None else (frequency, frequency)

    def cost(points) -> np.ndarray:
        found = cruises(fish, [decoded(point, frequencies) for point in points], speed, 3.0)
        off = np.array([abs(row["speed"] / speed - 1.0) for row in found])
        total = np.array([row["work"] for row in found]) + 30.0 * np.maximum(0.0, off - WITHIN)
        outside = np.array([np.abs(point - np.clip(point, 0.0, 1.0)).sum() for point in points])
        return np.nan_to_num(total, nan=1e3) + 10.0 * outside

    guesses = np.random.default_rng(0).uniform(size=(GUESSES, 6))
    start = guesses[np.argmin(cost(guesses))]
    point, _ = minimise(cost, start, 0.1, GENERATIONS, 1, POPULATION, each=lambda cost, points: cost(points))
    return decoded(point, frequencies)


def phases(gait: Gait, count=PHASES) -> list[Gait]:
    """The gait in so many phases."""
    shifts = 2 * np.pi * np.arange(count) / count
    return [Gait(gait.frequency, gait.amplitude, tuple(lag - shift for lag in gait.lag)) for shift in shifts]


def pulled(fish: Fish, gait: Gait | None, speed: float, sides: tuple[int, ...], count=PHASES, settling=SETTLING):
    """Motion of fish that pull one side after another, each for PULL control intervals, and none where a side is 0.

    Before that they have cruised for about `settling` s, each in another phase; without a gait they glide. The heading
    (K+1,B) rad counts from there, positive to where they turn first.
    """
    tank = tank_of(fish, count, speed)
    if gait is not None:
        drive(tank, beats(fish, phases(gait, count), round(settling * gait.frequency) / gait.frequency))
    goals = [np.repeat((fish.sides == side)[None].astype(float), PULL, axis=0) for side in sides]
    swum = drive(tank, np.repeat(np.concatenate(goals)[:, None], count, axis=1))
    yaw = swum.yaw - swum.yaw[0]
    return swum, yaw * np.sign(yaw[PULL].mean())


def peak_rate(yaw: np.ndarray, interval: float) -> np.ndarray:
    """Fastest change of heading (B,) within one control interval, degrees/s."""
    return np.degrees(np.abs(np.diff(yaw, axis=0)).max(axis=0) / interval)


def turn(fish: Fish, gait: Gait | None, speed=1.0, count=PHASES, settling=SETTLING) -> dict[str, float]:
    """Pull one side while cruising, then glide for 0.8 s.

    Values are 'angle' after 0.3 s, 'kept' at the end, the 'rate' at most, and the 'radius': the path over the angle
    until 90 % of the angle at the end, nan where less than 5 degrees are kept.
    """
    swum, yaw = pulled(fish, gait, speed, (1, 0, 0, 0, 0), count, settling)
    kept, radius = yaw[-1], []
    way = np.linalg.norm(np.diff(swum.centre, axis=0), axis=2).cumsum(axis=0) / fish.length
    for b in range(count):
        end = int(np.argmax(yaw[:, b] >= 0.9 * kept[b]))
        radius.append(way[end - 1, b] / yaw[end, b] if kept[b] > np.radians(5.0) else np.nan)
    late = round(0.3 / fish.control_interval)
    return {
        "angle": float(np.degrees(yaw[late].mean())), "kept": float(np.degrees(kept.mean())),
        "rate": float(peak_rate(swum.yaw, fish.control_interval).mean()),
        "radius": float(np.mean(radius)),
    }  # fmt: skip


def reversal(fish: Fish, gait: Gait | None, speed=1.0) -> dict[str, float]:
    """Pull one side while cruising, then the other: the 'way back' within 0.3 s of the second command, degrees.

    'lag' is the time from that command until the heading turns back, s; 'rate' the fastest change on the way back.
    """
    (_, yaw), interval = pulled(fish, gait, speed, (1, -1, 0)), fish.control_interval
    after = yaw[PULL : PULL + round(0.3 / interval) + 1]
    return {
        "lag": float(after.argmax(axis=0).mean() * interval),
        "way back": float(np.degrees((after.max(axis=0) - after[-1]).mean())),
        "rate": float(peak_rate(after, interval).mean()),
    }


def start(fish: Fish, first=range(2, 12), second=range(12)) -> dict[str, float]:
    """Start from rest by one side for 0.2 s, and by the best of a grid of two stages, for each quantity the best.

    `first` and `second` are the control intervals that the stages may last.

    'angle', of the line of best fit, 'snout', of the line from the centre of mass to the snout, and 'distance' (body
    lengths) are those after 0.3 s, 'acceleration' the largest mean over 40 ms.
    """
    interval, end = fish.control_interval, round(0.3 / fish.control_interval)
    first, second = (grid.ravel() for grid in np.meshgrid(first, second))
    first, second = np.append(PULL, first), np.append(0, second)
    k = np.arange(end)[:, None]
    side = np.where(k < first, 1, np.where(k < first + second, -1, 0))
    swum = drive(tank_of(fish, len(first)), (fish.sides == side[..., None]).astype(float))
    ahead = swum.nose - swum.centre
    faced = np.unwrap(np.arctan2(ahead[..., 1], ahead[..., 0]), axis=0)
    angle, snout = (np.degrees(np.abs(each[-1] - each[0])) for each in (swum.yaw, faced))
    distance = np.linalg.norm(swum.centre[-1] - swum.centre[0], axis=1) / fish.length
    apart = round(0.04 / interval)
    gained = np.linalg.norm(swum.velocity[apart:] - swum.velocity[:-apart], axis=2).max(axis=0)
    fastest = gained / (apart * interval)
    return {
        "angle": float(angle[0]), "acceleration": float(fastest[0]), "best angle": float(angle.max()),
        "best snout": float(snout.max()),
        "best distance": float(distance.max()), "best acceleration": float(fastest.max()),
    }  # fmt: skip


def wetted_area(fish: Fish) -> float:
    """Area of the surface, m2."""
    x, rise = fish.body.position[fish.body.faces.nodes], fish.body.faces.depth[:, None] * [0.0, 0.0, 1.0]
    return float(0.5 * np.linalg.norm(np.cross(x[:, 2] - x[:, 0] + rise, x[:, 3] - x[:, 1] + rise), axis=1).sum())


def coast(fish: Fish, speed=2.0) -> dict[str, float]:
    """Glide for 1 s: the 'deceleration' at first, over 0.1 s, m/s2, and the drag coefficient on the wetted area."""
    goals = np.zeros((round(1.0 / fish.control_interval), 1, fish.num_muscles))
    swum = drive(tank_of(fish, 1, speed), goals)
    early, fast = round(0.1 / fish.control_interval), swum.velocity[:, 0, 0]
    resistance = (1.0 / fast[-1] - 1.0 / fast[0]) / 1.0
    coefficient = 2.0 * fish.body.mass.sum() * resistance / (1000.0 * wetted_area(fish))
    return {"deceleration": float(fast[0] - fast[early]) / 0.1, "drag coefficient": float(coefficient)}


def station(fish: Fish, gait: Gait | None, speed=1.0, seconds=2.0) -> dict[str, float]:
    """Swim the gait of a speed against a current of it, without steering, from a heading 5 degrees off.

    'drift' is the distance from the station after some seconds, body lengths, 'heading' how far it is off, degrees.
    'carried' is the part of its speed with which the same current, from the side, carries a resting fish after 0.5 s.
    """
    flow = fish.water._replace(current=np.array([-speed * fish.length, 0.0, 0.0]))
    tank = tank_of(replace(fish, water=flow), PHASES, 0.0, np.radians(5.0))
    goals = np.zeros((round(seconds / fish.control_interval), PHASES, fish.num_muscles))
    swum = drive(tank, goals if gait is None else beats(fish, phases(gait), seconds))
    aside = replace(fish, water=fish.water._replace(current=np.array([0.0, speed * fish.length, 0.0])))
    rest = np.zeros((round(0.5 / fish.control_interval), 1, fish.num_muscles))
    carried = drive(tank_of(aside, 1), rest).velocity[-1, 0, 1] / (speed * fish.length)
    away = np.linalg.norm(swum.centre[-1] - swum.centre[0], axis=1) / fish.length
    off = np.degrees(np.abs(swum.yaw[-1]))
    return {"drift": float(away.mean()), "heading": float(off.mean()), "carried": float(carried)}


def contract(fish: Fish, dashpot: float) -> tuple[float, float]:
    """Largest force, N, and speed, m/s, of the base of the tail fin against a dashpot, N s/m; infinite ones hold it."""
    front, base = np.unique(fish.landmarks.node[FRONT]), np.unique(fish.landmarks.node[BASE])
    load = make_anchors(base, fish.body.position[base], 0.0, dashpot / len(base)) if dashpot < np.inf else None
    tank = Tank(fish, 1, water=VACUUM._replace(anchors=load), threads=1)
    tank.fix(front)
    if load is None:
        tank.fix(base, axes="y")
    held, fastest, contraction = [], 0.0, (fish.sides > 0).astype(float)[None]
    for _ in range(round(PULLING / tank.dt)):
        tank.drive(contraction, 1)
        if load is None:
            held.append(float(tank.reactions()[0, base, 1].sum()))
        else:
            fastest = max(fastest, abs(float(tank.velocity[0, base, 1].mean())))
    late = held[len(held) // 2 :]  # the front of a body that is held suddenly swings at first
    return (abs(float(np.mean(late))), 0.0) if load is None else (dashpot * fastest, fastest)
