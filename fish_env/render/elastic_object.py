"""The picture of an elastic object: the inner layer seen through the outer one, the springs faint, floor and hand."""

from functools import lru_cache

import numpy as np
import pygame

from fish_env.bodies.room import InRoom
from fish_env.render.body import View, draw_quads, surface_over
from fish_env.render.flat import pixels_of
from fish_env.render.labels import HEIGHT, OVER, WIDTH
from fish_env.render.mesh import smooth
from fish_env.render.skin import normals
from fish_env.render.water import from_pixels

SKY, HORIZON, FLOOR, EDGE = (246, 249, 251), (206, 221, 232), (173, 191, 204), (128, 150, 168)
OUTER, INNER, SPRING, NODE, GRIP = (228, 62, 104), (255, 178, 44), (120, 20, 60), (110, 12, 48), (24, 92, 140)
LIGHT = np.array((-0.45, 0.65, 0.61))  # in the axes of the view: from the upper left
ANGLE = (0.3, 0.28)  # rad: how far from the side, and how far from above, a solid is looked at
DEPTH = 0.7  # of the room that is drawn, over its width
CURVE = 6  # points of the drawn line for an edge of a ring
VEIL = (0.34, 0.62)  # opacity of the outer skin: seen along its normal, and how much more along its rim
SHADOW = 8  # the shadow is made so many times smaller


class Painter:
    """Draws one kind of object in its room: what does not depend on its motion is worked out once.

    Args:
        thing: the object.
        size: width and height of the pictures, pixels.
    """

    def __init__(self, thing: InRoom, size: tuple[int, int] = (WIDTH, HEIGHT)):
        self.thing, self.size = thing, size
        self.canvas = tuple(OVER * side for side in size)
        if thing.water.planes is None:
            raise ValueError(f"{thing.name!r} has no walls around it; give it a room (fish_env.bodies.objects.room)")
        self.reach = -float(thing.water.planes[0, 3])  # walls are so far from the origin
        self.solid = thing.skin.shape[1] == 4
        scale = min(self.canvas[0] / 2.3, self.canvas[1] / (2.35 if self.solid else 2.15)) / self.reach
        origin = (self.canvas[0] / 2, self.canvas[1] * (0.44 if self.solid else 0.48))
        self.view = View(axes(*(ANGLE if self.solid else (0.0, 0.5 * np.pi))), np.zeros(3), origin, scale, LIGHT)
        self.springs = {kind: thing.body.springs.nodes[which] for kind, which in thing.kinds.items()}
        if self.solid:
            nodes, skin = np.arange(len(thing.outer)), np.searchsorted(thing.outer, thing.skin)
            self.fine, self.coarse = (smooth(skin, len(nodes), levels, nodes) for levels in (2, 1))
        self.backdrop = sky(self.canvas).copy()
        self._draw_room()

    def picture(self, x, hand=None) -> np.ndarray:
        """The picture (H,W,3) uint8 of nodes at x (N,3) m; hand is (node, point (3,) m) if one drags it."""
        return pixels_of(self.surface(x, hand))

    def surface(self, x, hand=None) -> pygame.Surface:
        """Return the picture as a new surface; arguments as for `picture`."""
        canvas = self.backdrop.copy()
        if self.solid:
            self._draw_solid(canvas, x)
        elif len(self.thing.inner):
            self._draw_ring(canvas, x)
        else:
            self._draw_string(canvas, x)
        if hand is not None:
            (start, end), _ = self.view.project(np.array([x[hand[0]], hand[1]]))
            pygame.draw.line(canvas, GRIP, start, end, 5)
            pygame.draw.circle(canvas, GRIP, start, 9)
            pygame.draw.circle(canvas, GRIP, end, 15, 5)
        return pygame.transform.smoothscale(canvas, self.size)

    def place(self, pixel, depth=0.0) -> np.ndarray:
        """The point (3,) m that a pixel of the picture shows, at a depth towards the beholder, m."""
        right, down = (OVER * np.asarray(pixel, dtype=float) - self.view.origin) / self.view.scale
        return right * self.view.axes[0] - down * self.view.axes[1] + depth * self.view.axes[2]

    def _draw_room(self) -> None:
        """Draw floor and walls on the backdrop."""
        r, canvas = self.reach, self.backdrop
        if self.solid:
            d = DEPTH * r
            self._draw_panel([(-r, -d, -r), (r, -d, -r), (r, d, -r), (-r, d, -r)], FLOOR, 255)
            for g in np.linspace(-1.0, 1.0, 9):
                for line in (((g * r, -d, -r), (g * r, d, -r)), ((-r, g * d, -r), (r, g * d, -r))):
                    begin, end = self.view.project(np.array(line))[0]
                    pygame.draw.line(canvas, HORIZON, begin, end, 3)
            for side in (-r, r):
                self._draw_panel([(side, -d, -r), (side, d, -r), (side, d, 0.5 * r), (side, -d, 0.5 * r)], FLOOR, 90)
            return
        (left, _), (right, low) = self.view.project(np.array([(-r, r, 0), (r, -r, 0)]))[0]
        width, height = self.canvas
        floor = len(self.thing.inner) > 0  # of a ring; a string ends at its fixed node
        left, bottom = (left, low) if floor else (self.view.origin[0], height)
        if floor:
            pygame.draw.rect(canvas, FLOOR, (0, bottom, width, height))
            pygame.draw.line(canvas, EDGE, (0, bottom), (width, bottom), 5)
        pygame.draw.rect(canvas, FLOOR, (0, 0, left, height))
        pygame.draw.line(canvas, EDGE, (left, 0), (left, bottom), 5)
        pygame.draw.rect(canvas, FLOOR, (right, 0, width, height))
        pygame.draw.line(canvas, EDGE, (right, 0), (right, bottom), 5)

    def _draw_panel(self, corners, colour, opacity) -> None:
        """A flat part of the room between corners (4,3)."""
        layer = pygame.Surface(self.canvas, pygame.SRCALPHA, 32)
        pygame.draw.polygon(layer, (*colour, opacity), self.view.project(np.array(corners))[0].tolist())
        self.backdrop.blit(layer, (0, 0))

    def _draw_lines(self, canvas, pixels, pairs, opacity) -> None:
        """Faint lines between pairs (K,2) of points (N,2) pixels."""
        layer, low = surface_over(pixels, 2)
        places = (pixels - low).tolist()
        for a, b in pairs.tolist():
            pygame.draw.line(layer, (*SPRING, opacity), places[a], places[b], 2)
        canvas.blit(layer, low)

    def _draw_ring(self, canvas, x) -> None:
        pixels, n = self.view.project(x)[0], len(self.thing.outer)
        outer, inner = round_curve(pixels[:n]), round_curve(pixels[n:])
        layer, low = surface_over(outer, 2)
        pygame.draw.polygon(layer, (*OUTER, 150), outer - low)
        middle = inner.mean(axis=0)
        for k in range(6):  # lighter towards the upper left
            part = 1.0 - 0.14 * k
            colour = mix_colours(INNER, (255, 246, 206), k / 7)
            spot = middle + (-4.0 * k, -5.0 * k) + part * (inner - middle)
            pygame.draw.polygon(layer, (*colour, 240), spot - low)
        canvas.blit(layer, low)
        between = np.concatenate([self.springs[kind] for kind in ("radius", "shear left", "shear right")])
        self._draw_lines(canvas, pixels, between, 110)
        pygame.draw.polygon(canvas, mix_colours(OUTER, NODE, 0.35), outer, 7)
        pygame.draw.polygon(canvas, mix_colours(INNER, NODE, 0.35), inner, 5)
        for pixel in pixels.tolist():
            pygame.draw.circle(canvas, NODE, pixel, 6)

    def _draw_string(self, canvas, x) -> None:
        pixels = self.view.project(x)[0]
        for a, b in self.thing.body.springs.nodes:
            turns = np.arange(25)
            across = np.where((turns < 2) | (turns > 22), 0.0, 22.0 * (-1.0) ** turns)
            line = pixels[a] + (pixels[b] - pixels[a]) * (turns / 24)[:, None] + across[:, None] * (0.0, 1.0)
            pygame.draw.lines(canvas, mix_colours(OUTER, NODE, 0.35), False, line.tolist(), 6)
        for pixel in pixels[1:].tolist():
            pygame.draw.circle(canvas, NODE, pixel, 30)
            pygame.draw.circle(canvas, OUTER, pixel, 25)

    def _draw_solid(self, canvas, x) -> None:
        outside = x[self.thing.outer]
        self._draw_shadow(canvas, outside)
        if not len(self.thing.inner):
            self._draw_layer(canvas, outside, self.fine, OUTER, (1.0, 0.0))
            return
        self._draw_layer(canvas, x[self.thing.inner], self.coarse, INNER, (1.0, 0.0))
        pixels, depth = self.view.project(x)
        self._draw_lines(canvas, pixels, self.springs["radius"], 70)
        self._draw_layer(canvas, outside, self.fine, OUTER, VEIL)
        ends = self.springs["outer"]
        self._draw_lines(canvas, pixels, ends[depth[ends].mean(axis=1) > depth[self.thing.outer].mean()], 45)

    def _draw_layer(self, canvas, x, mesh, colour, veil) -> None:
        """A smooth skin of nodes at x (n,3): the faces that point to the viewer, the nearest last."""
        weights, quads = mesh
        pixels, depth = self.view.project(weights @ x)
        normal = normals(np.column_stack([pixels * (1, -1), self.view.scale * depth]), quads)
        order = np.flatnonzero(normal[:, 2] > 0)
        order = order[np.argsort(depth[quads[order]].mean(axis=1), kind="stable")]
        facing, rim = normal[order] @ LIGHT, 1.0 - normal[order, 2]
        shine = np.clip(normal[order] @ np.array((-0.26, 0.37, 0.89)), 0.0, 1.0) ** 40
        bright = np.array(colour) * (0.62 + 0.42 * facing)[:, None]
        shaded = bright + (255.0 - bright) * 0.75 * shine[:, None]
        opacity = np.clip(veil[0] + veil[1] * rim**1.5 + 0.4 * shine, 0.0, 1.0)
        painted = np.clip(np.column_stack([shaded, 255 * opacity]), 0, 255).astype(int)
        layer, low = surface_over(pixels, 2)
        draw_quads(layer, painted, (pixels - low)[quads[order]])
        canvas.blit(layer, low)

    def _draw_shadow(self, canvas, x) -> None:
        """Draw the soft shadow of the outer skin at x (n,3) on the floor; it fades with height."""
        flat = x * (1.0, 1.0, 0.0) - (0.0, 0.0, self.reach)
        pixels = self.view.project(flat)[0]
        low, high = pixels.min(axis=0) - 40, pixels.max(axis=0) + 40
        size = ((high - low) / SHADOW).astype(int)
        small = pygame.Surface(size.tolist(), pygame.SRCALPHA, 32)
        dark = int(120 * np.exp(-3.0 * (x[:, 2].min() + self.reach) / self.reach)) + 10
        pygame.draw.ellipse(small, (40, 50, 70, dark), (40 // SHADOW, 40 // SHADOW, *(size - 80 // SHADOW).tolist()))
        soft = pygame.transform.box_blur(small, 3)
        canvas.blit(pygame.transform.smoothscale(soft, (size * SHADOW).tolist()), low.tolist())


def axes(aside: float, above: float) -> np.ndarray:
    """Rows to the right, upwards and towards the viewer at an azimuth and elevation, rad; from above, y is upwards."""
    level = np.array((np.sin(aside), -np.cos(aside), 0.0))
    toward = np.cos(above) * level + np.array((0.0, 0.0, np.sin(above)))
    right = np.array((np.cos(aside), np.sin(aside), 0.0))
    return np.array((right, np.cross(toward, right), toward))


def round_curve(points) -> np.ndarray:
    """A closed Catmull-Rom curve through points (n,2): (n CURVE, 2)."""
    t = (np.arange(CURVE) / CURVE)[None, :, None]
    before, here, after, beyond = (np.roll(points, shift, axis=0)[:, None] for shift in (1, 0, -1, -2))
    slope, ahead = 0.5 * (after - before), 0.5 * (beyond - here)
    curve = here + t * slope + t**2 * (3 * (after - here) - 2 * slope - ahead)
    return (curve + t**3 * (2 * (here - after) + slope + ahead)).reshape(-1, 2)


def mix_colours(one, other, part) -> tuple[int, ...]:
    """A colour between two."""
    return tuple(int(a + (b - a) * part) for a, b in zip(one, other, strict=True))


@lru_cache(maxsize=8)
def sky(size: tuple[int, int]) -> pygame.Surface:
    """The empty background; copy it."""
    colour = np.linspace(SKY, HORIZON, size[1])[:, None, :].repeat(size[0], axis=1)
    return from_pixels(colour)
