"""What holds the nodes of a tank while it runs: those that are dragged, fixed, or moved along a given way.

By elimination, a degree of freedom has no inverse mass (`fish_env.physics.body.fix`) and keeps the velocity that it is
given; what is prescribed holds to the bit. By penalty, a spring without length draws the node to its place; it is
stiffer than the body by PENALTY, so what is prescribed holds but for an error in proportion to 1 / PENALTY.
A `Tank` has them in `Tank._conditions`; the functions here say what they become.
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


def moved(was: Conditions, nodes: np.ndarray, chosen: np.ndarray, along, penalty: Anchors | None) -> Conditions:
    """The conditions when nodes (K,) are moved along a way from now on, by elimination or by a penalty that is given.

    Args:
        was: the conditions until now.
        nodes: numbers of nodes.
        chosen: (3,) True for the axes along which they are moved.
        along: a velocity, m/s, (3,) or (K,3), or a function of the time that returns a displacement, m.
        penalty: what draws them to their places, with no velocity yet; None for elimination.

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
        taken[np.intersect1d(nodes, penalties.node)] = True  # a penalty is taken away whole
        penalties = without(penalties, nodes)
    return was._replace(held=held, velocity=prescribed, penalties=penalties,
                        motions=(*remaining(was.motions, taken), *motions))  # fmt: skip


def released(was: Conditions, nodes: np.ndarray, drag=True) -> Conditions:
    """The conditions that are left when nodes are let go, of a drag spring too unless that stays."""
    held, velocity, taken = was.held.copy(), was.velocity.copy(), np.zeros_like(was.held)
    held[nodes], velocity[nodes], taken[nodes] = False, 0.0, True
    penalties, pulled = (None if part is None else without(part, nodes) for part in (was.penalties, was.drag))
    return Conditions(held, velocity, penalties, pulled if drag else was.drag, remaining(was.motions, taken))


def set_out(was: Conditions, dt: float) -> Conditions:
    """The conditions of a step of dt s: nodes that are moved along ways have the velocities that take them there."""
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
    """Why a method has no stable step of dt s with the penalties in a world; "" if it has."""
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
