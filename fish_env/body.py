"""The nouns of the simulation: what a body is, what it swims in, its state and its controls. Plain tuples of arrays.

A body is data. Every array here enters the compiled kernels as it is; the functions that make a `Body` or a `World`
check what they are given and say what is allowed.
"""

from itertools import combinations
from numbers import Real
from typing import NamedTuple

import numpy as np

from fish_env.linalg import ldlt


class Springs(NamedTuple):
    """Viscoelastic units (a spring and a dashpot side by side): E of them. Tu 1996, ch. 4."""

    nodes: np.ndarray  # (E,2) the two nodes of each unit
    stiffness: np.ndarray  # (E,) c, N/m
    damping: np.ndarray  # (E,) k, N s/m
    rest_length: np.ndarray  # (E,) natural length, m
    entry: np.ndarray  # (E,) place of the unit's off-diagonal entry in the skyline


class Faces(NamedTuple):
    """Surface elements the water acts on: F quadrilaterals, or triangles with their third node given twice."""

    nodes: np.ndarray  # (F,4) counter-clockwise seen from outside
    share: np.ndarray  # (F,4) part of the face's force each corner carries; rows sum to 1


class Body(NamedTuple):
    """A deformable body of N nodes at rest."""

    position: np.ndarray  # (N,3) m
    mass: np.ndarray  # (N,) kg
    springs: Springs
    faces: Faces
    elastic_rate: float  # highest eigenvalue of M^-1 K at rest, 1/s2: the square of the highest frequency
    viscous_rate: float  # highest eigenvalue of M^-1 D at rest, 1/s
    profile: ldlt.Profile  # skyline of the system matrix: the nodes that a unit or a face joins


class World(NamedTuple):
    """What surrounds the body. All zero is vacuum."""

    linear: float  # coefficient of the linear face law, kg/(m2 s)
    quadratic: float  # coefficient of the quadratic face law, half density times drag coefficient, kg/m3
    current: np.ndarray  # (3,) velocity of the water, m/s


class State(NamedTuple):
    """Motion of B bodies of one kind; the integrators advance it in place."""

    x: np.ndarray  # (B,N,3) m
    v: np.ndarray  # (B,N,3) m/s
    t: np.ndarray  # (B,) s
    failure: np.ndarray  # (B,) 0 while the body is sound, else an index into FAILURES
    counters: np.ndarray  # (B,4) work done and trouble met so far, a column for each of COUNTERS


class Control(NamedTuple):
    """What drives the bodies: rest lengths that move linearly in time during one call of `advance`, and then stop."""

    rest_length: np.ndarray  # (B,E) m; advanced in place at the end of the call
    rate: np.ndarray  # (B,E) m/s; zero after it


COUNTERS = ("force_evaluations", "factorisations", "solves", "non_positive_pivots")
FORCES, FACTORISATIONS, SOLVES, PIVOTS = 0, 1, 2, 3

STRETCH_LIMIT = 3.0  # a unit longer than this many natural lengths is taken as torn
FAILURES = (
    "",
    "non-finite: a position or velocity is not a number or infinite",
    f"torn: a unit is stretched beyond {STRETCH_LIMIT:g} times its natural length",
    "untrusted solve: a pivot of the system matrix has lost nine digits or is not finite",
    "no convergence: the adaptive method gave up",
)
NON_FINITE, TORN, UNTRUSTED_SOLVE, NO_CONVERGENCE = 1, 2, 3, 4

VACUUM = World(0.0, 0.0, np.zeros(3))


def make_water(density=1000.0, drag_coefficient=1.5, law="quadratic", current=(0.0, 0.0, 0.0)) -> World:
    """Still or uniformly moving water that pushes on outward-moving faces (docs/physics.md, eq. 11-13).

    Args:
        density: of the water, kg/m3 (quadratic law).
        drag_coefficient: of a face moving along its normal, dimensionless (quadratic law); for the linear law the
            coefficient itself, kg/(m2 s), and `density` is not used.
        law: "quadratic" (Terzopoulos, Tu & Grzeszczuk 1994) or "linear" (Tu & Terzopoulos 1994).
        current: velocity of the water, (3,) m/s.

    Raises:
        ValueError: for an unknown law, a negative or non-finite number, or a current that is not three finite numbers.
    """
    if law not in ("quadratic", "linear"):
        raise ValueError(f"unknown water law {law!r}; choose 'quadratic' or 'linear'")
    for name, value in (("density", density), ("drag_coefficient", drag_coefficient)):
        if not (isinstance(value, Real) and np.isfinite(value) and value >= 0):
            raise ValueError(f"{name} is {value!r}; give a finite number, zero or positive")
    flow = finite_array(current, (3,), "current (m/s)")
    if law == "linear":
        return World(float(drag_coefficient), 0.0, flow)
    return World(0.0, 0.5 * float(density) * float(drag_coefficient), flow)


def make_body(position, mass, pairs, stiffness, damping, rest_length, faces) -> Body:
    """Check the parts of a mass-spring body and put them together, with the skyline computed once.

    Args:
        position: rest positions, (N,3) m.
        mass: node masses, (N,) kg, positive.
        pairs: the two nodes of each unit, (E,2), different nodes, each pair once.
        stiffness: c, (E,) N/m, zero or positive.
        damping: k, (E,) N s/m, zero or positive.
        rest_length: natural lengths, (E,) m, positive.
        faces: surface, (F,4); a triangle gives its third node twice.

    Raises:
        ValueError: naming the part, what it holds, and what is allowed.
    """
    mass = np.asarray(mass)
    if mass.ndim != 1 or mass.size == 0:
        raise ValueError(f"mass has shape {mass.shape}; give one mass a node, (N,) with N at least 1")
    n = mass.size
    mass = positive_array(mass, (n,), "mass (kg)")
    position = finite_array(position, (n, 3), "position (m)")
    pairs = node_array(pairs, 2, n, "springs")
    if np.any(pairs[:, 0] == pairs[:, 1]):
        e = int(np.argmax(pairs[:, 0] == pairs[:, 1]))
        raise ValueError(f"spring {e} joins node {pairs[e, 0]} to itself; give two different nodes")
    if len(np.unique(np.sort(pairs, axis=1), axis=0)) != len(pairs):
        raise ValueError("two springs join the same pair of nodes; add their constants into one spring")
    count = len(pairs)
    corners = node_array(faces, 4, n, "faces")
    check_outward(position, corners)
    shape = ldlt.profile(np.concatenate([pairs, *(corners[:, pair] for pair in combinations(range(4), 2))]), n)
    springs = Springs(
        pairs,
        positive_array(stiffness, (count,), "stiffness (N/m)", zero=True),
        positive_array(damping, (count,), "damping (N s/m)", zero=True),
        positive_array(rest_length, (count,), "rest_length (m)"),
        ldlt.entries(shape, pairs),
    )
    share = np.where(corners[:, 2:3] == corners[:, 3:4], [[1 / 3, 1 / 3, 1 / 6, 1 / 6]], 0.25)
    rates = [highest_rate(position, mass, pairs, constant) for constant in (springs.stiffness, springs.damping)]
    return Body(position, mass, springs, Faces(corners, np.ascontiguousarray(share)), *rates, shape)


def scaled(body: Body, stiffness=1.0, damping=1.0, mass=1.0) -> Body:
    """The body with its units' stiffness and damping and its nodes' masses multiplied by positive factors."""
    springs = body.springs._replace(
        stiffness=body.springs.stiffness * stiffness, damping=body.springs.damping * damping
    )
    return body._replace(
        mass=body.mass * mass,
        springs=springs,
        elastic_rate=body.elastic_rate * (stiffness / mass),
        viscous_rate=body.viscous_rate * (damping / mass),
    )


def highest_rate(position, mass, pairs, constant) -> float:
    """Highest eigenvalue of M^-1 K for units of the given stiffness (E,) along their directions at rest."""
    n = len(mass)
    matrix = np.zeros((n, 3, n, 3))
    for (i, j), c in zip(pairs, constant, strict=True):
        r = position[j] - position[i]
        block = c * np.outer(r, r) / (r @ r)
        matrix[i, :, i] += block
        matrix[j, :, j] += block
        matrix[i, :, j] -= block
        matrix[j, :, i] -= block
    root = np.repeat(mass, 3) ** -0.5
    return float(np.linalg.eigvalsh(matrix.reshape(3 * n, 3 * n) * np.outer(root, root))[-1])


def check_outward(position, corners) -> None:
    """Raise ValueError if the faces (F,4) close a surface that is inside out: the water would pull instead of push."""
    edges = {(int(a), int(b)) for face in corners for a, b in zip(face, np.roll(face, -1), strict=True) if a != b}
    if not edges or any((b, a) not in edges for a, b in edges):
        return  # an open surface has no inside
    p, q, r, s = position[corners].transpose(1, 0, 2)
    area = 0.5 * np.cross(r - p, s - q)
    volume = np.sum(area * (p + q + r + s)) / 12  # exact for flat faces, near enough for the sign otherwise
    if volume <= 0:
        raise ValueError("the faces enclose a negative volume; give their nodes counter-clockwise seen from outside")


def finite_array(value, shape, name) -> np.ndarray:
    """`value` as a new float64 array of the given shape, or ValueError saying what it is and what it should be."""
    try:
        array = np.array(value, dtype=np.float64, order="C")
    except (TypeError, ValueError) as error:
        raise ValueError(f"{name} is {value!r}; give finite numbers of shape {shape}") from error
    if array.shape != tuple(shape):
        raise ValueError(f"{name} has shape {array.shape}; give shape {tuple(shape)}")
    if not np.isfinite(array).all():
        where = tuple(int(k) for k in np.argwhere(~np.isfinite(array))[0])
        raise ValueError(f"{name} is {array[where]} at {where}; give finite numbers")
    return array


def positive_array(value, shape, name, zero=False) -> np.ndarray:
    """As `finite_array`, and every element positive (or zero, where `zero` allows it)."""
    array = finite_array(value, shape, name)
    bad = array < 0 if zero else array <= 0
    if bad.any():
        where = tuple(int(k) for k in np.argwhere(bad)[0])
        raise ValueError(f"{name} is {array[where]} at {where}; give {'zero or ' if zero else ''}positive numbers")
    return array


def node_array(value, width, num_nodes, name) -> np.ndarray:
    """`value` as an int64 array (K, width) of existing node numbers, or ValueError."""
    array = np.array(value)
    if array.size == 0:
        return np.zeros((0, width), dtype=np.int64)
    if array.ndim != 2 or array.shape[1] != width or not np.issubdtype(array.dtype, np.integer):
        raise ValueError(f"{name} have shape {array.shape} and type {array.dtype}; give whole numbers (K, {width})")
    if array.min() < 0 or array.max() >= num_nodes:
        bad = int(array[(array < 0) | (array >= num_nodes)][0])
        raise ValueError(f"{name} name node {bad}, which is missing; nodes are numbered 0 to {num_nodes - 1}")
    return np.ascontiguousarray(array, dtype=np.int64)
