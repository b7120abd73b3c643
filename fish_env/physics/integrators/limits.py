"""Step-size limits of the methods: of a body in its surroundings, by linear theory about rest; and for default steps.

A small motion x about rest has the acceleration -K x - D v, with K and D over the masses, that of the water included.
Drag is of second order there. `benchmarks/stability/survey.py` measures limits of large motion.
"""

import math
from collections.abc import Callable
from itertools import pairwise
from typing import Any

import numpy as np

from fish_env.physics import forces
from fish_env.physics.forces import springs
from fish_env.physics.integrators import leapfrog_chebyshev
from fish_env.physics.integrators.leapfrog_chebyshev import MOST_STAGES, SAFETY
from fish_env.physics.linalg.rates import assemble
from fish_env.physics.records import Anchors, Body, World

Limit = Callable[[Body, World], float]
MOST_MODES = 600  # degrees of freedom up to which all motions are computed, within a second
TRIED = np.geomspace(1e-6, 1.0, 2000)  # steps, of the longest that any method could take
UNDAMPED = 1e-9  # of a rate, its real part: less is rounding
GROWS = 1e-12  # of a step: less is rounding


def motion(body: Body, world: World, subtracted: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
    """K and D, (n,n) 1/s2 and 1/s; of a body with more than MOST_MODES degrees of freedom, of two extreme ones."""
    # From K, so many times the stiffness of springs that are taut at rest, as if each pulled in all directions, is
    # subtracted.
    large = body.inverse_mass.size > MOST_MODES
    if large:
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
        parts: Any = [assemble(forces.rest_matrices(body, elastic), free.size, free.size) for elastic in (True, False)]
        taut = subtracted * springs.effective(body)
        parts[0] -= assemble([(body.springs.nodes, taut[:, None, None] * springs.EVERY_WAY)], free.size, free.size)
        rigid = np.linalg.qr(np.linalg.solve(root, rigid_motions(body, body.position)[free]))[0]
        kept = np.eye(len(root)) - rigid @ rigid.T  # else gas that its springs do not balance would turn the body
        matrices = tuple(kept @ root @ part[free][:, free] @ root.T @ kept for part in parts)
        if world.anchors is not None:
            held = anchored(body, world.anchors)
            matrices = tuple(
                own + root @ part[free][:, free] @ root.T for own, part in zip(matrices, held, strict=True)
            )
    one, around = np.eye(len(matrices[0])), world if large else world._replace(anchors=None)
    bounds = forces.bounds(body._replace(barriers=None), around)  # barriers are inactive at rest
    elastic, viscous = np.sum([(0.0, world.viscosity * body.inverse_mass.max()), *bounds], axis=0)
    return matrices[0] + elastic * one, matrices[1] + viscous * one


def rigid_motions(body: Body, x: np.ndarray, turning: bool = True) -> np.ndarray:
    """Displacements (3N,K) of the rigid motions at x (N,3) m that leave all fixed degrees of freedom where they are."""
    turns = np.stack([np.cross(axis, x - x.mean(axis=0)) for axis in np.eye(3)], axis=2)
    every = np.concatenate([np.tile(np.eye(3), (len(x), 1, 1)), turns[..., : 3 * turning]], axis=2).reshape(x.size, -1)
    every /= np.maximum(np.linalg.norm(every, axis=0), 1e-300)
    fixed = every[body.inverse_mass.ravel() == 0.0]
    sizes, axes = np.linalg.svd(np.concatenate([fixed, np.zeros((every.shape[1], every.shape[1]))]))[1:]
    motions = every @ axes[sizes < 1e-9].T
    return motions[:, np.linalg.norm(motions, axis=0) > 1e-9]


def anchored(body: Body, anchors: Anchors) -> tuple[np.ndarray, np.ndarray]:
    """Stiffness and damping (3N,3N) of anchors on a body at rest; across a drag spring they are less."""
    elastic, viscous = np.zeros((2, body.position.size, body.position.size))
    for node, point, _, stiffness, damping, length in zip(*anchors, strict=True):
        i, way = slice(3 * node, 3 * node + 3), point - body.position[node]
        elastic[i, i] += stiffness * np.eye(3)
        viscous[i, i] += damping * (np.outer(way, way) / max(way @ way, 1e-300) if length else np.eye(3))
    return elastic, viscous


def roots(elastic: np.ndarray, viscous: np.ndarray) -> np.ndarray:
    """The 2n numbers z for which z^2 + z D + K is singular."""
    one = np.eye(len(elastic))
    return np.linalg.eigvals(np.block([[0.0 * one, one], [-elastic, -viscous]]))


def none(body: Body, world: World) -> float:
    """No limit: the method is stable at any step."""
    return math.inf


def filtered(reach: float, subtracted: float = 0.0) -> Limit:
    """Limit of a leapfrog, s, whose steps are stable while the highest eigenvalue of h^2 K + 2 h D is below reach."""
    # Symplectic Euler, and Tu's method near rest, reach 4: sqrt((w s)^2 + 4) - w s over w, with the relaxation time s.
    # What Tu's takes as implicit, the pull of springs that are taut at rest, is subtracted twice.

    def limit(body: Body, world: World) -> float:
        elastic, viscous = motion(body, world, subtracted)
        fastest = np.real(roots(-elastic / reach, -2.0 * viscous / reach)).max()
        return 1.0 / float(fastest) if fastest > 0.0 else math.inf

    return limit


def polynomial(*coefficients: float) -> Limit:
    """Limit of a Runge-Kutta method, s, that multiplies a motion exp(z t) by this polynomial of z h in a step."""
    # Where undamped motion grows at any step, as with explicit Euler, the limit is that of the least damped motion, and
    # zero without damping. Of a large body of springs or gas it is then unknown, nan.
    amplifies = abs(np.polyval(coefficients, 0.1j)) > 1.0

    def limit(body: Body, world: World) -> float:
        if amplifies and body.inverse_mass.size > MOST_MODES and (body.springs.nodes.size or body.compartments):
            return math.nan
        rates = roots(*motion(body, world))
        fastest = np.abs(rates).max()
        if fastest == 0.0:
            return math.inf
        least = 1e-6 * fastest
        rates = rates[(np.abs(rates) > least) & (np.real(rates) <= least)]  # no rigid motion, and no collapse
        if amplifies and (np.abs(np.real(rates)) < UNDAMPED * np.abs(rates)).any():
            return 0.0
        steps = 2.0 * len(coefficients) / fastest * TRIED
        growing = (np.abs(np.polyval(coefficients, steps[:, None] * rates)) > 1.0 + GROWS).any(axis=1)
        first = int(growing.argmax())
        return float(steps[first - 1]) if first else 0.0

    return limit


LEAPFROG, LAGGED = filtered(4.0), filtered(4.0, 2.0)
STABILISED = filtered(leapfrog_chebyshev.polynomial(MOST_STAGES)[3] / SAFETY)
EULER, MIDPOINT, RK4 = polynomial(1.0, 1.0), polynomial(0.5, 1.0, 1.0), polynomial(1 / 24, 1 / 6, 0.5, 1.0, 1.0)


def lagged(body: Body, world: World) -> float:
    """Limit of Tu's method, s; anchors are implicit."""
    return LAGGED(body, world._replace(anchors=None))


def leapfrog(body: Body) -> float:
    """Step that symplectic Euler can take on a body in any water, s, by the highest rates alone."""
    elastic, viscous = body.max_stiffness_eigenvalue, body.max_damping_eigenvalue
    if elastic == 0.0:
        return 2.0 / viscous if viscous > 0.0 else math.inf
    return (math.sqrt(viscous**2 + 4.0 * elastic) - viscous) / elastic


def relaxation(body: Body) -> float:
    """Shortest relaxation time k/c of the springs and tetrahedra, s; infinite without stiffness."""
    units, tets = body.springs, body.tets
    elastic = units.stiffness > 0.0
    shortest = math.inf if tets is None else float(tets.relaxation_time.min(initial=math.inf))
    return float((units.damping[elastic] / units.stiffness[elastic]).min(initial=shortest))


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
