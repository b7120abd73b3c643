"""The numbers that may be changed while a simulation runs: ranges, units and what they mean. All are checked here."""

from numbers import Real
from typing import NamedTuple

import numpy as np


class Setting(NamedTuple):
    """A number that the page may set."""

    label: str
    low: float
    high: float
    default: float
    meaning: str

    def checked(self, value) -> float:
        """The value as a float.

        Raises:
            ValueError: unless it is a finite number in the range.
        """
        number = float(value) if isinstance(value, Real) and not isinstance(value, bool) else np.nan
        if not self.low <= number <= self.high:
            raise ValueError(f"{self.label} is {value!r}; give a number from {self.low:g} to {self.high:g}")
        return number


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

METHOD: dict[str, Setting] = {
    "step": Setting("step", 0.1, 50.0, 1.0, "over the method's own step"),
}

SETTINGS: dict[str, Setting] = BODY | WORLD | METHOD

WALLS = ("own", "none", "closed room")
"""The walls that the object comes with, none, or walls on all sides."""


def checked_setting(name, value) -> float:
    """The value of a setting, or ValueError for a name that is not in SETTINGS or a value out of its range."""
    if name not in SETTINGS:
        raise ValueError(f"unknown setting {name!r}; choose from {', '.join(SETTINGS)}")
    return SETTINGS[name].checked(value)


def checked_point(value, reach: float) -> np.ndarray:
    """A point of the page, (3,) m, or ValueError unless it is finite and at most `reach` from the origin."""
    try:
        point = np.array(value, dtype=float)
    except (TypeError, ValueError) as error:
        raise ValueError(f"point is {value!r}; give three finite numbers") from error
    if point.shape != (3,) or not np.isfinite(point).all() or np.abs(point).max() > reach:
        raise ValueError(f"point is {value!r}; give three numbers from {-reach:g} to {reach:g} m")
    return point


def chosen(value, options, what: str):
    """The value if it is one of the options, or ValueError naming them."""
    if not isinstance(value, str) or value not in options:
        raise ValueError(f"unknown {what} {value!r}; choose from {', '.join(map(repr, options))}")
    return value
