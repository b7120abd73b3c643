"""The INTEGRATORS table: every method there is, with what a user wants to know before choosing one.

A method with steps of its own is a `Method`: how it plans a step, and a kernel that takes steps of a block of fish.
`fish_env.physics.engine` compiles the kernel together with the forces that act, and calls it.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from fish_env.kernels.simd import Kind, Pack
from fish_env.physics.integrators import adaptive, leapfrog_chebyshev, limits, rosenbrock, runge_kutta, semi_implicit
from fish_env.physics.records import Body, World


class Method(Protocol):
    """How fish are moved by steps of a given length: a module, or an object that is hashable, with these functions."""

    def plan(self, elastic: float, viscous: float, h: float) -> np.ndarray:
        """The row of `control.plans` for a step of h s; `fish_env.physics.forces.plan` names its numbers.

        `elastic`, 1/s2, and `viscous`, 1/s, are the highest eigenvalues of the stiffness and the damping of the body
        and its surroundings over the masses.
        """
        ...

    def costs(self, row: np.ndarray) -> tuple[int, int, int]:
        """Force evaluations, factorisations and solves of a step that is planned so."""
        ...

    def make_work(self, body: Body, kind: Kind) -> Pack:
        """The scratch memory of a block of fish of a kind."""
        ...

    def make_run(self, names: tuple[str, ...]) -> Callable:
        """The kernel `run(body, world, control, x, v, work, cache, n)`, of a block on which forces of these names act.

        It takes n steps of `control.plans[control.row[0], H]` seconds: x and v are changed in place, `work` is what
        `make_work` made, `cache` what the forces keep. It sets the rest lengths of each time it evaluates a force at,
        calls the forces' `constrain` on accelerations that are not an immediate sum of forces and `finish` after every
        step, leaves fixed degrees of freedom their velocities, and notes in `control.pivots` and `control.untrusted`
        what went wrong in solves. What it captures are kernels, numbers, tuples of them and truth values, which name
        the compiled code on disk.
        """
        ...


@dataclass(frozen=True)
class Integrator:
    """A time-stepping method, as the table lists it."""

    name: str
    order: int
    """Order of accuracy in h for smooth controls."""
    kind: str
    """"explicit", "semi-implicit" (one linear solve a step, stiffness lagged), "linearly implicit" (stiffness
    linearised), "stabilised" (explicit, with as many stages as the step needs) or "adaptive" (chooses its own steps: h
    is only the unit in which a duration is given)."""
    forces: int
    """Force evaluations a step; 0 for a stabilised or adaptive method, which counts them as they come."""
    factorisations: int
    """Factorisations of a matrix a step."""
    solves: int
    """Solves with one, for all nodes and coordinates, a step."""
    source: str
    method: Method | None = None
    """What takes its steps; None for a method that chooses its own."""
    limit: Callable[[Body], float] = limits.leapfrog
    """Longest step, s, that is sure to be stable for small motion about rest."""
    refuses: Callable[[Body, World], str] = limits.everything
    """Why it cannot move a body in a world; "" if it can."""
    advance: Callable | None = None
    """Without a `method`: `advance(body, world, state, control, h, n)` moves every valid body n h seconds."""

    def __reduce__(self):
        return named, (self.name,)  # a pickle names its method; compiled code stays in the process that compiled it


def named(name: str) -> Integrator:
    """The entry of the table."""
    return INTEGRATORS[name]


IMPLICIT, TU, SONG, BARAFF = "linearly implicit", "Tu 1996, ch. 4", "Song 2009, ch. 5", "Baraff & Witkin 1998"
HAIRER, DOP853, RADAU = "Hairer, Lubich & Wanner 2003", "Hairer, Norsett & Wanner 1993", "Hairer & Wanner 1996"
INTEGRATORS: dict[str, Integrator] = {
    record.name: record
    for record in (
        Integrator("semi_implicit", 1, "semi-implicit", 1, 1, 1, TU, semi_implicit, refuses=limits.whole_nodes),
        Integrator("symplectic_euler", 1, "explicit", 1, 0, 0, HAIRER, runge_kutta.SYMPLECTIC_EULER),
        Integrator("rk4", 4, "explicit", 4, 0, 0, f"Kutta 1901; {SONG}", runge_kutta.RK4),
        Integrator("explicit_euler", 1, "explicit", 1, 0, 0, SONG, runge_kutta.EULER, limits.explicit_euler),
        Integrator("midpoint", 2, "explicit", 2, 0, 0, SONG, runge_kutta.MIDPOINT, limits.midpoint),
        Integrator("leapfrog_chebyshev", 2, "stabilised", 0, 0, 0, "Carle, Hochbruck & Sturm 2020", leapfrog_chebyshev),
        Integrator("linearly_implicit", 1, IMPLICIT, 1, 1, 1, BARAFF, rosenbrock.EULER),
        Integrator("linearly_implicit_projected", 1, IMPLICIT, 1, 1, 1, BARAFF, rosenbrock.PROJECTED),
        Integrator("linearly_implicit_water", 1, IMPLICIT, 1, 1, 1, BARAFF, rosenbrock.WATER),
        Integrator("rosenbrock", 2, IMPLICIT, 2, 1, 2, "Verwer et al. 1999", rosenbrock.ROS2),
        Integrator("dop853", 8, "adaptive", 0, 0, 0, DOP853, refuses=limits.no_walls, advance=adaptive.advance_dop853),
        Integrator("radau", 5, "adaptive", 0, 0, 0, RADAU, refuses=limits.no_walls, advance=adaptive.advance_radau),
    )
}
