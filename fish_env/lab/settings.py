"""The numbers of an object and its surroundings that may be changed while it moves: ranges, units, what they mean."""

from typing import NamedTuple


class Setting(NamedTuple):
    """A number that the page may set."""

    label: str
    low: float
    high: float
    default: float
    meaning: str


BODY: dict[str, Setting] = {
    "stiffness": Setting("stiffness", 0.05, 5.0, 1.0, "of all springs, tetrahedra and gas, over the object's own"),
    "damping": Setting("damping", 0.0, 5.0, 1.0, "of all springs and tetrahedra, over the object's own"),
    "pressure": Setting("pressure", 0.0, 3.0, 1.0, "of the gas, over the object's own; 0 for none"),
    "density": Setting("density", 0.05, 5.0, 1.0, "mass of all nodes, over the object's own"),
    "inner_density": Setting("inner density", 0.05, 5.0, 1.0, "mass of the inner layer, over the object's own"),
}
"""Settings of the body: a change of these builds the body again and keeps its motion."""

SETTINGS: dict[str, Setting] = BODY | {
    "gravity": Setting("gravity (m/s2)", -20.0, 20.0, 0.0, "downward"),
    "water": Setting("water density", 0.0, 5.0, 1.0, "over that of the object's own water; 0 for none"),
    "current_x": Setting("current x", -3.0, 3.0, 0.0, "of the water, lengths of the object a second"),
    "current_y": Setting("current y", -3.0, 3.0, 0.0, "of the water, lengths of the object a second"),
    "restitution": Setting("restitution", 0.0, 1.0, 0.5, "part of a node's normal speed that a wall leaves it"),
    "step": Setting("step", 0.1, 50.0, 1.0, "over the method's own step"),
}
WALLS = ("own", "none", "closed room")
"""The walls that the object comes with, none, or walls on all sides."""
