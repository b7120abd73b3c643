"""The part of a tank that drags, fixes, moves and releases nodes while it runs."""

from dataclasses import replace
from typing import Any

import numpy as np

from fish_env import forces
from fish_env.body import Body, Control, State, chosen_axes, fix_where, node_numbers
from fish_env.checks import Settled, finite_array, frozen, is_whole
from fish_env.conditions import (
    METHODS,
    Conditions,
    Motion,
    alike,
    along_axes,
    carried,
    make_penalty,
    remaining,
    without,
)
from fish_env.engine import Engine
from fish_env.forces.evaluate import Evaluator
from fish_env.integrators import Integrator, leapfrog_chebyshev
from fish_env.tank_options import chosen_nodes, refused, varied
from fish_env.world import Anchors, World, joined, make_anchors


class Conditioned(Settled):
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
        if not (is_whole(node) and 0 <= node < self.state.x.shape[1]):
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

    def move(self, nodes, along, axes: str = "xyz", method: str = "elimination") -> None:
        """Move nodes of every body along a way, until `fix`, `release` or another `move`; otherwise as `fix`.

        A node takes its velocity at once, without the time that its inertia would need. A function is asked before
        every step of dt where the step ends, and within the step the node moves there evenly: at the end of every step
        it is on its way. A body that is reset goes on from where it is put, by what its way has left.

        Args:
            nodes: their numbers (K,), or a boolean mask (N,).
            along: a constant velocity, m/s, (3,) for all nodes, or (K,3), one each; or a function of the time since
                now, s, that returns their displacement from where they are now, m, (3,) or (K,3), zero at time 0.
                Zero along axes that are left free.
            axes: of "x", "y" and "z", along which they are moved; by penalty all three.
            method: "elimination" or "penalty".

        Raises:
            ValueError: as `fix`, and for velocities or displacements of another shape, not finite, or along an axis
                that is left free; `advance` raises it for a displacement that a function returns later, and has then
                moved the bodies up to there.
        """
        if method not in METHODS:
            raise ValueError(f"method is {method!r}; choose from {', '.join(map(repr, METHODS))}")
        nodes, chosen = node_numbers(self._own, nodes), chosen_axes(axes)
        if method == "penalty" and not chosen.all():
            raise ValueError(f"a penalty holds a node along all axes, not along {axes!r} only; use elimination")
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
        was = self._conditions
        if method == "penalty":
            found = self._without(nodes, drag=False)
            new = make_penalty(self._own, nodes, self._common_place(nodes), velocity)
            self._apply(found._replace(penalties=joined(found.penalties, new), motions=(*found.motions, *motions)))
            return
        held, prescribed = was.held.copy(), was.velocity.copy()
        held[np.ix_(nodes, chosen)] = True
        prescribed[np.ix_(nodes, chosen)] = velocity[:, chosen]
        taken = np.zeros_like(held)
        taken[np.ix_(nodes, chosen)] = True
        penalties = was.penalties
        if penalties is not None:
            taken[np.intersect1d(nodes, penalties.node)] = True  # a penalty is taken away whole
            penalties = without(penalties, nodes)
        motions = (*remaining(was.motions, taken), *motions)
        self._apply(was._replace(held=held, velocity=prescribed, penalties=penalties, motions=motions))

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
        anchors, conditions = self.world.anchors, self._conditions
        moving = bool(conditions.motions) or (anchors is not None and bool(anchors.velocity.any()))
        return moving or bool(conditions.held.any())

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
        taken = np.zeros_like(held)
        taken[nodes] = True
        penalties, pulled = (None if part is None else without(part, nodes) for part in (was.penalties, was.drag))
        return Conditions(held, velocity, penalties, pulled if drag else was.drag, remaining(was.motions, taken))

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
        fish = self.fish if same else frozen(replace(self.fish, body=body))
        self._settle_anew(fish=fish, world=frozen(world))
        self._conditions = new
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

    def _set_out(self) -> None:
        """Give the nodes that are moved along ways the velocities that take them there in a step."""
        was, moved, motions = self._conditions, np.zeros_like(self._conditions.held), []
        speed = np.zeros_like(was.velocity)
        for motion in was.motions:
            time = motion.time + self.dt
            ahead = motion.at(time)
            moved[motion.nodes] |= motion.moved
            speed[motion.nodes] += np.where(motion.moved, (ahead - motion.now) / self.dt, 0.0)
            motions.append(motion._replace(time=time, now=ahead))
        velocity, penalties = np.where(was.held & moved, speed, was.velocity), was.penalties
        if penalties is not None:
            i = penalties.node
            penalties = penalties._replace(velocity=np.where(moved[i], speed[i], penalties.velocity))
            self._place(joined(was.drag, penalties))
        self._conditions = was._replace(velocity=velocity, penalties=penalties, motions=tuple(motions))

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
            self._place(joined(drag, penalties))

    def _place(self, anchors: Anchors | None) -> None:
        """Let the anchors, the same ones, be elsewhere, or move otherwise."""
        self._settle_anew(world=frozen(self.world._replace(anchors=anchors)))
        if self._engine is not None and anchors is not None:
            self._engine.follow(anchors)
