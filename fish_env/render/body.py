"""Drawing a body on a surface, as seen along any direction."""

from typing import NamedTuple

import numpy as np
import pygame

from fish_env.scene.frame import Body
from fish_env.scene.look import PALETTE, Look
from fish_env.scene.skin import CONTRACTED, EYE_HEIGHT, normals

MARGIN, LARGEST = 8, 4096  # pixels
FAR = 16384  # pixels: pygame visits every row of a polygon, also outside the picture, and counts in 32 bits
EYE_RADIUS = 0.018  # body lengths


class View(NamedTuple):
    """A parallel projection."""

    axes: np.ndarray  # (3,3) rows: unit world vectors to the right, upwards, and towards the viewer
    centre: np.ndarray  # (3,) world point, m, that is shown at
    origin: tuple[float, float]  # this pixel
    scale: float  # pixels a metre
    light: np.ndarray  # (3,) towards the light, unit vector in the axes of the view
    pen: float = 1.0  # width of lines, over that in the standard picture

    def project(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Pixels (P,2), at most FAR from the picture, and depth (P,), m, larger is nearer, of world points (P,3)."""
        seen = (points - self.centre) @ self.axes.T
        return np.clip(seen[:, :2] * (self.scale, -self.scale) + self.origin, -FAR, FAR), seen[:, 2]


def body_picture(body: Body, view: View) -> tuple[pygame.Surface, tuple[int, int]]:
    """A body on a transparent surface just large enough, and the place of that surface's upper left corner."""
    look, marks = body.look, body.look.marks(body.position)
    _, low = canvas = surface_over(view.project(marks)[0], MARGIN + round(0.12 * look.length * view.scale))
    view = view._replace(origin=(view.origin[0] - low[0], view.origin[1] - low[1]))
    none = np.zeros(len(look.muscles))
    for skin in reversed(look.surfaces):  # from the inside out
        pixels, depth = view.project(marks if skin.weights is None else skin.weights @ marks)
        normal = normals(np.column_stack([pixels * (1, -1), view.scale * depth]), skin.faces)
        thin = np.arange(len(normal)) >= skin.closed
        order = np.flatnonzero(thin | (normal[:, 2] > 0))
        order = order[np.argsort(depth[skin.faces[order]].mean(axis=1), kind="stable")]
        warmth = np.clip(skin.influence @ (body.contraction if body.contraction.size else none), 0.0, 1.0)[:, None]
        colour = (skin.colour + warmth * (CONTRACTED - skin.colour))[order]
        shades = groups(shade(normal[order], thin[order], colour, view.light), 3)
        for shaded, corners in zip(shades, groups(pixels[skin.faces[order]], 2, 4), strict=True):
            pygame.draw.polygon(canvas[0], shaded, corners)
    if not look.surfaces:
        pixels, _ = view.project(body.position)
        for start, end in pixels[look.springs].tolist():
            pygame.draw.line(canvas[0], PALETTE["layers"][0], start, end, max(1, round(6 * view.pen)))
    if len(look.eyes):
        draw_eyes(canvas[0], look, marks, view)
    return canvas


def surface_over(pixels: np.ndarray, margin: int) -> tuple[pygame.Surface, tuple[int, int]]:
    """A clear surface just over points (N,2) and a margin, and where its upper left corner belongs."""
    low = np.floor(pixels.min(axis=0)).astype(int) - margin
    size = np.minimum(np.ceil(pixels.max(axis=0)).astype(int) + margin - low, LARGEST)
    return pygame.Surface(size.tolist(), pygame.SRCALPHA, 32), tuple(low.tolist())


def groups(array: np.ndarray, *sizes: int):
    """The numbers of an array in tuples, or tuples of tuples, of the sizes, inner first."""
    # Made one at a time, unlike with `tolist`: thousands of lists at once would set off the garbage collector.
    numbers = iter(array.ravel().tolist())
    for size in sizes:
        numbers = zip(*[numbers] * size, strict=True)
    return numbers


def shade(normal: np.ndarray, thin: np.ndarray, colour: np.ndarray, light: np.ndarray) -> np.ndarray:
    """Colours (Q,3) uint8 under light from one side, with a wet gleam and darker rims; normals in axes of the view."""
    # What is thin (Q,) bool has neither inside nor rim, and light shines through it.
    facing = np.clip(normal @ light, 0.0, None)
    half = light + np.array((0.0, 0.0, 1.0))
    gleam = 62.0 * np.clip(normal @ (half / np.linalg.norm(half)), 0.0, None) ** 22
    bright = (0.64 + 0.5 * facing) * (0.74 + 0.26 * np.clip(normal[:, 2] / 0.6, 0.0, 1.0))
    bright, gleam = np.where(thin, 0.8 + 0.2 * np.abs(normal @ light), bright), np.where(thin, 0.0, gleam)
    return np.clip(colour * bright[:, None] + gleam[:, None], 0, 255).astype(np.uint8)


def draw_eyes(surface, look: Look, marks: np.ndarray, view: View) -> None:
    """The eyes that are on the side of the viewer."""
    places = look.eyes @ marks
    pixels, _ = view.project(places)
    outward = (places - places[::-1]) @ view.axes.T
    outward /= max(float(np.linalg.norm(outward[0])), 1e-300)
    radius = EYE_RADIUS * look.length * view.scale
    lift = EYE_HEIGHT * float(view.axes[2] @ rotation(look, marks)[2])  # they sit above the middle of the flank
    for place, out in zip(pixels, outward, strict=True):
        if out[2] + lift > 0:
            pygame.draw.circle(surface, PALETTE["eye"], place, radius)
            pygame.draw.circle(surface, PALETTE["pupil"], place, 0.7 * radius)
            pygame.draw.circle(surface, PALETTE["eye"], place - 0.25 * radius, 0.2 * radius)


def rotation(look: Look, marks: np.ndarray) -> np.ndarray:
    """Rotation (3,3) that best maps a body at rest onto the present one: rows forward, left, up, unit vectors."""
    rest, now = (nodes - nodes.mean(axis=0) for nodes in (look.rest, marks))
    u, _, v = np.linalg.svd(rest.T @ now)
    u[:, 2] *= np.sign(np.linalg.det(u @ v))  # no mirror images
    return u @ v
