"""Boundary conditions of a running tank: nodes that are dragged, fixed, or moved along a prescribed path.

By elimination, a degree of freedom has zero inverse mass (`fish_env.physics.body.fix`) and keeps its prescribed
velocity exactly. By penalty, a spring of zero length draws the node to its place. It is PENALTY times stiffer than the
body, so the error is proportional to 1 / PENALTY.
A `Tank` stores its `Conditions`, a record; their methods return new ones.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from fish_env.checks import finite_array
from fish_env.physics import forces
from fish_env.physics.linalg import rates
from fish_env.physics.records import Anchors, Body
from fish_env.physics.world import join_anchors, make_anchors

PENALTY = 1e4  # times the largest entry of the stiffness matrix, as textbooks recommend
METHODS = ("elimination", "penalty")


class Motion(NamedTuple):
    """Prescribed motion of some nodes."""

    nodes: np.ndarray  # (K,)
    axes: np.ndarray  # (3,) True for the axes along which it may displace nodes
    along: Callable[[float], Any]  # displacement (3,) or (K,3) m after a time, s
    moved: np.ndarray  # (K,3) True for the degrees of freedom that it still moves
    time: float = 0.0  # s since it began
    now: Any = 0.0  # (K,3) m, the displacement at that time

    def at(self, time: float) -> np.ndarray:
        """Displacement (K,3) m after a time, s; ValueError if it is invalid or not along these axes only."""
        return vectors_along(self.along(time), self.nodes, self.axes, f"along({time:g})",
                             f"the displacement after {time:g} s", "m")  # fmt: skip


def vectors_along(given, nodes: np.ndarray, axes: np.ndarray, name: str, what: str, unit: str) -> np.ndarray:
    """Vectors (K,3) of the nodes from (3,) or (K,3); ValueError if one is invalid or not along the axes (3,) only."""
    given = np.asarray(given)
    given = finite_array(given, (3,) if given.shape == (3,) else (nodes.size, 3), f"{name} ({unit})")
    vectors = np.broadcast_to(given, (nodes.size, 3))
    bad = np.flatnonzero(vectors[:, ~axes].any(axis=1))
    if bad.size:
        letters = "".join(np.array(list("xyz"))[axes])
        raise ValueError(f"{what} is {vectors[bad[0]]} {unit}, not along the axes {letters!r} alone; name more axes")
    return vectors


class Conditions(NamedTuple):
    """Boundary conditions of the nodes of all bodies of a tank, beyond those that their `Body` fixes."""

    held: np.ndarray  # (N,3) degrees of freedom that are eliminated
    velocity: np.ndarray  # (N,3) m/s, prescribed velocity of those
    penalties: Anchors | None  # springs of the nodes that are fixed by penalty
    drag: Anchors | None  # the drag spring of `grab`, or the anchors that the world was made with
    motions: tuple[Motion, ...] = ()  # prescribed motions of nodes that are eliminated or fixed by penalty

    @property
    def anchors(self) -> Anchors | None:
        """Drag spring and penalties together."""
        return join_anchors(self.drag, self.penalties)

    def with_motion(self, nodes: np.ndarray, axes: np.ndarray, along, penalty: Anchors | None) -> Conditions:
        """Conditions when nodes (K,) start a prescribed motion along some axes (3,); see `Tank.move` for the arguments.

        `penalty` holds the springs that draw them to their places, with zero velocity; None stands for elimination.
        """
        velocity, motions = np.zeros((nodes.size, 3)), ()
        if callable(along):
            motion = Motion(nodes, axes, along, np.tile(axes, (nodes.size, 1)))
            start = motion.at(0.0)
            if start.any():
                raise ValueError(f"along(0.0) is {start[0]} m; a way begins where the nodes are, with zero")
            motions = (motion._replace(now=start),)
        else:
            velocity = vectors_along(along, nodes, axes, "velocity", "the velocity", "m/s")
        if penalty is not None:
            left = self.without(nodes, drag=False)
            penalties = join_anchors(left.penalties, penalty._replace(velocity=np.ascontiguousarray(velocity)))
            return left._replace(penalties=penalties, motions=(*left.motions, *motions))
        held, prescribed, taken = self.held.copy(), self.velocity.copy(), np.zeros_like(self.held)
        held[np.ix_(nodes, axes)] = taken[np.ix_(nodes, axes)] = True
        prescribed[np.ix_(nodes, axes)] = velocity[:, axes]
        if self.penalties is not None:
            taken[np.intersect1d(nodes, self.penalties.node)] = True  # a penalty is removed along all axes
        return Conditions(held, prescribed, anchors_without(self.penalties, nodes), self.drag,
                          (*motions_without(self.motions, taken), *motions))  # fmt: skip

    def without(self, nodes: np.ndarray, drag=True) -> Conditions:
        """Conditions after nodes are released, also from the drag spring unless `drag` is False."""
        held, velocity, taken = self.held.copy(), self.velocity.copy(), np.zeros_like(self.held)
        held[nodes], velocity[nodes], taken[nodes] = False, 0.0, True
        pulled = anchors_without(self.drag, nodes) if drag else self.drag
        penalties = anchors_without(self.penalties, nodes)
        return Conditions(held, velocity, penalties, pulled, motions_without(self.motions, taken))

    def begin_step(self, dt: float) -> Conditions:
        """Conditions of a step of dt s, with the velocities that move nodes along their prescribed motions."""
        moved, speed, motions = np.zeros_like(self.held), np.zeros_like(self.velocity), []
        for motion in self.motions:
            ahead = motion.at(motion.time + dt)
            moved[motion.nodes] |= motion.moved
            speed[motion.nodes] += np.where(motion.moved, (ahead - motion.now) / dt, 0.0)
            motions.append(motion._replace(time=motion.time + dt, now=ahead))
        velocity, penalties = np.where(self.held & moved, speed, self.velocity), self.penalties
        if penalties is not None:
            i = penalties.node
            penalties = penalties._replace(velocity=np.where(moved[i], speed[i], penalties.velocity))
        return self._replace(velocity=velocity, penalties=penalties, motions=tuple(motions))

    def move_anchors(self, duration: float) -> Conditions:
        """Conditions with the points of the anchors moved on by a time, s."""
        drag, penalties = (part and part._replace(point=part.point + duration * part.velocity)
                           for part in (self.drag, self.penalties))  # fmt: skip
        return self._replace(drag=drag, penalties=penalties)


def anchors_without(anchors: Anchors | None, nodes) -> Anchors | None:
    """Anchors that are not attached to any of these nodes (K,)."""
    kept = np.zeros(0, dtype=bool) if anchors is None else ~np.isin(anchors.node, nodes)
    return Anchors(*(array[kept] for array in anchors)) if anchors and kept.any() else None


def motions_without(motions: tuple[Motion, ...], taken: np.ndarray) -> tuple[Motion, ...]:
    """Motions that have degrees of freedom left after those of a boolean array (N,3) are removed."""
    left = (motion._replace(moved=motion.moved & ~taken[motion.nodes]) for motion in motions)
    return tuple(motion for motion in left if motion.moved.any())


def same_springs(one: Anchors | None, other: Anchors | None) -> bool:
    """Return True if the anchors match in all but the positions and velocities of their points."""
    if one is None or other is None:
        return one is other
    return all(np.array_equal(getattr(one, name), getattr(other, name))
               for name in ("node", "stiffness", "damping", "rest_length"))  # fmt: skip


def largest_entry(body: Body) -> float:
    """Largest entry of the stiffness matrix at rest, N/m."""
    return float(abs(rates.assemble(forces.rest_matrices(body), body.position.size)).max())


def make_penalty(body: Body, nodes, point, velocity=(0.0, 0.0, 0.0), multiple=PENALTY) -> Anchors:
    """Critically damped springs of zero length from nodes (K,) to points (K,3) m that move at a velocity, m/s.

    Their stiffness is `multiple` times the largest entry of the stiffness matrix. The damping is critical for the mass
    of their own node.

    Raises:
        ValueError: for an invalid number, or a body without stiffness.
    """
    stiffness = multiple * largest_entry(body)
    if not stiffness > 0.0:
        raise ValueError("the body has no stiffness for a penalty to be a multiple of; hold it by elimination")
    damping: Any = 2.0 * np.sqrt(stiffness * body.mass[nodes])
    return make_anchors(nodes, point, stiffness, damping, velocity=velocity)
