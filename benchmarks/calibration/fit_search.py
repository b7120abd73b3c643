"""What is minimised to find an inexpensive body that moves like the finest one.

Searched are logarithms: of stiffness, damping, drag and masses themselves, and of what a muscle takes off its length.
Minimised are squares: of the errors of every scene (`benchmarks.common.motion.residuals`); of how far the body swims
from a trout, with the gaits of the finest one; and of what is beyond the limits of the highest rates, of the error and
of the magnification. Where bodies fold, differences are no slopes: CMA-ES needs none.
"""

from typing import NamedTuple

import numpy as np

from benchmarks.calibration.finest import living_gaits
from benchmarks.calibration.performance import beyond, perform
from benchmarks.calibration.performance import residuals as aims
from benchmarks.common.measures import pose_of
from benchmarks.common.motion import Motion, play, residuals
from benchmarks.common.problems import Problem, distance, left_after_right, run
from benchmarks.common.scenes import beats
from fish_env import Fish, Tank, make_fish
from fish_env.bodies.fitted import read_calibration
from fish_env.control import Gait
from fish_env.control.chart import DISTURBANCE, steps_of

STAGED = 18.2
"""(h w)^2 + 2 h d that is free, of the highest frequency w and damping rate d at the body's own step h: three stages
of the default method. Faster motion does not move a fish, and every method pays for it."""
PREDICTABLE = 50.0
"""Times that the abrupt manoeuvre may magnify a disturbance: a fish that buckles does so a millionfold, and nobody can
say where it ends (the finest body: 5 times)."""
ACCURATE, FINE = 0.007, 48
"""Error of the abrupt manoeuvre that is free, body lengths, and the steps a control interval that it is taken from."""
KEPT = 0.3
"""Part of its area that a section must keep, seen from above: one that is inverted never comes back."""
UPRIGHT = 0.03
"""Roll, rad, that is free in strong gaits: the finest fish stays upright (`roll`)."""
RESTLESS, SPAN = {"mass_spring": 96, "planar": 96, "two_layer": 16}, 100
"""Fish whose sides pull in turns, half of them by chance and half as square waves, and for how many intervals."""
STIFFER, LONGER = 1.4, 3 / 4
"""Stiffness of those in longer steps, and their steps an interval over the body's own."""
NOISE, TURNS, WAVES = 0.05, 0.2, (1.0, 12.0)
"""Velocities of their nodes at the start, body lengths/s; chance of a change in an interval; frequencies, Hz."""
LIVING, FAST, MAGNIFIED, INACCURATE, BUCKLING, ROLLING, NEAR = 1.0, 30.0, 1.5, 3.0, 2.0, 1.0, 0.003
REPEATED, DEAD = 5.0, 10.0
"""Weights: of living fish, of a high frequency and damping rate, of magnification, of the error of the default step, of
sections that are nearly inverted, of roll, of how far the search has gone, and of what restless fish do."""
FIXED = {"relaxation_time": 0.001, "outline": "trout", "time_step": 0.02 / 16}
"""Parameters of `mass_spring` that are not searched; `damping_taper` is relative to the relaxation time."""
OF_FINEST = ("drag_coefficient", "law", "friction", "thinning", "added_mass", "contraction_time", "lengthening")
"""Its water and its muscles are those of the finest body."""


GAITS, SECONDS, LAST = 16, 3.0, 25
"""Strong gaits, for how long, s, and the control intervals at the end in which the roll is looked at."""


class Range(NamedTuple):
    """Where the search for a parameter begins, and the least and the highest value that it may take."""

    start: list
    least: float
    most: float


SEARCHED: dict[str, dict[str, Range]] = {
    "mass_spring": {
        "stiffness": Range([1845.0, 3651.0, 3056.0], 25.0, 40_000.0),
        "taper": Range([1.416, 0.3468, 0.5899, 0.1484, 0.3924, 0.2594], 0.02, 3.0),
        "contracted": Range([0.6606, 0.8647, 0.7832], 0.6, 0.97),
        "damping_taper": Range([0.3394, 0.1278, 0.4452, 0.4266, 0.2975, 0.009549], 0.005, 20.0),
        "mass_factor": Range([0.2587, 0.8152, 0.3781, 1.54, 0.4507, 0.9073, 2.932], 0.1, 4.0),
        "water_place": Range([0.3511, 0.05689, 0.2706, 0.6687, 0.8118, 0.8452], 0.01, 0.99),
        "water_drag": Range([0.9795, 6.508, 0.8185, 1.885, 2.113, 0.406], 0.1, 8.0),
    },
    "planar": {
        "bending": Range([1.0] * 5, 0.2, 5.0),
        "shear": Range([1.0], 0.2, 5.0),
        "pull": Range([1.0] * 3, 0.5, 2.0),
        "drag": Range([1.0] * 6, 0.2, 3.0),
        "damping": Range([1.0], 0.2, 5.0),
    },
    "two_layer": {
        "bending": Range([0.7601, 0.7669, 0.4664, 0.614, 1.253], 0.2, 5.0),
        "shear": Range([0.6886], 0.2, 5.0),
        "pull": Range([1.25, 1.37, 1.36], 0.5, 2.0),
        "drag": Range([1.016, 0.8475, 1.046, 0.645, 1.207, 0.8909], 0.1, 6.0),
        "damping": Range([0.8098], 0.05, 5.0),
    },
}
"""Near what earlier searches ended with; `planar` and `two_layer` are factors on `mass_spring`."""


def logarithms(name: str, values) -> np.ndarray:
    """What is searched of a parameter's values: of muscles, what they take off their length."""
    return np.log(1.0 - np.asarray(values)) if name == "contracted" else np.log(values)


def parameters(body: str, water: str, point) -> dict:
    """The parameters at a point of the search."""
    given, used = {}, 0
    if body == "mass_spring":
        known = read_calibration("tetrahedral", water)["parameters"]
        given = FIXED | {name: known[name] for name in OF_FINEST if name in known}
    for name, (start, *_) in SEARCHED[body].items():
        value = np.exp(point[used : used + len(start)])
        used += len(start)
        value = (1.0 - value if name == "contracted" else value).tolist()
        given[name] = value[0] if len(value) == 1 else value
    return given


def beginning(body: str) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The point at which the search begins, and the lowest and the highest point."""
    columns = []
    for name, (start, least, most) in SEARCHED[body].items():
        ends = sorted([float(logarithms(name, least)), float(logarithms(name, most))])
        columns.append(np.array([logarithms(name, start), *(np.full(len(start), end) for end in ends)]))
    start, low, high = np.concatenate(columns, axis=1)
    return start, low, high


def living(fish: Fish, water: str) -> np.ndarray:
    """How far this body, with the finest one's three gaits, its turns and its starts are from living fish."""
    try:
        return aims(perform(fish, living_gaits(water)))
    except ArithmeticError:
        return np.full(55, 2.0)


def endure(fish: Fish) -> tuple[float, float]:
    """Share of the intervals that restless fish had to repeat in shorter steps, and that they were dead for.

    Stiffer ones in longer steps, which are never repeated, count among the dead: what holds here must hold beside it.
    """
    again, dead = restless(fish, 1.0, steps_of(fish), fish.refine)
    return again, dead + restless(fish, STIFFER, max(1, round(LONGER * steps_of(fish))), np.inf)[1]


def restless(fish: Fish, stiffness: float, steps: int, refine: float) -> tuple[float, float]:
    """Shares of intervals repeated, and dead, of fish in so many steps an interval, half of them stiffer."""
    count, generator = RESTLESS[fish.name], np.random.default_rng(5)
    by_chance = np.cumsum(generator.random((SPAN, count)) < TURNS, axis=0) % 2 == 1
    waves = np.arange(SPAN)[:, None] * fish.control_interval * generator.uniform(*WAVES, count) % 1.0 < 0.5
    left = np.where(np.arange(count) % 2, by_chance, waves)
    tank = Tank(fish, count, dt=fish.control_interval / steps, water=fish.water, threads=1, refine=refine)
    for i in range(0, count, 4):
        tank.vary(i, stiffness=stiffness)
        tank.vary(i + 1, stiffness=stiffness)
    moving, dead = NOISE * fish.length * generator.standard_normal(tank.velocity.shape), 0
    tank.velocity[:] = moving * (fish.body.inverse_mass > 0.0)
    for side in left:
        tank.drive(((fish.sides > 0) == side[:, None]).astype(float), steps)
        dead += int((~tank.alive).sum())
    return float(tank.counters["refinements"].sum()) / count / SPAN, dead / count / SPAN


def inaccuracy(fish: Fish) -> float:
    """Largest distance of any node in the abrupt manoeuvre at the fish's own step from a finer one, body lengths."""
    scene = Problem("turn", "left after right", fish, fish.water, left_after_right(fish))
    fine, reference = run(scene, fish.integrator, FINE)
    path, tank = run(scene, fish.integrator, steps_of(fish), refine=fish.refine)
    return distance(fish, path, fine) if tank.alive[0] and reference.alive[0] else 1.0


def magnification(fish: Fish) -> float:
    """By how much the abrupt manoeuvre magnifies a small displacement of the nodes; the larger of two."""
    goals, count = left_after_right(fish), 2
    tank, moved = Tank(fish, 1 + count, water=fish.water, threads=1), 0.0
    shape = tank.position[0].shape
    for b in range(count):
        displaced = DISTURBANCE * fish.length * np.random.default_rng(b).normal(size=shape)
        tank.position[1 + b] += displaced * (fish.body.inverse_mass > 0.0)
    for goal in goals:
        tank.drive(np.repeat(goal[None], 1 + count, axis=0), round(fish.control_interval / tank.dt))
        moved = max(moved, float(np.linalg.norm(tank.position[1:] - tank.position[0], axis=2).max()))
    return moved / (DISTURBANCE * fish.length) if tank.alive.all() else 1e7


def strong_gaits(count=GAITS) -> list[Gait]:
    """Gaits of more than half the strength, 3 to 4.3 beats a second and any lags, drawn from a fixed seed."""
    generator, found = np.random.default_rng(0), []
    for _ in range(count):
        lag = np.cumsum([0.0, *generator.uniform(-0.6, 1.6, 2)])
        found.append(Gait(generator.uniform(3.0, 4.3), tuple(generator.uniform(0.6, 1.0, 3)), tuple(lag)))
    return found


def roll(fish: Fish) -> np.ndarray:
    """Largest angle (GAITS,) rad between the up axis and the vertical in the last half second; pi for what failed."""
    steps = round(fish.control_interval / fish.time_step)
    tank = Tank(fish, GAITS, water=fish.water, threads=1)
    contraction = beats(fish, strong_gaits(), SECONDS)
    noise = np.random.default_rng(0).normal(0.0, NOISE * fish.length, fish.body.position.shape)
    tank.velocity[:] += noise * (fish.body.inverse_mass > 0.0) + (fish.length, 0.0, 0.0)
    tilted = np.zeros(GAITS)
    for k, goal in enumerate(contraction):
        tank.drive(goal, steps)
        if k >= len(contraction) - LAST:
            upright = pose_of(tank).axes[:, 2, 2]
            tilted = np.maximum(tilted, np.arccos(np.clip(upright, -1.0, 1.0)))
    return np.where(tank.alive, np.nan_to_num(tilted, nan=np.pi), np.pi)


class Search:
    """The residuals of a body at the points of a search.

    Args:
        body: its name.
        water: the level of water that it is fitted for.
        contractions: (S,K,M) that it is told.
        finest: what the finest body makes of them.
        weights: (S,) factors on the errors of the scenes; None for ones.
    """

    def __init__(self, body: str, water: str, contractions: np.ndarray, finest: Motion, weights=None):
        self.body, self.water, self.contractions, self.finest = body, water, contractions, finest
        self.weights = np.ones(len(contractions)) if weights is None else np.asarray(weights)
        self.start, self.low, self.high = beginning(body)

    def fish(self, point) -> Fish:
        """The body at a point.

        Raises:
            ValueError: where there is none, since no masses have the outline's inertia.
        """
        return make_fish(self.body, water=self.water, **parameters(self.body, self.water, point))

    def residuals(self, point) -> np.ndarray:
        """What squares are taken of."""
        fish = self.fish(point)
        body, motion = fish.body, play(fish, self.contractions)
        h = fish.time_step
        fast = np.log((h * h * body.max_stiffness_eigenvalue + 2.0 * h * body.max_damping_eigenvalue) / STAGED)
        wild, off = (np.log10(max(value, 1e-9) / free) for value, free in (
            (magnification(fish), PREDICTABLE), (inaccuracy(fish), ACCURATE)
        ))  # fmt: skip
        near = NEAR * np.sqrt(len(self.contractions)) * (np.asarray(point) - self.start)
        again, dead = endure(fish)
        apart = self.weights[:, None] * residuals(motion, self.finest, fish.control_interval)
        return np.concatenate([
            apart.ravel(), LIVING * living(fish, self.water),
            ROLLING * np.maximum(np.log10(np.maximum(roll(fish), 1e-9) / UPRIGHT), 0.0),
            BUCKLING * beyond(KEPT, np.nan_to_num(motion.kept, nan=-1.0)).ravel(),
            [FAST * max(fast, 0.0), MAGNIFIED * max(wild, 0.0), INACCURATE * max(off, 0.0)],
            [REPEATED * again, DEAD * np.sqrt(dead)], near,
        ])  # fmt: skip

    def squares(self, point) -> float:
        """The sum of their squares; a large number where there is no such body."""
        if (np.asarray(point) < self.low).any() or (np.asarray(point) > self.high).any():
            return 1e4
        try:
            return float((self.residuals(point) ** 2).sum())
        except ValueError:
            return 1e4
