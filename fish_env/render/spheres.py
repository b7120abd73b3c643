"""Spheres in the water: targets are bubbles to be touched, obstacles are stones."""

from functools import lru_cache

import numpy as np
import pygame

from fish_env.render.body import View
from fish_env.render.water import from_pixels
from fish_env.scene.frame import Frame
from fish_env.scene.look import PALETTE

BUBBLE, RIM, GLINT = np.array([(255, 214, 128), PALETTE["target"], (255, 252, 232)], dtype=float)
STONE, STONE_PATCH, STONE_SHADE = np.array([PALETTE["obstacle"], (194, 148, 126), (44, 36, 52)], dtype=float)
RIM_WIDTH = 9.0  # pixels of the canvas of the standard picture
MADE = 480  # pixels of the canvas: the radius of the largest sphere of the tasks, seen from above
LARGEST = 1500  # pixels of the canvas: no sphere is drawn with a larger radius
IN_FRONT = 0.5  # radii nearer than the fish, from where on a stone is drawn over it
VEIL = 0.62  # opacity of a stone in front of the fish, which should still be seen

Sprite = tuple[pygame.Surface, tuple[int, int]]  # A transparent surface, and where its upper left corner belongs


def sphere_pictures(frame: Frame, view: View, canvas: tuple[int, int]) -> tuple[list[Sprite], list[Sprite]]:
    """Pictures of spheres behind the fish and of those in front of it, the furthest first; none far off the canvas."""
    # canvas is its width and height, pixels. A bubble is always behind: a fish that reaches it should be seen whole.
    behind, front = [], []
    pixels, depth = view.project(frame.spheres[:, :3])
    light = tuple(view.light.tolist())
    for k in np.argsort(depth, kind="stable").tolist():
        size = frame.spheres[k, 3] * frame.length
        radius = round(min(view.scale * size, LARGEST))
        if radius < 1 or not (np.abs(pixels[k] - np.array(canvas) / 2) < np.array(canvas) / 2 + 1.5 * radius).all():
            continue  # half a radius to spare, for a shadow
        low = tuple(np.round(pixels[k] - radius).astype(int).tolist())
        if frame.touchable:
            behind.append((make_scaled(bubble, radius, RIM_WIDTH * view.pen), low))
        elif depth[k] > IN_FRONT * size:
            front.append((make_scaled(stone, radius, light, VEIL), low))
        else:
            behind.append((make_scaled(stone, radius, light, 1.0), low))
    return behind, front


@lru_cache(maxsize=8)
def make_scaled(make, radius: int, *look) -> pygame.Surface:
    """A picture by `make`; a large one is a smaller one scaled up: to make one takes twenty times its memory."""
    if radius <= MADE:
        return make(radius, *look)
    return pygame.transform.smoothscale(make(MADE, *look), (2 * radius, 2 * radius))


@lru_cache(maxsize=8)
def bubble(radius: int, width: float) -> pygame.Surface:
    """A warm translucent bubble with a clear rim of a width, 2 radius pixels wide."""
    x, y, r = disc(radius)
    inside = 0.4 + 0.3 * r**3
    rim = np.clip(1.0 - np.abs((1.0 - r) * radius - 0.5 * width) / (0.5 * width), 0.0, 1.0) ** 0.5
    glint = np.exp(-(((x + 0.42) / 0.2) ** 2 + ((y - 0.46) / 0.13) ** 2))
    colour = mix_colours(mix_colours(BUBBLE, RIM, rim), GLINT, glint)
    return with_opacity(colour, np.maximum(np.maximum(inside, 0.95 * rim), 0.9 * glint) * coverage(r, radius))


@lru_cache(maxsize=8)
def stone(radius: int, light: tuple[float, float, float], opacity: float) -> pygame.Surface:
    """A round mottled stone under light from one side (in the axes of the view), 2 radius pixels wide."""
    x, y, r = disc(radius)
    z = np.sqrt(np.clip(1.0 - r**2, 0.0, 1.0))
    facing = x * light[0] + y * light[1] + z * light[2]
    bright = np.clip(0.5 + 0.5 * facing, 0.0, 1.0) * (0.72 + 0.28 * np.clip(z / 0.5, 0.0, 1.0))
    colour = mix_colours(STONE_SHADE, mix_colours(STONE, STONE_PATCH, patches(2 * radius)), bright)
    colour = colour + (44.0 * np.clip(facing, 0.0, 1.0) ** 9)[..., None]
    return with_opacity(colour, opacity * coverage(r, radius))


@lru_cache(maxsize=4)
def patches(size: int) -> np.ndarray:
    """Brightness of a stone, (size,size) 0 to 1: soft patches and fine grains, always the same."""
    total = np.zeros((size, size))
    for cells, part in ((7, 0.45), (19, 0.3), (67, 0.25)):
        cell = np.random.default_rng(cells).uniform(0.0, 255.0, (cells, cells, 1)).repeat(3, axis=2)
        smooth = pygame.transform.smoothscale(from_pixels(cell), (size, size))
        total += part / 255.0 * pygame.surfarray.array3d(smooth)[..., 0]
    return total


def disc(radius: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Places (2 radius, 2 radius) on a disc of radius one: to the right, upwards, and from its middle."""
    line = (np.arange(2 * radius) + 0.5) / radius - 1.0
    x, y = np.meshgrid(line, -line)
    return x, y, np.hypot(x, y)


def coverage(r: np.ndarray, radius: int) -> np.ndarray:
    """Part of each pixel that the disc covers, 0 to 1."""
    return np.clip((1.0 - r) * radius + 0.5, 0.0, 1.0)


def mix_colours(one: np.ndarray, other: np.ndarray, part: np.ndarray) -> np.ndarray:
    """Colours (H,W,3) between two, by the part (H,W) of the other."""
    return one + part[..., None] * (other - one)


def with_opacity(colour: np.ndarray, opacity: np.ndarray) -> pygame.Surface:
    """A transparent surface from colours (H,W,3) of 0..255 and opacity (H,W) of 0..1."""
    return from_pixels(np.concatenate([colour, 255 * opacity[..., None]], axis=2))
