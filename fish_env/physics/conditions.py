"""Boundary conditions of a running tank: nodes that are dragged, fixed, or moved along a prescribed path.

By elimination, a degree of freedom has zero inverse mass (`fish_env.physics.body.fix`) and keeps its prescribed
velocity exactly. By penalty, a spring of zero length draws the node to its place. It is PENALTY times stiffer than the
body, so the error is proportional to 1 / PENALTY.
A `Tank` stores its conditions in `Tank._conditions`; the functions here return new ones.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from fish_env.checks import finite_array
from fish_env.physics import forces
from fish_env.physics.integrators import Integrator, leapfrog_chebyshev
from fish_env.physics.linalg import rates
from fish_env.physics.records import Anchors, Body, World
from fish_env.physics.world import joined, make_anchors

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
        wanted = (len(self.nodes), 3)
        found = np.asarray(self.along(time))
        found = finite_array(found, (3,) if found.shape == (3,) else wanted, f"along({time:g}) (m)")
        return along_axes(np.broadcast_to(found, wanted), self.axes, f"the displacement after {time:g} s", "m")


def along_axes(vectors: np.ndarray, axes: np.ndarray, what: str, unit: str) -> np.ndarray:
    """Return the vectors (K,3); ValueError if one is not along the axes (3,) only."""
    bad = np.flatnonzero(vectors[:, ~axes].any(axis=1))
    if bad.size:
        named = "".join(np.array(list("xyz"))[axes])
        raise ValueError(f"{what} is {vectors[bad[0]]} {unit}, not along the axes {named!r} alone; name more axes")
    return vectors


class Conditions(NamedTuple):
    """Boundary conditions of the nodes of all bodies of a tank, beyond those that their `Body` fixes."""

    held: np.ndarray  # (N,3) degrees of freedom that are eliminated
    velocity: np.ndarray  # (N,3) m/s, prescribed velocity of those
    penalties: Anchors | None  # springs of the nodes that are fixed by penalty
    drag: Anchors | None  # the drag spring of `grab`, or the anchors that the world was made with
    motions: tuple[Motion, ...] = ()  # prescribed motions of nodes that are eliminated or fixed by penalty


def no_conditions(body: Body, world: World) -> Conditions:
    """Conditions of a new tank."""
    shape = body.position.shape
    return Conditions(np.zeros(shape, dtype=bool), np.zeros(shape), None, world.anchors)


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


def carried(anchors: Anchors | None, duration: float) -> Anchors | None:
    """Move the points of the anchors on by a time, s."""
    return anchors and anchors._replace(point=anchors.point + duration * anchors.velocity)


def remaining(motions: tuple[Motion, ...], taken: np.ndarray) -> tuple[Motion, ...]:
    """Motions that have degrees of freedom left after those of a boolean array (N,3) are removed."""
    left = (motion._replace(moved=motion.moved & ~taken[motion.nodes]) for motion in motions)
    return tuple(motion for motion in left if motion.moved.any())


def without(anchors: Anchors, nodes) -> Anchors | None:
    """Anchors that are not attached to any of these nodes (K,)."""
    kept = ~np.isin(anchors.node, nodes)
    return Anchors(*(array[kept] for array in anchors)) if kept.any() else None


def alike(one: Anchors | None, other: Anchors | None) -> bool:
    """Return True if the anchors match in all but the positions and velocities of their points."""
    if one is None or other is None:
        return one is other
    return all(np.array_equal(getattr(one, name), getattr(other, name))
               for name in ("node", "stiffness", "damping", "rest_length"))  # fmt: skip


def moved(was: Conditions, nodes: np.ndarray, chosen: np.ndarray, along, penalty: Anchors | None) -> Conditions:
    """Conditions when nodes (K,) start a prescribed motion, by elimination or by the given penalty.

    Args:
        was: the previous conditions.
        nodes: node numbers.
        chosen: (3,) True for the axes along which they are moved.
        along: a velocity, m/s, (3,) or (K,3), or a function of the time that returns a displacement, m.
        penalty: springs that draw them to their places, with zero velocity; None for elimination.

    Raises:
        ValueError: for velocities or displacements of another shape, not finite, or along an axis that is left free.
    """
    velocity, motions = np.zeros((nodes.size, 3)), ()
    if callable(along):
        way = Motion(nodes, chosen, along, np.tile(chosen, (nodes.size, 1)))
        start = way.at(0.0)
        if start.any():
            raise ValueError(f"along(0.0) is {start[0]} m; a way begins where the nodes are, with zero")
        motions = (way._replace(now=start),)
    else:
        along = np.asarray(along)
        shape = (3,) if along.shape == (3,) else (nodes.size, 3)
        given = np.broadcast_to(finite_array(along, shape, "velocity (m/s)"), (nodes.size, 3))
        velocity = along_axes(given, chosen, "the velocity", "m/s")
    if penalty is not None:
        left = released(was, nodes, drag=False)
        penalties = joined(left.penalties, penalty._replace(velocity=np.ascontiguousarray(velocity)))
        return left._replace(penalties=penalties, motions=(*left.motions, *motions))
    held, prescribed, taken = was.held.copy(), was.velocity.copy(), np.zeros_like(was.held)
    held[np.ix_(nodes, chosen)] = taken[np.ix_(nodes, chosen)] = True
    prescribed[np.ix_(nodes, chosen)] = velocity[:, chosen]
    penalties = was.penalties
    if penalties is not None:
        taken[np.intersect1d(nodes, penalties.node)] = True  # a penalty is removed along all axes
        penalties = without(penalties, nodes)
    return was._replace(held=held, velocity=prescribed, penalties=penalties,
                        motions=(*remaining(was.motions, taken), *motions))  # fmt: skip


def released(was: Conditions, nodes: np.ndarray, drag=True) -> Conditions:
    """Conditions that remain after nodes are released, also from the drag spring unless `drag` is False."""
    held, velocity, taken = was.held.copy(), was.velocity.copy(), np.zeros_like(was.held)
    held[nodes], velocity[nodes], taken[nodes] = False, 0.0, True
    penalties, pulled = (None if part is None else without(part, nodes) for part in (was.penalties, was.drag))
    return Conditions(held, velocity, penalties, pulled if drag else was.drag, remaining(was.motions, taken))


def set_out(was: Conditions, dt: float) -> Conditions:
    """Conditions of a step of dt s, with the velocities that move nodes along their prescribed motions."""
    moved, speed, motions = np.zeros_like(was.held), np.zeros_like(was.velocity), []
    for motion in was.motions:
        ahead = motion.at(motion.time + dt)
        moved[motion.nodes] |= motion.moved
        speed[motion.nodes] += np.where(motion.moved, (ahead - motion.now) / dt, 0.0)
        motions.append(motion._replace(time=motion.time + dt, now=ahead))
    velocity, penalties = np.where(was.held & moved, speed, was.velocity), was.penalties
    if penalties is not None:
        i = penalties.node
        penalties = penalties._replace(velocity=np.where(moved[i], speed[i], penalties.velocity))
    return was._replace(velocity=velocity, penalties=penalties, motions=tuple(motions))


def too_stiff(body: Body, world: World, integrator: Integrator, dt: float) -> str:
    """Reason that a method is unstable at a step of dt s with the penalties in a world; "" if it is stable."""
    own = (body.max_stiffness_eigenvalue, body.max_damping_eigenvalue)
    elastic, viscous = (sum(part) for part in zip(own, *forces.bounds(body, world), strict=True))
    stiffer = body._replace(max_stiffness_eigenvalue=elastic, max_damping_eigenvalue=viscous)
    if integrator.kind == "explicit" and dt > integrator.limit(stiffer):
        limit = integrator.limit(stiffer)
        return f"beside the penalty, its stable steps are shorter than {limit:.2g} s, and dt is {dt:.2g} s"
    if integrator.kind == "stabilised":
        stages = leapfrog_chebyshev.stages_for(elastic, viscous, dt)
        if stages >= leapfrog_chebyshev.MOST_STAGES:
            return f"beside the penalty, a step of {dt:.2g} s would need more stages than {stages}"
    return ""
