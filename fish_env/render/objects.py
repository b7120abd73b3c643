"""A window in which the mouse drags an elastic object: `python -m fish_env.render.objects ring` (Song 2009, ch. 6).

Press on the object and pull; R puts it back, Escape or Q ends. In real time, 60 pictures a second.
"""

import argparse

import numpy as np
import pygame

from fish_env.bodies.objects import OBJECTS
from fish_env.bodies.room import InRoom
from fish_env.physics.tank import Tank
from fish_env.render.elastic_object import Painter
from fish_env.render.renderer import open_window

FRAME = 1 / 60  # s
PULL = 0.4  # of the mouse's spring over the object's weight an object's length away
SLACK = 0.05  # its natural length over the object's length
DAMPING = 0.02  # s, over its stiffness


class Viewer:
    """An object that the mouse can drag, and its picture.

    Args:
        thing: the object; it starts at the middle of its room.
        size: width and height of the picture, pixels.
    """

    def __init__(self, thing: InRoom, size: tuple[int, int] = (640, 480)):
        self.thing = thing
        self.tank = Tank(thing, water=thing.water)
        self.painter = Painter(thing, size)
        self.steps = round(FRAME / self.tank.dt)
        gravity = np.zeros(3) if thing.water.gravity is None else thing.water.gravity
        self.stiffness = thing.body.mass.sum() * np.linalg.norm(gravity) / (PULL * thing.length)
        self.dragged: tuple[int, np.ndarray] | None = None
        """The node that the mouse drags, and the position of the mouse, (3,) m."""
        self.open = True

    def handle(self, event: pygame.event.Event) -> None:
        """Grab the nearest node of the outer layer, drag it, let go; start again; end."""
        if event.type == pygame.QUIT or (event.type == pygame.KEYDOWN and event.key in (pygame.K_ESCAPE, pygame.K_q)):
            self.open = False
        elif event.type == pygame.KEYDOWN and event.key == pygame.K_r:
            self.let_go()
            self.tank.reset()
        elif event.type == pygame.MOUSEBUTTONDOWN and event.button == 1:
            self.drag(self.nearest(event.pos), event.pos)
        elif event.type == pygame.MOUSEMOTION and self.dragged is not None:
            self.drag(self.dragged[0], event.pos)
        elif event.type == pygame.MOUSEBUTTONUP and event.button == 1:
            self.let_go()

    def nearest(self, pixel) -> int:
        """The outer node nearest to a pixel, of those in front."""
        x = self.tank.position[0]
        depth = x[self.thing.outer] @ self.painter.view.axes[2]
        front = self.thing.outer[depth >= depth.mean() - 1e-9]
        away = x[front] - self.painter.place(pixel)
        flat = away - np.outer(away @ self.painter.view.axes[2], self.painter.view.axes[2])
        return int(front[np.argmin((flat**2).sum(axis=1))])

    def drag(self, node: int, pixel) -> None:
        """Pull a node towards a pixel, at the depth where the node is."""
        depth = float(self.tank.position[0, node] @ self.painter.view.axes[2])
        point = self.painter.place(pixel, depth)
        damping = DAMPING * self.stiffness
        self.tank.grab(node, point, self.stiffness, damping, SLACK * self.thing.length)
        self.dragged = node, point

    def let_go(self) -> None:
        """Release the node that the mouse drags."""
        self.tank.release()
        self.dragged = None

    def advance(self) -> None:
        """Move on by a sixtieth of a second; an object that fails starts again."""
        self.tank.advance(self.steps)
        if not self.tank.alive[0]:
            print(f"started again: {self.tank.failure[0]}")
            self.let_go()
            self.tank.reset()

    def surface(self) -> pygame.Surface:
        """The picture now, a new surface."""
        return self.painter.surface(self.tank.position[0], self.dragged)


def run(viewer: Viewer, frames: int | None = None) -> None:
    """Show a window until it is closed, or for a number of frames.

    Raises:
        RuntimeError: if no window can be opened.
    """
    window = open_window(viewer.painter.size, f"fish_env: {viewer.thing.name}, drag it with the mouse")
    clock = pygame.time.Clock()
    while viewer.open and frames != 0:
        for event in pygame.event.get():
            viewer.handle(event)
        viewer.advance()
        window.blit(viewer.surface(), (0, 0))
        pygame.display.flip()
        clock.tick(round(1 / FRAME))
        frames = None if frames is None else frames - 1
    pygame.display.quit()


def main() -> None:
    """The command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("object", nargs="?", default="ring", choices=OBJECTS, help="which one")
    run(Viewer(OBJECTS[parser.parse_args().object].make()))


if __name__ == "__main__":
    main()
