"""Boundary conditions of a running tank: nodes that are dragged, fixed, or moved along a prescribed path.

`Tank.grab`, `fix`, `move` and `release` call these functions. By elimination, a degree of freedom has zero inverse mass
(`fish_env.physics.body.fix`) and keeps its prescribed velocity exactly. By penalty, a spring of zero length draws the
node to its place. It is PENALTY times stiffer than the body, so the error is proportional to 1 / PENALTY.
A `Tank` stores its `Conditions`, a record; their methods return new ones.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from fish_env.checks import check_names, finite_array, frozen, is_whole, node_array, positive_array
from fish_env.physics import forces
from fish_env.physics.body import chosen_axes, fix_where, node_numbers
from fish_env.physics.engine import Engine
from fish_env.physics.forces.evaluate import Evaluator
from fish_env.physics.linalg import rates
from fish_env.physics.records import Anchors, Body
from fish_env.physics.tank import Tank
from fish_env.physics.tank_options import integrator_error, too_long

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
        """Conditions when nodes (K,) start a prescribed motion along some axes (3,): see `Tank.move`."""
        # `penalty` holds the springs that draw them to their places, with zero velocity; None stands for elimination.
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


def present(tank: Tank) -> Conditions:
    """The present conditions of a tank: where none has been set, those of its world."""
    shape = tank.fish.body.position.shape
    return tank._conditions or Conditions(np.zeros(shape, dtype=bool), np.zeros(shape), None, tank.world.anchors)


def grab(tank: Tank, node: int, point, stiffness, damping, rest_length, velocity) -> None:
    """`Tank.grab`."""
    if not (is_whole(node) and 0 <= node < tank.state.x.shape[1]):
        raise ValueError(f"node is {node!r}; give a whole number from 0 to {tank.state.x.shape[1] - 1}")
    point, velocity = finite_array(point, (3,), "point (m)"), finite_array(velocity, (3,), "velocity (m/s)")
    apply(tank, present(tank)._replace(drag=make_anchors([node], [point], stiffness, damping, rest_length, velocity)))


def move(tank: Tank, nodes, along, axes: str, method: str) -> None:
    """`Tank.move`."""
    check_names("method is", METHODS, method)
    nodes, chosen = node_numbers(tank._own, nodes), chosen_axes(axes)
    penalty, places = None, tank.state.x[:, nodes]
    if method == "penalty":
        if not chosen.all():
            raise ValueError(f"a penalty holds a node along all axes, not along {axes!r} only; use elimination")
        if (places != places[0]).any():
            raise ValueError(
                "the nodes of the bodies of this tank are in different places, and a penalty draws all to the "
                "same; use elimination, or a tank of one body"
            )
        penalty = make_penalty(tank._own, nodes, places[0])
    apply(tank, present(tank).with_motion(nodes, chosen, along, penalty))


def release(tank: Tank, nodes) -> None:
    """`Tank.release`."""
    now = present(tank)
    apply(tank, now._replace(drag=None) if nodes is None else now.without(node_numbers(tank._own, nodes)))


def apply(tank: Tank, new: Conditions) -> None:
    """Apply these conditions from now on; raise ValueError if the method does not support them."""
    same, body = np.array_equal(new.held, present(tank).held), tank.fish.body
    if not same:
        body = fix_where(tank._own, new.held) if new.held.any() else tank._own
    world = tank.world._replace(anchors=new.anchors)
    fish = tank.fish if same else replace(tank.fish, body=body)
    reason = tank.integrator.refuses(body, world) or (new.penalties and too_long(fish, world, tank.integrator, tank.dt))
    if reason:
        raise integrator_error(tank.fish, tank.integrator, reason)
    follows = same and same_springs(tank.world.anchors, world.anchors)
    tank._set_read_only(fish=fish if same else frozen(fish), world=frozen(world))
    tank._conditions = new
    if tank._engine is not None and not follows:
        tank._engine = Engine(tank)
    update_anchors(tank)
    start_penalties(tank)
    impose(tank)


def run(tank: Tank, steps: int) -> None:
    """Advance a tank under its conditions."""
    if not tank._conditions.motions:
        _run_evenly(tank, steps)
        return
    rate = tank.control.rate.copy()
    for _ in range(steps):
        tank._conditions = tank._conditions.begin_step(tank.dt)
        update_anchors(tank)
        start_penalties(tank)
        alive = tank.alive
        tank.control.rate[alive] = rate[alive]  # a run sets these rates to zero
        _run_evenly(tank, 1)


def _run_evenly(tank: Tank, steps: int) -> None:
    """Advance by steps in which moved nodes keep their velocity."""
    impose(tank)
    tank._run_evenly(steps)
    if tank.world.anchors is not None and tank.world.anchors.velocity.any():
        tank._conditions = tank._conditions.move_anchors(steps * tank.dt)
        update_anchors(tank)


def impose(tank: Tank) -> None:
    """Set the velocities of the eliminated degrees of freedom of all valid bodies."""
    held = tank._conditions.held
    if held.any():
        tank.state.v[:] = np.where(held & tank.alive[:, None, None], tank._conditions.velocity, tank.state.v)


def start_penalties(tank: Tank) -> None:
    """Set the velocities of nodes that penalties hold or move to those prescribed: else they would swing in first."""
    penalties = tank._conditions.penalties
    if penalties is not None:
        tank.state.v[np.ix_(np.flatnonzero(tank.alive), penalties.node)] = penalties.velocity


def update_anchors(tank: Tank) -> None:
    """Copy the points and velocities of the anchors, which stay the same otherwise, to the world and the engine."""
    anchors = tank._conditions.anchors
    if anchors is not None:
        tank._set_read_only(world=frozen(tank.world._replace(anchors=anchors)))
        for block in [] if tank._engine is None else tank._engine.blocks:
            kind = tank.kind
            block.world.anchors.set(point=kind.rows(anchors.point), velocity=kind.rows(anchors.velocity))


def acting(tank: Tank) -> bool:
    """Return True if a node is fixed by elimination or an anchor moves."""
    moving = tank.world.anchors is not None and tank.world.anchors.velocity.any()
    return bool(tank._conditions.motions or moving or tank._conditions.held.any())


def fixed(tank: Tank) -> np.ndarray:
    """`Tank.fixed`."""
    found, penalties = tank.fish.body.inverse_mass == 0.0, present(tank).penalties
    if penalties is not None:
        found[penalties.node] = True
    return found


def reactions(tank: Tank) -> np.ndarray:
    """`Tank.reactions`."""
    body, found, now = tank.fish.body, np.zeros_like(tank.state.x), present(tank)
    world = tank.world._replace(anchors=now.drag)
    names = tuple(name for name in forces.present(body, world) if not hasattr(forces.FORCES[name], "JUMPS"))
    bearing, rest = body.inverse_mass == 0.0, tank.control.rest_length
    if bearing.any():
        for i in range(tank.num_fish):
            force = Evaluator(*tank._varied(i, world), names).force(rest[i], tank.state.x[i], tank.state.v[i])
            found[i][bearing] = -force[bearing]
    pulling = now.penalties
    if pulling is not None:
        i, c, k = pulling.node, pulling.stiffness[:, None], pulling.damping[:, None]
        found[:, i] += c * (pulling.point - tank.state.x[:, i]) + k * (pulling.velocity - tank.state.v[:, i])
    return found


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
    """Critically damped springs of zero length from nodes (K,) to points (K,3) m that move at a velocity, m/s."""
    # Their stiffness is `multiple` times the largest entry of the stiffness matrix. The damping is critical for the
    # mass of their own node. ValueError for an invalid number, or a body without stiffness.
    stiffness = multiple * largest_entry(body)
    if not stiffness > 0.0:
        raise ValueError("the body has no stiffness for a penalty to be a multiple of; hold it by elimination")
    damping: Any = 2.0 * np.sqrt(stiffness * body.mass[nodes])
    return make_anchors(nodes, point, stiffness, damping, velocity=velocity)


def make_anchors(node, point, stiffness, damping=0.0, rest_length=0.0, velocity=(0.0, 0.0, 0.0)) -> Anchors:
    """Springs from nodes (A,) to points (A,3) m; all else is one number or one each. ValueError for an invalid part."""
    nodes = node_array(np.reshape(node, (-1, 1)), 1, np.iinfo(np.int64).max, "anchors")[:, 0].copy()
    a = nodes.size

    def each(value, shape, name, check, **options):
        try:
            return np.ascontiguousarray(check(np.broadcast_to(value, shape), shape, name, **options))
        except ValueError as error:
            raise ValueError(f"{name} of the anchors: {error}") from error

    return Anchors(
        nodes,
        each(point, (a, 3), "point (m)", finite_array),
        each(velocity, (a, 3), "velocity (m/s)", finite_array),
        each(stiffness, (a,), "stiffness (N/m)", positive_array, zero=True),
        each(damping, (a,), "damping (N s/m)", positive_array, zero=True),
        each(rest_length, (a,), "rest_length (m)", positive_array, zero=True),
    )


def join_anchors(one: Anchors | None, other: Anchors | None) -> Anchors | None:
    """Concatenate two sets of anchors, either of which may be None."""
    if one is None or other is None:
        return other if one is None else one
    return Anchors(*(np.concatenate(pair) for pair in zip(one, other, strict=True)))
