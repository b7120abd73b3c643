"""Step-size limits of the methods: of a body in its surroundings, by linear theory about rest; and for default steps.

A small motion x about rest has the acceleration -K x - D v, with K and D over the masses, that of the water included.
Drag is of second order there. `benchmarks/stability/survey.py` measures limits of large motion.
"""

import math
from collections.abc import Callable
from itertools import pairwise

import numpy as np

from fish_env.physics import forces
from fish_env.physics.integrators import leapfrog_chebyshev
from fish_env.physics.integrators.leapfrog_chebyshev import MOST_STAGES, SAFETY
from fish_env.physics.linalg.rates import DENSE, assemble
from fish_env.physics.records import Body, World

Limit = Callable[[Body, World], float]
TRIED = np.geomspace(1e-6, 1.0, 2000)  # steps, of the longest that any method could take
GROWS = 1e-12  # of a step: less is rounding


def motion(body: Body, world: World) -> tuple[np.ndarray, np.ndarray]:
    """K and D, (n,n) 1/s2 and 1/s; of a body with more than DENSE degrees of freedom, those of two extreme modes."""
    if body.inverse_mass.size > DENSE:
        elastic, viscous = body.max_stiffness_eigenvalue, body.max_damping_eigenvalue
        matrices = np.diag([elastic, elastic]), np.diag([min(viscous, relaxation(body) * elastic), viscous])
    else:
        free, mass = body.inverse_mass.ravel() > 0.0, np.diag(np.repeat(body.mass, 3))
        if world.added_mass is not None and body.sections is not None:
            nodes, first, share, *_, lateral, vertical, _, _, _, _ = body.sections
            for k, (a, b) in enumerate(pairwise(first)):
                for axis, volume in ((1, lateral), (2, vertical)):
                    i = 3 * nodes[a:b] + axis
                    mass[np.ix_(i, i)] += world.added_mass[axis - 1] * volume[k] * np.outer(share[a:b], share[a:b])
        root = np.linalg.inv(np.linalg.cholesky(mass[free][:, free]))
        parts = (assemble(forces.rest_matrices(body, elastic), free.size) for elastic in (True, False))
        matrices = tuple(root @ part[free][:, free] @ root.T for part in parts)
    one, around = np.eye(len(matrices[0])), forces.bounds(body._replace(barriers=None), world)  # inactive at rest
    added = np.sum([(0.0, world.viscosity * body.inverse_mass.max()), *around], axis=0)
    return matrices[0] + added[0] * one, matrices[1] + added[1] * one


def roots(elastic: np.ndarray, viscous: np.ndarray) -> np.ndarray:
    """The 2n numbers z for which z^2 + z D + K is singular."""
    one = np.eye(len(elastic))
    return np.linalg.eigvals(np.block([[0.0 * one, one], [-elastic, -viscous]]))


def none(body: Body, world: World) -> float:
    """No limit: the method is stable at any step."""
    return math.inf


def filtered(reach: float) -> Limit:
    """Limit of a leapfrog, s, whose steps are stable while the highest eigenvalue of h^2 K + 2 h D is below its reach.

    Symplectic Euler, and Tu's method near rest, reach 4: sqrt((w s)^2 + 4) - w s over w, with the relaxation time s.
    """

    def limit(body: Body, world: World) -> float:
        elastic, viscous = motion(body, world)
        fastest = np.real(roots(-elastic / reach, -2.0 * viscous / reach)).max()
        return 1.0 / fastest if fastest > 0.0 else math.inf

    return limit


def polynomial(*coefficients: float) -> Limit:
    """Limit of a Runge-Kutta method, s, that multiplies a motion exp(z t) by this polynomial of z h in a step."""

    def limit(body: Body, world: World) -> float:
        rates = roots(*motion(body, world))
        fastest = np.abs(rates).max()
        if fastest == 0.0:
            return math.inf
        rates = rates[np.abs(rates) > 1e-6 * fastest]  # rigid motion, to rounding
        steps = 2.0 * len(coefficients) / fastest * TRIED
        growing = (np.abs(np.polyval(coefficients, steps[:, None] * rates)) > 1.0 + GROWS).any(axis=1)
        first = int(growing.argmax())
        return float(steps[first - 1]) if first else 0.0

    return limit


LEAPFROG, STABILISED = filtered(4.0), filtered(leapfrog_chebyshev.polynomial(MOST_STAGES)[3] / SAFETY)
EULER, MIDPOINT, RK4 = polynomial(1.0, 1.0), polynomial(0.5, 1.0, 1.0), polynomial(1 / 24, 1 / 6, 0.5, 1.0, 1.0)


def lagged(body: Body, world: World) -> float:
    """Limit of Tu's method, s: that of symplectic Euler, for which it takes springs at rest; anchors are implicit."""
    return LEAPFROG(body, world._replace(anchors=None))


def leapfrog(body: Body) -> float:
    """Step that symplectic Euler, and so most methods, can take on a body in any water, s: default steps follow it."""
    elastic, viscous = body.max_stiffness_eigenvalue, body.max_damping_eigenvalue
    if elastic == 0.0:
        return 2.0 / viscous if viscous > 0.0 else math.inf
    return (math.sqrt(viscous**2 + 4.0 * elastic) - viscous) / elastic


def relaxation(body: Body) -> float:
    """Shortest relaxation time k/c of the springs and tetrahedra, s; infinite without stiffness."""
    springs, tets = body.springs, body.tets
    elastic = springs.stiffness > 0.0
    shortest = math.inf if tets is None else float(tets.relaxation_time.min(initial=math.inf))
    return float((springs.damping[elastic] / springs.stiffness[elastic]).min(initial=shortest))


def explicit_euler(body: Body) -> float:
    """Largest stable step of explicit Euler, s: at most the relaxation time, which is zero without damping."""
    return min(relaxation(body), leapfrog(body))


def midpoint(body: Body) -> float:
    """Largest stable step of the midpoint method, s: it amplifies by (h w)^4 / 4, and damping reduces by h s w^2."""
    if body.max_stiffness_eigenvalue == 0.0:
        return leapfrog(body)
    return min((4.0 * relaxation(body) / body.max_stiffness_eigenvalue) ** (1 / 3), leapfrog(body))


def everything(body: Body, world: World) -> str:
    """Return "", for a method that can move any body in any world."""
    return ""


def whole_nodes(body: Body, world: World) -> str:
    """Reason that Tu's method cannot move the body, or "": a node must be fixed along all axes or along none."""
    fixed = body.inverse_mass == 0.0
    mixed = fixed[:, ~fixed.all(axis=0)]
    bad = np.flatnonzero(mixed.any(axis=1) & ~mixed.all(axis=1))
    return f"node {bad[0]} is fixed along some axes only, and one matrix serves all of them" if bad.size else ""


def no_walls(body: Body, world: World) -> str:
    """Reason that adaptive methods cannot move the body, or "": error control fails for an impact within a step."""
    return "a step of its own choice would run through the walls" if world.planes is not None else ""
