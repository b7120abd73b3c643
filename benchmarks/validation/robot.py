"""A robot's tail strokes imposed on a body of its shape and mass: one number fitted to two trials, six predicted.

Dimensions, masses and marker tracks are those of github.com/srl-ethz/fishsim (MIT licence; arXiv:2602.23283): eight
trials at constant motor speed. Frequency, speed along the head and the first harmonic of the fin marker across the head
were fitted to the tracks of each trial. The shape of the stroke is the mean of four trials whose markers do not
coincide. The robot's electronics, motor shaft and tendon arms are bluff and stand outside any outline, so their drag
cannot follow from it: a coefficient on the surface before the tail's joint stands for it, and is the number fitted.
"""

import sys
from typing import NamedTuple

import numpy as np
from scipy.interpolate import PchipInterpolator
from scipy.optimize import fminbound

from benchmarks.common.charts import GREY, legend_below, panels, save
from benchmarks.common.tables import RESULTS, columns, publish, read_table, select
from benchmarks.validation.waters import COLOURS, waters
from fish_env import Fish, World, make_fish, prescribe
from fish_env.kernels.compile import kernel
from fish_env.kernels.simd import dot, sqrt
from fish_env.physics.forces import FORCES, water
from fish_env.physics.records import Body

LENGTH, VISCOSITY = 0.559, 1.0e-6  # m, m2/s
FREQUENCY = (0.377, 0.56, 0.75, 0.94, 1.127, 1.313, 1.5, 1.659)  # Hz
SPEED = (0.0227, 0.0496, 0.0805, 0.1039, 0.1292, 0.1602, 0.2018, 0.2227)  # m/s
SWAY = (0.1006, 0.104, 0.1104, 0.1057, 0.0996, 0.1051, 0.1025, 0.0983)  # m, half of the fin marker's
FITTED = (2, 5)  # the trials to which the robot's makers fitted five numbers
THEIRS, ELONGATED = 0.019, 0.134  # m/s, mean error of their simulation and of their elongated-body theory
JOINT, MARKER = 0.362, (0.4065, 0.4385, 0.4675, 0.4885, 0.551)  # m from the nose
SHARE = np.array((0.206, 0.359, 0.516, 0.635, 1.0)) * np.exp(1j * np.radians((30.6, 22.5, 17.0, 13.2, 0.0)))
"""Sway of each marker over the fin marker's, and how far it is ahead."""
OUTLINE = np.array([
    (0.0, 0.0, 0.0), (0.004, 0.0264, 0.05), (0.154, 0.0264, 0.05), (0.157, 0.0113, 0.05), (0.2, 0.0113, 0.05),
    (0.203, 0.0255, 0.0525), (0.355, 0.0255, 0.0525), (0.362, 0.004, 0.0375), (0.37, 0.0017, 0.05),
    (0.4875, 0.0017, 0.04), (0.494, 0.0008, 0.0225), (0.4996, 0.001, 0.0263), (0.508, 0.001, 0.0552),
    (0.5165, 0.001, 0.0722), (0.5252, 0.001, 0.0869), (0.5337, 0.001, 0.0972), (0.5423, 0.001, 0.1014),
    (0.559, 0.001, 0.0997),
])  # fmt: skip
"""Place, half width and half depth, m. The depths are the robot's; the widths give each part its mass."""


class Front(NamedTuple):
    """Parameters of the force of the bluff front, in `World.extra`."""

    coefficient: np.ndarray  # (F,) half the density of the water times each face's coefficient, kg/m3


ANYWHERE = True


def present(body: Body, world: World) -> bool:
    """Return True if the world has a bluff front."""
    return "front" in (world.extra or {})


@kernel
def add_force(body, world, control, x, v, f, cache):
    """Add the drag of the front on every face, against the part of its velocity through the water along the face."""
    current = world.current[0] + control.current[0]
    for k in range(body.faces.nodes.shape[0]):
        a, w = water.area_vector(body, x, k), water.velocity(body, current, v, k)
        size = sqrt(dot(a, a))
        ahead = water.along((1.0 / size) * a, w)
        water.scatter(body, k, (-world.front.coefficient[k] * size * sqrt(dot(w, w))) * ahead, f)


def stroke(trial: int):
    """Midline of a trial in the axes of the head, as `prescribe` takes it."""
    place = np.array([0.0, JOINT, *MARKER]) / LENGTH
    sway = np.array([0.0, 0.0, *SHARE * SWAY[trial]]) / LENGTH
    shape, turn = PchipInterpolator(place, np.stack([sway.real, -sway.imag], axis=1)), 2.0 * np.pi * FREQUENCY[trial]
    return lambda places, time: shape(places) @ (np.cos(turn * time), np.sin(turn * time))


def speed(fish: Fish, world: World, trial: int) -> float:
    """Speed in a trial, m/s."""
    return prescribe(fish, stroke(trial), 1.0 / FREQUENCY[trial], water=world).speed


def with_bluff_front(fish: Fish, world: World, coefficient: float) -> World:
    """The world with drag along the surface before the joint too, a force of one's own."""
    FORCES["front"] = sys.modules[__name__]
    place = -fish.body.position[fish.body.faces.nodes, 0].mean(axis=1)
    return world._replace(extra={"front": Front(np.where(place < JOINT, 500.0 * coefficient, 0.0))})


def fitted(fish: Fish, world: World) -> float:
    """Coefficient of the front with which two trials are nearest to the measured speeds."""

    def cost(logarithm: float) -> float:
        bluff = with_bluff_front(fish, world, np.exp(logarithm))
        return sum((speed(fish, bluff, trial) - SPEED[trial]) ** 2 for trial in FITTED)

    return float(np.exp(fminbound(cost, *np.log((0.01, 2.0)), xtol=0.01)))


def measure() -> list[dict]:
    """A row for each level of water and trial."""
    fish, rows = make_fish("tetrahedral", level=2, length=LENGTH, outline=OUTLINE / LENGTH), []
    levels = waters(fish, VISCOSITY)
    for name in ("drag", "reactive"):
        smooth, rough = levels[name], levels[f"{name}, friction"]
        coefficient = fitted(fish, rough)
        bluff = with_bluff_front(fish, rough, coefficient)
        for level, number, around in ((name, "", smooth), (f"{name}, friction", round(coefficient, 3), bluff)):
            for trial, frequency in enumerate(FREQUENCY):
                found = speed(fish, around, trial)
                rows.append({
                    "water": level, "coefficient": number, "frequency_hz": frequency,
                    "fitted": int(trial in FITTED and around is bluff), "speed_m_s": round(found, 4),
                    "published": SPEED[trial], "off_m_s": round(found - SPEED[trial], 4),
                })  # fmt: skip
    return rows


def draw() -> None:
    """Speed against frequency."""
    rows = read_table("validation/robot.csv")
    figure, (left, right) = panels(2, 4.2, width_ratios=(1.0, 1.4))
    left.plot(FREQUENCY, SPEED, "x", color=GREY, ms=9, mew=2, label="robot")
    levels = list(dict.fromkeys(row["water"] for row in rows))
    for level in levels:
        (speeds,) = columns(select(rows, water=level), "speed_m_s")
        left.plot(FREQUENCY, speeds, "o-", ms=4, color=COLOURS[level], label=level)
    left.set(xlabel="strokes a second", ylabel="speed, m/s", ylim=(0, None))
    errors = [np.abs(columns(select(rows, water=level, fitted=0), "off_m_s")).mean() for level in levels]
    labels = [*(level.replace(", ", ",\n") for level in levels), "fishsim", "elongated\nbody"]
    right.bar(labels, [*errors, THEIRS, ELONGATED], color=[*(COLOURS[level] for level in levels), GREY, GREY])
    right.set(ylabel="mean error, m/s")
    legend_below(figure, 5)
    save(figure, RESULTS / "validation" / "robot.svg")


if __name__ == "__main__":
    publish(__doc__, {"validation/robot.csv": measure}, draw)
