"""The scene of a school: skins, muscles coloured by activation, where each fish is to go, targets and obstacles.

Everything is drawn in body lengths. The picture follows the school; the grid shows that it moves.
"""

from typing import Any

import numpy as np

from fish_env.lab import colours
from fish_env.lab.drawing import flat_points, free_part
from fish_env.lab.geometry import octahedron, surfaces
from fish_env.lab.requests import SessionLike
from fish_env.lab.school import APART, MOST_OBSTACLES, School

FOLLOW = 4.0  # 1/s, how fast the picture follows the school
BEHIND = np.array([-0.62, -0.3, 0.72])  # where the camera is, from the middle of the fish; a unit vector, nearly
ROOM = 1.8  # body lengths around them
ARROW = 0.55  # length of the arrow to where a fish is to go
WATER = "/water"  # name of the part of the scene that moves


class SchoolDrawing:
    """Scene of a school in the browser.

    Args:
        session: the session of the school.
        school: the school to draw.
    """

    def __init__(self, session: SessionLike, school: School):
        self.school, self.session, self.scene = school, session, session.client.scene
        fish = school.fish
        self.scale = 1.0 / fish.length
        self._surface = surfaces(fish)[0]
        self._handles: list[Any] = []
        self.water = self._keep(self.scene.add_frame(WATER, show_axes=False))
        points, count = self._points(school.shown()), school.num_fish
        nodes = len(self._surface.nodes)
        triangles = np.concatenate([self._surface.triangles + nodes * k for k in range(count)])
        self.skin = self._keep(
            self.scene.add_mesh_simple(
                f"{WATER}/skin", points, triangles, color=colours.SKY, opacity=0.55, side="double"
            )
        )
        ends = np.zeros((count * len(fish.fibres), 2, 3))
        self.muscles = self._keep(
            self.scene.add_line_segments(f"{WATER}/muscles", ends, np.zeros(ends.shape, np.uint8), thickness=0.022)
        )
        self.aims = self._keep(
            self.scene.add_arrows(f"{WATER}/aims", np.zeros((count, 2, 3)), colours.BLACK, shaft_radius=0.015,
                                  head_radius=0.04, head_length=0.1)
        )  # fmt: skip
        self.targets = self._balls("targets", count if len(school.targets()) else 0, colours.ORANGE)
        self.obstacles = self._balls(
            "obstacles", MOST_OBSTACLES if school.goal == "obstacle" else 0, colours.VERMILLION
        )
        self.grid = self._keep(
            self.scene.add_grid("/grid", 60.0, 60.0, cell_size=0.5, section_size=1.0, section_color=colours.GREY,
                                fade_distance=14.0, position=(0.0, 0.0, -0.35))
        )  # fmt: skip
        self._focus = self._centre()
        self.look()
        self.update(0.0)

    def look(self) -> None:
        """Turn the camera to the fish: from behind and above, all of them in what the panel leaves free of the page."""
        hidden, half = free_part(self.session.client.camera)
        room = APART * (np.sqrt(self.school.num_fish) - 1.0) / 2.0**0.5 + ROOM  # from the middle, in every direction
        far = room / (half * (1.0 - hidden))
        right = hidden * half * far * np.array([-BEHIND[1], BEHIND[0], 0.0]) / np.hypot(*BEHIND[:2])
        self.session.turn_camera(tuple(right + far * BEHIND), tuple(right))

    def _keep(self, handle) -> Any:
        self._handles.append(handle)
        return handle

    def _balls(self, name: str, count: int, colour) -> Any:
        """Balls of the size of an obstacle or target; None for none."""
        if not count:
            return None
        points, triangles = octahedron(self.school.radius * self.scale)
        return self._keep(
            self.scene.add_batched_meshes_simple(
                f"{WATER}/{name}", points, triangles, np.tile((1.0, 0.0, 0.0, 0.0), (count, 1)),
                np.zeros((count, 3)), batched_colors=np.tile(np.array(colour, np.uint8), (count, 1)), lod="off",
                flat_shading=False,
            )
        )  # fmt: skip

    def clear(self) -> None:
        """Take everything away."""
        for handle in reversed(self._handles):
            handle.remove()
        self._handles = []

    def place(self, origin, direction) -> np.ndarray:
        """The point (3,) m at the height of the fish that a ray of the scene hits, from an origin (3,) on.

        Raises:
            ValueError: for a ray that does not.
        """
        height = self._focus[2] + origin[2]
        if not (height > 0.0 > direction[2] or height < 0.0 < direction[2]):
            raise ValueError("that point lies in the sky; give one nearer, in the plane in which the fish swim")
        with np.errstate(over="ignore", invalid="ignore"):  # of a ray that is nearly level: rejected as too far
            found = origin - height / direction[2] * direction + self._focus
        return found / self.scale

    def update(self, seconds: float) -> None:
        """Draw where everything is now, `seconds` after the last picture."""
        school, fish = self.school, self.school.fish
        x = school.shown()
        self._focus = self._focus + min(FOLLOW * seconds, 1.0) * (self._centre() - self._focus)
        if np.abs(self._centre() - self._focus).max() > 5.0:  # the fish have begun again
            self._focus = self._centre()
        self.water.position = tuple(-self._focus)
        self.grid.position = (-self._focus[0] % 1.0, -self._focus[1] % 1.0, -0.35)
        self.skin.vertices = self._points(x)
        pairs = fish.body.springs.nodes[fish.fibres]
        self.muscles.points = flat_points(self.scale * x[:, pairs].reshape(-1, 2, 3))
        tank = school.waters.tank
        natural, span = tank._fibres[2], tank._fibres[3]
        active = (natural - tank.rest_length[:, fish.fibres]) / span
        self.muscles.colors = np.repeat(colours.along(colours.MUSCLE, active.ravel())[:, None], 2, axis=1)
        nose, aim = self.scale * x[:, fish.nose], school.aim()
        ahead = np.column_stack([np.cos(aim), np.sin(aim), np.zeros(len(aim))])
        self.aims.points = flat_points(np.stack([nose + 0.1 * ahead, nose + (0.1 + ARROW) * ahead], axis=1))
        if self.targets is not None:
            self.targets.batched_positions = flat_points(self.scale * school.targets())
        if self.obstacles is not None:
            shown = np.tile((0.0, 0.0, -1e4), (MOST_OBSTACLES, 1))  # out of sight
            for k, point in enumerate(school.obstacles):
                shown[k] = self.scale * point
            self.obstacles.batched_positions = flat_points(shown)

    def _points(self, x) -> np.ndarray:
        """The points of all skins, (B P,3), body lengths."""
        return flat_points(self.scale * np.concatenate([self._surface.points(each) for each in x]))

    def _centre(self) -> np.ndarray:
        return self.scale * self.school.shown().mean(axis=(0, 1))
