"""Prescribed displacements of some nodes of a body at rest, by elimination and by penalty, with the reactions.

The linear problem about rest, K u = load, with u given on the degrees of freedom c and unknown on the others f:

- elimination: K_ff u_f = load_f - K_fc u_c, and the reactions are r_c = K_cf u_f + K_cc u_c - load_c;
- penalty: P = multiple * largest entry of K is added to the diagonal of c and P u_c to the load. The reactions are
  r_c = P (u_c - u) = K u - load, with the solution u. The error is proportional to 1 / multiple (Bathe, Finite Element
  Procedures, ch. 3.4).

For large displacements, fix the nodes (`fish_env.physics.body.fix`), start `fish_env.physics.statics.equilibrium` with
them at their new positions, and compute the `reactions` there.
"""

from typing import Any

import numpy as np
from scipy.sparse import csc_array, diags_array
from scipy.sparse.linalg import splu

from fish_env.checks import finite_array, positive_array
from fish_env.physics.body import node_numbers
from fish_env.physics.conditions import METHODS, PENALTY
from fish_env.physics.forces.evaluate import Evaluator
from fish_env.physics.forces.sparse import tangent
from fish_env.physics.integrity import check_problem
from fish_env.physics.records import Body, World
from fish_env.physics.statics import LOOSE, SINGULAR, SYMMETRIC, NoEquilibrium
from fish_env.physics.world import VACUUM


def prescribed_displacement(
    body: Body, nodes, displacement, load=None, world: World = VACUUM, method="elimination", multiple=PENALTY
) -> tuple[np.ndarray, np.ndarray]:
    """Small displacements (N,3) m of a body at rest with some nodes displaced, and the reactions (N,3) N.

    The reactions are the forces on the displaced nodes and on the fixed degrees of freedom; zero on all other nodes.

    Args:
        body: any body; its fixed degrees of freedom are not displaced.
        nodes: the displaced nodes, as numbers (K,) or a boolean mask (N,).
        displacement: m, (3,) for all of them, or (K,3), one each.
        load: further forces, (N,3) N.
        world: its anchors and current add to the stiffness.
        method: "elimination" or "penalty".
        multiple: ratio of the penalty to the largest entry of the stiffness matrix.

    Raises:
        ValueError: for a missing node, an array of another shape or not finite, another method, a multiple that is not
            positive, or a node that the body fixes and the displacement moves.
        NoEquilibrium: if the stiffness does not resist every motion.
    """
    check_problem(body, world)
    if method not in METHODS:
        raise ValueError(f"method is {method!r}; choose from {', '.join(map(repr, METHODS))}")
    multiple = float(positive_array(multiple, (), "multiple"))
    nodes, shape = node_numbers(body, nodes), body.position.shape
    given = np.asarray(displacement)
    given = finite_array(given, (3,) if given.shape == (3,) else (nodes.size, 3), "displacement (m)")
    wanted = np.zeros(shape)
    wanted[nodes] = given
    load = np.zeros(shape) if load is None else finite_array(load, shape, "load (N)")
    own = body.inverse_mass == 0.0
    if (clash := wanted[own]).any():
        raise ValueError(
            f"the body fixes degrees of freedom that are to move by up to {abs(clash).max():g} m; free them"
        )
    moved = np.zeros(shape, dtype=bool)
    moved[nodes] = True
    matrix = csc_array(tangent(body, world, body.springs.rest_length, body.position))
    if method == "elimination":
        return _eliminated(matrix, wanted, load, own | moved)
    penalty = multiple * abs(matrix).max() * (moved & ~own)
    stiffer = csc_array(matrix + diags_array(penalty.ravel()))
    found, _ = _eliminated(stiffer, np.zeros(shape), load + penalty * wanted, own)
    bearing = (matrix @ found.ravel()).reshape(shape) - load  # P (u_c - u) is the same, with more rounding
    return found, np.where(own | moved, bearing, 0.0)


def _eliminated(matrix: csc_array, given, load, held) -> tuple[np.ndarray, np.ndarray]:
    """Displacements (N,3) with those of the mask `held` (N,3) given, and the reactions on `held`."""
    found, free, fixed = given.copy().ravel(), np.flatnonzero(~held.ravel()), np.flatnonzero(held.ravel())
    rows = matrix.tocsr()
    force = load.ravel() - rows @ found
    inner = rows[free][:, free]
    size = np.sqrt(np.abs(inner.diagonal()))  # scaling that makes penalties no larger than other entries
    if not size.all():
        raise NoEquilibrium(LOOSE)
    scale = diags_array(1.0 / size)
    options: dict[str, Any] = SYMMETRIC
    try:
        factors = splu(csc_array(scale @ inner @ scale), **options)
    except RuntimeError as error:
        raise NoEquilibrium(LOOSE) from error
    pivots = np.abs(factors.U.diagonal())
    if not pivots.min() > SINGULAR * pivots.max():
        raise NoEquilibrium(LOOSE)
    found[free] = factors.solve(force[free] / size) / size
    bearing = np.zeros(found.size)
    bearing[fixed] = (rows @ found - load.ravel())[fixed]
    return found.reshape(given.shape), bearing.reshape(given.shape)


def reactions(body: Body, position, world: World = VACUUM, rest_length=None, load=None) -> np.ndarray:
    """Reactions (N,3) N on the fixed degrees of freedom of a body at rest at positions (N,3) m; zero on free ones.

    Args:
        body: any body.
        position: for example the result of `fish_env.physics.statics.equilibrium`.
        world: gravity, current and anchors act; walls do not.
        rest_length: of the springs, (E,) m; None takes the body's.
        load: further forces, (N,3) N.

    Raises:
        ValueError: for an array of another shape, or not finite.
    """
    check_problem(body, world)
    shape, springs = body.position.shape, body.springs.rest_length
    rest = finite_array(springs if rest_length is None else rest_length, springs.shape, "rest_length (m)")
    load = np.zeros(shape) if load is None else finite_array(load, shape, "load (N)")
    evaluator = Evaluator(body, world._replace(planes=None))
    force = evaluator.force(rest, finite_array(position, shape, "position (m)"), np.zeros(shape)) + load
    return np.where(body.inverse_mass == 0.0, -force, 0.0)
