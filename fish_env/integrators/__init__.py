"""The INTEGRATORS table: every method there is, with what a user wants to know before choosing one."""

from collections.abc import Callable
from dataclasses import dataclass

from fish_env.body import Body
from fish_env.integrators import (
    adaptive,
    explicit_euler,
    leapfrog_chebyshev,
    limits,
    linearly_implicit,
    midpoint,
    rk4,
    rosenbrock,
    semi_implicit,
    symplectic_euler,
)
from fish_env.world import World


@dataclass(frozen=True)
class Integrator:
    """A time-stepping method. `advance(body, world, state, control, h, n)` moves every sound body n steps of h s."""

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
    advance: Callable
    limit: Callable[[Body], float] = limits.leapfrog
    """Longest step, s, that is sure to be stable for small motion about rest."""
    refuses: Callable[[Body, World], str] = limits.everything
    """Why it cannot move a body in a world; "" if it can."""

    def __reduce__(self):
        return named, (self.name,)  # a pickle names its method; compiled code stays in the process that compiled it


def named(name: str) -> Integrator:
    """The entry of the table."""
    return INTEGRATORS[name]


SONG, BARAFF, HAIRER = "Song 2009, ch. 5", "Baraff & Witkin 1998", "Hairer, Lubich & Wanner 2003"
IMPLICIT = "linearly implicit"
INTEGRATORS: dict[str, Integrator] = {
    record.name: record
    for record in (
        Integrator(
            "semi_implicit",
            1,
            "semi-implicit",
            1,
            1,
            1,
            "Tu 1996, ch. 4",
            semi_implicit.advance,
            refuses=limits.whole_nodes,
        ),
        Integrator("symplectic_euler", 1, "explicit", 1, 0, 0, HAIRER, symplectic_euler.advance),
        Integrator("rk4", 4, "explicit", 4, 0, 0, f"Kutta 1901; {SONG}", rk4.advance),
        Integrator("explicit_euler", 1, "explicit", 1, 0, 0, SONG, explicit_euler.advance, limits.explicit_euler),
        Integrator("midpoint", 2, "explicit", 2, 0, 0, SONG, midpoint.advance, limits.midpoint),
        Integrator(
            "leapfrog_chebyshev", 2, "stabilised", 0, 0, 0, "Carle, Hochbruck & Sturm 2020", leapfrog_chebyshev.advance
        ),
        Integrator("linearly_implicit", 1, IMPLICIT, 1, 1, 1, BARAFF, linearly_implicit.advance),
        Integrator("linearly_implicit_projected", 1, IMPLICIT, 1, 1, 1, BARAFF, linearly_implicit.advance_projected),
        Integrator("linearly_implicit_water", 1, IMPLICIT, 1, 1, 1, BARAFF, linearly_implicit.advance_water),
        Integrator("rosenbrock", 2, IMPLICIT, 2, 1, 2, "Verwer et al. 1999", rosenbrock.advance),
        Integrator(
            "dop853",
            8,
            "adaptive",
            0,
            0,
            0,
            "Hairer, Norsett & Wanner 1993",
            adaptive.advance_dop853,
            refuses=limits.no_walls,
        ),
        Integrator(
            "radau", 5, "adaptive", 0, 0, 0, "Hairer & Wanner 1996", adaptive.advance_radau, refuses=limits.no_walls
        ),
    )
}
