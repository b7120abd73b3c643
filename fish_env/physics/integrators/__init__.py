"""The INTEGRATORS table: every method, with its order, kind, cost and step-size limit.

A method with a given step is a `Method`: it computes the coefficients of a step, and makes a kernel that advances a
block of fish. `fish_env.physics.engine` compiles the kernel together with the acting forces, and calls it.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from fish_env.kernels.simd import Kind, Pack
from fish_env.physics.integrators import leapfrog_chebyshev, limits, runge_kutta, semi_implicit
from fish_env.physics.lazy import load_texts
from fish_env.physics.records import Body, World
from fish_env.physics.world import VACUUM


class Method(Protocol):
    """Method with steps of a given length: a module, or a hashable object, with these functions."""

    def plan(self, elastic: float, viscous: float, h: float) -> np.ndarray:
        """Coefficients of a step of h s, a row of `control.plans`; `fish_env.physics.forces.plan` names its columns.

        `elastic`, 1/s2, and `viscous`, 1/s, are the highest eigenvalues of the stiffness and the damping of the body
        and its surroundings over the masses.
        """
        ...

    def costs(self, row: np.ndarray) -> tuple[int, int, int]:
        """Force evaluations, factorisations and solves of a step with these coefficients."""
        ...

    def make_work(self, body: Body, kind: Kind) -> Pack:
        """Scratch memory of a block of fish of a kind."""
        ...

    def make_run(self, names: tuple[str, ...], flows: bool = False) -> Callable:
        """Make the kernel `run(body, world, control, x, v, work, cache, n)` of a block, for the forces of these names.

        It takes n steps of `control.plans[control.row[0], H]` seconds, and changes x and v in place. `work` is of
        `make_work`, `cache` of the forces' `make_cache`. The kernel sets the rest lengths for the time of each force
        evaluation, and adds the work of the muscles there, with the weight that it has in the step (`common.add_work`).
        It calls the forces' `constrain` on accelerations that are no direct sum of forces, and `finish` after every
        step. It keeps the velocities of fixed degrees of freedom, and counts bad pivots in `control.pivots` and
        `control.untrusted`. With `flows`, it also adds the energy flows of each step (`common.make_measure`); a tank
        that is to measure them refuses a method without that argument. It may capture kernels, numbers, tuples of them
        and Booleans only.
        """
        ...


@dataclass(frozen=True)
class Integrator:
    """Entry of the table: a time-stepping method."""

    name: str
    order: int
    """Order of accuracy in h for smooth controls, at the steps that the method is meant for."""
    kind: str
    """"explicit", "semi-implicit" (one linear solve a step, stiffness lagged), "linearly implicit" (stiffness
    linearised), "stabilised" (explicit, with as many stages as the step needs) or "adaptive" (chooses its own steps; h
    is only the unit of durations)."""
    forces: int
    """Force evaluations per step; 0 for a stabilised or adaptive method, which counts them at run time."""
    factorisations: int
    """Factorisations of a matrix per step."""
    solves: int
    """Solves with a factorised matrix, for all nodes and coordinates, per step."""
    source: str
    method: Any = None
    """The implementation of its steps, a `Method`, or a text "module:name" of it; None for a method that chooses its
    own."""
    limit: limits.Limit = limits.none
    """Largest stable step of a body in a world for small motion about rest, s; inf if all are, nan if unknown."""
    refuses: Callable[[Body, World], str] = limits.everything
    """Reason that it cannot move a body in a world; "" if it can."""
    advance: Any = None
    """Function of a method without a `method`, or a text of it: `advance(body, world, state, control, h, n)` moves
    every valid body."""

    def __post_init__(self):
        load_texts(self, "method", "advance")

    def base(self, body: Body) -> float:
        """Step from which the default one follows, s: the largest stable one of the body in vacuum, nan if unknown.

        Methods that have none, or choose their own steps or stages, take that of symplectic Euler.
        """
        own = self.kind in ("explicit", "semi-implicit")
        return self.limit(body, VACUUM) if own else limits.leapfrog(body)

    def __reduce__(self):
        return get_integrator, (self.name,)  # a pickle contains the name only; compiled code stays in its process


def get_integrator(name: str) -> Integrator:
    """Entry of the table with this name."""
    return INTEGRATORS[name]


IMPLICIT, TU, SONG, BARAFF = "linearly implicit", "Tu 1996, ch. 4", "Song 2009, ch. 5", "Baraff & Witkin 1998"
CARLE = "Carle, Hochbruck & Sturm 2020"
SOFT = "fish_env.soft"
HAIRER, DOP853, RADAU = "Hairer, Lubich & Wanner 2003", "Hairer, Norsett & Wanner 1993", "Hairer & Wanner 1996"
INTEGRATORS: dict[str, Integrator] = {
    record.name: record
    for record in (
        Integrator(
            "semi_implicit", 1, "semi-implicit", 1, 1, 1, TU, semi_implicit, limits.lagged, refuses=limits.whole_nodes
        ),
        Integrator("symplectic_euler", 1, "explicit", 1, 0, 0, HAIRER, runge_kutta.SYMPLECTIC_EULER, limits.LEAPFROG),
        Integrator("rk4", 4, "explicit", 4, 0, 0, f"Kutta 1901; {SONG}", runge_kutta.RK4, limits.RK4),
        Integrator("explicit_euler", 1, "explicit", 1, 0, 0, SONG, runge_kutta.EULER, limits.EULER),
        Integrator("midpoint", 2, "explicit", 2, 0, 0, SONG, runge_kutta.MIDPOINT, limits.MIDPOINT),
        Integrator("leapfrog_chebyshev", 1, "stabilised", 0, 0, 0, CARLE, leapfrog_chebyshev, limits.STABILISED),
        Integrator("linearly_implicit", 1, IMPLICIT, 1, 1, 1, BARAFF, f"{SOFT}.rosenbrock:EULER"),
        Integrator("linearly_implicit_projected", 1, IMPLICIT, 1, 1, 1, BARAFF, f"{SOFT}.rosenbrock:PROJECTED"),
        Integrator("linearly_implicit_water", 1, IMPLICIT, 1, 1, 1, BARAFF, f"{SOFT}.rosenbrock:WATER"),
        Integrator("rosenbrock", 2, IMPLICIT, 2, 1, 2, "Verwer et al. 1999", f"{SOFT}.rosenbrock:ROS2"),
        Integrator(
            "dop853", 8, "adaptive", 0, 0, 0, DOP853, refuses=limits.no_walls, advance=f"{SOFT}.adaptive:advance_dop853"
        ),
        Integrator(
            "radau", 5, "adaptive", 0, 0, 0, RADAU, refuses=limits.no_walls, advance=f"{SOFT}.adaptive:advance_radau"
        ),
    )
}
