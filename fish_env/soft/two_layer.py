"""The fish as two skins with gas between and inside them (Song 2009): tissue around a swim bladder.

The outer skin is the default fish's surface, the inner one a smaller copy of it. Structural springs run along the edges
of each, radius and shear springs between them; twelve outer ones are muscles. The outer skin is braced across its
quadrilaterals, without which a body so much longer than it is wide would shear like a lattice. The gas has the pressure
of the water around while the fish is at rest, so that it resists a change of volume and nothing else.
`benchmarks/calibration/fit.py` fits stiffness, muscles and drag to the finest body's motion.
"""

import numpy as np

from fish_env.bodies import mass_spring as tu
from fish_env.bodies.fitted import fitted_parameters
from fish_env.bodies.masses import continuum, match_moments
from fish_env.bodies.outline import outline_of
from fish_env.checks import positive_array
from fish_env.physics.body import make_body
from fish_env.physics.elements import make_sections
from fish_env.physics.fish import Fish, Landmarks
from fish_env.physics.records import Body
from fish_env.soft.elements import fill, make_barriers
from fish_env.soft.skins import Skin, edges_of, layer_springs

WITHIN = [[], [0, 1, 2, 3, 4], *tu.LAYERS[2:5], [17, 18, 19, 20, 21, 22], []]
"""Inner nodes by the outer layer they lie at."""
SECTIONS = [[*layer, *(23 + node for node in inner)] for layer, inner in zip(tu.LAYERS, WITHIN, strict=True)]
REACH = 0.1  # how far the inner skin reaches into the head and into the tail fin, which have no cavity


def make_two_layer(
    bending=None, pull=None, shear=None, drag=None, damping=None, inner_size=0.5, inner_stiffness=0.3, inner_mass=0.87,
    pressure=1000.0, gap_pressure=1000.0, barrier_energy=3e-3, water=None, **parameters,
) -> Fish:  # fmt: skip
    """The pressurised fish: 46 nodes, 239 springs, two compartments.

    Args:
        bending: factors on the springs along the flanks of the sections behind the head, (5,); None: as fitted.
        pull: factors on the contraction of the three muscle segments, (3,); None: as fitted.
        shear: factor on the braces and on the shear springs from layer to layer; None: as fitted.
        drag: factors on the drag of the six sections, (6,); None: as fitted.
        damping: factor on the relaxation time of every spring; None: as fitted.
        inner_size: of the inner skin over the outer one, between 0 and 1.
        inner_stiffness: of the inner skin's springs over the outer ones', positive.
        inner_mass: the inner skin's part of the mass, between 0 and 1, before `match_moments` changes the masses.
        pressure: of the gas in the inner skin at rest, and of what surrounds it, Pa.
        gap_pressure: the same between the skins, Pa.
        barrier_energy: scale of the barrier that keeps the inner skin inside the outer one, J, for a fish of 0.2 m; it
            grows as the cube of the length.
        water: "drag" or "reactive", the water that it is fitted for; None: the default one.
        parameters: fields of `MassSpringParameters`.

    Raises:
        ValueError: for an unknown parameter or a value that is not allowed.
    """
    p = tu.check_parameters("two_layer", parameters, water)
    for name, value in (("inner_size", inner_size), ("inner_mass", inner_mass)):
        if not 0.0 < float(positive_array(value, (), name)) < 1.0:
            raise ValueError(f"{name} is {value!r}; give a number between 0 and 1")
    inner_stiffness = float(positive_array(inner_stiffness, (), "inner_stiffness"))
    bending, pull, shear, drag, damping = fitted_parameters("two_layer", water, bending, pull, shear, drag, damping)
    topology, classes, sections, faces = tu.topology()
    skin = Skin(tu.shape(p), edges_of(faces.tolist()), faces)
    body = two_skins(
        p, skin, inner_shape(p, inner_size), inner_mass, (bending, shear, inner_stiffness, damping),
        (pressure, gap_pressure), barrier_energy, drag,
    )  # fmt: skip
    edge = {frozenset(pair): e for e, pair in enumerate(skin.edges.tolist())}
    ends, mirror = topology[classes == tu.MUSCLE], tu.mirror_nodes()
    segments = sections[classes == tu.MUSCLE].astype(int) - 1
    return Fish(
        name="two_layer", body=body, muscles=np.array([edge[frozenset(pair)] for pair in ends.tolist()]),
        sides=np.where(np.isin(ends[:, 0], tu.LEFT), 1, -1), segments=segments,
        contracted=1.0 - (1.0 - np.array(p.contracted)[segments]) * pull[segments],
        time_step=p.time_step / 4,  # half of the largest stable step of barriers under oscillating commands
        nose=tu.NOSE, tail=np.array(tu.TAIL), left=tu.LEFT.copy(), right=tu.RIGHT.copy(),
        mirror=np.concatenate([mirror, mirror + 23]),
        landmarks=Landmarks(np.arange(23), np.zeros(23), tu.masses(p), faces, ends, mirror), **tu.common_fields(p),
    )  # fmt: skip


def two_skins(p, skin, inner, inner_mass, material, pressures, barrier_energy, drag) -> Body:
    """The body: nodes 0 to 22 the outer skin, 23 to 45 the inner one (23,3) m, two compartments, barriers."""
    # `material`: factors on the bending and the shear stiffness, the inner skin's stiffness over the outer one's, and a
    # factor on the relaxation time. `drag`: factors on the drag of the six sections.
    faces, scale = skin.faces, p.length / tu.REFERENCE_LENGTH
    position, mass = np.concatenate([skin.place, inner]), tu.masses(p)
    mass = np.concatenate([(1.0 - inner_mass) * mass, inner_mass * mass])
    mass = match_moments(mass, position, continuum(p), solid=True)
    pairs, kinds = layer_springs(skin)
    quads = faces[faces[:, 2] != faces[:, 3]]
    braces = np.concatenate([quads[:, [0, 2]], quads[:, [1, 3]]])
    *material, damping = material
    stiffness = springs(p, skin, kinds, braces, *material)
    pairs = np.concatenate([pairs, braces])
    natural = np.linalg.norm(position[pairs[:, 0]] - position[pairs[:, 1]], axis=1)
    gap = np.concatenate([faces, reverse_faces(faces) + 23])
    triangles, nodes = corners_of(faces)
    share, drag = tu.drag_points(p, drag)
    return make_body(
        position, mass, pairs, stiffness,
        damping * p.relaxation_time * stiffness, natural, faces, share=share, drag=drag,
        compartments=fill(position, [faces + 23, gap], pressures, pressures),
        barriers=make_barriers(position, triangles, nodes, scale**3 * barrier_energy),
        sections=make_sections(position, mass, SECTIONS, tu.EDGES, outline_of(p).stations),
    )  # fmt: skip


def inner_shape(p, size) -> np.ndarray:
    """Positions (23,3) m of the inner skin: every layer smaller about its middle; it ends before snout and tail fin."""
    outer = tu.shape(p)
    inner = outer * (1.0, size, size)
    first, last = outer[tu.LAYERS[1], 0].mean(), outer[tu.LAYERS[5], 0].mean()
    inner[tu.NOSE, 0] = (1.0 - REACH) * first
    tail = list(tu.TAIL)
    inner[tail, 0] = last + REACH * (outer[tail, 0] - last)
    inner[tail, 2] = size * p.half_depth[4] * p.length * np.sign(outer[tail, 2])
    return inner


def corners_of(faces) -> tuple[np.ndarray, np.ndarray]:
    """Corners of faces, each with its two neighbours (K,3), and the inner partner (K,) that a barrier holds."""
    # A quadrilateral cut along one diagonal would not be its own mirror image.
    triangles, partners = [], []
    for face in faces.tolist():
        around = list(dict.fromkeys(face))
        for k, corner in enumerate(around):
            triangles.append((around[k - 1], corner, around[(k + 1) % len(around)]))
            partners.append(corner + 23)
    return np.array(triangles), np.array(partners)


def reverse_faces(faces) -> np.ndarray:
    """Turn faces (F,4) to be seen from inside; a triangle's third node stays the one given twice."""
    return np.where(faces[:, 2:3] == faces[:, 3:4], faces[:, [1, 0, 2, 3]], faces[:, [0, 3, 2, 1]])


def springs(p, skin, kinds, braces, bending, shear, inner) -> np.ndarray:
    """Stiffness (E,) N/m in the order of `layer_springs`, then of the braces: along edges that of the default fish."""
    cross, muscle, other = np.array(p.stiffness) * (p.length / tu.REFERENCE_LENGTH)
    layer = np.empty(23)
    for number, nodes in enumerate(tu.LAYERS):
        layer[nodes] = number
    ahead, behind = np.sort(layer[skin.edges], axis=1).T
    between = ahead != behind
    taper = tu.along(p.taper, np.where(between, ahead, ahead - 0.5))
    factor = np.where(between & (ahead > 0), np.array([1.0, *bending])[ahead.astype(int).clip(0, 5)], 1.0)
    edge = np.where(between & (ahead >= 1) & (ahead <= 3), muscle, other) * taper * factor
    stiffness = np.empty(kinds["shear right"].stop)
    stiffness[kinds["outer"]] = edge
    stiffness[kinds["inner"]] = inner * edge
    stiffness[kinds["radius"]] = other * tu.along(p.taper, layer - 0.5)
    for kind in ("shear left", "shear right"):
        stiffness[kinds[kind]] = np.where(between, shear * cross, other) * taper  # stiff enough to keep a layer square
    return np.concatenate([stiffness, shear * cross * tu.along(p.taper, layer[braces].min(axis=1))])
