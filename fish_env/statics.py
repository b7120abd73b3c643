"""Bodies at rest: equilibrium under load, small deflections, natural frequencies.

Equilibrium is found by Newton's method with the exact derivatives of the forces. A full step may be too long; it is
halved until the simplified step that would follow it, with the matrix at hand, is shorter: Deuflhard's natural
monotonicity test (Deuflhard 2004, ch. 3). The residual itself would not do: a slender beam that bends stretches a
little in between, and is far stiffer along itself than across.

A body that nothing holds keeps its place: steps and deflections have no part in the rigid motions it is free to make.
"""

import warnings
from collections.abc import Callable
from functools import partial

import numpy as np
from scipy.linalg import LinAlgWarning, lu_factor, lu_solve, null_space
from scipy.sparse import block_array, csr_array, diags_array
from scipy.sparse.linalg import eigsh, splu

from fish_env import forces
from fish_env.body import Body
from fish_env.checks import finite_array
from fish_env.forces.sparse import tangent
from fish_env.world import VACUUM, World

ROUNDING = 1e-14  # of stiffness times place: what is left of a force in balance
SHORTEST = 2.0**-20  # part of a Newton step below which it is given up
MOST_STEPS = 200
SINGULAR = 1e-14  # smallest pivot over the largest
UNSTABLE = 1e-10  # of the highest rate: less is rounding
SHIFT = 1e-9
LOOSE = "the stiffness does not resist every motion; hold or anchor more nodes, or start from another place"
ADVICE = "apply the load in smaller steps, each started from the last; hold or anchor a body that its load would move"


class NoEquilibrium(ArithmeticError):  # noqa: N818 - it names what was not found
    """No place was found at which the forces vanish; the text says what to try."""


def equilibrium(body: Body, world: World = VACUUM, rest_length=None, start=None, load=None, tolerance=1e-9):
    """Positions (N,3) m at which no force acts on any free degree of freedom: f(x) + load = 0, at zero velocity.

    An equilibrium near the start, stable or not: `modes` tells. Held degrees of freedom stay where they start.

    Args:
        body: any; of a free body the place is kept.
        world: gravity, current and anchors act; walls are refused.
        rest_length: of the springs, (E,) m; None takes the body's.
        start: positions, (N,3) m; None takes those at rest.
        load: further forces, (N,3) N, that keep their direction.
        tolerance: largest force left, over the largest at the start; never asked for below rounding.

    Raises:
        ValueError: for an array of another shape or not finite, a tolerance that is not positive, or walls.
        NoEquilibrium: if Newton's method does not find one.
    """
    if world.planes is not None:
        raise ValueError("the world has walls, which stop motion; hold the nodes that rest on them instead (body.hold)")
    if not tolerance > 0:
        raise ValueError(f"tolerance is {tolerance!r}; give a positive number")
    n = len(body.mass)
    rest = body.springs.rest_length if rest_length is None else rest_length
    rest = finite_array(rest, body.springs.rest_length.shape, "rest_length (m)")
    x = finite_array(body.position if start is None else start, (n, 3), "start (m)")
    load = np.zeros((n, 3)) if load is None else finite_array(load, (n, 3), "load (N)")
    free = _free(body)

    def force(x):
        f = np.empty((n, 3))
        forces.total(body, world, rest, x, np.zeros((n, 3)), f)
        return (f + load).ravel()[free]

    f = force(x)
    wanted = tolerance * np.abs(f).max()
    for _ in range(MOST_STEPS):
        matrix = tangent(body, world, rest, x)
        floor = ROUNDING * np.abs(matrix.diagonal()).max() * np.abs(x).max()
        if not np.abs(f).max() > max(wanted, floor):
            return x
        x, f = _newton(x, f, force, free, _solver(body, world, matrix, x))
    raise NoEquilibrium(f"forces of {np.abs(f).max():g} N are left after {MOST_STEPS} steps; {ADVICE}")


def _newton(x, f, force: Callable, free, solve: Callable):
    """One Newton step from x with the forces f, shortened as far as need be: positions and forces after it."""
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
    """Displacements (N,3) m under small forces on a body at rest: K u = load, held degrees of freedom zero.

    Args:
        body: any; of a free body the load must balance.
        load: (N,3) N.
        world: whose anchors and current add to the stiffness.

    Raises:
        ValueError: if the load is of another shape, not finite, or moves a free body.
        NoEquilibrium: if the stiffness does not resist every motion.
    """
    x = body.position
    load = finite_array(load, x.shape, "load (N)")
    free, matrix = _free(body), tangent(body, world, body.springs.rest_length, x)
    moved = rigid_motions(body, world, x).T @ load.ravel()[free]
    if np.abs(moved).max(initial=0.0) > 1e-9 * np.abs(load).max():
        raise ValueError("the load has a resultant that moves the free body; hold some nodes, or balance the load")
    displacement = np.zeros(x.size)
    displacement[free] = _solver(body, world, matrix, x)(load.ravel()[free])
    return displacement.reshape(x.shape)


def modes(body: Body, count: int, world: World = VACUUM, rest_length=None, position=None):
    """Lowest natural frequencies (count,) Hz and their shapes (count,N,3), 1/sqrt(kg); of a free body rigid ones first.

    Undamped vibration about an equilibrium: K u = (2 pi f)^2 M u, with u^T M u = 1. The frequency of a rigid motion is
    zero but for rounding.

    Args:
        body: any.
        count: how many, from 1 to the number of free degrees of freedom.
        world: whose anchors add to the stiffness.
        rest_length: of the springs, (E,) m; None takes the body's.
        position: the equilibrium, (N,3) m; None takes the positions at rest.

    Raises:
        ValueError: for a count out of range.
        NoEquilibrium: if the body would leave the position by itself.
    """
    free = _free(body)
    if not (isinstance(count, int | np.integer) and 1 <= count <= free.size):
        raise ValueError(f"count is {count!r}; give a whole number from 1 to {free.size}")
    x = body.position if position is None else finite_array(position, body.position.shape, "position (m)")
    rest = body.springs.rest_length if rest_length is None else rest_length
    matrix = tangent(body, world, finite_array(rest, body.springs.rest_length.shape, "rest_length (m)"), x)
    root = np.sqrt(body.inverse_mass).ravel()[free]
    squares, shapes = _lowest(matrix, free, root, count)
    if squares[0] < -UNSTABLE * body.elastic_rate:
        raise NoEquilibrium(f"the position is unstable: a motion grows at {np.sqrt(-squares[0]):g} 1/s; give another")
    found = np.zeros((count, x.size))
    found[:, free] = root * shapes.T
    return np.sqrt(np.maximum(squares, 0.0)) / (2.0 * np.pi), found.reshape(count, *x.shape)


def _lowest(matrix, free, root, count):
    """Lowest eigenvalues (count,), 1/s2, and vectors (K,count) of W K W: W the diagonal `root` (K,)."""
    if isinstance(matrix, np.ndarray):
        scaled = matrix[np.ix_(free, free)] * np.outer(root, root)
        values, vectors = np.linalg.eigh(0.5 * (scaled + scaled.T))
        return values[:count], vectors[:, :count]
    scaled = diags_array(root) @ matrix[free][:, free] @ diags_array(root)
    scaled = (0.5 * (scaled + scaled.T)).tocsc()
    if count >= free.size // 2:
        return _lowest(scaled.toarray(), np.arange(free.size), np.ones(free.size), count)
    shift = -SHIFT * np.abs(scaled.diagonal()).max()  # just below zero, so that rigid motions leave it regular
    values, vectors = eigsh(scaled, k=count, sigma=shift, v0=np.cos(np.arange(free.size)))
    order = np.argsort(values)
    return values[order], vectors[:, order]


def rigid_motions(body: Body, world: World, x) -> np.ndarray:
    """Orthonormal rigid motions (K,R) of the free degrees of freedom at x (N,3) that no hold and no anchor resists."""
    if world.anchors is not None:
        return np.zeros((_free(body).size, 0))
    arms = x - x.mean(axis=0)
    motions = np.zeros((*x.shape, 6))
    motions[:, [0, 1, 2], [0, 1, 2]] = 1.0
    for axis in range(3):
        motions[:, :, 3 + axis] = np.cross(np.eye(3)[axis], arms) / np.abs(arms).max()
    motions = motions.reshape(-1, 6)
    held = motions[body.inverse_mass.ravel() == 0.0]
    allowed = null_space(held) if held.size else np.eye(6)
    return np.linalg.qr(motions[_free(body)] @ allowed)[0]


def _solver(body: Body, world: World, matrix, x) -> Callable:
    """Solution of K u = f on the free degrees of freedom, u without rigid motion: a function of f (K,)."""
    free, rigid = _free(body), rigid_motions(body, world, x)
    rigid = rigid * np.abs(matrix.diagonal()).max()
    size, border = rigid.shape
    if isinstance(matrix, np.ndarray):
        system = np.block([[matrix[np.ix_(free, free)], rigid], [rigid.T, np.zeros((border, border))]])
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", LinAlgWarning)  # the pivots are looked at below
            factors = lu_factor(system)
        pivots, solve = np.diag(factors[0]), partial(lu_solve, factors)
    else:
        system = matrix[free][:, free]
        if border:
            system = block_array([[system, csr_array(rigid)], [csr_array(rigid.T), None]])
        try:
            factors = splu(system.tocsc(), permc_spec="MMD_AT_PLUS_A", options={"SymmetricMode": True})
        except RuntimeError as error:
            raise NoEquilibrium(LOOSE) from error
        pivots, solve = factors.U.diagonal(), factors.solve
    if not np.abs(pivots).min() > SINGULAR * np.abs(pivots).max():
        raise NoEquilibrium(LOOSE)
    padding = np.zeros(border)
    return lambda f: solve(np.concatenate([f, padding]))[:size]


def _free(body: Body) -> np.ndarray:
    """(K,) numbers of the degrees of freedom that may move."""
    return np.flatnonzero(body.inverse_mass.ravel())
