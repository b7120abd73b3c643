"""Tank: B fish of one kind in water, or B other elastic objects. The one stateful simulation class."""

import copy
import math
import warnings
from collections.abc import Callable, Mapping
from importlib import import_module
from itertools import pairwise
from types import ModuleType
from typing import Any, Generic

import numpy as np

from fish_env.checks import ReadOnly, check_numbers, checked_keywords, finite_array, frozen, is_whole, own
from fish_env.kernels.simd import Kind, Pack, Vectors
from fish_env.kernels.threads import Threads
from fish_env.physics import tank_options as options
from fish_env.physics.engine import Engine
from fish_env.physics.failures import FAILURES
from fish_env.physics.fish import Elastic, Fish
from fish_env.physics.forces.control import NOMINAL
from fish_env.physics.forces.evaluate import Evaluator
from fish_env.physics.linearise import Jacobians, linearise
from fish_env.physics.muscles import command_all, contraction_of, first_fibres, opposed_fibres
from fish_env.physics.records import COUNTERS, FLOWS, Body, Control, State, World
from fish_env.physics.world import VACUUM, checked_water

FISH_PER_THREAD = 16  # with fewer, a thread costs more than it saves


class Tank(ReadOnly, Generic[Elastic]):
    """B fish of one kind, without interaction, in the same water, advanced by one integrator.

    `fish` and `world` of a tank are its own, read-only copies, because kernels read them without checks.

    Args:
        fish: a fish (`make_fish`) or another elastic object (`fish_env.soft.objects`).
        num_fish: B, at least 1.
        integrator: a key of `INTEGRATORS`; None selects the fish's default.
        dt: integrator step, s; None selects the fish's `time_step` for its default integrator. For another, it selects
            the longest step that divides the control interval and is at most half of one that is stable at rest. A step
            above the largest stable one warns.
        water: `make_water(...)`, or as environments take it: "none", "drag" or "reactive", the fish's own with inertia,
            or a dictionary of what differs in it. None is vacuum.
        threads: number of threads that advance the fish; None selects the number of available processors.
            Results do not depend on it.
        dtype: "float64" or "float32", the precision of the kernels; the state is always float64.
        lanes: number of fish that a kernel processes at once: "xyz" (one, its coordinates side by side), 1, 2, 4, 8, 16
            or 32; None selects one. Results do not depend on it in float64.
        refine: relative change of a spring's length within a step above which the call is repeated for that fish, with
            steps half as long, down to 1/64; inf for never. None selects the fish's own value for its own method, and
            inf for others. Only the default method checks its springs.
        energy: True to measure the energy flows at every step (`flows`); steps take longer then.

    Raises:
        ValueError: for an unknown integrator, `num_fish` or `threads` below 1, a step that is not positive, an
            unsupported dtype, lanes or refine, or energy flows of a method that does not measure them.
    """

    READ_ONLY = ("fish", "world", "integrator", "dt", "refine", "num_fish", "threads", "kind", "energy", "state",
                 "control", "natural", "span", "effort", "variation", "muscle_variation", "length_variation", "flow",
                 "pack")  # fmt: skip
    pack: Pack

    @checked_keywords
    def __init__(self, fish: Elastic, num_fish=1, integrator: str | None = None, dt: float | None = None,
                 water: str | Mapping[str, Any] | World | None = None, threads: int | None = None,
                 dtype: str = "float64", lanes: str | int | None = None, refine: float | None = None,
                 energy: bool = False):  # fmt: skip
        self.integrator, self.dt, self.refine = options.method_for(fish, integrator, dt, refine)
        self.num_fish = options.checked_count(num_fish, "num_fish")
        self.threads = options.available_processors() if threads is None else options.checked_count(threads, "threads")
        water = VACUUM if water is None else checked_water(water, fish.water)
        options.check_scene(fish, water, self.integrator, energy, self.num_fish)
        self.energy = bool(energy)
        fish, self.world = frozen(copy.deepcopy((fish, water)))
        if dt is not None and (reason := options.too_long(fish, self.world, self.integrator, self.dt)):
            failing = f"{self.integrator.name!r} {'will' if self.refine == math.inf else 'may'} fail on {fish.name!r}"
            said = f"{failing} in this water: {reason}; give a shorter dt or none, or another integrator"
            warnings.warn(said, stacklevel=3)
        self.fish, self._own, body, b = fish, fish.body, fish.body, self.num_fish
        self._conditions: Any = None
        self._conditions = None if self.world.anchors is None else _boundary().present(self)
        self.kind = options.kind_for(b, dtype, lanes)
        """Number of fish that the kernels process at once, and their precision."""
        position, counts = np.repeat(body.position[None], b, axis=0), np.zeros((b, len(COUNTERS)), dtype=np.int64)
        time, failure, work = np.zeros(b), np.zeros(b, dtype=np.int64), np.zeros(b)
        self.state = State(position, np.zeros_like(position), time, failure, counts, work)
        springs = body.springs.rest_length
        self.control = Control(np.repeat(springs[None], b, axis=0), np.zeros((b, springs.size)))
        self.natural = springs[fish.muscles]
        """(M,) natural length of each muscle, m."""
        self.span = (1.0 - fish.contracted) * self.natural
        """(M,) reduction of the rest length at full contraction, m."""
        natural = springs[fish.fibres]
        self._fibres = (fish.fibres, fish.drives, natural, (1.0 - fish.contracted[fish.drives[:, 0]]) * natural)
        self.effort = np.zeros(b)
        """(B,) mean square of the muscles' speeds in the last `swim`; 1 if all moved at their fastest."""
        self.variation = np.tile(NOMINAL, (b, 1))
        """(B,6) factors and current of each fish (`vary`); read-only."""
        self.muscle_variation = np.ones((b, 2))
        """(B,2) factors on strength and contraction time of each fish (`vary`); read-only."""
        self.length_variation = np.ones(b)
        """(B,) factor on the length of each fish (`vary`); read-only."""
        self.flow = np.zeros((b, len(FLOWS) if self.energy else 0))
        """(B,4) energy flows, J, a column for each of FLOWS; (B,0) if they are not measured."""
        self._chunks = min(self.threads, max(1, b // FISH_PER_THREAD))
        self._threads = Threads(self.threads)
        self._compile()

    def _compile(self) -> None:
        """Make the pack of arrays for kernels, and the engine if the method has one."""
        self._set_read_only(pack=self._describe())
        self._engine = None if self.integrator.method is None else Engine(self)

    def _describe(self) -> Pack:
        """Pack of the tank's arrays and of its fish's properties, as kernels read them."""
        fish, state, control = self.fish, self.state, self.control
        springs, one = fish.body.springs, Kind(1)
        fields = {}
        if isinstance(fish, Fish):
            fields = {
                "line": fish.line, "left": fish.left, "right": fish.right, "nose": fish.nose,
                "node": fish.landmarks.node, "height": fish.landmarks.height,
            }  # fmt: skip
        fibres, drives, natural, span = self._fibres
        fields |= {
            "muscles": fish.muscles,
            "fibres": fibres,
            "drives": drives,
            "opposed": opposed_fibres(fish),
            "first_fibre": first_fibres(fish),
            "spring_nodes": springs.nodes,
        }
        own = {key: frozen(np.array(each)) if isinstance(each, np.ndarray) else each for key, each in fields.items()}
        return Pack(  # kernels do not check the indices in these arrays
            "tank",
            x=state.x, v=state.v, position=Vectors(state.x, one), velocity=Vectors(state.v, one),
            clock=state.t, failure=state.failure, counters=state.counters, work=state.work,
            rest_length=control.rest_length, rate=control.rate, variation=self.variation, effort=self.effort,
            muscle_variation=self.muscle_variation, length_variation=self.length_variation,
            rest_position=fish.body.position, mass=fish.body.mass, length=float(fish.length),
            contraction_time=float(fish.contraction_time), lengthening=float(fish.lengthening),
            natural=self.natural, span=self.span, fibre_natural=natural, fibre_span=span,
            spring_length=springs.rest_length, **own,
        )  # fmt: skip

    def __getstate__(self):
        return self.__dict__ | {"pack": None, "_engine": None}

    def __setstate__(self, state: dict[str, Any]):
        self.__dict__ |= own(state, state["variation"])
        frozen((self.fish, self.world, self._own))
        self._compile()

    @property
    def position(self) -> np.ndarray:
        """Node positions, (B,N,3) m: live and writable."""
        return self.state.x

    @property
    def velocity(self) -> np.ndarray:
        """Node velocities, (B,N,3) m/s: live and writable."""
        return self.state.v

    @property
    def rest_length(self) -> np.ndarray:
        """Rest lengths of all springs, (B,E) m: live and writable."""
        return self.control.rest_length

    @property
    def time(self) -> np.ndarray:
        """Clock of each fish, (B,) s."""
        return self.state.t

    @property
    def alive(self) -> np.ndarray:
        """Boolean mask (B,) of the fish whose simulation is valid."""
        return self.state.failure == 0

    @property
    def failure(self) -> np.ndarray:
        """Reason of each fish's failure, (B,), "" without one; ValueError for an invalid number in `state`."""
        check_numbers("state.failure", self.state.failure, (self.num_fish,), len(FAILURES))
        return np.array(FAILURES, dtype=object)[self.state.failure]

    @property
    def counters(self) -> dict[str, np.ndarray]:
        """Work done for each fish since its reset, an array (B,) for each name of COUNTERS: live."""
        return dict(zip(COUNTERS, self.state.counters.T, strict=True))

    @property
    def work(self) -> np.ndarray:
        """Work of the muscles of each fish on it since its reset, (B,) J: live (docs/physics-more.md, eq. 55).

        It is integrated at every step of dt. It counts the motion of rest lengths that commands set, not those that a
        program writes into `rest_length`.
        """
        return self.state.work

    @property
    def flows(self) -> dict[str, np.ndarray]:
        """Energy flows of each fish since its reset (docs/physics-more.md, eq. 57-60), live arrays (B,) J by name.

        "positive_work" is the part of `work` of the fibres that do positive work, "damping" is lost in springs and
        tetrahedra, "water" to the water, and "thrust" is the useful part of the work on the water. A tank without
        energy=True raises AttributeError.
        """
        if not self.energy:
            raise AttributeError("this tank does not measure its energy flows; make it with energy=True")
        return dict(zip(FLOWS, self.flow.T, strict=True))

    def energies(self) -> dict[str, np.ndarray]:
        """Present energies of each fish, (B,) J: "kinetic", and the energy of every force that stores any, by its name.

        They are those in water at rest: velocities are relative to the current. That of "reactive" is the kinetic
        energy of the water that moves with the fish.
        """
        found, rest = [], self.control.rest_length
        for i, (length, x, v) in enumerate(zip(rest, self.state.x, self.state.v, strict=True)):
            body, world = self._varied(i, self.world)
            found.append(Evaluator(body, world._replace(current=np.zeros(3))).energies(length, x, v - world.current))
        return {name: np.array([each[name] for each in found]) for name in found[0]}

    @property
    def contraction(self) -> np.ndarray:
        """Contraction of each muscle's rest length, (B,M): 0 relaxed, 1 full."""
        return contraction_of(self.fish, self.rest_length)

    def vary(self, i: int, stiffness=1.0, mass=1.0, drag=1.0, current=(0.0, 0.0, 0.0), strength=1.0,
             contraction_time=1.0, length=1.0) -> None:  # fmt: skip
        """Set the factors and the current of fish i, 0 to B - 1; without arguments, restore their defaults.

        Args:
            i: number of the fish.
            stiffness: factor on the stiffness and the damping of its elements, 1e-9 to 1e9.
            mass: factor on its mass, 1e-9 to 1e9.
            drag: factor on the force of the water, 0 to 1e9.
            current: velocity of its water relative to that of the tank's, (3,) m/s.
            strength: factor on how far its muscles contract, 0.01 to 1.5.
            contraction_time: factor on the time that a contraction takes, 0.01 to 100.
            length: factor on its length, 0.01 to 100, at the same tissue and times. All else counts in its own lengths,
                so that its metres are those of the tank's fish (docs/physics-more.md, eq. 75).

        Raises:
            ValueError: for a missing fish, a factor out of range or too large for the default method at any step, or a
                current that is not finite.
        """
        if not (is_whole(i) and 0 <= i < self.num_fish):
            raise ValueError(f"fish is {i!r}; give a whole number from 0 to {self.num_fish - 1}")
        muscles = options.checked_muscle_variation(strength, contraction_time)
        row = options.checked_variation(stiffness, mass, drag, current, length)
        if self._engine is not None and self._engine.too_stiff(row):
            ratio = f"stiffness over mass and squared length is {row[0] / row[1]:g}"
            raise ValueError(f"{ratio}, too much for the shortest parts of dt = {self.dt:g} s; give less, or less dt")
        self._set_variation(int(i), row)
        self.muscle_variation[i], self.length_variation[i] = muscles, length

    def _set_variation(self, i: int, row: np.ndarray) -> None:
        self.variation[i] = row
        if self._engine is not None:
            self._engine.choose_step(i)

    def _varied(self, i: int, world: World) -> tuple[Body, World]:
        """The body of fish i, and this world as it acts on it."""
        return options.apply_variation(self.fish.body, world, self.variation[i], self.length_variation[i])

    def advance(self, steps: int) -> None:
        """Advance by `steps` steps of dt with constant controls. A fish that fails stops at its last valid state."""
        self._run(options.checked_steps(steps))

    def swim(self, action, duration: float) -> None:
        """Move the muscles' rest lengths linearly towards a command within a duration, s, and advance by it.

        They reach their targets at the end, or move as far as `fish.contraction_time` allows.

        Args:
            action: (B,M), or (M,) for all fish, in [-1, 1]: -1 natural length, 1 full contraction.
            duration: s, a whole multiple of dt.

        Raises:
            ValueError: for an action of another shape, not finite or outside [-1, 1], or an invalid duration.
        """
        steps = options.whole_steps(duration, self.dt, "duration")
        if not self.fish.num_muscles:
            raise ValueError(f"{self.fish.name!r} has no muscles to command; use advance")
        action = options.checked_action(action, (self.num_fish, self.fish.num_muscles))
        self.drive(0.5 * (action + 1.0), steps)

    def drive(self, contraction: np.ndarray, steps: int) -> None:
        """Swim for contractions (B,M) in [0, 1], for at least one step of dt; ValueError as in `swim`."""
        self.command(contraction, options.checked_steps(steps) * self.dt)
        self._run(steps)

    def command(self, contraction: np.ndarray, duration: float) -> None:
        """Set the rates of the muscles' rest lengths for contractions (B,M) in [0, 1] within `duration` s.

        The bodies do not move yet. Invalid contractions or durations raise ValueError.
        """
        command_all(self.pack, *options.checked_command(contraction, duration, (self.num_fish, self.fish.num_muscles)))

    def linearise(self, contraction: np.ndarray, steps: int) -> Jacobians:
        """Derivatives of the state that `drive(contraction, steps)` would lead to; the fish do not move.

        They are exact: those of the steps that the method takes, also where it refines them (Griewank & Walther 2008,
        ch. 3). Where a force has a kink, they are those of one side.

        Args:
            contraction: (B,M) in [0, 1].
            steps: number of steps of dt, at least 1.

        Returns:
            `state` (B,S,S) and `command` (B,S,M): S = 6N + K rows, for the positions (N,3) m, the velocities (N,3) m/s
            and the rest lengths (K,) m of the springs `np.unique(fish.fibres)`, flat and in this order.

        Raises:
            ValueError: as `swim`, for a fish that has failed or fails in this interval, an adaptive method, nodes that
                are fixed by elimination or moved, or a drag spring whose point moves.
        """
        return linearise(self, contraction, options.checked_steps(steps))

    def _run(self, steps: int) -> None:
        if self._conditions is None:
            self._run_evenly(steps)
        else:
            _boundary().run(self, steps)

    def _run_evenly(self, steps: int) -> None:
        """Advance by steps without a change of the boundary conditions."""
        if self._engine is None:
            for i in range(self.num_fish):
                one = (type(each)(*(array[i : i + 1] for array in each)) for each in (self.state, self.control))
                self.integrator.advance(*self._varied(i, self.world), *one, self.dt, steps)
        else:
            self.share_out(self._engine.advance, steps)

    def share_out(self, work: Callable, *args) -> None:
        """Call `work(chunk, first, last, *args)` for every chunk of the fish, in threads if there are several."""
        assert self._engine is not None  # only engines distribute fish over threads
        self._engine.sort()
        if self._chunks == 1:
            work(0, 0, self.num_fish, *args)
            return
        edges = np.linspace(0, self.num_fish, self._chunks + 1).astype(int).tolist()
        self._threads.run(work, [(i, first, last, *args) for i, (first, last) in enumerate(pairwise(edges))])

    def reset(self, mask=None) -> None:
        """Reset the fish (those of the boolean mask (B,), or all) to rest, relaxed, at time zero.

        Settings of `vary`, `change`, `grab`, `fix` and `move` remain, also the points of penalties and of the drag
        spring. An environment draws those of `vary` at each of its resets.
        """
        which = np.ones(self.num_fish, dtype=bool) if mask is None else np.asarray(mask)
        if which.dtype != bool or which.shape != (self.num_fish,):
            raise ValueError(f"mask is {mask!r}; give a boolean array ({self.num_fish},), or None for all fish")
        for array, value in zip(self.state, (self.fish.body.position, 0.0, 0.0, 0, 0, 0.0), strict=True):
            array[which] = value
        self.control.rest_length[which], self.control.rate[which] = self.fish.body.springs.rest_length, 0.0
        self.effort[which] = self.flow[which] = 0.0
        self._impose()

    def close(self) -> None:
        """Stop the threads; they restart when needed."""
        self._threads.close()

    def get_state(self) -> dict[str, np.ndarray]:
        """Copies of all that determines the further motion but a command that has not ended, and of what was counted.

        Their names are x, v, t, failure, counters, work, rest_length, variation, muscle_variation and length_variation,
        and flow if it is measured.
        """
        return {name: array.copy() for name, array in self._named().items()}

    def _named(self) -> dict[str, np.ndarray]:
        """Arrays of the state, by name."""
        return self.state._asdict() | {
            "rest_length": self.control.rest_length, "variation": self.variation,
            "muscle_variation": self.muscle_variation, "length_variation": self.length_variation,
            **({"flow": self.flow} if self.energy else {}),
        }  # fmt: skip

    def set_state(self, state: dict[str, np.ndarray]) -> None:
        """Restore a state that `get_state` returned, under the present boundary conditions (`grab`, `fix`, `move`).

        Rest lengths then stay until the next command.
        It must be of the same body, of which only the shapes are checked.

        Raises:
            ValueError: if a part is missing, unknown, of another shape or not finite; the tank is then unchanged.
        """
        target = self._named()
        checked = options.checked_state(state, target)
        for name, array in target.items():
            array[...] = checked[name]
        for i, row in enumerate(checked["variation"]):
            self._set_variation(i, row)
        self.control.rate[:] = 0.0
        self._impose()

    def nearest(self, point, nodes=None, i=0) -> int:
        """Node of body i nearest to a point (3,) m, among `nodes` (numbers) or all; ValueError for a missing one."""
        bodies, count, _ = self.state.x.shape
        check_numbers("i", i, (), bodies)
        which = np.arange(count) if nodes is None else np.asarray(nodes)
        if not which.size:
            raise ValueError("nodes is empty; give the numbers of some nodes, or None for all")
        check_numbers("nodes", which, (None,), count)
        away = self.state.x[i, which] - finite_array(point, (3,), "point (m)")
        return int(which[np.argmin((away**2).sum(axis=1))])

    def grab(self, node: int, point, stiffness: float, damping=0.0, rest_length=0.0, velocity=(0.0, 0.0, 0.0)) -> None:
        """Pull a node of every body by a drag spring to a point (3,) m; it replaces any previous one (`make_anchors`).

        The point moves at `velocity` (3,) m/s, and the damping acts on the node's velocity relative to it. A point that
        is set to a new position before every call jumps instead, and stretches the spring at once. A missing node or an
        invalid number raises ValueError.
        """
        _boundary().grab(self, node, point, stiffness, damping, rest_length, velocity)

    def change(self, *, gravity=None, restitution=None, stiffness=1.0, damping=1.0, mass=1.0, inner_mass=1.0,
               pressure=1.0) -> None:  # fmt: skip
        """Change materials and surroundings of all bodies while they move; a `reset` keeps them.

        Factors are over what the tank was made with (`fish_env.soft.changes.change_body`), and not over the last ones:
        one that is left out is 1 again.

        Args:
            gravity: (3,) m/s2; None leaves it.
            restitution: of all walls, 0 to 1; None leaves it.
            stiffness: factor on springs, tetrahedra, gas and barriers.
            damping: factor on springs and tetrahedra.
            mass: factor on all nodes.
            inner_mass: further factor on the nodes of an inner layer.
            pressure: factor on the gas; zero for none.

        Raises:
            ValueError: for a value that is not allowed, or a factor on what the bodies do not have.

        Warns:
            UserWarning: if the step is then too long for the method.
        """
        factors = stiffness, damping, mass, inner_mass, pressure
        import_module("fish_env.soft.changes").change(self, gravity, restitution, factors)

    def fix(self, nodes, axes: str = "xyz", method: str = "elimination") -> None:
        """Fix nodes of every body at their present positions until `release`: `move` with zero velocity.

        By elimination, the positions are constant exactly. By penalty, a stiff, damped spring (`make_penalty`) draws
        each node back: it deviates a little, and explicit methods need short steps.
        """
        self.move(nodes, np.zeros(3), axes, method)

    def move(self, nodes, along, axes: str = "xyz", method: str = "elimination") -> None:
        """Prescribe the motion of nodes of every body, until `fix`, `release` or another `move`.

        It replaces previous conditions of these nodes along these axes, and any penalty. A node gets its velocity at
        once, whatever its inertia. A function is called before every step of dt for the displacement at its end, and
        the node moves there at constant velocity. So it is on its path at the end of every step. A body that is reset
        continues from its rest position, by the rest of the displacement.

        Args:
            nodes: node numbers (K,), or a boolean mask (N,).
            along: a constant velocity, m/s, (3,) for all nodes, or (K,3), one each. Or a function of the time since
                this call, s, that returns their displacement since then, m, (3,) or (K,3), zero at time 0.
                Both are zero along free axes.
            axes: any of "x", "y" and "z", along which they are moved; by penalty all three.
            method: "elimination" or "penalty".

        Raises:
            ValueError: for a missing node, another axis or method, an invalid velocity or displacement, if no degree of
                freedom would remain, or if the tank's integrator does not support the condition; the tank is then
                unchanged. `advance` raises it for a displacement that a function returns later; the bodies have then
                moved up to that time.
        """
        _boundary().move(self, nodes, along, axes, method)

    def release(self, nodes=None) -> None:
        """Release the drag spring of `grab` (None); or nodes, numbers or a mask (N,), from `grab`, `fix` and `move`.

        They keep their present velocity: for ever along axes that `fish_env.physics.body.fix` holds, so `fix` these
        before. A missing node raises ValueError.
        """
        _boundary().release(self, nodes)

    @property
    def conditioned(self) -> bool:
        """True if a node is fixed by elimination or an anchor moves; `advance` updates both."""
        return self._conditions is not None and _boundary().acting(self)

    @property
    def fixed(self) -> np.ndarray:
        """Boolean mask (N,3) of the degrees of freedom that are fixed or moved by `fix`, `move` or the body itself."""
        return _boundary().fixed(self)

    def reactions(self) -> np.ndarray:
        """Reaction forces on the fixed and moved nodes of every body, (B,N,3) N; zero on all others.

        By elimination, they balance all other forces at the present positions and velocities. By penalty, they are the
        forces of its springs. A wall that such a node touches carries no part of them.
        """
        return _boundary().reactions(self)

    def _impose(self) -> None:
        """Set the velocities of the eliminated degrees of freedom of all valid bodies."""
        if self._conditions is not None:
            _boundary().impose(self)


def _boundary() -> ModuleType:
    """Load the functions for boundary conditions, which most tanks have none of."""
    return import_module("fish_env.soft.conditions")
