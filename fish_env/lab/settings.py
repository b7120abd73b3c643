"""The numbers that may be changed while a simulation runs: ranges, units and what they mean. All are checked here."""

import math
from typing import NamedTuple

import numpy as np

from fish_env.checks import real


def is_finite(value) -> bool:
    """Return True for a finite number that is not a bool."""
    return not isinstance(value, bool) and math.isfinite(real(value))


class Setting(NamedTuple):
    """A number that the page may set."""

    label: str
    low: float
    high: float
    default: float
    meaning: str

    def checked(self, value) -> float:
        """The value as a float; ValueError unless it is a number in the range."""
        if not (is_finite(value) and self.low <= value <= self.high):
            raise ValueError(f"{self.label} is {value!r}; give a number from {self.low:g} to {self.high:g}")
        return float(value)


def factor(label: str, high: float, meaning: str, low: float = 0.05) -> Setting:
    """A factor on a parameter of the object."""
    return Setting(label, low, high, 1.0, meaning)


BODY: dict[str, Setting] = {
    "stiffness": factor("stiffness", 5.0, "of all springs, tetrahedra and gas, over the object's own"),
    "damping": factor("damping", 5.0, "of all springs and tetrahedra, over the object's own", low=0.0),
    "pressure": factor("pressure", 3.0, "of the gas, over the object's own; 0 for none", low=0.0),
    "density": factor("density", 5.0, "mass of all nodes, over the object's own"),
    "inner_density": factor("inner density", 5.0, "mass of the inner layer, over the object's own"),
}
"""Settings of the body: a change of these builds the body again and keeps its motion."""

WORLD: dict[str, Setting] = {
    "gravity": Setting("gravity (m/s2)", -20.0, 20.0, 0.0, "downward"),
    "water": factor("water density", 5.0, "over that of the object's own water; 0 for none", low=0.0),
    "current_x": Setting("current x", -3.0, 3.0, 0.0, "of the water, lengths of the object a second"),
    "current_y": Setting("current y", -3.0, 3.0, 0.0, "of the water, lengths of the object a second"),
    "restitution": Setting("restitution", 0.0, 1.0, 0.5, "part of a node's normal speed that a wall leaves it"),
}
"""Settings of the world around the body."""

SETTINGS: dict[str, Setting] = BODY | WORLD | {"step": Setting("step", 0.1, 50.0, 1.0, "over the method's own step")}

WALLS = ("own", "none", "closed room")
"""The walls that the object comes with, none, or walls on all sides."""


def checked_setting(name, value) -> float:
    """The value of a setting; ValueError for a name that is not in SETTINGS or a value out of its range."""
    return SETTINGS[checked_choice(name, SETTINGS, "setting")].checked(value)


def checked_point(value, reach: float = math.inf, what: str = "point") -> np.ndarray:
    """A point or a direction that a page sends, (3,).

    Raises:
        ValueError: naming it, unless it is three finite numbers from -reach to reach.
    """
    if not (isinstance(value, list | tuple | np.ndarray) and len(value) == 3 and all(map(is_finite, value))):
        raise ValueError(f"{what} is {value!r}; give three finite numbers")
    if np.abs(value).max() > reach:
        raise ValueError(f"{what} is {value!r}; give three numbers from {-reach:g} to {reach:g} m")
    return np.array(value, dtype=float)


def checked_choice(value, options, what: str) -> str:
    """The value if it is one of the options, or ValueError naming them."""
    if not isinstance(value, str) or value not in options:
        raise ValueError(f"unknown {what} {value!r}; choose from {', '.join(map(repr, options))}")
    return value


def positive_or(value, default: float) -> float:
    """Return `value`, which the page reports of its camera, if it is positive and finite, else `default`."""
    return float(value) if is_finite(value) and value > 0.0 else default
