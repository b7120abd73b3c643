"""The fish as corotational tetrahedra: a soft solid, stiffened along its flanks by fibres, of which twelve are muscles.

The outline is the default fish's, cut into `level` pieces a section and into 2 x `level` cells across and upward. From
layer to layer run fibres, springs spread over the cross-section: muscles where that fish has them, else tendons. They
skip the nodes in between, at which a chain of springs would buckle, the sooner the finer. The fibres carry the bending,
the solid shear and volume. `benchmarks/calibration/bodies.py` fits both to the default fish.
"""

import numpy as np

from fish_env.bodies import mass_spring as tu
from fish_env.bodies.fish import Fish, Landmarks
from fish_env.bodies.fitted import checked_level, fitted
from fish_env.bodies.mesh import grid, lumped_mass
from fish_env.body import make_body
from fish_env.elements import make_tets
from fish_env.world import make_water

SHAPES = {"bending": (5,), "pull": (3,), "young": (6,), "drag": ()}
MOST = 3  # pieces a section
POISSON = 0.4


def make_tetrahedral(
    level=1, bending=None, pull=None, young=None, drag=None, poisson=POISSON, corotational=True, lumping="quarter",
    **parameters,
) -> Fish:  # fmt: skip
    """The fish of tetrahedra: 49 nodes and 116 elements with level 1, some 8 times as many with every doubling.

    Args:
        level: 1 to 3.
        bending: factors on the stiffness of the fibres of the sections behind the head, (5,); None: as fitted.
        pull: factors on the contraction of the three muscle segments, (3,); None: as fitted.
        young: Young's modulus of the solid of the six sections of a fish of 0.2 m, (6,) Pa; None: as fitted.
        drag: factor on the drag coefficient, which is that of coarse faces; None: as fitted.
        poisson: Poisson's ratio of the solid, above -1 and below 0.5.
        corotational: False for plain linear elasticity, which swells when it turns.
        lumping: "quarter" of each element's mass to its corners, or "uniform".
        parameters: fields of `MassSpringParameters`.

    Raises:
        ValueError: for another level, an unknown parameter or a value that is not allowed.
    """
    level = checked_level(level, MOST)
    p = tu.checked_parameters("tetrahedral", parameters)
    given = {"bending": bending, "pull": pull, "young": young, "drag": drag}
    bending, pull, young, drag = fitted("tetrahedral", level, SHAPES, **given)
    mesh, section = meshed(p, level)
    modulus = young[section] * (p.length / tu.REFERENCE_LENGTH) ** 2
    tets = make_tets(mesh.position, mesh.tets, modulus, poisson, p.relaxation_time, corotational)
    pairs, stiffness, place = fibres(p, mesh, bending, level)
    natural = np.linalg.norm(mesh.position[pairs[:, 0]] - mesh.position[pairs[:, 1]], axis=1)
    body = make_body(
        mesh.position, masses(p, mesh, lumping), pairs, stiffness, p.relaxation_time * stiffness, natural,
        mesh.faces, tets=tets,
    )  # fmt: skip
    driven = np.flatnonzero(np.isin(place // 4, (1, 2, 3)))
    drives = np.repeat(place[driven, None] - 4, 2, axis=1)
    segments = np.repeat(np.arange(3), 4)
    lines = corner_lines(mesh)[:, 1:-1]
    mirror = np.array([np.argmin(((mesh.position * (1, -1, 1) - at) ** 2).sum(axis=1)) for at in mesh.position])
    return Fish(
        name="tetrahedral",
        body=body,
        length=float(p.length),
        muscles=driven[[int(np.argmax(drives[:, 0] == m)) for m in range(12)]],
        fibres=driven,
        drives=drives,
        sides=np.tile([1, -1, -1, 1], 3),
        segments=segments,
        contracted=1.0 - (1.0 - np.array(p.contracted)[segments]) * pull[segments],
        contraction_time=float(p.contraction_time),
        activation_time=p.activation_time,
        time_step=float(p.time_step) / (4.0 if level > 2 else 2.0),  # small elements stiffen when muscles contract
        control_interval=float(p.control_interval),
        water=make_water(tu.WATER_DENSITY, p.drag_coefficient * float(drag)),
        nose=int(mesh.number[0, 0, 0]),
        tail=mesh.number[-1, 0, [-1, 0]],
        left=lines[[0, 3]].ravel(),
        right=lines[[1, 2]].ravel(),
        mirror=mirror,
        landmarks=landmarks(mesh, level, tu.masses(p)),
    )


def meshed(p, level):
    """The mesh of the default fish's outline, and the section of the body, 0 to 5, in which each tetrahedron is."""
    along = p.length * np.interp(np.arange(6 * level + 1) / level, np.arange(7), [0.0, *p.layer_position, 1.0])
    half = [[0.0, *p.half_width, 0.0], [0.0, *p.half_depth, p.tail_half_span]]
    width, depth = (p.length * np.interp(np.arange(6 * level + 1) / level, np.arange(7), row) for row in half)
    mesh = grid(-along, width, depth, 2 * level, 2 * level)
    section = np.clip(np.searchsorted(along, -mesh.position[mesh.tets, 0].mean(axis=1)) - 1, 0, 6 * level - 1) // level
    return mesh, section


def corner_lines(mesh) -> np.ndarray:
    """Nodes along the four edges of the body, (4,R): up-left, up-right, down-right, down-left, as a layer's are."""
    return np.array([mesh.number[:, j, k] for j, k in ((-1, -1), (0, -1), (0, 0), (-1, 0))])


def fibres(p, mesh, bending, level):
    """Springs from layer to layer: pairs (E,2), stiffness (E,) N/m, and place (E,), four times the section plus edge.

    Those of an edge together are as stiff as the spring of the default fish that runs along it there, times a factor.
    They are spread over the quarter of the cross-section at that edge, by area and in proportion to the distances from
    the middle planes; at level 1 only the edge itself is left. The distances count more the farther out: the sum of
    stiffness times their squares is the same at every level.
    """
    _, muscle, other = np.array(p.stiffness) * (p.length / tu.REFERENCE_LENGTH) ** 3
    section = np.array([other, muscle, muscle, muscle, other, other]) * p.taper * np.array([1.0, *bending])
    steps = np.arange(1, level + 1)
    weight = steps * np.where(steps == level, 0.5, 1.0)  # away from a middle plane: distance times width
    weight = np.outer(weight, weight) / (weight @ steps**2 / level**2) ** 2
    pairs, stiffness, place = [], [], []
    for k in range(6):
        for edge, (y, z) in enumerate(((1, 1), (-1, 1), (-1, -1), (1, -1))):
            here, behind = (mesh.number[i * level][np.ix_(level + y * steps, level + z * steps)] for i in (k, k + 1))
            pairs.append(np.stack([here, behind], axis=-1).reshape(-1, 2)[::-1])  # the edge itself first
            stiffness.append(section[k] * weight.ravel()[::-1])
            place.append(np.full(level**2, 4 * k + edge))
    return np.concatenate(pairs), np.concatenate(stiffness), np.concatenate(place)


def masses(p, mesh, lumping) -> np.ndarray:
    """Node masses (N,) kg: of the displaced water in all, distributed as the default fish's layers are."""
    middle = mesh.position[mesh.tets, 0].mean(axis=1)
    known = -p.length * np.array([0.0, *p.layer_position, 1.0])
    density = tu.WATER_DENSITY * np.interp(-middle, -known, p.mass_factor)
    mass = lumped_mass(mesh.position, mesh.tets, density, lumping)
    return mass * (tu.masses(p).sum() / mass.sum())


def landmarks(mesh, level, mass) -> Landmarks:
    """The default fish's nodes: the corners of every `level`-th station."""
    lines = corner_lines(mesh)[:, ::level]
    node = np.array([mesh.number[0, 0, 0], *lines[:, 1:-1].T.ravel(), *mesh.number[-1, 0, [-1, 0]]])
    pairs, classes, _, faces = tu.topology()
    return Landmarks(node, np.zeros(23), mass, faces, pairs[classes == tu.MUSCLE], tu.mirrored())
