"""Base class of elastic objects: a body with the direction of gravity and its skin; and a room with walls around it."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from fish_env.checks import finite_array, is_whole, positive_array, real, representable
from fish_env.physics.fish import NOTHING, ElasticObject
from fish_env.physics.records import World
from fish_env.physics.world import GRAVITY, VACUUM


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


def make_world(gravity=(0.0, 0.0, 0.0), planes=(), viscosity=0.0, water: World = VACUUM) -> World:
    """Gravity, walls and air (Song 2009, ch. 4), with or without water.

    Args:
        gravity: (3,) m/s2.
        planes: walls, each (normal (3,), offset, restitution): bodies stay where normal . x >= offset, m, the normal
            being normalised. Restitution is the ratio of a node's normal speed after an impact to that before it: 1 is
            Song's perfect reflection, a smaller value his damped one, 0 no rebound.
        viscosity: drag on each node over its velocity, N s/m.
        water: result of `make_water`, or vacuum.

    Raises:
        ValueError: for an invalid part; the message names it, its value and the valid values.
    """
    rows = []
    if not isinstance(water, World):
        raise ValueError(f"water is a {type(water).__name__}; give fish_env.make_water(...)")
    if not isinstance(planes, Sequence | np.ndarray):
        raise ValueError(f"planes is {planes!r}; give a list of (normal (3,), offset in m, restitution)")
    for i, plane in enumerate(planes):
        try:
            normal, offset, restitution = plane
        except (TypeError, ValueError) as error:
            raise ValueError(f"plane {i} is {plane!r}; give (normal (3,), offset in m, restitution)") from error
        normal = finite_array(normal, (3,), f"normal of plane {i}")
        with representable(f"normal of plane {i}"):
            size = np.linalg.norm(normal)
        if not size > 0.0:
            raise ValueError(f"normal of plane {i} is {normal}; give a vector that is not null")
        offset = float(finite_array(offset, (), f"offset of plane {i} (m)"))
        restitution = float(finite_array(restitution, (), f"restitution of plane {i}"))
        if not 0.0 <= restitution <= 1.0:
            raise ValueError(f"restitution of plane {i} is {restitution}; give a number from 0 to 1")
        rows.append([*(normal / size), offset, restitution])
    return water._replace(
        gravity=finite_array(gravity, (3,), "gravity (m/s2)"),
        viscosity=float(positive_array(viscosity, (), "viscosity (N s/m)", zero=True)),
        planes=np.array(rows) if rows else None,
    )


def room(down, size: float, restitution=0.5, gravity=GRAVITY, closed=False) -> World:
    """Gravity, m/s2, and walls at `size` m from the origin along x and along `down`, (3,): the room of an object.

    `down` is a unit vector, along which gravity pulls; `restitution` is as of `make_world`. Closed, the room has walls
    on all six sides, floor and ceiling included, so that nothing can leave. ValueError for other numbers.
    """
    down, size, gravity = finite_array(down, (3,), "down"), float(positive_array(size, (), "size (m)")), real(gravity)
    if not math.isclose(np.linalg.norm(down), 1.0, rel_tol=1e-9):
        raise ValueError(f"down is {down}; give a unit vector")
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
