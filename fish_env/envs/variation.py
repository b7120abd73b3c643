"""Variation between episodes of any task: the body, the water and its current, the pose."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from fish_env.bodies import Fish
from fish_env.checks import check_names
from fish_env.physics.tank import Tank
from fish_env.tasks.options import Option
from fish_env.tasks.start import POSE_OPTIONS

VARIATIONS: dict[str, Option] = {
    "stiffness": Option(0.5, 2.0, "factor on the stiffness and damping of every spring"),
    "mass": Option(0.5, 2.0, "factor on the mass"),
    "drag": Option(0.5, 2.0, "factor on the drag and the friction of the water"),
    "strength": Option(0.25, 1.25, "factor on how far the muscles contract"),
    "contraction_time": Option(0.5, 2.0, "factor on the time that a contraction takes"),
    "length": Option(0.5, 2.0, "factor on the length of a fish of the same tissue: all else counts in its lengths"),
    "current": Option(0.0, 1.0, "speed of the water, body lengths per second"),
    "current_heading": Option(-np.pi, np.pi, "where the water flows to, rad"),
    "pitch": POSE_OPTIONS["pitch"],
    "roll": POSE_OPTIONS["roll"],
}
"""Keys of the keyword `variation` and, in addition to the task's own, of `reset(options=...)`."""

FACTORS = ("stiffness", "mass", "drag", *(f"current {k}" for k in "xyz"), "strength", "contraction_time", "length")
"""What a privileged observation ends with: factors of the fish (on stiffness over squared length), its current, m/s."""


def factors_of(tank: Tank[Fish], i: int | slice) -> np.ndarray:
    """The present values of FACTORS of fish i, (9,), or of several, (K,9)."""
    return np.concatenate([tank.variation[i], tank.muscle_variation[i], tank.length_variation[i, None]], axis=-1)


def checked_variation(given: Mapping[str, Any]) -> dict[str, tuple[float, float]]:
    """The range of every key given, or ValueError saying what is allowed."""
    if not isinstance(given, Mapping):
        raise ValueError(f"variation is {given!r}; give a dict with keys among {', '.join(VARIATIONS)}")
    check_names("unknown variation", VARIATIONS, *given)
    return {  # in this order whatever the order given: numbers are drawn one after the other
        name: option.checked_range(f"variation[{name!r}]", given[name])
        for name, option in VARIATIONS.items()
        if name in given
    }


def draw(variation: Mapping[str, tuple[float, float]], generator: np.random.Generator) -> dict[str, float]:
    """A value for every key, uniform over its range; a current without a heading flows anywhere."""
    drawn = {name: generator.uniform(*bounds) for name, bounds in variation.items()}
    if "current" in drawn and "current_heading" not in drawn:
        drawn["current_heading"] = generator.uniform(-np.pi, np.pi)
    return drawn


def vary(tank: Tank[Fish], i: int, values: Mapping[str, float]) -> None:
    """Give fish i of the tank the body and the water of these values; values without a name are the original ones."""
    # A fish of r times the length has muscles as fast, since a key changes one thing: `make_fish(length=...)` slows
    # them by r^0.52 (docs/physics-more.md, eq. 74).
    names = ("stiffness", "mass", "drag", "strength", "contraction_time", "length")
    factors = {name: values[name] for name in names if name in values}
    heading, speed = values.get("current_heading", 0.0), values.get("current", 0.0) * tank.fish.length
    tank.vary(i, **factors, current=(speed * np.cos(heading), speed * np.sin(heading), 0.0))
