"""Bodies at rest: equilibrium under load, small deflections, prescribed displacements, natural frequencies.

Equilibrium is found by Newton's method with the exact derivatives of the forces. A step that is too long is halved
until the simplified step that would follow it, with the same matrix, is shorter: Deuflhard's natural monotonicity test
(Deuflhard 2004, ch. 3). A test of the residual would fail: a bending slender beam also stretches a little between two
iterations, and its axial stiffness is far larger.

A free body keeps its position: steps and deflections contain no free rigid motion. These are translations, and
rotations if all forces are internal.

Prescribed displacements solve the linear problem about rest, K u = load, with u given on the degrees of freedom c and
unknown on the others f:

- elimination: K_ff u_f = load_f - K_fc u_c, and the reactions are r_c = K_cf u_f + K_cc u_c - load_c;
- penalty: P = multiple * largest entry of K is added to the diagonal of c and P u_c to the load. The reactions are
  r_c = P (u_c - u) = K u - load, with the solution u. The error is proportional to 1 / multiple (Bathe, Finite Element
  Procedures, ch. 3.4).

For large displacements, fix the nodes (`fish_env.physics.body.fix`), start `equilibrium` with them at their new
positions, and compute the `reactions` there.
"""

from collections.abc import Callable
from typing import Any

import numpy as np
from scipy.linalg import orth
from scipy.sparse import block_array, csc_array, csr_array, diags_array, eye_array
from scipy.sparse.csgraph import structural_rank
from scipy.sparse.linalg import LinearOperator, eigsh, splu

from fish_env.checks import check_names, finite_array, is_whole, positive_array, real
from fish_env.physics.body import node_numbers
from fish_env.physics.failures import ESCAPED
from fish_env.physics.forces.evaluate import Evaluator
from fish_env.physics.integrators import limits
from fish_env.physics.integrity import check_problem
from fish_env.physics.linalg import rates
from fish_env.physics.records import Body, World
from fish_env.physics.world import VACUUM
from fish_env.soft.conditions import METHODS, PENALTY, vectors_along
from fish_env.soft.sparse import tangent

ROUNDING = 2e-15  # times stiffness and position: above the rounding error of balanced forces, 1.4e-16
SHORTEST = 2.0**-20  # part of a Newton step below which the line search stops
MOST_STEPS = 200
RANK = 1e-9
SINGULAR = 1e-14  # smallest pivot over the largest
UNSTABLE = 1e-10  # times the highest rate: less is rounding
SHIFT = 1e-7  # times the highest rate: at a hundredth of it, rounding errors of a solve mix neighbouring modes
SLACK = 1e-12  # times the largest stiffness, for motions without stiffness and without force
SYMMETRIC: dict[str, Any] = {"permc_spec": "MMD_AT_PLUS_A", "options": {"SymmetricMode": True}}
UNRESISTED = "the stiffness does not resist every motion; fix or anchor more nodes, or start from another place"
ADVICE = "apply the load in smaller steps, each started from the last; fix or anchor a body that its load would move"


class NoEquilibrium(ArithmeticError):  # noqa: N818 - named after what was not found
    """No equilibrium was found; the message suggests what to try."""


def equilibrium(body: Body, world: World = VACUUM, rest_length=None, start=None, load=None, tolerance=1e-9):
    """Positions (N,3) m at which no force acts on any free degree of freedom: f(x) + load = 0, at zero velocity.

    It finds an equilibrium near the start, stable or not; `modes` tests the stability. Fixed degrees of freedom keep
    their start position.

    Args:
        body: any body; a free body keeps its position.
        world: gravity, current and anchors act; walls raise an error.
        rest_length: of the springs, (E,) m; None takes the body's.
        start: positions, (N,3) m; None takes those at rest.
        load: further forces, (N,3) N, that keep their direction.
        tolerance: ratio of the largest residual force to the largest at the start; never below rounding.

    Raises:
        ValueError: for an array of another shape or not finite, a tolerance that is not positive, or walls.
        NoEquilibrium: if Newton's method does not find one.
    """
    check_problem(body, world)
    world = world._replace(added_mass=None)  # at rest, nothing accelerates
    if world.planes is not None:
        raise ValueError("the world has walls, which stop motion; fix the nodes that rest on them instead (body.fix)")
    if not real(tolerance) > 0:
        raise ValueError(f"tolerance is {tolerance!r}; give a positive number")
    rest = _given(rest_length, body.springs.rest_length, "rest_length (m)")
    x = _given(start, body.position, "start (m)")
    internal = load is None and _still(world) and (world.gravity is None or not world.gravity.any())
    free, still, evaluator = _free(body), np.zeros_like(x), Evaluator(body, world)
    load = _given(load, still, "load (N)")

    def force(x):
        if ESCAPED in evaluator.failures(rest, x):  # beyond a barrier nothing pushes back
            return np.full(free.size, np.nan)
        return (evaluator.force(rest, x, still) + load).ravel()[free]

    f = force(x)
    wanted = tolerance * np.abs(f).max()
    for _ in range(MOST_STEPS):
        matrix = tangent(body, world, rest, x)
        floor = ROUNDING * np.abs(matrix.diagonal()).max() * np.abs(x).max()
        if not np.abs(f).max() > max(wanted, floor):
            return x
        x, f = _newton(x, f, force, free, _solver(body, matrix, rigid_motions(body, world, x, internal), SLACK))
    raise NoEquilibrium(f"forces of {np.abs(f).max():g} N are left after {MOST_STEPS} steps; {ADVICE}")


def _newton(x, f, force: Callable, free, solve: Callable):
    """Positions and forces after one Newton step from x with the forces f, shortened as necessary."""
    step = solve(f)
    part, size = 1.0, np.linalg.norm(step)
    while part >= SHORTEST:
        trial = x.copy()
        trial.ravel()[free] += part * step
        after = force(trial)
        if np.isfinite(after).all() and np.linalg.norm(solve(after)) <= (1.0 - 0.25 * part) * size:
            return trial, after
        part *= 0.5
    raise NoEquilibrium(f"no step lessens the forces of {np.abs(f).max():g} N; {ADVICE}")


def linear_deflection(body: Body, load, world: World = VACUUM) -> np.ndarray:
    """Displacements (N,3) m under small forces on a body at rest: K u = load, fixed degrees of freedom zero.

    Args:
        body: any body; the load on a free body must balance.
        load: (N,3) N.
        world: its anchors and current add to the stiffness.

    Raises:
        ValueError: if the load is of another shape, not finite, or moves a free body.
        NoEquilibrium: if the stiffness does not resist every motion.
    """
    check_problem(body, world)
    world = world._replace(added_mass=None)  # at rest, nothing accelerates
    x = body.position
    load = finite_array(load, x.shape, "load (N)")
    free, matrix = _free(body), tangent(body, world, body.springs.rest_length, x)
    rigid = rigid_motions(body, world, x, _still(world))
    if np.abs(rigid.T @ load.ravel()[free]).max(initial=0.0) > 1e-9 * np.abs(load).max():
        raise ValueError("the load has a resultant that moves the free body; fix some nodes, or balance the load")
    displacement = np.zeros(x.size)
    displacement[free] = _solver(body, matrix, rigid)(load.ravel()[free])
    return displacement.reshape(x.shape)


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
    world = world._replace(added_mass=None)  # at rest, nothing accelerates
    check_names("method is", METHODS, method)
    multiple = float(positive_array(multiple, (), "multiple"))
    nodes, shape, own = node_numbers(body, nodes), body.position.shape, body.inverse_mass == 0.0
    wanted, displaced, every = np.zeros(shape), np.zeros(shape, dtype=bool), np.ones(3, dtype=bool)
    wanted[nodes], displaced[nodes] = vectors_along(displacement, nodes, every, "displacement", "it", "m"), True
    load = _given(load, np.zeros(shape), "load (N)")
    if (clash := abs(wanted[own])).any():
        raise ValueError(f"the body fixes degrees of freedom that are to move by up to {clash.max():g} m; free them")
    matrix = tangent(body, world, body.springs.rest_length, body.position)
    if method == "elimination":
        return _eliminate(matrix, wanted, load, own | displaced)
    penalty = multiple * abs(matrix).max() * (displaced & ~own)
    stiffer = csr_array(matrix + diags_array(penalty.ravel()))
    found, _ = _eliminate(stiffer, np.zeros(shape), load + penalty * wanted, own)
    bearing = (matrix @ found.ravel()).reshape(shape) - load  # P (u_c - u) is the same, with more rounding
    return found, np.where(own | displaced, bearing, 0.0)


def _eliminate(matrix: csr_array, given, load, held) -> tuple[np.ndarray, np.ndarray]:
    """Solve for displacements (N,3), given those of the mask `held` (N,3); return them and the reactions on `held`."""
    found, free, fixed = given.copy().ravel(), np.flatnonzero(~held.ravel()), np.flatnonzero(held.ravel())
    force = load.ravel() - matrix @ found
    inner = matrix[free][:, free]
    size = np.sqrt(np.abs(inner.diagonal()))  # scaling that makes penalties no larger than other entries
    if not size.all():
        raise NoEquilibrium(UNRESISTED)
    scale = diags_array(1.0 / size)
    if free.size:
        found[free] = _factor(scale @ inner @ scale).solve(force[free] / size) / size
    bearing = np.zeros(found.size)
    bearing[fixed] = (matrix @ found - load.ravel())[fixed]
    return found.reshape(given.shape), bearing.reshape(given.shape)


def reactions(body: Body, position, world: World = VACUUM, rest_length=None, load=None) -> np.ndarray:
    """Reactions (N,3) N on the fixed degrees of freedom of a body at rest at positions (N,3) m; zero on free ones.

    Args:
        body: any body.
        position: for example the result of `equilibrium`.
        world: gravity, current and anchors act; walls do not.
        rest_length: of the springs, (E,) m; None takes the body's.
        load: further forces, (N,3) N.

    Raises:
        ValueError: for an array of another shape, or not finite.
    """
    check_problem(body, world)
    world = world._replace(added_mass=None)  # at rest, nothing accelerates
    still, rest = np.zeros(body.position.shape), _given(rest_length, body.springs.rest_length, "rest_length (m)")
    x, load = finite_array(position, still.shape, "position (m)"), _given(load, still, "load (N)")
    force = Evaluator(body, world._replace(planes=None)).force(rest, x, still) + load
    return np.where(body.inverse_mass == 0.0, -force, 0.0)


def modes(body: Body, count: int, world: World = VACUUM, rest_length=None, position=None):
    """Lowest natural frequencies (count,) Hz and mode shapes (count,N,3), 1/sqrt(kg); rigid motions come first.

    Undamped vibration about an equilibrium: K u = (2 pi f)^2 M u, with u^T M u = 1. The frequency of a rigid motion is
    zero up to rounding.

    Args:
        body: any body.
        count: number of modes, from 1 to the number of free degrees of freedom.
        world: its anchors add to the stiffness.
        rest_length: of the springs, (E,) m; None takes the body's.
        position: the equilibrium, (N,3) m; None takes the positions at rest.

    Raises:
        ValueError: for a count out of range.
        NoEquilibrium: if the position is unstable.
    """
    check_problem(body, world)
    world = world._replace(added_mass=None)  # at rest, nothing accelerates
    free = _free(body)
    if not (is_whole(count) and 1 <= count <= free.size):
        raise ValueError(f"count is {count!r}; give a whole number from 1 to {free.size}")
    x, rest = _given(position, body.position, "position (m)"), body.springs.rest_length
    matrix = tangent(body, world, _given(rest_length, rest, "rest_length (m)"), x)
    root = np.sqrt(body.inverse_mass).ravel()[free]
    squares, shapes = _lowest(matrix, free, root, count)
    if squares[0] < -UNSTABLE * body.max_stiffness_eigenvalue:
        raise NoEquilibrium(f"the position is unstable: a motion grows at {np.sqrt(-squares[0]):g} 1/s; give another")
    found = np.zeros((count, x.size))
    found[:, free] = root * shapes.T
    return np.sqrt(np.maximum(squares, 0.0)) / (2.0 * np.pi), found.reshape(count, *x.shape)


def _lowest(matrix, free, root, count):
    """Lowest eigenvalues (count,), 1/s2, and vectors (K,count) of W K W: W the diagonal `root` (K,)."""
    scaled = diags_array(root) @ matrix[free][:, free] @ diags_array(root)
    scaled = (0.5 * (scaled + scaled.T)).tocsc()
    if free.size <= rates.DENSE or count >= free.size // 2:
        values, vectors = np.linalg.eigh(scaled.toarray())
        return values[:count], vectors[:, :count]
    shift = -SHIFT * np.abs(scaled.diagonal()).max()  # just below zero, so that rigid motions leave it regular
    inverse = LinearOperator(scaled.shape, splu((scaled - shift * eye_array(free.size)).tocsc(), **SYMMETRIC).solve)
    _, vectors = eigsh(scaled, k=count, sigma=shift, OPinv=inverse, v0=np.cos(np.arange(free.size)))
    basis = np.linalg.qr(vectors)[0]
    values, turn = np.linalg.eigh(basis.T @ (scaled @ basis))  # separates the modes of close eigenvalues
    return values, basis @ turn


def rigid_motions(body: Body, world: World, x, turning: bool) -> np.ndarray:
    """Orthonormal rigid motions (K,R) of the free degrees of freedom at x (N,3) that nodes and anchors allow."""
    # They are translations, which no other force of the package resists or drives, and rotations if `turning`. There
    # are none if a user's own force acts, because it may resist them.
    free = _free(body)
    if world.anchors is not None or world.extra:
        return np.zeros((free.size, 0))
    motions = limits.rigid_motions(body, x, turning)[free]
    return orth(motions, rcond=RANK) if motions.size else motions


def _solver(body: Body, matrix, rigid, slack=0.0) -> Callable:
    """Make the solver of K u = f on the free degrees of freedom: a function of f (K,), u without `rigid` (K,R)."""
    # `slack` times the largest stiffness is added to that of every degree of freedom.
    free, scale = _free(body), np.abs(matrix.diagonal()).max()
    rigid = rigid * scale
    size, border = rigid.shape
    system = matrix[free][:, free] + slack * scale * eye_array(size)
    if border:
        system = block_array([[system, csr_array(rigid)], [csr_array(rigid.T), None]])
    factors, padding = _factor(system), np.zeros(border)
    return lambda f: factors.solve(np.concatenate([f, padding]))[:size]


def _factor(matrix):
    """Factors of a sparse, symmetric matrix; NoEquilibrium if it is singular."""
    if structural_rank(matrix) < matrix.shape[0]:  # on such a matrix SuperLU may end the process
        raise NoEquilibrium(UNRESISTED)
    try:
        factors = splu(csc_array(matrix), **SYMMETRIC)
    except RuntimeError as error:
        raise NoEquilibrium(UNRESISTED) from error
    pivots = np.abs(factors.U.diagonal())
    if not pivots.min() > SINGULAR * pivots.max():
        raise NoEquilibrium(UNRESISTED)
    return factors


def _given(value, default: np.ndarray, name: str) -> np.ndarray:
    """Array of the shape of the default, which None stands for; ValueError for another shape, or not finite."""
    return finite_array(default if value is None else value, default.shape, name)


def _still(world: World) -> bool:
    """Return True if the water exerts no force on a body without motion."""
    return not (world.current.any() and (world.linear or world.quadratic or world.friction))


def _free(body: Body) -> np.ndarray:
    """Numbers (K,) of the free degrees of freedom."""
    return np.flatnonzero(body.inverse_mass.ravel())
