"""The flat fish: the default one seen from above, for scenes that stay level.

Upper and lower nodes of each layer become one, motion out of the plane is eliminated, and the springs are those of the
default fish projected onto the plane, with factors fitted by `benchmarks/calibration/bodies.py` to its bending
stiffness and to what its muscles do. The water acts on upright faces as deep as the fish is there. `level` sets how
many nodes there are.
"""

from typing import NamedTuple

import numpy as np

from fish_env.bodies import mass_spring as tu
from fish_env.bodies.fish import Fish, Landmarks
from fish_env.bodies.fitted import checked_level, fitted
from fish_env.body import fix, make_body
from fish_env.world import make_water

SHAPES = {"bending": (5,), "pull": (3,), "shear": ()}
MOST = 2  # pieces a section: finer lattices fold where a muscle contracts


class Outline(NamedTuple):
    """R rows across the fish, from nose to tail: each section of the default fish cut into pieces."""

    section: np.ndarray  # (R-1,) of the piece behind each row
    along: np.ndarray  # (R,) from the nose, m
    width: np.ndarray  # (R,) half of it, m
    depth: np.ndarray  # (R,) half of it, m
    pieces: int  # a section

    @property
    def nodes(self) -> list[tuple[int, int]]:
        """Left and right node of each row; of nose and tail the one there is, twice."""
        last = 2 * (len(self.along) - 2) + 1
        return [(0, 0), *((k, k + 1) for k in range(1, last, 2)), (last, last)]


def make_planar(level=1, bending=None, pull=None, shear=None, **parameters) -> Fish:
    """The flat fish: each section of the default one in `level` pieces, 12 nodes with one, 24 with two.

    Args:
        level: 1 or 2.
        bending: factors on the stiffness of the sections behind the head, (5,); None: as fitted.
        pull: factors on the contraction of the three muscle segments, (3,); None: as fitted.
        shear: factor on the stiffness of the diagonals; None: as fitted.
        parameters: fields of `MassSpringParameters`.

    Raises:
        ValueError: for another level, an unknown parameter or a value that is not allowed.
    """
    level = checked_level(level, MOST)
    p = tu.checked_parameters("planar", parameters)
    bending, pull, shear = fitted("planar", level, SHAPES, bending=bending, pull=pull, shear=shear)
    outline = rows(p, level)
    chord, diagonal, across, active = projected(p)
    chord[1:] *= bending
    diagonal[1:] *= bending
    diagonal *= shear
    active /= chord
    position = shape(outline)
    pairs, stiffness, piece = lattice(outline, chord, diagonal, across)
    natural = np.linalg.norm(position[pairs[:, 0]] - position[pairs[:, 1]], axis=1)
    faces, height = surface(outline)
    body = make_body(
        position, masses(p, outline), pairs, stiffness, p.relaxation_time * stiffness, natural, faces, depth=height
    )
    fibres = np.flatnonzero(np.isin(piece // 2 // outline.pieces, (1, 2, 3)) & (piece >= 0))
    segment, right = piece[fibres] // 2 // outline.pieces - 1, piece[fibres] % 2
    drives = 4 * segment[:, None] + np.where(right[:, None], (1, 2), (0, 3))  # upper and lower muscle of the side
    segments, sides = np.repeat(np.arange(3), 4), np.tile([1, -1, -1, 1], 3)
    left, right_nodes = np.array(outline.nodes[1:-1]).T.copy()
    mirror = np.arange(len(position))
    mirror[left], mirror[right_nodes] = right_nodes, left
    return Fish(
        name="planar",
        body=fix(body, np.arange(len(position)), "z"),
        length=float(p.length),
        muscles=np.array([fibres[np.argmax((drives == m).any(axis=1))] for m in range(12)]),
        fibres=fibres,
        drives=drives,
        sides=sides,
        segments=segments,
        contracted=1.0 - ((1.0 - np.array(p.contracted)) * pull * active[1:4])[segments],
        contraction_time=float(p.contraction_time),
        activation_time=p.activation_time,
        time_step=float(p.time_step) / (1.0 if level == 1 else 2.0),
        refine=tu.REFINE,
        control_interval=float(p.control_interval),
        water=make_water(tu.WATER_DENSITY, p.drag_coefficient),
        nose=0,
        tail=np.array([len(position) - 1] * 2),
        left=left,
        right=right_nodes,
        mirror=mirror,
        landmarks=landmarks(p, outline),
    )


def rows(p, level) -> Outline:
    """Where the nodes are: every section of the default fish cut into pieces."""
    along = np.array([0.0, *p.layer_position, 1.0])
    width, depth = np.array([0.0, *p.half_width, 0.0]), np.array([0.0, *p.half_depth, p.tail_half_span])
    at = np.arange(6 * level + 1) / level
    along, width, depth = (p.length * np.interp(at, np.arange(7), row) for row in (along, width, depth))
    return Outline(np.repeat(np.arange(6), level), along, width, depth, level)


def shape(outline) -> np.ndarray:
    """Rest positions (N,3) m: nose at the origin, body along -x, y to the left, z zero."""
    position = np.zeros((2 * len(outline.along) - 2, 3))
    for (left, right), along, width in zip(outline.nodes, outline.along, outline.width, strict=True):
        position[[left, right], 0] = -along
        position[left, 1], position[right, 1] = width, -width * (left != right)
    return position


def masses(p, outline) -> np.ndarray:
    """Node masses (N,) kg: those of the default fish's layers, each spread over the rows around it."""
    total = tu.masses(p)
    known = p.length * np.array([0.0, *p.layer_position, 1.0])
    row = np.zeros(len(outline.along))
    for layer, nodes in enumerate(tu.LAYERS):
        near = np.interp(outline.along, known, np.eye(7)[layer])  # a tent about the layer
        row += total[nodes].sum() * near / near.sum()
    mass = np.empty(2 * len(row) - 2)
    for nodes, value in zip(outline.nodes, row, strict=True):
        mass[list(nodes)] = value / len(set(nodes))
    return mass


def projected(p):
    """What the default fish's springs come to in the plane, N/m.

    Returns:
        chord (6,) of each side of a section, diagonal (6,) of each of two, across (7,) a layer, active (6,) the
        muscles' part of the chord.
    """
    along = p.length * np.diff([0.0, *p.layer_position, 1.0])
    width = p.length * np.array([0.0, *p.half_width, 0.0])
    depth = p.length * np.array([0.0, *p.half_depth, p.tail_half_span])
    cross, muscle, other = np.array(p.stiffness) * (p.length / tu.REFERENCE_LENGTH) ** 3
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
    between = np.exp(np.interp(np.arange(5) + 0.5, np.arange(6), np.log(taper)))
    flat = width[1:-1] ** 2 / (width[1:-1] ** 2 + depth[1:-1] ** 2)
    across = np.array([0.0, *(2 * between * (other + cross * flat)), 0.0])
    active *= np.isin(np.arange(6), (1, 2, 3))
    return chord, diagonal, across, active


def lattice(outline, chord, diagonal, across):
    """The springs: pairs (E,2), stiffness (E,) N/m, and piece (E,), twice the row ahead of a chord plus 1 on the right.

    A piece of a section has n times its chord's stiffness and the same stiffness in shear; piece is -1 off the chords.
    """
    pairs, stiffness, piece = [], [], []
    layers, n = np.arange(len(across)), outline.pieces
    brace = shear_factor(outline)
    for k, ((a, b), (c, d)) in enumerate(zip(outline.nodes[:-1], outline.nodes[1:], strict=True)):
        section = outline.section[k]
        pairs += [(a, c), (b, d)]
        stiffness += [n * chord[section]] * 2
        piece += [2 * k, 2 * k + 1]
        if a != b and c != d:
            pairs += [(a, d), (b, c)]
            stiffness += [brace[k] * diagonal[section]] * 2
            piece += [-1, -1]
        if c != d:
            pairs.append((c, d))
            at = np.interp((k + 1) / n, layers[1:-1], across[1:-1])
            stiffness.append(at / n)
            piece.append(-1)
    return np.sort(np.array(pairs), axis=1), np.array(stiffness), np.array(piece)


def shear_factor(outline) -> np.ndarray:
    """(R-1,) by how much the diagonals of a piece are stiffer than its section's, for the same stiffness in shear."""

    def softness(ahead, behind):  # what a braced panel yields in shear, over its length and its diagonals' stiffness
        long = outline.along[behind] - outline.along[ahead]
        wide = outline.width[behind] + outline.width[ahead]
        return (long**2 + wide**2) / (long * wide**2)

    start = np.arange(len(outline.along) - 1)
    first = start // outline.pieces * outline.pieces
    return softness(start, start + 1) / softness(first, first + outline.pieces)


def surface(outline):
    """Upright faces (F,4) and their depths (F,) m: the flanks; the slopes that face forward, above and below."""
    faces, height = [], []
    for k, ((a, b), (c, d)) in enumerate(zip(outline.nodes[:-1], outline.nodes[1:], strict=True)):
        front, back = outline.depth[k], outline.depth[k + 1]
        if a == b:  # the nose: third node twice, so that the face's force is shared as a triangle's
            faces += [(a, c, c, c), (d, b, d, d)]
            height += [2 * back] * 2
        else:
            faces += [(a, c, c, a), (d, b, b, d)]
            height += [front + back] * 2
        if back > front:  # they face forward; those that face back are hardly ever pushed
            faces += [(b, a, c, d)] * 2
            height += [back - front] * 2
    return np.array(faces), np.array(height)


def landmarks(p, outline) -> Landmarks:
    """The default fish's nodes, as far above or below the flat one's as they lie on it."""
    points, mass = tu.shape(p), tu.masses(p)
    flat = shape(outline)
    flat[:, 2] = 0.0
    level = points * (1.0, 1.0, 0.0)
    node = np.array([np.argmin(np.linalg.norm(flat - point, axis=1)) for point in level])
    pairs, classes, _, faces = tu.topology()
    mirror = tu.mirrored()
    return Landmarks(node, points[:, 2].copy(), mass, faces, pairs[classes == tu.MUSCLE], mirror)
