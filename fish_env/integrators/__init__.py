"""The INTEGRATORS table: every method there is, with what a user wants to know before choosing one."""

from collections.abc import Callable
from dataclasses import dataclass
from types import ModuleType

from fish_env.body import Body
from fish_env.integrators import (
    leapfrog_chebyshev,
    limits,
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
    method: ModuleType | None
    limit: Callable[[Body], float] = limits.leapfrog
    """Longest step, s, that is sure to be stable for small motion about rest."""
    refuses: Callable[[Body, World], str] = limits.everything
    """Why it cannot move a body in a world; "" if it can."""

    def __reduce__(self):
        return named, (self.name,)  # a pickle names its method; compiled code stays in the process that compiled it


def named(name: str) -> Integrator:
    """The entry of the table."""
    return INTEGRATORS[name]


INTEGRATORS: dict[str, Integrator] = {
    record.name: record
    for record in (
        Integrator(
            "leapfrog_chebyshev", 2, "stabilised", 0, 0, 0, "Carle, Hochbruck & Sturm 2020", leapfrog_chebyshev
        ),
    )
}
