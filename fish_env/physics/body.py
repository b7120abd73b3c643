"""Construction of bodies: input validation, fixed degrees of freedom and scaling.

A body is a plain tuple of arrays, which the compiled kernels read unchanged. `make_body` checks its arguments and its
errors state the valid values. Elements other than springs are made in `elements.py`.
"""

import numpy as np

from fish_env.checks import finite_array, node_array, positive_array, representable
from fish_env.physics import forces
from fish_env.physics.elements import check_outward
from fish_env.physics.linalg import ldlt, rates
from fish_env.physics.records import Barriers, Body, Compartments, Faces, Sections, Springs, Tets


@representable("the body")
def make_body(position, mass, pairs, stiffness, damping, rest_length, faces, *, share=None,
              drag=None, depth=None, tets: Tets | None = None,
              compartments: Compartments | None = None, barriers: Barriers | None = None,
              sections: Sections | None = None) -> Body:  # fmt: skip
    """Check the parts of a body and combine them, with the skyline computed once.

    Args:
        position: rest positions, (N,3) m.
        mass: node masses, (N,) kg, positive.
        pairs: the two nodes of each spring, (E,2), different nodes, each pair once.
        stiffness: c, (E,) N/m, zero or positive.
        damping: k, (E,) N s/m, zero or positive.
        rest_length: natural lengths, (E,) m, positive.
        faces: surface, (F,4); a triangle gives its third node twice.
        share: point of each face at which the water acts, as the weights of its corners, (F,4), rows of sum 1; None:
            its middle.
        drag: factor on the drag of each face, (F,), positive; None: 1.
        depth: height of the upright faces of a flat body, (F,) m; None if there are none.
        tets: result of `make_tets` for these positions, or None.
        compartments: result of `make_compartments`, or None.
        barriers: result of `make_barriers`, or None.
        sections: result of `make_sections`, or None for a body on which the inertia of water cannot act.

    Raises:
        ValueError: for an invalid part; the message names it, its value and the valid values.
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
                             ("barriers", barriers, Barriers), ("sections", sections, Sections)):  # fmt: skip
        if not isinstance(part, kind | None):
            raise ValueError(f"{name} is a {type(part).__name__}; give what make_{name} returns, or None")
        highest = 0 if part is None else getattr(part, "faces" if name == "compartments" else "nodes").max(initial=0)
        if highest >= n:
            raise ValueError(f"{name} contain node {highest}; valid numbers are 0 to {n - 1}")
    shape = ldlt.profile_of_elements(n, pairs, corners, tets, sections)
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
        0.0, 0.0, shape, sections,
    )  # fmt: skip
    return with_rates(body)


def fix(body: Body, nodes, axes: str = "xyz") -> Body:
    """Fix nodes of a body along some axes by elimination (Dirichlet): no force moves them, no matrix has their rows.

    A fixed degree of freedom keeps its prescribed velocity: zero holds it in place, any other value moves it.

    Args:
        body: any body.
        nodes: node numbers, or a boolean mask (N,).
        axes: any of "x", "y" and "z".

    Raises:
        ValueError: for a missing node, an axis of another name, or if no degree of freedom would remain.
    """
    if not isinstance(body, Body):
        raise ValueError(f"body is a {type(body).__name__}; give a Body, as make_body makes one")
    held = np.zeros(body.position.shape, dtype=bool)
    held[np.ix_(node_numbers(body, nodes), chosen_axes(axes))] = True
    return fix_where(body, held)


def chosen_axes(axes) -> np.ndarray:
    """Boolean mask (3,) of the axes "x", "y" and "z" that a string contains; ValueError for another."""
    if not (isinstance(axes, str) and axes and set(axes) <= set("xyz")):
        raise ValueError(f"axes are {axes!r}; give some of 'xyz'")
    return np.array([axis in axes for axis in "xyz"])


def node_numbers(body: Body, nodes) -> np.ndarray:
    """Node numbers (K,) from node numbers or from a boolean mask (N,); ValueError for a missing node."""
    nodes = np.asarray(nodes)
    if nodes.dtype == bool:
        if nodes.shape != body.mass.shape:
            raise ValueError(f"the mask of nodes has shape {nodes.shape}; give {body.mass.shape}")
        nodes = np.flatnonzero(nodes)
    if np.unique(nodes).size < nodes.size:
        raise ValueError(f"the nodes are {nodes.tolist()}; give each of them once")
    return node_array(nodes.reshape(-1, 1), 1, body.mass.size, "fixed nodes")[:, 0]


def fix_where(body: Body, held: np.ndarray) -> Body:
    """Fix the degrees of freedom of a boolean array (N,3), in addition to those that are fixed already."""
    inverse = np.where(held, 0.0, body.inverse_mass)
    if not inverse.any():
        raise ValueError(f"all {len(inverse)} nodes would be fixed along every axis; leave one of them free")
    return with_rates(body._replace(inverse_mass=inverse, fixed=np.ascontiguousarray(np.argwhere(inverse == 0.0))))


def scale_body(body: Body, stiffness=1.0, damping=1.0, mass=1.0) -> Body:
    """Multiply the stiffness and damping of a body's elements and the masses of its nodes by positive factors."""
    tets, compartments, barriers, sections = body.tets, body.compartments, body.barriers, body.sections
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
        sections=sections and sections._replace(leverage=sections.leverage * mass),
        max_stiffness_eigenvalue=body.max_stiffness_eigenvalue * (stiffness / mass),
        max_damping_eigenvalue=body.max_damping_eigenvalue * (damping / mass),
    )


def with_rates(body: Body) -> Body:
    """Return the body with the highest stiffness and damping eigenvalues of its free degrees of freedom."""
    root = np.sqrt(body.inverse_mass)
    return body._replace(
        max_stiffness_eigenvalue=rates.highest(forces.rest_matrices(body, elastic=True), root),
        max_damping_eigenvalue=rates.highest(forces.rest_matrices(body, elastic=False), root),
    )
