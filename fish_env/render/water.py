"""The water: a rippling bed of light that repeats every two body lengths, and a grid of one. Pictures made once."""

from functools import lru_cache

import numpy as np
import pygame

from fish_env.scene.look import PALETTE

SHALLOW, DEEP, SIDE_TOP, SIDE_BOTTOM = np.array(
    [PALETTE["shine"], PALETTE["floor"], (150, 212, 216), (40, 112, 138)], dtype=float
)
GRID, LAYER_LINE = (196, 234, 234), (112, 176, 190)
LAYER = 0.25  # body lengths between the lines of equal depth
REPEAT = 2  # body lengths after which the ripples come back


def from_pixels(pixels: np.ndarray) -> pygame.Surface:
    """A surface from an array of 0..255: (H,W,3), opaque, or (H,W,4), the last the opacity."""
    pixels = np.clip(np.round(pixels), 0, 255).astype(np.uint8)
    opaque = pixels.shape[2] == 3
    picture = pygame.image.frombuffer(pixels.tobytes(), pixels.shape[1::-1], "RGB" if opaque else "RGBA")
    surface = pygame.Surface(picture.get_size(), 0 if opaque else pygame.SRCALPHA, 32)
    surface.blit(picture, (0, 0))
    return surface


@lru_cache(maxsize=4)
def ripples(size: int) -> pygame.Surface:
    """A net of light on the bed, size x size pixels, that joins itself at every edge."""
    # The bright lines run where two of a set of scattered points are equally near.
    grid = np.arange(size // 3) / (size // 3)
    x, y = np.meshgrid(grid, grid)
    for wave, bend in ((2, 0.022), (5, 0.007)):
        x, y = x + bend * np.sin(2 * np.pi * wave * y), y + bend * np.sin(2 * np.pi * wave * x + 1)
    nearest, second = np.full(x.shape, 9.0), np.full(x.shape, 9.0)
    cells = np.stack(np.meshgrid(np.arange(7), np.arange(7)), axis=-1).reshape(-1, 2)  # a point somewhere in each
    for px, py in (cells + np.random.default_rng(4).uniform(0.05, 0.95, cells.shape)) / 7:
        dx, dy = np.abs(x - px) % 1, np.abs(y - py) % 1
        distance = np.hypot(np.minimum(dx, 1 - dx), np.minimum(dy, 1 - dy))
        second = np.minimum(second, np.maximum(nearest, distance))
        nearest = np.minimum(nearest, distance)
    gap = second - nearest
    bright = (0.4 * np.exp(-gap / 0.014) + 0.4 * np.exp(-gap / 0.05))[..., None]
    return pygame.transform.smoothscale(from_pixels(DEEP + bright * (SHALLOW - DEEP)), (size, size))


@lru_cache(maxsize=4)
def vignette(width: int, height: int) -> pygame.Surface:
    """Factors that darken the corners of the picture."""
    x, y = np.meshgrid(np.linspace(-1, 1, width), np.linspace(-1, 1, height))
    shade = 1.0 - 0.16 * np.clip(x**2 + y**2 - 0.35, 0.0, None)[..., None]
    return from_pixels(255 * shade ** np.array((1.25, 1.0, 0.9)))


def draw_turned_bed(canvas: pygame.Surface, unit: float, centre, origin, pen: float, angle: float) -> None:
    """Fill the canvas as `draw_bed` does, seen by a camera turned by an angle, counter-clockwise, rad."""
    side = 2 * int(np.hypot(*np.maximum(origin, np.array(canvas.get_size()) - origin)) + 2)
    level = sheet(side)
    draw_bed(level, unit, centre, (side / 2, side / 2), pen)
    turned = pygame.transform.rotate(level, -np.degrees(angle))
    canvas.blit(turned, turned.get_rect(center=origin))


@lru_cache(maxsize=2)
def sheet(side: int) -> pygame.Surface:
    """A square surface to draw on: it is kept, because the system takes long to hand out its memory."""
    return pygame.Surface((side, side), 0, 32)


def draw_bed(canvas: pygame.Surface, unit: float, centre, origin, pen: float) -> None:
    """Fill the canvas with rippling water and the grid; unit is pixels a body length, pen the width of lines."""
    # The place `centre` (2,), in body lengths, comes to the pixel `origin`; y points up.
    line = max(1, round(3 * pen))
    tile = ripples(round(REPEAT * unit))
    size = tile.get_width()
    width, height = canvas.get_size()
    left, top = (round(origin[0] - centre[0] * unit) % size - size, round(origin[1] + centre[1] * unit) % size - size)
    canvas.fblits([(tile, (x, y)) for x in range(left, width, size) for y in range(top, height, size)])
    x0, y0 = (origin[0] - centre[0] * unit) % unit, (origin[1] + centre[1] * unit) % unit
    for x in np.arange(x0, width, unit):
        pygame.draw.line(canvas, GRID, (round(x), 0), (round(x), height), line)
    for y in np.arange(y0, height, unit):
        pygame.draw.line(canvas, GRID, (0, round(y)), (width, round(y)), line)


@lru_cache(maxsize=4)
def panel(width: int, height: int) -> pygame.Surface:
    """The water seen from the side, lighter towards the surface."""
    t = np.linspace(0.0, 1.0, height)[:, None, None] ** 0.8
    return from_pixels(np.broadcast_to(SIDE_TOP + t * (SIDE_BOTTOM - SIDE_TOP), (height, width, 3)))


def draw_depths(canvas: pygame.Surface, unit: float, height: float, origin: float, pen: float) -> None:
    """Fill the canvas with water seen from the side; `height`, in body lengths, comes to the row `origin`."""
    line = max(1, round(2 * pen))
    width, rows = canvas.get_size()
    canvas.blit(panel(width, rows), (0, 0))
    for y in np.arange((origin + height * unit) % (LAYER * unit), rows, LAYER * unit):
        pygame.draw.line(canvas, LAYER_LINE, (0, round(y)), (width, round(y)), line)
