"""Skin: what a fish looks like, worked out once from its shape at rest.

Everything on it, fins and eyes too, is a weighted sum of node positions, so it bends as the body bends. The physics
knows none of it.
"""

from functools import lru_cache
from typing import NamedTuple

import numpy as np

from fish_env.scene.mesh import smooth

LEVELS = 3  # of subdivision: 24 faces become some 1400, small enough not to be told apart
BACK, FLANK, BELLY, TAIL_FIN, OTHER_FINS, CONTRACTED = np.array(
    [(44, 92, 120), (182, 208, 208), (255, 250, 236), (226, 178, 84), (238, 204, 128), (250, 66, 34)], dtype=float
)
MUSCLE_REACH = 0.055  # body lengths: how far from a muscle the skin still takes on its colour
FORK = 0.45  # how far the notch of the tail fin reaches towards its root
UP, DOWN = np.array([0.0, 0.0, 1.0]), np.array([0.0, 0.0, -1.0])
LEFT, RIGHT = np.array([0.0, 1.0, -0.35]), np.array([0.0, -1.0, -0.35])
ABOVE_LEFT, ABOVE_RIGHT = np.array([0.0, 0.6, 1.0]), np.array([0.0, -0.6, 1.0])
PECTORAL, PECTORAL_RAYS = 0.12, 10  # body lengths; a fan from one point, outward, down and backward
EYE_STATION, EYE_HEIGHT = 0.085, 0.35  # body lengths behind the nose; slope of the line of sight above the horizontal


class Surface(NamedTuple):
    """V points and Q faces of a body that has L landmarks and M muscles; its last faces may be thin fins."""

    weights: np.ndarray | None  # (V,L) points from landmarks; None if the landmarks are the points
    faces: np.ndarray  # (Q,4) corners, counter-clockwise seen from outside; a triangle gives its third point twice
    colour: np.ndarray  # (Q,3) of the relaxed body, 0 to 255
    influence: np.ndarray  # (Q,M) share of each muscle's contraction in the colour of a face, 0 to 1
    closed: int  # the faces before this one enclose the body; later ones are fins, seen from both sides
    opacity: float = 1.0


def skin_of(rest, faces, muscles, levels: int = LEVELS) -> tuple[Surface, np.ndarray]:
    """The skin of a body at rest (L,3) with faces (F,4) and muscle landmarks (M,2), and weights (2,L) of its eyes."""
    # It is subdivided `levels` times; the left eye is the first.
    parts = (np.ascontiguousarray(rest, dtype=float), np.asarray(faces, np.int64), np.asarray(muscles, np.int64))
    return _skin(*(part.tobytes() for part in parts), levels)


@lru_cache(maxsize=8)
def _skin(rest: bytes, faces: bytes, muscles: bytes, levels: int) -> tuple[Surface, np.ndarray]:
    nodes, corners = np.frombuffer(rest).reshape(-1, 3), np.frombuffer(faces, np.int64).reshape(-1, 4)
    pairs = np.frombuffer(muscles, np.int64).reshape(-1, 2)
    x, length = nodes[:, 0], np.ptp(nodes[:, 0])
    nose, tail = (np.flatnonzero(abs(x - end) < 0.01 * length) for end in (x.max(), x.min()))
    weights, quads = smooth(corners, len(nodes), levels, np.concatenate([nose, tail]))
    quads = turn_outward(weights @ nodes, quads)
    weights = fork_tail(weights, nodes, corners, tail, length)
    colour = countershading(weights @ nodes, quads, length)
    influence = muscle_influence((weights @ nodes)[quads].mean(axis=1), nodes[pairs], length)
    extra, fin_quads = fins(weights, weights @ nodes, length)
    skin = Surface(
        np.concatenate([weights, extra]),
        np.concatenate([quads, fin_quads]),
        np.concatenate([colour, np.broadcast_to(OTHER_FINS, (len(fin_quads), 3))]),
        np.concatenate([influence, np.zeros((len(fin_quads), len(pairs)))]),
        len(quads),
    )
    return skin, eyes(weights, weights @ nodes, length)


def fork_tail(weights, nodes, corners, tail, length) -> np.ndarray:
    """Draw the middle of the tail fin's rear edge towards its root, so that the fin is forked; weights (V,N)."""
    if len(tail) < 2:
        return weights
    root = np.setdiff1d(corners[np.isin(corners, tail).any(axis=1)], tail)
    points = weights @ nodes
    start, end = nodes[root, 0].mean(), nodes[tail, 0].mean()
    behind = np.clip((points[:, 0] - start) / (end - start), 0.0, 1.0)
    span = np.abs(nodes[tail, 2] - nodes[tail, 2].mean()).max() or length
    height = np.clip(np.abs(points[:, 2] - nodes[tail, 2].mean()) / span, 0.0, 1.0)
    pull = np.eye(len(nodes))[root].mean(axis=0) - np.eye(len(nodes))[tail].mean(axis=0)
    return weights + (FORK * behind**1.5 * (1.0 - height))[:, None] * pull


def turn_outward(points: np.ndarray, quads: np.ndarray) -> np.ndarray:
    """The quadrilaterals (Q,4) counter-clockwise seen from outside, whichever way round all of them are given."""
    a, b, c, d = points[quads].transpose(1, 0, 2)
    volume = (a * (np.cross(b, c) + np.cross(c, d))).sum()  # enclosed, times six
    return quads if volume > 0 else quads[:, ::-1]


def normals(points: np.ndarray, quads: np.ndarray) -> np.ndarray:
    """Unit outward normals (Q,3) of quadrilaterals; null where one has no area."""
    a, b, c, d = points[quads].transpose(1, 0, 2)
    n = np.cross(c - a, d - b)
    return n / np.maximum(np.linalg.norm(n, axis=1, keepdims=True), 1e-300)


def countershading(points, quads, length) -> np.ndarray:
    """Countershading, (Q,3): dark above and light below, as in the open sea, and a golden tail fin."""
    middle = points[quads].mean(axis=1)
    up = normals(points, quads)[:, 2]
    behind = (points[:, 0].max() - middle[:, 0]) / length
    light = np.clip((0.8 - up) / 0.7, 0.0, 1.0)[:, None]
    pale = np.clip((-0.05 - up) / 0.5, 0.0, 1.0)[:, None]
    colour = BACK + light * (FLANK - BACK) + pale * (BELLY - FLANK)
    bars = 0.06 * np.sin(2 * np.pi * 9 * behind) * np.clip(up + 0.3, 0.0, 1.0)
    colour *= (1.0 + bars)[:, None]
    fin = np.clip((behind - 0.8) / 0.12, 0.0, 1.0)[:, None]
    return colour + 0.85 * fin * (TAIL_FIN - colour)


def muscle_influence(middle, ends, length) -> np.ndarray:
    """Weights (Q,M) with which muscles from ends[:,0] to ends[:,1] (M,2,3) colour the skin at middle (Q,3)."""
    start, along = ends[:, 0], ends[:, 1] - ends[:, 0]
    offset = middle[:, None] - start
    where = (offset * along).sum(-1) / np.maximum((along**2).sum(-1), 1e-300)
    nearest = np.clip(where, 0.0, 1.0)[..., None] * along
    distance = np.linalg.norm(offset - nearest, axis=-1) / length
    spindle = np.sqrt(np.clip(1.06 - (2.0 * where - 1.0) ** 2, 0.0, 1.0))  # thick in the middle, like a muscle
    reach = np.clip(1.4 - distance / (MUSCLE_REACH * (0.35 + 0.65 * spindle)), 0.0, 1.0) * (spindle > 0)
    reach *= middle[:, None, 1] * ends[:, :, 1].mean(axis=1) > 0  # only of its own side
    total = reach.sum(axis=1, keepdims=True)
    return np.minimum(total, 1.0) * reach / np.maximum(total, 1e-9)


def fins(weights: np.ndarray, points: np.ndarray, length: float) -> tuple[np.ndarray, np.ndarray]:
    """Fins on back, belly and flanks of a skin at rest, points (V,3) = weights (V,N) @ nodes, m."""
    # Weights of their points (P,N), and quadrilaterals (R,4) that number them from V on.
    angles = np.radians(np.linspace(62.0, 8.0, PECTORAL_RAYS))
    reach = PECTORAL * np.sin(np.pi * np.linspace(0.16, 0.86, PECTORAL_RAYS)) ** 0.4  # with a round edge
    fan = ((0.225, 0.225), reach * np.sin(angles), reach * np.cos(angles))
    shapes = (  # side, opposite side, stations of the root, height and sweep of each ray; all in body lengths
        (UP, DOWN, (0.27, 0.58), (0.0, 0.085, 0.075, 0.05, 0.035, 0.03, 0.022, 0.0), (0.03, 0.075)),
        (DOWN, UP, (0.58, 0.72), (0.0, 0.055, 0.04, 0.025, 0.0), (0.03, 0.05)),
        (DOWN, UP, (0.36, 0.41), (0.0, 0.05, 0.02), (0.05, 0.06)),
        (LEFT, ABOVE_RIGHT, *fan),
        (RIGHT, ABOVE_LEFT, *fan),
    )
    rows, quads = [], []
    for side, opposite, (start, stop), heights, sweep in shapes:
        base, count = len(weights) + sum(map(len, rows)), len(heights)
        stations = np.linspace(start, stop, count)
        sweep = sweep if len(sweep) == count else np.linspace(sweep[0], sweep[1], count)
        rows.append(fin_rays(weights, points, length, side, opposite, stations, heights, sweep))
        quads += [(base + 2 * k, base + 2 * k + 1, base + 2 * k + 3, base + 2 * k + 2) for k in range(len(heights) - 1)]
    return np.concatenate(rows), np.array(quads)


def fin_rays(weights, points, length, side, opposite, stations, heights, sweep) -> np.ndarray:
    """Weights (2K,N) of a fin of K rays: root and tip of each in turn."""
    backwards = weights[points[:, 0].argmin()] - weights[points[:, 0].argmax()]
    rows = []
    for station, height, back in zip(stations, heights, sweep, strict=True):
        root, far = outermost(points, length, station, side), outermost(points, length, station, opposite)
        thickness = np.linalg.norm(points[root] - points[far]) / length
        out = (weights[root] - weights[far]) / max(thickness, 0.01)
        rows += [weights[root], weights[root] + height * out + back * backwards]
    return np.array(rows)


def eyes(weights: np.ndarray, points: np.ndarray, length: float) -> np.ndarray:
    """Weights (2,N) of the left and the right eye."""
    sight = [np.array([0.0, side, EYE_HEIGHT]) for side in (1.0, -1.0)]
    return weights[[outermost(points, length, EYE_STATION, direction) for direction in sight]]


def outermost(points, length, station, direction) -> int:
    """The point furthest out in a direction among those about `station` body lengths behind the nose."""
    behind = (points[:, 0].max() - points[:, 0]) / length
    return int((points @ direction / length - 4.0 * np.abs(behind - station)).argmax())
