"""Parameters of bodies, read from the files beside this one that `benchmarks/calibration` writes."""

import json

import numpy as np

from fish_env.checks import check_names, positive_array
from fish_env.kernels.data import data
from fish_env.physics.records import World

WATERS = ("drag", "reactive")
"""Levels of water that fish are calibrated for: each has its own parameters, gaits and tables of motor controllers."""
DEFAULT_WATER = "reactive"
SHAPES = {"bending": (5,), "pull": (3,), "shear": (), "drag": (6,), "damping": ()}


def read_calibration(body: str, water: str | None = None) -> dict:
    """Part of a body's file for a level of WATERS, or ValueError: its "parameters", and how they were found."""
    found, level = json.loads(data("fish_env.bodies", f"{body}.json").read_text("utf-8")), check_level(water)
    if level not in found:
        known = ", ".join(f"water={name!r}" for name in found)
        raise ValueError(f"the {body} fish is not calibrated for water={level!r}; give {known}")
    return found[level]


def check_level(water: str | None) -> str:
    """Return a level of WATERS, by default DEFAULT_WATER; ValueError for another."""
    level = DEFAULT_WATER if water is None else water
    check_names("no fish is calibrated for water", WATERS, level)
    return level


def level_of(water: World) -> str:
    """The level of WATERS that water is of."""
    return "drag" if water.added_mass is None else "reactive"


def fitted_parameters(body: str, water: str | None, *given) -> list[np.ndarray]:
    """Parameters as arrays, in order and shapes those of SHAPES, None for the fitted value; ValueError for others."""
    found = read_calibration(body, water)["parameters"] if any(value is None for value in given) else {}
    return [
        positive_array(found[name] if value is None else value, shape, name)
        for (name, shape), value in zip(SHAPES.items(), given, strict=True)
    ]
