"""How things look, for all that draw them: surfaces, springs and muscles of a body, and the colours of a picture."""

import base64
from typing import Any, NamedTuple

import numpy as np

from fish_env.bodies import Fish
from fish_env.scene.skin import CONTRACTED, FLANK, LEVELS, Surface, skin_of

STEPS = 65535  # of a number in 16 bits

PALETTE: dict[str, Any] = {
    "sky": (206, 232, 234), "floor": (112, 190, 200), "shine": (164, 220, 222), "wall": (70, 120, 150),
    "path": (18, 104, 134), "command": (16, 56, 72), "pointer": (213, 94, 0), "node": (40, 60, 80),
    "target": (255, 186, 66), "obstacle": (136, 94, 88), "eye": (250, 246, 220), "pupil": (18, 26, 34),
    "relaxed": tuple(FLANK.astype(int).tolist()), "contracted": tuple(CONTRACTED.astype(int).tolist()),
    "strain": ((0, 90, 160), (86, 160, 215), (225, 225, 225), (236, 150, 60), (200, 80, 0)),
    "lines": ((0, 114, 178), (213, 94, 0), (0, 158, 115), (204, 121, 167)),
    "layers": ((228, 62, 104), (255, 178, 44)), "solid": (142, 172, 196),
}  # fmt: skip
"""Colours, 0 to 255. "strain" goes from shortened over rest to stretched, "layers" are an outer and an inner skin;
"lines" of a chart tell several apart, also for the colour-blind (Okabe & Ito 2008)."""
VEIL = 0.5  # opacity of an outer layer through which an inner one is seen


class Look(NamedTuple):
    """What a body looks like, worked out once from its shape at rest."""

    length: float  # m
    node: np.ndarray  # (L,) node of each landmark
    height: np.ndarray  # (L,) m above it
    rest: np.ndarray  # (L,3) landmarks at rest, m
    surfaces: list[Surface]  # from the outside in
    eyes: np.ndarray  # (2,L) weights of the left and the right eye; (0,L) without
    springs: np.ndarray  # (E,2) nodes
    muscles: np.ndarray  # (M,2) landmarks

    def marks(self, x: np.ndarray) -> np.ndarray:
        """Landmarks (L,3) m of nodes at x (N,3) m."""
        return x[self.node] + self.height[:, None] * (0.0, 0.0, 1.0)

    def of_landmarks(self) -> "Look":
        """The same body, given by its landmarks in place of its nodes."""
        count = len(self.node)
        return self._replace(node=np.arange(count), height=np.zeros(count), springs=np.zeros((0, 2), np.int64))


def look_of(thing: Any, levels: int = LEVELS) -> Look:
    """The look of a fish, an elastic object or a solid; `levels` of subdivision of a fish's skin."""
    x, springs = thing.body.position, thing.body.springs.nodes
    if isinstance(thing, Fish):
        marks, rest = thing.landmarks, thing.points(x)
        skin, eyes = skin_of(rest, marks.faces, marks.muscles, levels)
        return Look(thing.length, marks.node, marks.height, rest, [skin], eyes, springs, marks.muscles)
    count = len(x)
    surfaces = [
        Surface(None, faces, np.broadcast_to(colour, (len(faces), 3)), np.zeros((len(faces), 0)), len(faces), opacity)
        for faces, colour, opacity in layers_of(thing)
    ]
    none = np.zeros((0, 2), np.int64)
    return Look(thing.length, np.arange(count), np.zeros(count), x, surfaces, np.zeros((0, count)), springs, none)


def layers_of(thing: Any) -> list[tuple[np.ndarray, tuple, float]]:
    """Faces (Q,4) of each layer of an elastic object, from the outside in, with its colour and its opacity."""
    outer, inner = PALETTE["layers"]
    if thing.body.tets is not None:
        return [(thing.skin, PALETTE["solid"], 1.0)]
    two = len(thing.inner) > 0
    if not len(thing.skin):
        return []
    if thing.skin.shape[1] == 4:
        layers = [(thing.skin, outer, VEIL if two else 1.0)]
        return [*layers, (thing.inner[thing.skin], inner, 1.0)] if two else layers
    a, b = thing.skin.T
    if not two:
        return [(fan(a), outer, 1.0)]
    return [(np.stack([a, b, thing.inner[b], thing.inner[a]], axis=1), outer, 1.0), (fan(thing.inner[a]), inner, 1.0)]


def fan(ring: np.ndarray) -> np.ndarray:
    """Faces (K-2,4) from the first node of a ring (K,) to all its edges."""
    return np.stack([np.full(len(ring) - 2, ring[0]), ring[1:-1], ring[2:], ring[2:]], axis=1)


def pack_look(look: Look) -> dict[str, Any]:
    """A look as JSON, for `renderer.js`, which gives a point the mean colour of the faces that meet there."""
    return {
        "length": float(look.length),
        "node": as_text(look.node.astype("<u2")),
        "height": look.height.tolist(),
        "surfaces": [
            {
                "weights": None if one.weights is None else pack_numbers(one.weights),
                "points": len(look.node if one.weights is None else one.weights),
                "faces": as_text(one.faces.astype("<u2")),
                "colour": as_text(np.clip(one.colour, 0, 255).astype(np.uint8)),
                "influence": as_text(np.clip(255 * one.influence, 0, 255).round().astype(np.uint8)),
                "opacity": one.opacity,
            }
            for one in look.surfaces
        ],
        "eyes": pack_numbers(look.eyes) if len(look.eyes) else None,
        "springs": as_text(look.springs.astype("<u2")),
        "muscles": as_text(look.muscles.astype("<u2")),
    }


def pack_numbers(array: np.ndarray) -> dict[str, Any]:
    """Numbers (..., K) in 16 bits, from the lowest to the highest of each of the K columns."""
    # The error is at most half of `step`: of 10 m of water it is 0.08 mm.
    columns = np.asarray(array, dtype=np.float64).reshape(-1, array.shape[-1])
    low = columns.min(axis=0) if len(columns) else np.zeros(columns.shape[1])
    step = (columns.max(axis=0) - low if len(columns) else low) / STEPS
    whole = np.round((columns - low) / np.where(step > 0.0, step, 1.0)).astype("<u2")
    return {"low": low.tolist(), "step": step.tolist(), "data": as_text(whole)}


def as_text(array: np.ndarray) -> str:
    """The bytes of an array in base 64."""
    return base64.b64encode(np.ascontiguousarray(array).tobytes()).decode()
