"""The INTEGRATORS table: every method there is, with what a user wants to know before choosing one."""

from collections.abc import Callable
from dataclasses import dataclass

from fish_env.integrators import rk4, semi_implicit, symplectic_euler


@dataclass(frozen=True)
class Integrator:
    """A time-stepping method. `advance(body, world, state, control, h, n)` moves every sound body n steps of h s."""

    name: str
    order: int
    """Order of accuracy in h for smooth controls."""
    kind: str
    """"explicit" or "semi-implicit" (one linear solve a step, stiffness lagged)."""
    forces: int
    """Force evaluations a step."""
    source: str
    advance: Callable

    def __reduce__(self):
        return named, (self.name,)  # a pickle names its method; compiled code stays in the process that compiled it


def named(name: str) -> Integrator:
    """The entry of the table."""
    return INTEGRATORS[name]


INTEGRATORS: dict[str, Integrator] = {
    record.name: record
    for record in (
        Integrator("semi_implicit", 1, "semi-implicit", 1, "Tu 1996, ch. 4", semi_implicit.advance),
        Integrator("symplectic_euler", 1, "explicit", 1, "Hairer, Lubich & Wanner 2003", symplectic_euler.advance),
        Integrator("rk4", 4, "explicit", 4, "Kutta 1901; Song 2009, ch. 5", rk4.advance),
    )
}
