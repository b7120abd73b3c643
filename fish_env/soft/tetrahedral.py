"""The fish as corotational tetrahedra: a soft solid with fibres along its four edges, of which twelve are muscles.

The outline is cut into `level` pieces a section and into 2 x `level` cells across and upward. From layer to layer run
fibres, springs where the default fish has them along its edges: muscles, else tendons. They skip the nodes in between,
at which a chain of springs would buckle, the sooner the finer. The material is the same at every level: `softening`
takes off what linear elements are too stiff in bending. `benchmarks/calibration/living_fish.py` calibrated it to living
fish.
"""

import numpy as np

from fish_env.bodies import mass_spring as tu
from fish_env.bodies.fitted import read_calibration
from fish_env.bodies.masses import WATER_DENSITY, continuum, match_moments
from fish_env.bodies.outline import layers_of, outline_of, sides_of
from fish_env.checks import check_names, positive_array
from fish_env.physics.body import make_body
from fish_env.physics.elements import make_sections
from fish_env.physics.fish import Fish, Landmarks
from fish_env.soft.elements import make_tets
from fish_env.soft.mesh import RULES, grid, lumped_mass
from fish_env.soft.room import whole

MOST = 4  # pieces a section
POISSON = 0.4


def make_tetrahedral(
    level=1, young=None, poisson=POISSON, strain="corotational", lumping="matched", water=None, **parameters
) -> Fish:
    """The fish of tetrahedra: 49 nodes and 116 elements with level 1, some 8 times as many with every doubling.

    Args:
        level: 1 to 4. The material is the same at every level.
        young: Young's modulus of the solid of the six sections, (6,) Pa, at every length; None: as calibrated.
        poisson: Poisson's ratio of the solid, above -1 and below 0.5.
        strain: "corotational"; "linear", which swells when it turns; or "green_lagrange" (`make_tets`).
        lumping: "matched", masses with the inertia of the outline; "quarter" of each element's mass to its corners, or
            "uniform".
        water: "drag" or "reactive", the water that it is calibrated for; None: the default one.
        parameters: fields of `MassSpringParameters`; those of this body's own material are in `tetrahedral.json`.

    Raises:
        ValueError: for another level, an unknown parameter or a value that is not allowed.
    """
    level, own = whole(level, "level", 1, MOST), read_calibration("tetrahedral", water)
    p = tu.check_parameters("tetrahedral", parameters, water, own["parameters"])
    young = positive_array(own["young"] if young is None else young, (6,), "young")
    mesh, section = make_mesh(p, level)
    modulus = (young * softening(mesh, section, poisson))[section]
    tets = make_tets(mesh.position, mesh.tets, modulus, poisson, p.relaxation_time, strain)
    marks = landmarks(mesh, level, tu.masses(p))
    pairs, stiffness, muscles = fibres(p, marks)
    natural = np.linalg.norm(mesh.position[pairs[:, 0]] - mesh.position[pairs[:, 1]], axis=1)
    mass, lines = masses(p, mesh, lumping), corner_lines(mesh)[:, 1:-1]
    planes = [np.unique(plane) for plane in mesh.number]
    sections = make_sections(mesh.position, mass, planes, lines.reshape(2, -1), outline_of(p).stations, fin=level)
    body = make_body(
        mesh.position, mass, pairs, stiffness, p.relaxation_time * stiffness, natural,
        mesh.faces, tets=tets, sections=sections,
    )  # fmt: skip
    _, classes, section, _ = tu.topology()
    segments = section[classes == tu.MUSCLE].astype(int) - 1
    mirror = np.array([np.argmin(((mesh.position * (1, -1, 1) - at) ** 2).sum(axis=1)) for at in mesh.position])
    return Fish(
        name="tetrahedral", body=body, muscles=muscles, sides=np.where(np.isin(marks.muscles[:, 0], tu.LEFT), 1, -1),
        segments=segments, contracted=np.array(p.contracted)[segments],
        time_step=p.time_step / (4.0 if level > 2 else 2.0),  # small elements stiffen when muscles contract
        nose=int(mesh.number[0, 0, 0]), tail=mesh.number[-1, 0, [-1, 0]], left=lines[[0, 3]].ravel(),
        right=lines[[1, 2]].ravel(), mirror=mirror, landmarks=marks, **tu.common_fields(p),
    )  # fmt: skip


def make_mesh(p, level):
    """Make the mesh inside the fish's outline; returns it and the section, 0 to 5, of each tetrahedron."""
    at, (layer, *sides) = np.arange(6 * level + 1) / level, sides_of(p)
    along = np.interp(at, np.arange(7), layers_of(p)[0])
    width, depth = (np.interp(at, layer, side) for side in sides)
    mesh = grid(along, width, depth, 2 * level, 2 * level)
    return mesh, np.interp(-mesh.position[mesh.tets, 0].mean(axis=1), -along, at).astype(int)


def corner_lines(mesh) -> np.ndarray:
    """Nodes along the four edges of the body, (4,R): up-left, up-right, down-right, down-left, as a layer's are."""
    return np.array([mesh.number[:, j, k] for j, k in ((-1, -1), (0, -1), (0, 0), (-1, 0))])


def fibres(p, marks):
    """Springs along the edges, from layer to layer: pairs (24,2), stiffness (24,) N/m, and which are muscles (12,)."""
    pairs, classes, section, _ = tu.topology()
    layer = np.repeat(np.arange(7), [len(nodes) for nodes in tu.LAYERS])
    along = (layer[pairs[:, 0]] != layer[pairs[:, 1]]) & (classes != tu.CROSS)
    pairs, classes, section = pairs[along], classes[along], section[along].astype(int)
    stiffness = np.array(p.stiffness)[classes] * np.array(p.taper)[section] * (p.length / tu.REFERENCE_LENGTH)
    return marks.node[pairs], stiffness, np.flatnonzero(classes == tu.MUSCLE)


def softening(mesh, section, poisson) -> np.ndarray:
    """Factors (6,) on the moduli of the sections, with which each is as stiff in bending sideways as the continuum."""
    # A linear tetrahedron that is bent is sheared as well, and is too stiff by what that takes: the more, the longer it
    # is along the body and the thinner the body. The factor is the energy of pure bending, by the exact integral, over
    # that of the same displacements of the nodes, between which elements are linear. It tends to 1 as the mesh is
    # refined (docs/physics-more.md, eq. 71).
    tets = make_tets(mesh.position, mesh.tets, 1.0, poisson)
    x, y, z = mesh.position.T
    bent = np.stack([-x * y, 0.5 * (x**2 + poisson * (y**2 - z**2)), poisson * y * z], axis=1)  # of curvature 1
    slope = np.einsum("tik,til->tkl", bent[tets.nodes], tets.gradient)
    strain = 0.5 * (slope + slope.transpose(0, 2, 1))
    trace = np.trace(strain, axis1=1, axis2=2)
    found = tets.volume * (tets.shear * (strain**2).sum(axis=(1, 2)) + 0.5 * tets.dilation * trace**2)
    corner = y[tets.nodes]
    exact = 0.5 * tets.volume * (corner.sum(axis=1) ** 2 + (corner**2).sum(axis=1)) / 20.0  # half of y2, integrated
    return np.bincount(section, exact, 6) / np.bincount(section, found, 6)


def masses(p, mesh, lumping) -> np.ndarray:
    """Node masses (N,) kg: of the displaced water in all."""
    check_names("unknown rule", ("matched", *RULES), lumping)
    if lumping == "matched":
        mass = lumped_mass(mesh.position, mesh.tets, WATER_DENSITY)
        return match_moments(mass, mesh.position, continuum(p), solid=True)
    return lumped_mass(mesh.position, mesh.tets, WATER_DENSITY, lumping)


def landmarks(mesh, level, mass) -> Landmarks:
    """The default fish's nodes: the corners of every `level`-th station."""
    lines = corner_lines(mesh)[:, ::level]
    node = np.array([mesh.number[0, 0, 0], *lines[:, 1:-1].T.ravel(), *mesh.number[-1, 0, [-1, 0]]])
    pairs, classes, _, faces = tu.topology()
    return Landmarks(node, np.zeros(23), mass, faces, pairs[classes == tu.MUSCLE], tu.mirror_nodes())
