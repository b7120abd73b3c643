"""Boundary conditions of a tank while it runs: nodes that are dragged, fixed, or moved along a given way.

By elimination, a degree of freedom has no inverse mass (`fish_env.body.fix`) and keeps the velocity that it is given;
what is prescribed holds to the bit. By penalty, a spring without length draws the node to its place; it is stiffer than
the body by PENALTY, so what is prescribed holds but for an error in proportion to 1 / PENALTY.
"""

from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from fish_env import forces
from fish_env.body import Body, Control, State, chosen_axes, fix_where, node_numbers
from fish_env.checks import finite_array
from fish_env.engine import Engine
from fish_env.forces.evaluate import Evaluator
from fish_env.integrators import Integrator, leapfrog_chebyshev
from fish_env.linalg import rates
from fish_env.tank_options import chosen_nodes, refused, varied
from fish_env.world import Anchors, World, joined, make_anchors

PENALTY = 1e4  # of the largest entry of the stiffness matrix: the multiple that textbooks recommend
METHODS = ("elimination", "penalty")


class Conditions(NamedTuple):
    """What holds the nodes of all bodies of a tank, beyond what their `Body` fixes."""

    held: np.ndarray  # (N,3) degrees of freedom that are eliminated
    velocity: np.ndarray  # (N,3) m/s, theirs
    penalties: Anchors | None  # where nodes are held by a penalty
    drag: Anchors | None  # what `grab` pulls, or the world was made with


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


class Conditioned:
    """The part of `fish_env.Tank` that drags, fixes, moves and releases nodes, of all of its bodies alike."""

    fish: Any
    world: World
    state: State
    control: Control
    integrator: Integrator
    dt: float
    num_fish: int
    variation: np.ndarray
    _own: Body
    _conditions: Conditions
    _engine: Engine | None

    def nearest(self, point, nodes=None, i=0) -> int:
        """The node of body i nearest to a point (3,) m: of `nodes`, their numbers, or of all; ValueError if missing."""
        which = chosen_nodes(nodes, i, self.state.x.shape)
        away = self.state.x[i, which] - finite_array(point, (3,), "point (m)")
        return int(which[np.argmin((away**2).sum(axis=1))])

    def grab(self, node: int, point, stiffness: float, damping=0.0, rest_length=0.0, velocity=(0.0, 0.0, 0.0)) -> None:
        """Pull a node of every body by a drag spring to a point (3,) m, in place of any before (`make_anchors`).

        The point moves on at `velocity` (3,) m/s, that of a hand, and the damping of the spring compares the node's
        velocity with it. A hand that is given its velocity does its work along its way; one that is put elsewhere
        before every call jumps, and stretches the spring at once.

        Raises:
            ValueError: for a missing node or a number that is not allowed.
        """
        if not (isinstance(node, int | np.integer) and 0 <= node < self.state.x.shape[1]):
            raise ValueError(f"node is {node!r}; give a whole number from 0 to {self.state.x.shape[1] - 1}")
        self._set_anchors(make_anchors([node], [point], stiffness, damping, rest_length, velocity))

    def fix(self, nodes, axes: str = "xyz", method: str = "elimination") -> None:
        """Hold nodes of every body where they are, until `release`; the rest of the state stays as it is.

        What a node held before gives way to it: its speed along these axes is lost. By elimination, the nodes stay
        where they are to the bit. By penalty they are drawn back there by a stiff, damped spring (`make_penalty`), and
        give way a little; explicit methods need short steps for it.

        Args:
            nodes: their numbers, or a boolean mask (N,).
            axes: of "x", "y" and "z"; by penalty all three.
            method: "elimination" or "penalty".

        Raises:
            ValueError: for a missing node, another axis or method, if nothing were left to move, or if the tank's
                integrator cannot serve the condition, with the reason; nothing is changed then.
        """
        self.move(nodes, np.zeros(3), axes, method)

    def move(self, nodes, velocity, axes: str = "xyz", method: str = "elimination") -> None:
        """Move nodes of every body at a constant velocity, until `fix`, `release` or another `move`; as `fix`.

        Call it before every `advance` for a motion whose velocity varies. The node takes the velocity at once, without
        the time that its inertia would need.

        Args:
            nodes: their numbers (K,), or a boolean mask (N,).
            velocity: m/s, (3,) for all nodes, or (K,3), one each; zero along axes that are left free.
            axes: of "x", "y" and "z", along which they are moved; by penalty all three.
            method: "elimination" or "penalty".

        Raises:
            ValueError: as `fix`, and for a velocity of another shape, not finite, or along an axis that is left free.
        """
        if method not in METHODS:
            raise ValueError(f"method is {method!r}; choose from {', '.join(map(repr, METHODS))}")
        nodes, along = node_numbers(self._own, nodes), chosen_axes(axes)
        velocity = np.asarray(velocity)
        shape = (3,) if velocity.shape == (3,) else (nodes.size, 3)
        velocity = np.broadcast_to(finite_array(velocity, shape, "velocity (m/s)"), (nodes.size, 3))
        if velocity[:, ~along].any():
            raise ValueError(f"the velocity {velocity[0]} m/s is not along the axes {axes!r} alone; name more axes")
        was = self._conditions
        if method == "penalty":
            if not along.all():
                raise ValueError(f"a penalty holds a node along all axes, not along {axes!r} only; use elimination")
            found = self._without(nodes, drag=False)
            new = make_penalty(self._own, nodes, self._common_place(nodes), velocity)
            self._apply(found._replace(penalties=joined(found.penalties, new)))
            return
        held, prescribed = was.held.copy(), was.velocity.copy()
        held[np.ix_(nodes, along)] = True
        prescribed[np.ix_(nodes, along)] = velocity[:, along]
        penalties = None if was.penalties is None else without(was.penalties, nodes)
        self._apply(was._replace(held=held, velocity=prescribed, penalties=penalties))

    def release(self, nodes=None) -> None:
        """Let go of what `grab` holds; or of nodes, whatever holds them: `grab`, `fix` or `move`.

        They go on at the velocity that they have. What the body itself fixes (`fish_env.body.fix`) stays fixed.

        Args:
            nodes: their numbers, or a boolean mask (N,); None for the drag spring alone.

        Raises:
            ValueError: for a missing node.
        """
        if nodes is None:
            self._set_anchors(None)
        else:
            self._apply(self._without(node_numbers(self._own, nodes)))

    @property
    def conditioned(self) -> bool:
        """Whether a node is held by elimination, or an anchor is on the move: `advance` sees to both."""
        anchors = self.world.anchors
        return bool(self._conditions.held.any()) or (anchors is not None and bool(anchors.velocity.any()))

    @property
    def fixed(self) -> np.ndarray:
        """(N,3) True for each degree of freedom that is fixed or moved: by `fix`, by `move`, or by the body itself."""
        found = self.fish.body.inverse_mass == 0.0
        if self._conditions.penalties is not None:
            found[self._conditions.penalties.node] = True
        return found

    def reactions(self) -> np.ndarray:
        """Force on every body that holds its fixed and moved nodes, (B,N,3) N; zero on all others.

        By elimination, what all other forces leave to balance at the present positions and velocities; by penalty, the
        pull of its springs. A wall that such a node touches carries no part of it.
        """
        body, found = self.fish.body, np.zeros_like(self.state.x)
        world = self.world._replace(anchors=self._conditions.drag)
        names = tuple(name for name in forces.present(body, world) if not hasattr(forces.FORCES[name], "JUMPS"))
        bearing, rest = body.inverse_mass == 0.0, self.control.rest_length
        if bearing.any():
            for i, row in enumerate(self.variation):
                force = Evaluator(*varied(body, world, row), names).force(rest[i], self.state.x[i], self.state.v[i])
                found[i][bearing] = -force[bearing]
        pulling = self._conditions.penalties
        if pulling is not None:
            i, c, k = pulling.node, pulling.stiffness[:, None], pulling.damping[:, None]
            found[:, i] += c * (pulling.point - self.state.x[:, i]) + k * (pulling.velocity - self.state.v[:, i])
        return found

    def _without(self, nodes, drag=True) -> Conditions:
        """The conditions that are left when nodes are let go."""
        was = self._conditions
        held, velocity = was.held.copy(), was.velocity.copy()
        held[nodes], velocity[nodes] = False, 0.0
        penalties, pulled = (None if part is None else without(part, nodes) for part in (was.penalties, was.drag))
        return Conditions(held, velocity, penalties, pulled if drag else was.drag)

    def _common_place(self, nodes) -> np.ndarray:
        """Where the nodes (K,) of all bodies are, (K,3) m; ValueError unless it is the same for all."""
        places = self.state.x[:, nodes]
        if (places != places[0]).any():
            raise ValueError(
                "the nodes of the bodies of this tank are in different places, and a penalty draws all to the same; "
                "use elimination, or a tank of one body"
            )
        return places[0]

    def _set_anchors(self, anchors: Anchors | None) -> None:
        self._apply(self._conditions._replace(drag=anchors))

    def _apply(self, new: Conditions) -> None:
        """Let these conditions hold from now on, unless the method cannot serve them."""
        was, before = self._conditions, self.fish.body
        same = np.array_equal(new.held, was.held)
        body = before if same else fix_where(self._own, new.held) if new.held.any() else self._own
        world = self.world._replace(anchors=joined(new.drag, new.penalties))
        reason = self.integrator.refuses(body, world) or (new.penalties and self._too_stiff(body, world))
        if reason:
            raise refused(self.fish, self.integrator, reason)
        follows = same and alike(self.world.anchors, world.anchors)
        self.fish = self.fish if same else replace(self.fish, body=body)
        self.world, self._conditions = world, new
        if self._engine is not None and not follows:
            self._engine = Engine(self)
        elif self._engine is not None and world.anchors is not None:
            self._engine.follow(world.anchors)
        self._impose()

    def _too_stiff(self, body: Body, world: World) -> str:
        """Why the method has no stable step of the tank's length with the penalties; "" if it has."""
        own = (body.max_stiffness_eigenvalue, body.max_damping_eigenvalue)
        elastic, viscous = (sum(part) for part in zip(own, *forces.bounds(body, world), strict=True))
        stiffer = body._replace(max_stiffness_eigenvalue=elastic, max_damping_eigenvalue=viscous)
        if self.integrator.kind == "explicit":
            limit = self.integrator.limit(stiffer)
            if self.dt > limit:
                return f"beside the penalty, its stable steps are shorter than {limit:.2g} s, and dt is {self.dt:.2g} s"
        if self.integrator.kind == "stabilised":
            stages = leapfrog_chebyshev.stages_for(elastic, viscous, self.dt)
            if stages >= leapfrog_chebyshev.MOST_STAGES:
                return f"beside the penalty, a step of {self.dt:.2g} s would need more stages than {stages}"
        return ""

    def _impose(self) -> None:
        """Give the eliminated degrees of freedom of the bodies that are alive their velocities."""
        held = self._conditions.held
        if held.any():
            alive = self.state.failure == 0
            self.state.v[:] = np.where(held & alive[:, None, None], self._conditions.velocity, self.state.v)

    def _carry(self, duration: float) -> None:
        """Move the points of moving anchors on by the time that has gone by."""
        if self.world.anchors is not None and self.world.anchors.velocity.any():
            drag, penalties = (carried(part, duration) for part in (self._conditions.drag, self._conditions.penalties))
            self._conditions = self._conditions._replace(drag=drag, penalties=penalties)
            anchors = joined(drag, penalties)
            self.world = self.world._replace(anchors=anchors)
            if self._engine is not None and anchors is not None:
                self._engine.follow(anchors)


def carried(anchors: Anchors | None, duration: float) -> Anchors | None:
    """The anchors after a time, s."""
    return anchors and anchors._replace(point=anchors.point + duration * anchors.velocity)


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
