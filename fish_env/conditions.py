"""What holds the nodes of a tank while it runs: those that are dragged, fixed, or moved along a given way.

By elimination, a degree of freedom has no inverse mass (`fish_env.body.fix`) and keeps the velocity that it is given;
what is prescribed holds to the bit. By penalty, a spring without length draws the node to its place; it is stiffer than
the body by PENALTY, so what is prescribed holds but for an error in proportion to 1 / PENALTY.
`fish_env.conditioned` is the part of a tank that sets them.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from fish_env import forces
from fish_env.body import Body
from fish_env.checks import finite_array
from fish_env.linalg import rates
from fish_env.world import Anchors, World, make_anchors

PENALTY = 1e4  # of the largest entry of the stiffness matrix: the multiple that textbooks recommend
METHODS = ("elimination", "penalty")


class Motion(NamedTuple):
    """A way that nodes are moved along."""

    nodes: np.ndarray  # (K,)
    axes: np.ndarray  # (3,) True for those along which its displacements may be
    along: Callable[[float], Any]  # displacement (3,) or (K,3) m after a time, s
    moved: np.ndarray  # (K,3) which degrees of freedom nothing has taken from it since
    time: float = 0.0  # s since it began
    now: Any = 0.0  # (K,3) m, the displacement at that time

    def at(self, time: float) -> np.ndarray:
        """Displacement (K,3) m after a time, s; ValueError if it is none, or not along the axes alone."""
        wanted = (len(self.nodes), 3)
        found = np.asarray(self.along(time))
        found = finite_array(found, (3,) if found.shape == (3,) else wanted, f"along({time:g}) (m)")
        return along_axes(np.broadcast_to(found, wanted), self.axes, f"the displacement after {time:g} s", "m")


def along_axes(vectors: np.ndarray, axes: np.ndarray, what: str, unit: str) -> np.ndarray:
    """The vectors (K,3), or ValueError if one is not along the axes (3,) alone."""
    bad = np.flatnonzero(vectors[:, ~axes].any(axis=1))
    if bad.size:
        named = "".join(np.array(list("xyz"))[axes])
        raise ValueError(f"{what} is {vectors[bad[0]]} {unit}, not along the axes {named!r} alone; name more axes")
    return vectors


class Conditions(NamedTuple):
    """What holds the nodes of all bodies of a tank, beyond what their `Body` fixes."""

    held: np.ndarray  # (N,3) degrees of freedom that are eliminated
    velocity: np.ndarray  # (N,3) m/s, theirs
    penalties: Anchors | None  # where nodes are held by a penalty
    drag: Anchors | None  # what `grab` pulls, or the world was made with
    motions: tuple[Motion, ...] = ()  # along ways, of nodes that are eliminated or held by a penalty


def no_conditions(body: Body, world: World) -> Conditions:
    """Those of a tank as it is made."""
    shape = body.position.shape
    return Conditions(np.zeros(shape, dtype=bool), np.zeros(shape), None, world.anchors)


def largest_entry(body: Body) -> float:
    """Largest entry of the stiffness matrix at rest, N/m."""
    return float(abs(rates.assemble(forces.rest_matrices(body), body.position.size)).max())


def make_penalty(body: Body, nodes, point, velocity=(0.0, 0.0, 0.0), multiple=PENALTY) -> Anchors:
    """Critically damped springs without length from nodes (K,) to points (K,3) m that move at a velocity, m/s.

    Their stiffness is `multiple` times the largest entry of the stiffness matrix; they are damped for the mass of their
    node alone.

    Raises:
        ValueError: for a number that is not allowed, or a body without stiffness.
    """
    stiffness = multiple * largest_entry(body)
    if not stiffness > 0.0:
        raise ValueError("the body has no stiffness for a penalty to be a multiple of; hold it by elimination")
    damping: Any = 2.0 * np.sqrt(stiffness * body.mass[nodes])
    return make_anchors(nodes, point, stiffness, damping, velocity=velocity)


def carried(anchors: Anchors | None, duration: float) -> Anchors | None:
    """The anchors after a time, s."""
    return anchors and anchors._replace(point=anchors.point + duration * anchors.velocity)


def remaining(motions: tuple[Motion, ...], taken: np.ndarray) -> tuple[Motion, ...]:
    """The motions that have degrees of freedom left when those of a boolean array (N,3) are taken from them."""
    left = (motion._replace(moved=motion.moved & ~taken[motion.nodes]) for motion in motions)
    return tuple(motion for motion in left if motion.moved.any())


def without(anchors: Anchors, nodes) -> Anchors | None:
    """The anchors that do not hold any of these nodes (K,)."""
    kept = ~np.isin(anchors.node, nodes)
    return Anchors(*(array[kept] for array in anchors)) if kept.any() else None


def alike(one: Anchors | None, other: Anchors | None) -> bool:
    """Whether they differ at most in where they are and how they move."""
    if one is None or other is None:
        return one is other
    return all(np.array_equal(getattr(one, name), getattr(other, name))
               for name in ("node", "stiffness", "damping", "rest_length"))  # fmt: skip
