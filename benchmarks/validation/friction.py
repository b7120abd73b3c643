"""Skin friction, which the package's water lacks, as a force of one's own: the water drags on faces along themselves.

The mean coefficient of a laminar boundary layer on a flat plate is that of Blasius (1908). Nothing is fitted.
"""

import sys
from typing import NamedTuple

import numpy as np

from fish_env.kernels.compile import kernel
from fish_env.kernels.simd import dot, fma, sqrt
from fish_env.physics.forces import FORCES, water
from fish_env.physics.records import Body, World

ANYWHERE = True


class Friction(NamedTuple):
    """Parameters, in `World.extra`."""

    coefficient: np.ndarray  # (F,) half the density of the water times each face's coefficient, kg/m3


def present(body: Body, world: World) -> bool:
    """Return True if the world has friction."""
    return "friction" in (world.extra or {})


@kernel
def add_force(body, world, control, x, v, f, cache):
    """Add the force on every face, against the part of its velocity through the water that is along the face."""
    current = world.current[0] + control.current[0]
    for k in range(body.faces.nodes.shape[0]):
        a, w = water.area_vector(body, x, k), water.velocity(body, current, v, k)
        size = sqrt(dot(a, a))
        n = (1.0 / size) * a
        along = fma(-dot(n, w), n, w)
        water.scatter(body, k, (-world.friction.coefficient[k] * size * sqrt(dot(w, w))) * along, f)


def blasius(reynolds: float) -> float:
    """Mean friction coefficient of a laminar boundary layer on a flat plate, at a Reynolds number by its length."""
    return 1.328 / reynolds**0.5


def with_friction(world: World, body: Body, coefficient, density: float = 1000.0) -> World:
    """A world with skin friction beside all that it has, of one coefficient or one for each face (F,)."""
    FORCES["friction"] = sys.modules[__name__]
    each = 0.5 * density * np.broadcast_to(coefficient, len(body.faces.nodes)).astype(float)
    return world._replace(extra={**(world.extra or {}), "friction": Friction(each)})
