"""The scene of a school: skins, muscles coloured by activation, where each fish is to go, targets and obstacles.

Everything is drawn in body lengths. The picture follows the school; the grid shows that it moves.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from fish_env.lab import fields
from fish_env.lab.drawing import add_balls, add_lines, flat_points, free_part, move_lines
from fish_env.lab.geometry import surfaces
from fish_env.lab.school import APART, MOST_OBSTACLES, School

if TYPE_CHECKING:
    from fish_env.lab.session import Session

FOLLOW = 4.0  # 1/s, how fast the picture follows the school
BEHIND = np.array([-0.62, -0.3, 0.72])  # where the camera is, from the middle of the fish; a unit vector, nearly
ROOM = 1.8  # body lengths around them
ARROW = 0.55  # length of the arrow to where a fish is to go
WATER = "/water"  # name of the part of the scene that moves


class SchoolDrawing:
    """Scene of a school in the browser."""

    def __init__(self, session: Session, school: School):
        self.school, self.session, self.scene = school, session, session.client.scene
        fish = school.fish
        self.scale = 1.0 / fish.length
        self._surface = surfaces(fish)[0]
        scene, points, count = self.scene, self._points(school.shown_positions()), school.num_fish
        self.water = scene.add_frame(WATER, show_axes=False)
        triangles = np.concatenate([self._surface.triangles + len(self._surface.nodes) * k for k in range(count)])
        self.skin = scene.add_mesh_simple(
            f"{WATER}/skin", points, triangles, color=fields.SKY, opacity=0.55, side="double"
        )
        self.muscles = add_lines(scene, f"{WATER}/muscles", count * len(fish.fibres), 0.022)
        self.aims = scene.add_arrows(
            f"{WATER}/aims", np.zeros((count, 2, 3)), fields.BLACK, shaft_radius=0.015, head_radius=0.04,
            head_length=0.1,
        )  # fmt: skip
        self.grid = scene.add_grid(
            "/grid", 60.0, 60.0, cell_size=0.5, section_size=1.0, section_color=fields.GREY, fade_distance=14.0,
            position=(0.0, 0.0, -0.35),
        )  # fmt: skip
        balls = {"target": (count, fields.ORANGE), "obstacle": (MOST_OBSTACLES, fields.VERMILLION)}
        self.goals: Any = None  # targets or obstacles
        if school.goal in balls:
            number, colour = balls[school.goal]
            self.goals = add_balls(scene, f"{WATER}/{school.goal}s", number, school.radius * self.scale, colour)
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

    def clear(self) -> None:
        """Take everything away."""
        for handle in (self.goals, self.grid, self.aims, self.muscles, self.skin, self.water):
            if handle is not None:
                handle.remove()

    def place(self, origin, direction) -> np.ndarray:
        """The point (3,) m at the height of the fish that a ray from an origin (3,) hits; ValueError if none."""
        height = self._focus[2] + origin[2]
        if not (height > 0.0 > direction[2] or height < 0.0 < direction[2]):
            raise ValueError("that point lies in the sky; give one nearer, in the plane in which the fish swim")
        with np.errstate(over="ignore", invalid="ignore"):  # of a ray that is nearly level: rejected as too far
            found = origin - height / direction[2] * direction + self._focus
        return found / self.scale

    def update(self, seconds: float) -> None:
        """Draw where everything is now, `seconds` after the last picture."""
        school, fish = self.school, self.school.fish
        x = school.shown_positions()
        self._focus = self._focus + min(FOLLOW * seconds, 1.0) * (self._centre() - self._focus)
        if np.abs(self._centre() - self._focus).max() > 5.0:  # the fish have begun again
            self._focus = self._centre()
        self.water.position = tuple(-self._focus)
        self.grid.position = (-self._focus[0] % 1.0, -self._focus[1] % 1.0, -0.35)
        self.skin.vertices = self._points(x)
        pairs = fish.body.springs.nodes[fish.fibres]
        active = fields.activation(school.waters.tank)
        move_lines(self.muscles, self.scale * x[:, pairs].reshape(-1, 2, 3), fields.MUSCLE, active.ravel())
        nose, aim = self.scale * x[:, fish.nose], school.aim()
        ahead = np.column_stack([np.cos(aim), np.sin(aim), np.zeros(len(aim))])
        self.aims.points = flat_points(np.stack([nose + 0.1 * ahead, nose + (0.1 + ARROW) * ahead], axis=1))
        if self.goals is not None:
            points = school.targets()
            if school.goal == "obstacle":
                points = np.tile((0.0, 0.0, -1e4), (MOST_OBSTACLES, 1))  # out of sight
                points[: len(school.obstacles)] = np.reshape(school.obstacles, (-1, 3))
            self.goals.batched_positions = flat_points(self.scale * points)

    def _points(self, x) -> np.ndarray:
        """The points of all skins, (B P,3), body lengths."""
        return flat_points(self.scale * np.concatenate([self._surface.points(each) for each in x]))

    def _centre(self) -> np.ndarray:
        return self.scale * self.school.shown_positions().mean(axis=(0, 1))
