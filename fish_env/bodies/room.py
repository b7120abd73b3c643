"""Base class of elastic objects: a body with the direction of gravity and its skin; and the room around it."""

from dataclasses import dataclass, field

import numpy as np

from fish_env.checks import finite_array, is_whole, real
from fish_env.physics.fish import NOTHING, ElasticObject
from fish_env.physics.records import World
from fish_env.physics.world import make_world

GRAVITY = 9.81  # m/s2


@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class InRoom(ElasticObject):
    """An elastic object that falls, is thrown and is dragged in a room."""

    down: np.ndarray
    """(3,) direction of gravity, a unit vector: -y for the ring, -z for solid objects, along the string."""
    outer: np.ndarray
    """Nodes of the surface: those that a mouse may drag."""
    skin: np.ndarray
    """Faces (F,4) of the surface, outward, or edges (F,2) of a ring."""
    inner: np.ndarray = field(default_factory=NOTHING.copy)
    """Nodes of an inner layer, the partners of the outer ones in the same order; of most objects none."""
    kinds: dict[str, slice] = field(default_factory=dict)
    """Springs of each kind."""


def room(down, size: float, restitution=0.5, gravity=GRAVITY, closed=False) -> World:
    """Gravity, m/s2, and walls at `size` m from the origin along x and along `down`, (3,): the room of an object.

    Args:
        down: unit vector along which gravity pulls.
        size: from the origin to each wall, m.
        restitution: the part of a node's normal speed that an impact leaves it, 0 to 1.
        gravity: m/s2.
        closed: whether walls stand on all six sides, floor and ceiling included, so that nothing can leave.

    Raises:
        ValueError: for a restitution outside 0 to 1, or a number that is not finite.
    """
    down, size, gravity = finite_array(down, (3,), "down"), real(size), real(gravity)
    sides = {(1.0, 0.0, 0.0), (-1.0, 0.0, 0.0), tuple(down.tolist())}
    if closed:
        sides |= {tuple(side) for side in np.concatenate([np.eye(3), -np.eye(3)]).tolist()}
    return make_world(gravity * down, [(-np.array(side), -size, restitution) for side in sorted(sides)])


def whole(value, name: str, least: int, most: int | None = None) -> int:
    """`value` as an int, or ValueError unless it is a whole number from `least` to `most`."""
    if not (is_whole(value) and value >= least and (most is None or value <= most)):
        raise ValueError(
            f"{name} is {value!r}; give a whole number, {least} {'or more' if most is None else f'to {most}'}"
        )
    return int(value)
