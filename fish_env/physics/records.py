"""Records of the simulation: bodies and their elements, their surroundings, their state and their controls.

Plain tuples of arrays, which enter the compiled kernels as they are. Makers check what they are given: `make_body` in
`body.py`, those of other elements in `elements.py`, those of worlds in `world.py`.
"""

from typing import NamedTuple

import numpy as np


class Profile(NamedTuple):
    """Shape of a skyline matrix of order N, a row for each node: entry (i, j) is at `start[i] + j - first[i]`."""

    first: np.ndarray  # (N,) first stored column of each row
    start: np.ndarray  # (N+1,) index of the start of each row; the last element is the number of stored entries
    diagonal: np.ndarray  # (N,) index of the diagonal entry of each node
    row: np.ndarray  # (N,) row of each node
    node: np.ndarray  # (N,) node of each row


class Springs(NamedTuple):
    """Viscoelastic elements (a spring and a dashpot side by side): E of them. Tu 1996, ch. 4."""

    nodes: np.ndarray  # (E,2) the two nodes of each spring
    stiffness: np.ndarray  # (E,) c, N/m
    damping: np.ndarray  # (E,) k, N s/m
    rest_length: np.ndarray  # (E,) natural length, m
    entry: np.ndarray  # (E,) place of the spring's off-diagonal entry in the skyline


class Faces(NamedTuple):
    """Surface elements the water acts on: F quadrilaterals, or triangles with their third node given twice."""

    # A face of a flat body stands upright on it: its third and fourth corner are `depth` above the nodes they name.
    nodes: np.ndarray  # (F,4) counter-clockwise seen from outside
    share: np.ndarray  # (F,4) part of the face's force each corner carries; rows sum to 1
    drag: np.ndarray  # (F,) factor on the drag; the water acts at one point of the face
    depth: np.ndarray  # (F,) m along z; zero for the face of a solid body
    upright: bool = False  # True if any face is upright


class Tets(NamedTuple):
    """Linear tetrahedra of an isotropic material: T of them (Müller & Gross 2004)."""

    nodes: np.ndarray  # (T,4) the fourth on the side the first three turn counter-clockwise seen away from it
    gradient: np.ndarray  # (T,4,3) of the shape function of each node at rest, 1/m
    volume: np.ndarray  # (T,) at rest, m3
    shear: np.ndarray  # (T,) Lame's mu, Pa
    dilation: np.ndarray  # (T,) Lame's lambda, Pa
    relaxation_time: np.ndarray  # (T,) damping over stiffness, s
    rotating: bool  # True: corotational; False: linear elasticity, which mistakes rotation for strain
    quadratic: bool  # the strain of Green and Lagrange instead of either


class Compartments(NamedTuple):
    """Gas inside closed surfaces: C compartments (Song 2009, ch. 4.5)."""

    faces: np.ndarray  # (Q,4) outward; a triangle gives its third node twice, an edge of a flat ring gives -1 for both
    first: np.ndarray  # (C+1,) index of each compartment's first face, and the end of the last one's
    gas: np.ndarray  # (C,) n R T, J
    ambient: np.ndarray  # (C,) pressure outside, Pa


class Barriers(NamedTuple):
    """Barriers that keep a node of an inner layer behind an outer face: K of them."""

    nodes: np.ndarray  # (K,4) the outer face (-1 for the third node of an edge), then the inner node
    volume: np.ndarray  # (K,) of the tetrahedron, or triangle, they span at rest, m3 (m2)
    energy: np.ndarray  # (K,) scale of the barrier, J


class Sections(NamedTuple):
    """Sections of a body from head to tail, along which the inertia of the water acts: K of them."""

    # A section moves as its centre does, the mean of its P_k nodes by mass.
    nodes: np.ndarray  # (P,) nodes of all sections, one section after the other
    first: np.ndarray  # (K+1,) index of each section's first node, and the end of the last one's
    share: np.ndarray  # (P,) part of a section's mass that each of its nodes has
    upper: np.ndarray  # (U,) nodes along the upper edge of the trunk, above those of `lower`: they show which way is up
    lower: np.ndarray  # (U,)
    height: float  # m, added to the sum of their distances upward: of a flat body, whose edges are one
    slope: np.ndarray  # (K,3) weights of the three nearest centres in the derivative along their line, 1/m
    lateral: np.ndarray  # (K,) volume of water that moves with each section sideways, m3
    vertical: np.ndarray  # (K,) upward, m3
    trailing: float  # lateral volume per length at the trailing edge, m2
    narrowing: np.ndarray  # (K,) m2, loss of vertical volume per length at each section, which the flow leaves behind
    fin: int  # sections of the tail fin, whose forces along the body act on the section before them
    leverage: float  # kg, mass times length of the body over the sum of the distances between its edges


class Body(NamedTuple):
    """A deformable body of N nodes at rest; None says that there are no elements of a kind."""

    VECTORS = ("position", "inverse_mass")

    position: np.ndarray  # (N,3) m
    mass: np.ndarray  # (N,) kg
    inverse_mass: np.ndarray  # (N,3) 1/kg; zero along an axis in which the node is fixed: its velocity never changes
    fixed: np.ndarray  # (H,2) node and axis of every degree of freedom that is eliminated
    springs: Springs
    faces: Faces
    tets: Tets | None
    compartments: Compartments | None
    barriers: Barriers | None
    max_stiffness_eigenvalue: float  # highest eigenvalue of M^-1 K at rest, 1/s2: the square of the highest frequency
    max_damping_eigenvalue: float  # highest eigenvalue of M^-1 D at rest, 1/s
    profile: Profile  # skyline of the system matrix: the nodes that an element joins
    sections: Sections | None = None


class State(NamedTuple):
    """Motion of B bodies of one kind; the integrators advance it in place."""

    x: np.ndarray  # (B,N,3) m
    v: np.ndarray  # (B,N,3) m/s
    t: np.ndarray  # (B,) s
    failure: np.ndarray  # (B,) 0 while the body is valid, else an index into FAILURES
    counters: np.ndarray  # (B,5) computing done and trouble met so far, a column for each of COUNTERS
    work: np.ndarray  # (B,) J, done so far by the driven springs: what their moving rest lengths put in


class Control(NamedTuple):
    """Input of the bodies: rest lengths that move linearly in time during one call of `advance`, and then stop."""

    rest_length: np.ndarray  # (B,E) m; advanced in place at the end of the call
    rate: np.ndarray  # (B,E) m/s; zero after it. Only the fibres of the fish's muscles move


COUNTERS = ("force_evaluations", "factorisations", "solves", "non_positive_pivots", "refinements")
FLOWS = ("positive_work", "damping", "water", "thrust")
"""Energy flows that a tank measures if asked to, J; `Tank.flows` defines them."""
FORCES, FACTORISATIONS, SOLVES, PIVOTS, REFINEMENTS = range(5)


class Anchors(NamedTuple):
    """Springs from a node to a point in the world: drag springs, or penalties that move a node. A of them."""

    VECTORS = ("point", "velocity")

    node: np.ndarray  # (A,)
    point: np.ndarray  # (A,3) m, position of the far end when a call of `advance` begins
    velocity: np.ndarray  # (A,3) m/s at which it moves, with which the damping compares the node's
    stiffness: np.ndarray  # (A,) N/m
    damping: np.ndarray  # (A,) N s/m along the spring; of an anchor without length, along all axes
    rest_length: np.ndarray  # (A,) m; zero pulls the node right to the point, by a force linear in its place


class World(NamedTuple):
    """Surroundings of the body. A part that is None is absent; all zero and None is vacuum."""

    VECTORS = ("current", "gravity")

    linear: float  # coefficient of the linear face law, kg/(m2 s)
    quadratic: float  # coefficient of the quadratic face law, half density times drag coefficient, kg/m3
    current: np.ndarray  # (3,) velocity of the water, m/s
    gravity: np.ndarray | None = None  # (3,) m/s2; None for a neutrally buoyant fish
    viscosity: float = 0.0  # of the air: drag on every node over its velocity, N s/m; only beside gravity
    planes: np.ndarray | None = None  # (P,5) unit normal into the free side, offset m, restitution
    anchors: Anchors | None = None
    added_mass: np.ndarray | None = None  # (2,) kg/m3, density times a factor on lateral and on vertical added mass
    righting: float = 0.0  # m/s2, gravity times the height of buoyancy above weight over the body's length
    extra: dict[str, NamedTuple] | None = None  # parameters of other forces; kernels read them as `world.<name>`
    friction: float = 0.0  # of faces along themselves, kg s^-1/2 m^-2, over the root of the body's length
    oblique: float = 1.0  # part of the square of a face's velocity along itself in the quadratic law; 0: cross-flow
    thinning: float = 0.0  # part that friction grows by, times the square of the sine between flow and face
