"""The picture of one fish, which the camera follows, with another view of it in an inset; drawn at twice the size."""

import numpy as np
import pygame

from fish_env.render import labels, water
from fish_env.render.body import View, body_picture, rotation
from fish_env.render.labels import FOAM, OVER, PANEL, SIDE_UNIT, Format
from fish_env.render.spheres import sphere_pictures
from fish_env.scene.frame import Frame, clip_positions
from fish_env.scene.look import PALETTE

SOFT, SOFT_SMALL = 8, 3  # a shadow is made so many times smaller, that in a small picture at least so many
FADE = 1.1  # body lengths over which the path fades to a third
ABOVE_LIGHT, SIDE_LIGHT = (np.array(v) / np.linalg.norm(v) for v in ((-0.5, 0.6, 0.8), (-0.3, 0.9, 0.55)))
STANDARD = Format()


def draw(frame: Frame, form: Format = STANDARD) -> np.ndarray:
    """The picture of a frame, (H,W,3) uint8."""
    return pixels_of(draw_surface(frame, form))


def pixels_of(surface: pygame.Surface) -> np.ndarray:
    """The pixels of a surface, (H,W,3) uint8."""
    width, height = surface.get_size()
    return np.frombuffer(pygame.image.tobytes(surface, "RGB"), np.uint8).reshape(height, width, 3).copy()


def draw_surface(frame: Frame, form: Format = STANDARD) -> pygame.Surface:
    """The picture of a frame, a new surface."""
    frame = clip_positions(frame)
    canvas = pygame.Surface((OVER * form.width, OVER * form.height), 0, 32)
    other = "above" if form.camera == "side" else "side"
    draw_view(canvas, frame, form.camera, OVER * form.unit, [OVER * x for x in form.centre], form.unit / labels.UNIT)
    if form.panel:
        draw_inset(canvas, frame, other, form)
    picture = pygame.transform.smoothscale(canvas, form.size)
    picture.blit(water.vignette(*form.size), (0, 0), special_flags=pygame.BLEND_MULT)
    if form.panel:
        labels.draw_labels(picture, frame, form, other)
    if frame.caption:
        labels.draw_caption(picture, frame.caption, form)
    return picture


def draw_inset(canvas, frame: Frame, camera: str, form: Format) -> None:
    """Draw a second view, of the fish and the spheres alone, in a frame."""
    box, unit = labels.enlarged(form.place(PANEL)), OVER * SIDE_UNIT * form.part
    inset = pygame.Surface(box.size, 0, 32)
    draw_view(inset, frame._replace(path=frame.path[:0], arrows=[]), camera, unit, (box.width / 2, box.height / 2),
              form.part)  # fmt: skip
    canvas.blit(inset, box)
    rim = round(6 * form.part)
    pygame.draw.rect(canvas, FOAM, box.inflate(rim, rim), max(1, rim), border_radius=round(14 * form.part))


def draw_view(canvas, frame: Frame, camera: str, unit: float, origin, pen: float) -> None:
    """Water, shadows, path, spheres, arrows and bodies; unit is pixels a body length, pen the width of lines."""
    first = frame.bodies[0]
    here, forward = frame.middle / frame.length, rotation(first.look, first.look.marks(first.position))[0]
    axes, light = view_axes(forward, camera), SIDE_LIGHT if camera == "side" else ABOVE_LIGHT
    view = View(axes, frame.middle, tuple(origin), unit / frame.length, light, pen)
    if camera == "side":
        water.draw_depths(canvas, unit, here[2], origin[1], pen)
    elif camera == "follow":
        water.draw_turned_bed(canvas, unit, here[:2], origin, pen, np.arctan2(axes[0, 1], axes[0, 0]))
    else:
        water.draw_bed(canvas, unit, here[:2], origin, pen)
    bodies = [body_picture(body, view) for body in frame.bodies]
    behind, front = sphere_pictures(frame, view, canvas.get_size())
    if camera != "side":
        stones = [] if frame.touchable else behind + front  # a bubble lets the light through
        for what in [*stones, *bodies]:
            draw_shadow(canvas, *what, unit, pen)
    draw_path(canvas, frame, view)
    canvas.fblits(behind)
    for arrow in frame.arrows:  # one out of the plane of the picture is foreshortened
        tail, tip = view.project(np.array([arrow.start, arrow.start + arrow.way]))[0]
        draw_arrow(canvas, tail, tip, unit, pen, PALETTE[arrow.colour])
    canvas.fblits(bodies + front)


def view_axes(forward: np.ndarray, camera: str) -> np.ndarray:
    """Axes of a `View`: those of the world, or such that what is forward (3,) points level, upwards or to the right."""
    if camera == "above":
        return np.eye(3)
    forward = forward * (1.0, 1.0, 0.0)
    size = np.linalg.norm(forward)
    forward = forward / size if size > 1e-6 else np.array((1.0, 0.0, 0.0))  # straight up or down
    right, up = (forward[1], -forward[0], 0.0), (0.0, 0.0, 1.0)
    return np.array((right, forward, up) if camera == "follow" else (forward, up, right))


def draw_shadow(canvas, body: pygame.Surface, corner, unit: float, pen: float) -> None:
    """A soft shadow on the bed, to the lower right of what casts it; arguments as for `draw_view`."""
    soft = max(SOFT_SMALL, round(SOFT * pen))
    width, height = (side // soft + 4 for side in body.get_size())
    small = pygame.Surface((width, height), pygame.SRCALPHA, 32)
    small.blit(pygame.transform.smoothscale(body, (width - 4, height - 4)), (2, 2))
    small.fill((0, 30, 50, 90), special_flags=pygame.BLEND_RGBA_MULT)
    shadow = pygame.transform.smoothscale(pygame.transform.box_blur(small, 1), (soft * width, soft * height))
    canvas.blit(shadow, (corner[0] - 2 * soft + 0.05 * unit, corner[1] - 2 * soft + 0.09 * unit))


def draw_path(canvas, frame: Frame, view: View) -> None:
    """The path so far: a line that fades and narrows with the distance swum since."""
    every = max(1, round(1 / view.pen))  # of a small picture, lines shorter than a pixel are left out
    places = frame.path[::-every][::-1]
    if len(places) < 2:
        return
    pixels, _ = view.project(places)
    step = np.linalg.norm(np.diff(places, axis=0), axis=1) / frame.length
    age = np.cumsum(step[::-1])[::-1]
    strength = np.exp(-age / FADE)
    colours = (water.DEEP + strength[:, None] * (np.array(PALETTE["path"]) - water.DEEP)).astype(np.uint8)
    width = 3 + 7 * strength * np.clip(age / 0.15, 0.0, 1.0)
    width = np.maximum(1, np.round(view.pen * width)).astype(int).tolist()
    for k in np.flatnonzero(strength > 0.04).tolist():
        pygame.draw.line(canvas, colours[k], pixels[k], pixels[k + 1], width[k])


def draw_arrow(canvas, tail, tip, unit, pen, colour) -> None:
    """An arrow with a dark rim."""
    along = tip - tail
    size = np.linalg.norm(along)
    if size < 2:
        return
    along = along / size
    across = np.array((-along[1], along[0]))
    head, half, barb = min(0.1 * unit, size), 0.014 * unit, 0.05 * unit
    neck = tip - head * along
    corners = [tuple(point) for point in (
        tail + half * across, neck + half * across, neck + barb * across, tip,
        neck - barb * across, neck - half * across, tail - half * across,
    )]  # fmt: skip
    pygame.draw.polygon(canvas, FOAM, corners, max(1, round(9 * pen)))
    pygame.draw.polygon(canvas, colour, corners)
