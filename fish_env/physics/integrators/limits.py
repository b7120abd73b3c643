"""Step-size limits of each family of methods, from linear theory about rest; default steps derive from them.

A body's fastest vibration has the frequency w, w^2 = `max_stiffness_eigenvalue`, and the relaxation time s, s w^2 =
`max_damping_eigenvalue`. The limits are conservative: `benchmarks/stability/survey.py` measures longer stable steps.
"""

import math

import numpy as np

from fish_env.physics.records import Body, World


def leapfrog(body: Body) -> float:
    """Largest stable step of symplectic Euler, of Tu's and most other methods, s: (sqrt((w s)^2 + 4) - w s) / w."""
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
