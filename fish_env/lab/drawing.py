"""The scene: skins, muscles coloured by activation, springs and tetrahedra by strain, forces, walls, the hand.

Everything is drawn in lengths of the first object, so that a metre of a scene is never visible to the camera.
"""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from fish_env.bodies.skins import octasphere
from fish_env.lab import fields
from fish_env.lab.fields import ARROWS, SHADES, activation, arrows, colours_along, part_of, shade_of, shades
from fish_env.lab.geometry import boundary
from fish_env.lab.settings import checked_point, positive_or
from fish_env.lab.specimen import Specimen, down_of, room_size

if TYPE_CHECKING:
    from fish_env.lab.session import Session

TRANSLUCENT = 0.7  # opacity of tetrahedra with muscles between them
FAINT = 0.15  # opacity of what would hide forces
NODES = 0.018  # radius of a drawn node, lengths
FEW = 60  # nodes up to which they are drawn unless told otherwise
UPRIGHT = np.array([(1.0, 0.0, 0.0), (0.0, 0.0, -1.0), (0.0, 1.0, 0.0)])
PANEL = 336  # pixels of the page that the panel covers
SCREEN, SIGHT = (960.0, 600.0), 0.8  # pixels and angle of sight, rad, of a page that does not say
VIEWS = ("skin", "tetrahedra", "springs", "nodes", "forces")
"""Layers to show or hide. Tetrahedra, coloured by strain, replace the skin of a body that is made of them."""


def flat_points(points: np.ndarray) -> np.ndarray:
    """Convert points to 32-bit numbers; those that are not finite, of a failed body, go to the origin."""
    return np.nan_to_num(points, nan=0.0, posinf=0.0, neginf=0.0).astype(np.float32)


def upright(thing) -> bool:
    """Return True if an object falls within the xy plane, which is then shown upright."""
    return abs(down_of(thing)[2]) < 0.5


def free_part(camera) -> tuple[float, float]:
    """The part of the page that the panel hides, and half the width that all of the page shows at a distance of 1."""
    wide, high = positive_or(camera.image_width, SCREEN[0]), positive_or(camera.image_height, SCREEN[1])
    return min(PANEL / wide, 0.5), np.tan(0.5 * min(positive_or(camera.fov, SIGHT), 3.0)) * wide / high


def add_balls(scene: Any, name: str, count: int, radius: float, colour) -> Any:
    """Small balls that can be moved; the handle."""
    ball = octasphere(1)
    return scene.add_batched_meshes_simple(
        name, radius * ball.place, ball.faces[:, :3], np.tile((1.0, 0.0, 0.0, 0.0), (count, 1)), np.zeros((count, 3)),
        batched_colors=np.tile(np.array(colour, np.uint8), (count, 1)), lod="off", flat_shading=False,
    )  # fmt: skip


def add_lines(scene: Any, name: str, count: int, thickness: float) -> Any:
    """Straight lines without a place or a colour yet; the handle."""
    ends = np.zeros((count, 2, 3))
    return scene.add_line_segments(name, ends, np.zeros(ends.shape, np.uint8), thickness=thickness)


def move_lines(handle: Any, ends: np.ndarray, scale: np.ndarray, part: np.ndarray) -> None:
    """Put lines at ends (K,2,3), each in the colour at a part (K,) of a scale."""
    handle.points = flat_points(ends)
    handle.colors = np.repeat(colours_along(scale, part)[:, None], 2, axis=1)


class Drawing:
    """Scene of a bench in the browser."""

    def __init__(self, session: Session):
        self.session, self.scene = session, session.client.scene
        self.shown = dict.fromkeys(VIEWS, True) | {"forces": False}
        self.scale = 1.0
        self._handles: dict[tuple[int, str], Any] = {}
        self._room: list[Any] = []
        self._tets: dict[int, tuple[np.ndarray, np.ndarray]] = {}
        self._opacity: dict[tuple[int, str], float | None] = {}

    def offset(self, number: int) -> np.ndarray:
        """Offset (3,) m at which object `number` is shown: side by side along x."""
        bench = self.session.bench
        return np.array([(number - 0.5 * (len(bench.specimens) - 1)) * bench.spacing, 0.0, 0.0])

    def turn(self, number: int) -> np.ndarray:
        """The rotation (3,3) with which an object is shown: what moves in the xy plane stands upright."""
        return UPRIGHT if upright(self.session.bench.specimens[number].thing) else np.eye(3)

    def place(self, number: int, point) -> np.ndarray:
        """The point of an object's own space, (3,) m, that a point of the scene shows."""
        return np.asarray(point, dtype=float) @ self.turn(number) / self.scale - self.offset(number)

    def seen_from(self, number: int) -> tuple[float, float]:
        """Distance of the camera, m, and focal length of the picture, pixels; ValueError if the camera is nowhere."""
        camera = self.session.client.camera
        middle = self._to_scene(number, self.session.bench.specimens[number].position.mean(axis=0)[None])[0]
        away = float(np.linalg.norm(checked_point(camera.position, what="camera") - middle)) / self.scale
        high = positive_or(camera.image_height, SCREEN[1])
        return away, 0.5 * high / np.tan(0.5 * min(positive_or(camera.fov, SIGHT), 3.0))

    def build(self, look: bool = True) -> None:
        """Draw the objects that are now on the bench, and look at them unless the camera is to stay."""
        self.clear()
        bench = self.session.bench
        self.scale = 1.0 / bench.specimens[0].thing.length
        for number, specimen in enumerate(bench.specimens):
            self._add(number, specimen)
        self._show_all()
        self.build_room()
        if look:
            self.look()
        self.update()

    def clear(self) -> None:
        """Take everything away."""
        for handle in [*self._handles.values(), *self._room]:
            handle.remove()
        self._handles, self._room, self._tets, self._opacity = {}, [], {}, {}

    def look(self) -> None:
        """Turn the camera to the objects, all in what the panel leaves free of the page."""
        bench, camera = self.session.bench, self.session.client.camera
        thing = bench.specimens[0].thing
        flat = upright(thing)
        width = (len(bench.specimens) - 1) * bench.spacing * self.scale
        near = 1.7 if thing.water.planes is None else 2.2 * room_size(thing) * self.scale
        hidden, half = free_part(camera)
        far = max(0.55 * width + near, (0.5 * width + 0.5 * near) / (half * (1.0 - hidden)))
        aside = hidden * half * far
        place = (aside, -far, 0.01) if flat else (aside, -0.88 * far, 0.47 * far)
        self.session.turn_camera(place, (aside, 0.0, 0.0))

    def _add(self, number: int, specimen: Specimen) -> None:
        """Draw one object for the first time."""
        thing, count = specimen.thing, len(specimen.position)
        tint = fields.SPECIMENS[number] if len(self.session.bench.specimens) > 1 else fields.SKY
        for k, surface in enumerate(specimen.surfaces):
            points = self._to_scene(number, surface.points(specimen.position))
            opacity = None if k else 0.35 if len(specimen.surfaces) > 1 else 0.55
            self._mesh(number, f"skin {k}", points, surface.triangles, fields.ORANGE if k else tint, opacity)
        if thing.body.tets is not None:
            self._tets[number] = boundary(thing.body.tets.nodes)
            for k, shade in enumerate(shades()):
                see_through = TRANSLUCENT if len(thing.fibres) else None  # muscles are inside
                self._mesh(number, f"element {k}", np.zeros((3, 3)), [(0, 1, 2)], shade, see_through, flat=True)
        springs = len(thing.body.springs.nodes) - len(thing.fibres)
        for name, lines, thickness in (
            ("springs", springs, 0.007), ("muscles", len(thing.fibres), 0.022), ("hand", 1, 0.012),
        ):  # fmt: skip
            if lines:
                self._handles[number, name] = add_lines(self.scene, f"/{number}/{name}", lines, thickness)
        self._handles[number, "hand"].colors = np.tile(np.array(fields.VERMILLION, np.uint8), (1, 2, 1))
        radius = NODES * (1.0 if count <= FEW else 0.5)
        self._handles[number, "nodes"] = add_balls(self.scene, f"/{number}/nodes", count, radius, tint)
        self._draggable(number, self._handles[number, "nodes"])
        self._handles[number, "forces"] = self.scene.add_arrows(
            f"/{number}/forces", np.zeros((min(ARROWS, count), 2, 3)), fields.BLACK,
            shaft_radius=0.005, head_radius=0.014, head_length=0.03,
        )  # fmt: skip

    def _mesh(self, number, name, points, triangles, colour, opacity, flat=False) -> None:
        red, green, blue = map(int, colour)
        handle = self.scene.add_mesh_simple(
            f"/{number}/{name}", points, np.asarray(triangles), color=(red, green, blue), opacity=opacity,
            flat_shading=flat, side="double",
        )  # fmt: skip
        self._draggable(number, handle)
        self._handles[number, name], self._opacity[number, name] = handle, opacity

    def _draggable(self, number: int, handle: Any) -> None:
        """Let the mouse drag, or in another mode click, this part of an object."""
        session = self.session

        async def drag(event) -> None:
            if event.phase == "start":
                session.ask_at(partial(session.panel.press, number), start=event.start_position)
            if event.phase == "end":
                session.ask(session.bench.let_go)
            else:
                session.ask_at(partial(session.panel.drag, number), end=event.end_position)

        handle.on_drag("left")(drag)

    def build_room(self) -> None:
        """Draw the walls of every object: faint sheets."""
        for handle in self._room:
            handle.remove()
        self._room = []
        for number, specimen in enumerate(self.session.bench.specimens):
            planes = specimen.tank.world.planes
            size = room_size(specimen.thing) * self.scale
            turn = self.turn(number)
            depth = 0.4 if upright(specimen.thing) else size
            for k, plane in enumerate([] if planes is None else planes):
                half = np.where(np.abs(plane[:3]) > 0.5, 0.01, (size, size, depth))
                ground = np.dot(plane[:3], down_of(specimen.thing)) < -0.5
                place = self.scale * (plane[3] * plane[:3] + self.offset(number)) - half * plane[:3]
                box = self.scene.add_box(
                    f"/{number}/wall {k}", dimensions=tuple(np.abs(2.0 * half @ turn.T)), color=fields.GREY,
                    opacity=0.5 if ground else 0.12, cast_shadow=False, position=tuple(place @ turn.T),
                )  # fmt: skip
                self._room.append(box)

    def show(self, view: str, visible: bool) -> None:
        """Show or hide one of VIEWS."""
        self.shown[view] = bool(visible)
        self._show_all()

    def _show_all(self) -> None:
        """Show what is to be shown, and make faint what would hide forces."""
        for (number, name), handle in self._handles.items():
            kind = name.split()[0]
            if kind == "skin":
                handle.visible = self.shown["skin"] and not (number in self._tets and self.shown["tetrahedra"])
            elif kind == "element":
                handle.visible = self.shown["tetrahedra"]
            elif name != "hand":
                handle.visible = self.shown["springs" if name == "muscles" else name]
            if kind in ("skin", "element"):
                handle.opacity = FAINT if self.shown["forces"] else self._opacity[number, name]

    def _to_scene(self, number, points) -> np.ndarray:
        return flat_points((points + self.offset(number)) @ self.turn(number).T * self.scale)

    def update(self) -> None:
        """Draw where everything is now."""
        for number, specimen in enumerate(self.session.bench.specimens):
            self._update(number, specimen)

    def _update(self, number: int, specimen: Specimen) -> None:
        handles, x = self._handles, self._to_scene(number, specimen.position)
        if number in self._tets and self.shown["tetrahedra"]:
            self._update_elements(number, x, specimen.tet_strain())
        elif self.shown["skin"]:
            for k, surface in enumerate(specimen.surfaces):
                handles[number, f"skin {k}"].vertices = self._to_scene(number, surface.points(specimen.position))
        if self.shown["springs"]:
            self._update_springs(number, specimen, x, specimen.spring_strain())
        if self.shown["nodes"]:
            handles[number, "nodes"].batched_positions = x
        if self.shown["forces"]:
            self._update_forces(number, specimen, x)
        self._update_hand(number, specimen, x)

    def _update_elements(self, number, x, strain) -> None:
        """Sort the sides of the tetrahedra into shades of their strain; only those that are there are sent."""
        triangles, owner = self._tets[number]
        shade = shade_of(strain[owner])
        for k in range(SHADES):
            handle, found = self._handles[number, f"element {k}"], triangles[shade == k]
            count = 3 * max(len(found), 1)
            if len(found) or handle.vertices.any():
                handle.vertices = x[found].reshape(-1, 3) if len(found) else np.zeros((3, 3), np.float32)
            if handle.faces.size != count:
                handle.faces = np.arange(count, dtype=np.uint32).reshape(-1, 3)

    def _update_springs(self, number, specimen, x, strain) -> None:
        thing, ends = specimen.thing, specimen.thing.body.springs.nodes
        others = np.setdiff1d(np.arange(len(ends)), thing.fibres)
        for name, which, scale, part in (
            ("springs", others, fields.DIVERGING, part_of(strain[others])),
            ("muscles", thing.fibres, fields.MUSCLE, activation(specimen.tank)[0]),
        ):
            if (number, name) in self._handles:
                move_lines(self._handles[number, name], x[ends[which]], scale, part)

    def _update_forces(self, number, specimen, x) -> None:
        nodes, arrow = arrows(specimen.forces(), specimen.tank.fish.body.mass)
        ends = x[nodes] + arrow @ self.turn(number).T * specimen.thing.length * self.scale
        self._handles[number, "forces"].points = flat_points(np.stack([x[nodes], ends], axis=1))

    def _update_hand(self, number, specimen, x) -> None:
        hand, handle = self.session.bench.hand, self._handles[number, "hand"]
        nodes = 0 if hand is None else len(self.session.bench.specimens[hand.specimen].position)
        handle.visible = nodes == len(x)
        if hand is not None and nodes == len(x):
            handle.points = np.stack([x[hand.node], self._to_scene(number, hand.point[None])[0]])[None]
