"""The nouns of the simulation: what a body is, its state and its controls. Plain tuples of arrays.

A body is data. Every array here enters the compiled kernels as it is; `make_body` checks what it is given and says what
is allowed. The elements beside springs are made in `elements.py`.
"""

from itertools import combinations

import numpy as np

from fish_env.checks import finite_array, node_array, positive_array, representable
from fish_env.physics import forces
from fish_env.physics.elements import check_outward
from fish_env.physics.failures import FAILURES  # noqa: F401 - named here too, where the state that holds one is
from fish_env.physics.linalg import ldlt, rates
from fish_env.physics.records import (
    Barriers,
    Body,
    Compartments,
    Faces,
    Springs,
    Tets,
)


@representable("the body")
def make_body(position, mass, pairs, stiffness, damping, rest_length, faces, *, share=None,
              drag=None, depth=None, tets: Tets | None = None,
              compartments: Compartments | None = None, barriers: Barriers | None = None) -> Body:  # fmt: skip
    """Check the parts of a body and put them together, with the skyline computed once.

    Args:
        position: rest positions, (N,3) m.
        mass: node masses, (N,) kg, positive.
        pairs: the two nodes of each spring, (E,2), different nodes, each pair once.
        stiffness: c, (E,) N/m, zero or positive.
        damping: k, (E,) N s/m, zero or positive.
        rest_length: natural lengths, (E,) m, positive.
        faces: surface, (F,4); a triangle gives its third node twice.
        share: where on its faces the water is felt, as the part that each corner has in it, (F,4), rows of sum 1; None:
            in their middle.
        drag: factor on the push on each face, (F,), positive; None: 1.
        depth: height of the upright faces of a flat body, (F,) m; None if there are none.
        tets: of `make_tets`, for these positions, or None.
        compartments: of `make_compartments`, or None.
        barriers: of `make_barriers`, or None.

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
    depth = positive_array(np.zeros(len(corners)) if depth is None else depth, (len(corners),), "depth (m)", zero=True)
    if not depth.any():
        check_outward(position, corners)
    for name, part, kind in (("tets", tets, Tets), ("compartments", compartments, Compartments),
                             ("barriers", barriers, Barriers)):  # fmt: skip
        if not isinstance(part, kind | None):
            raise ValueError(f"{name} is a {type(part).__name__}; give what make_{name} returns, or None")
        highest = 0 if part is None else getattr(part, "faces" if name == "compartments" else "nodes").max(initial=0)
        if highest >= n:
            raise ValueError(f"{name} name node {highest}, which is missing; nodes are numbered 0 to {n - 1}")
    fours = corners if tets is None else np.concatenate([corners, tets.nodes])
    joined = np.concatenate([pairs, *(fours[:, pair] for pair in combinations(range(4), 2))])
    shape = ldlt.profile(joined, n)
    springs = Springs(
        pairs,
        positive_array(stiffness, (count,), "stiffness (N/m)", zero=True),
        positive_array(damping, (count,), "damping (N s/m)", zero=True),
        positive_array(rest_length, (count,), "rest_length (m)"),
        ldlt.entries(shape, pairs),
    )
    middle = np.where(corners[:, 2:3] == corners[:, 3:4], [[1 / 3, 1 / 3, 1 / 6, 1 / 6]], 0.25)
    share = positive_array(middle if share is None else share, corners.shape, "share", zero=True)
    for k in np.flatnonzero(np.abs(share.sum(axis=1) - 1.0) > 1e-9):
        raise ValueError(f"the shares of the corners of face {k} add up to {share[k].sum():g}; give parts of 1")
    drag = positive_array(np.ones(len(corners)) if drag is None else drag, (len(corners),), "drag")
    body = Body(
        position, mass, np.repeat(1.0 / mass[:, None], 3, axis=1), np.zeros((0, 2), np.int64), springs,
        Faces(corners, np.ascontiguousarray(share), drag, depth, bool(depth.any())), tets, compartments, barriers,
        0.0, 0.0, shape,
    )  # fmt: skip
    return with_rates(body)


def fix(body: Body, nodes, axes: str = "xyz") -> Body:
    """The body with nodes fixed along some axes, by elimination: no force moves them, and no row of a matrix is theirs.

    A fixed degree of freedom keeps the velocity it is given: zero fixes it, another moves it along its way.

    Args:
        body: any.
        nodes: their numbers, or a boolean mask (N,).
        axes: of "x", "y" and "z".

    Raises:
        ValueError: for a missing node, an axis of another name, or if nothing were left to move.
    """
    if not isinstance(body, Body):
        raise ValueError(f"body is a {type(body).__name__}; give a Body, as make_body makes one")
    held = np.zeros(body.position.shape, dtype=bool)
    held[np.ix_(node_numbers(body, nodes), chosen_axes(axes))] = True
    return fix_where(body, held)


def chosen_axes(axes) -> np.ndarray:
    """(3,) which of "x", "y" and "z" a string names; ValueError for another."""
    if not (isinstance(axes, str) and axes and set(axes) <= set("xyz")):
        raise ValueError(f"axes are {axes!r}; give some of 'xyz'")
    return np.array([axis in axes for axis in "xyz"])


def node_numbers(body: Body, nodes) -> np.ndarray:
    """Numbers (K,) of nodes that are given by them, or by a boolean mask (N,); ValueError for a missing one."""
    nodes = np.asarray(nodes)
    if nodes.dtype == bool:
        if nodes.shape != body.mass.shape:
            raise ValueError(f"the mask of nodes has shape {nodes.shape}; give {body.mass.shape}")
        nodes = np.flatnonzero(nodes)
    return node_array(nodes.reshape(-1, 1), 1, body.mass.size, "fixed nodes")[:, 0]


def fix_where(body: Body, held: np.ndarray) -> Body:
    """As `fix`: the body with the degrees of freedom of a boolean array (N,3) fixed, beside those that are."""
    inverse = np.where(held, 0.0, body.inverse_mass)
    if not inverse.any():
        raise ValueError(f"all {len(inverse)} nodes would be fixed along every axis; leave one of them free")
    return with_rates(body._replace(inverse_mass=inverse, fixed=np.ascontiguousarray(np.argwhere(inverse == 0.0))))


def scaled(body: Body, stiffness=1.0, damping=1.0, mass=1.0) -> Body:
    """The body with its elements' stiffness and damping and its nodes' masses multiplied by positive factors."""
    tets, compartments, barriers = body.tets, body.compartments, body.barriers
    return body._replace(
        mass=body.mass * mass,
        inverse_mass=body.inverse_mass / mass,
        springs=body.springs._replace(
            stiffness=body.springs.stiffness * stiffness, damping=body.springs.damping * damping
        ),
        tets=tets
        and tets._replace(
            shear=tets.shear * stiffness,
            dilation=tets.dilation * stiffness,
            relaxation_time=tets.relaxation_time * (damping / stiffness),
        ),
        compartments=compartments
        and compartments._replace(gas=compartments.gas * stiffness, ambient=compartments.ambient * stiffness),
        barriers=barriers and barriers._replace(energy=barriers.energy * stiffness),
        max_stiffness_eigenvalue=body.max_stiffness_eigenvalue * (stiffness / mass),
        max_damping_eigenvalue=body.max_damping_eigenvalue * (damping / mass),
    )


def with_rates(body: Body) -> Body:
    """The body with its highest elastic and viscous rates worked out, those of its free degrees of freedom."""
    root = np.sqrt(body.inverse_mass)
    return body._replace(
        max_stiffness_eigenvalue=rates.highest(forces.rest_matrices(body, elastic=True), root),
        max_damping_eigenvalue=rates.highest(forces.rest_matrices(body, elastic=False), root),
    )
