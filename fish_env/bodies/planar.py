"""The flat fish: the default one seen from above, for scenes that stay level.

Upper and lower nodes of each layer become one, motion out of the plane is eliminated, and the springs are those of the
default fish projected onto the plane, with factors that `benchmarks/calibration/fit.py` fitted to the finest body's
motion. The water acts on upright faces as deep as the fish is there.
"""

from itertools import pairwise

import numpy as np

from fish_env.bodies import mass_spring as tu
from fish_env.bodies.fitted import fitted_parameters
from fish_env.bodies.masses import continuum, layer_masses, match_moments
from fish_env.bodies.outline import layers_of, outline_of
from fish_env.physics.body import fix, make_body
from fish_env.physics.elements import make_sections
from fish_env.physics.fish import Fish, Landmarks

NODES = [(0, 0), *((k, k + 1) for k in range(1, 11, 2)), (11, 11)]
"""Left and right node of each layer, nose to tail; of nose and tail the one there is, twice."""


def make_planar(bending=None, pull=None, shear=None, drag=None, damping=None, water=None, **parameters) -> Fish:
    """The flat fish of 12 nodes.

    Args:
        bending: factors on the stiffness of the sections behind the head, (5,); None: as fitted.
        pull: factors on the contraction of the three muscle segments, (3,); None: as fitted.
        shear: factor on the stiffness of the diagonals; None: as fitted.
        drag: factors on the drag of the six sections, (6,); None: as fitted.
        damping: factor on the relaxation time of every spring; None: as fitted.
        water: "drag" or "reactive", the water that it is fitted for; None: the default one.
        parameters: fields of `MassSpringParameters`.

    Raises:
        ValueError: for an unknown parameter or a value that is not allowed.
    """
    p = tu.check_parameters("planar", parameters, water)
    bending, pull, shear, drag, damping = fitted_parameters("planar", water, bending, pull, shear, drag, damping)
    chord, diagonal, across, active = project_stiffness(p)
    chord[1:] *= bending
    diagonal[1:] *= bending
    diagonal *= shear
    active /= chord
    position = shape(p)
    pairs, stiffness, section, place = lattice(chord, diagonal, across)
    relaxation = damping * p.relaxation_time * tu.along(p.damping_taper, place)
    natural = np.linalg.norm(position[pairs[:, 0]] - position[pairs[:, 1]], axis=1)
    faces, section_of, height = surface(p)
    layer = np.repeat(np.arange(7), [len(set(nodes)) for nodes in NODES])[faces]
    share = tu.shares(faces, layer > section_of[:, None], np.array(p.water_place)[section_of])
    mass, groups, whole = masses(p), [sorted(set(nodes)) for nodes in NODES], outline_of(p)
    body = make_body(
        position, mass, pairs, stiffness, relaxation * stiffness, natural, faces,
        share=share, drag=(drag * p.water_drag)[section_of], depth=height,
        sections=make_sections(position, mass, groups, [[0], [0]], whole.stations, True),
    )  # fmt: skip
    fibres, drives = muscles(section)
    segments, sides = np.repeat(np.arange(3), 4), np.tile([1, -1, -1, 1], 3)
    left, right, mirror = mirror_nodes()
    return Fish(
        name="planar", body=fix(body, np.arange(len(position)), "z"),
        muscles=np.array([fibres[np.argmax((drives == m).any(axis=1))] for m in range(12)]),
        fibres=fibres, drives=drives, sides=sides, segments=segments,
        contracted=1.0 - ((1.0 - np.array(p.contracted)) * pull * active[1:4])[segments],
        time_step=p.time_step, refine=tu.REFINE, nose=0, tail=np.array([len(position) - 1] * 2), left=left,
        right=right, mirror=mirror, landmarks=landmarks(p), **tu.common_fields(p),
    )  # fmt: skip


def mirror_nodes() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Nodes on the left and on the right, (5,) each, and the node (12,) that each becomes when they are exchanged."""
    left, right = np.array(NODES[1:-1]).T.copy()
    mirror = np.arange(12)
    mirror[left], mirror[right] = right, left
    return left, right, mirror


def muscles(section) -> tuple[np.ndarray, np.ndarray]:
    """Springs that are fibres, (6,), and the muscles that drive each, (6,2), of the springs' sections (`lattice`)."""
    fibres = np.flatnonzero(np.isin(section // 2, (1, 2, 3)) & (section >= 0))
    segment, right = section[fibres] // 2 - 1, section[fibres] % 2
    return fibres, 4 * segment[:, None] + np.where(right[:, None], (1, 2), (0, 3))  # upper and lower one of the side


def shape(p) -> np.ndarray:
    """Rest positions (12,3) m: nose at the origin, body along -x, y to the left, z zero."""
    position = np.zeros((12, 3))
    for (left, right), x, width in zip(NODES, *layers_of(p)[:2], strict=True):
        position[[left, right], 0] = x
        position[left, 1], position[right, 1] = width, -width * (left != right)
    return position


def masses(p) -> np.ndarray:
    """Node masses (12,) kg: those of the default fish's layers, with the outline's mass, centre and yaw inertia."""
    mass = np.empty(12)
    for nodes, value in zip(NODES, layer_masses(p) * p.mass_factor, strict=True):
        mass[list(nodes)] = value / len(set(nodes))
    return match_moments(mass, shape(p), continuum(p), solid=False)


def project_stiffness(p):
    """Project the stiffness of the default fish's springs, N/m, onto the plane.

    Returns:
        chord (6,) of each side of a section, diagonal (6,) of each of two, across (7,) a layer, active (6,) the
        muscles' part of the chord.
    """
    along = p.length * np.diff([0.0, *p.layer_position, 1.0])
    _, width, depth = layers_of(p)
    cross, muscle, other = np.array(p.stiffness) * (p.length / tu.REFERENCE_LENGTH)
    taper = np.array(p.taper)
    front, back = (width[:-1], depth[:-1]), (width[1:], depth[1:])
    side = along**2 + (front[0] - back[0]) ** 2  # squares in the plane, of a line along a side and of one across
    slant = along**2 + (front[0] + back[0]) ** 2
    straight, crossed = (front[1] - back[1]) ** 2, (front[1] + back[1]) ** 2  # squares upward
    kind = np.array([other, muscle, muscle, muscle, other, other])
    active = 2 * kind * taper * side / (side + straight)
    chord = active + 2 * cross * taper * side / (side + crossed) * (np.arange(6) > 0)  # the head has no diagonals
    ends = np.isin(np.arange(6), (0, 5))  # a pyramid and a wedge, which do not shear
    diagonal = np.where(ends, chord, 2 * cross * taper * slant / (slant + straight))
    between = tu.along(taper, np.arange(5) + 0.5)
    flat = width[1:-1] ** 2 / (width[1:-1] ** 2 + depth[1:-1] ** 2)
    across = np.array([0.0, *(2 * between * (other + cross * flat)), 0.0])
    active *= np.isin(np.arange(6), (1, 2, 3))
    return chord, diagonal, across, active


def lattice(chord, diagonal, across):
    """The springs: pairs (E,2), stiffness (E,) N/m, section (E,) and place (E,)."""
    # Section is twice that of a chord plus 1 on the right, and -1 of springs that are no chords. The place is where
    # along the body they lie (`tu.topology`).
    pairs, stiffness, section, place = [], [], [], []
    for k, ((a, b), (c, d)) in enumerate(pairwise(NODES)):
        pairs += [(a, c), (b, d)]
        stiffness += [chord[k]] * 2
        section += [2 * k, 2 * k + 1]
        place += [k, k]
        if a != b and c != d:
            pairs += [(a, d), (b, c)]
            stiffness += [diagonal[k]] * 2
            section += [-1, -1]
            place += [k, k]
        if c != d:
            pairs.append((c, d))
            stiffness.append(across[k + 1])
            section.append(-1)
            place.append(k + 0.5)
    return np.sort(np.array(pairs), axis=1), np.array(stiffness), np.array(section), np.array(place, dtype=float)


def surface(p):
    """Upright faces (F,4), the section each is in (F,) and their depths (F,) m."""
    # The faces are the flanks, and the slopes that face forward, above and below.
    faces, section, height, depth = [], [], [], layers_of(p)[2]
    for k, ((a, b), (c, d)) in enumerate(pairwise(NODES)):
        front, back = depth[k], depth[k + 1]
        if a == b:  # the nose: third node twice, so that the face's force is shared as a triangle's
            faces += [(a, c, c, c), (d, b, d, d)]
            height += [2 * back] * 2
        else:
            faces += [(a, c, c, a), (d, b, b, d)]
            height += [front + back] * 2
        if back > front:  # they face forward; those that face back are hardly ever pushed
            faces += [(b, a, c, d)] * 2
            height += [back - front] * 2
        section += [k] * (len(faces) - len(section))
    return np.array(faces), np.array(section), np.array(height)


def landmarks(p) -> Landmarks:
    """The default fish's nodes, as far above or below the flat one's as they lie on it."""
    points, flat = tu.shape(p), shape(p)
    node = np.array([np.argmin(np.linalg.norm(flat - point, axis=1)) for point in points * (1.0, 1.0, 0.0)])
    pairs, classes, _, faces = tu.topology()
    return Landmarks(node, points[:, 2].copy(), tu.masses(p), faces, pairs[classes == tu.MUSCLE], tu.mirror_nodes())
