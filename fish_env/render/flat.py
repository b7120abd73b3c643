"""The picture of one fish: from above, following it, and from the side in an inset; drawn at twice the size."""

import numpy as np
import pygame

from fish_env.render import labels, water
from fish_env.render.body import View, body_picture, rotation
from fish_env.render.frame import Frame, clip_positions, place_of
from fish_env.render.labels import CENTRE, FOAM, HEIGHT, INK, OVER, PANEL, SIDE_UNIT, TRAIL, UNIT, WIDTH
from fish_env.render.spheres import sphere_pictures

SOFT = 8  # the shadow is made so many times smaller
FADE = 1.1  # body lengths over which the path fades to a third
ARROW = (0.56, 0.74)  # body lengths ahead of the fish where the arrow of a command begins and ends
ABOVE_LIGHT, SIDE_LIGHT = (np.array(v) / np.linalg.norm(v) for v in ((-0.5, 0.6, 0.8), (-0.3, 0.9, 0.55)))


def draw(frame: Frame) -> np.ndarray:
    """The picture of a frame, (H,W,3) uint8."""
    return pixels_of(draw_surface(frame))


def pixels_of(surface: pygame.Surface) -> np.ndarray:
    """The pixels of a surface, (H,W,3) uint8."""
    width, height = surface.get_size()
    return np.frombuffer(pygame.image.tobytes(surface, "RGB"), np.uint8).reshape(height, width, 3).copy()


def draw_surface(frame: Frame) -> pygame.Surface:
    """The picture of a frame, a new surface."""
    frame = clip_positions(frame)
    canvas = pygame.Surface((OVER * WIDTH, OVER * HEIGHT), 0, 32)
    draw_from_above(canvas, frame)
    draw_from_the_side(canvas, frame)
    picture = pygame.transform.smoothscale(canvas, (WIDTH, HEIGHT))
    picture.blit(water.vignette(WIDTH, HEIGHT), (0, 0), special_flags=pygame.BLEND_MULT)
    labels.draw_labels(picture, frame)
    return picture


def draw_from_above(canvas, frame: Frame) -> None:
    """Water, shadows, path, spheres, command and fish."""
    place, origin = place_of(frame), (OVER * CENTRE[0], OVER * CENTRE[1])
    view = View(np.eye(3), place, origin, OVER * UNIT / frame.length, ABOVE_LIGHT)
    water.draw_bed(canvas, OVER * UNIT, place[:2] / frame.length, origin)
    body, corner = body_picture(frame, view)
    behind, front = sphere_pictures(frame, view, canvas.get_size())
    if not frame.touchable:  # a bubble lets the light through
        for stone in behind + front:
            draw_shadow(canvas, *stone)
    draw_shadow(canvas, body, corner)
    draw_path(canvas, frame, view)
    canvas.fblits(behind)
    draw_commands(canvas, frame, view)
    canvas.blit(body, corner)
    canvas.fblits(front)


def draw_shadow(canvas, body: pygame.Surface, corner) -> None:
    """A soft shadow on the bed, to the lower right of what casts it."""
    width, height = (side // SOFT + 4 for side in body.get_size())
    small = pygame.Surface((width, height), pygame.SRCALPHA, 32)
    small.blit(pygame.transform.smoothscale(body, (width - 4, height - 4)), (2, 2))
    small.fill((0, 30, 50, 90), special_flags=pygame.BLEND_RGBA_MULT)
    soft = pygame.transform.smoothscale(pygame.transform.box_blur(small, 1), (SOFT * width, SOFT * height))
    canvas.blit(soft, (corner[0] - 2 * SOFT + 0.05 * UNIT * OVER, corner[1] - 2 * SOFT + 0.09 * UNIT * OVER))


def draw_path(canvas, frame: Frame, view: View) -> None:
    """The path so far: a line that fades and narrows with the distance swum since."""
    if len(frame.path) < 2:
        return
    path = np.zeros((len(frame.path), 3))
    path[:, : frame.path.shape[1]] = frame.path
    pixels, _ = view.project(path)
    step = np.linalg.norm(np.diff(path, axis=0), axis=1) / frame.length
    age = np.cumsum(step[::-1])[::-1]
    strength = np.exp(-age / FADE)
    colours = (water.DEEP + strength[:, None] * (np.array(TRAIL) - water.DEEP)).astype(np.uint8)
    width = np.round(3 + 7 * strength * np.clip(age / 0.15, 0.0, 1.0)).astype(int).tolist()
    for k in np.flatnonzero(strength > 0.04).tolist():
        pygame.draw.line(canvas, colours[k], pixels[k], pixels[k + 1], width[k])


def draw_commands(canvas, frame: Frame, view: View) -> None:
    """An arrow for each command, ahead of the fish; one out of the plane of the picture is foreshortened.

    None for a fish that is near its target: the arrow would point from beyond it.
    """
    far = np.linalg.norm(frame.spheres[:, :3] - view.centre, axis=1) / frame.length - frame.spheres[:, 3]
    if frame.touchable and (far < ARROW[1]).any():
        return
    unit = view.scale * frame.length
    for command in frame.commands:
        size = np.linalg.norm(command)
        if size > 0:
            along = unit * (view.axes[:2] @ (command / size)) * (1, -1)
            tail, tip = (np.array(view.origin) + reach * along for reach in ARROW)
            draw_arrow(canvas, tail, tip, unit)


def draw_arrow(canvas, tail, tip, unit) -> None:
    """An arrow with a dark rim."""
    along = tip - tail
    size = np.linalg.norm(along)
    if size < 2:
        return
    along = along / size
    across = np.array((-along[1], along[0]))
    head, half, barb = min(0.1 * unit, size), 0.014 * unit, 0.05 * unit
    neck = tip - head * along
    outline = [
        tail + half * across, neck + half * across, neck + barb * across, tip,
        neck - barb * across, neck - half * across, tail - half * across,
    ]  # fmt: skip
    corners = [tuple(point) for point in outline]
    pygame.draw.polygon(canvas, FOAM, corners, 9)
    pygame.draw.polygon(canvas, INK, corners)


def draw_from_the_side(canvas, frame: Frame) -> None:
    """The inset: the fish seen from its right, level, with lines of equal depth."""
    box = labels.enlarged(PANEL)
    inset = pygame.Surface(box.size, 0, 32)
    place, middle = place_of(frame), (box.width / 2, box.height / 2)
    water.draw_depths(inset, OVER * SIDE_UNIT, place[2] / frame.length, middle[1])
    forward = rotation(frame)[0] * (1.0, 1.0, 0.0)
    size = np.linalg.norm(forward)
    forward = forward / size if size > 1e-6 else np.array((1.0, 0.0, 0.0))
    axes = np.array((forward, (0.0, 0.0, 1.0), (forward[1], -forward[0], 0.0)))
    view = View(axes, place, middle, OVER * SIDE_UNIT / frame.length, SIDE_LIGHT)
    behind, front = sphere_pictures(frame, view, inset.get_size())
    inset.fblits([*behind, body_picture(frame, view), *front])
    canvas.blit(inset, box)
    pygame.draw.rect(canvas, FOAM, box.inflate(6, 6), 6, border_radius=14)
