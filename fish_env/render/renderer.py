"""Renderer: the pictures of an environment, as arrays or in a window."""

import os
import sys
from collections import deque

import gymnasium as gym
import numpy as np
import pygame

from fish_env.render.flat import draw_surface, pixels_of
from fish_env.render.labels import Format
from fish_env.scene.frame import make_frame
from fish_env.scene.look import look_of

PATH_POINTS = 1000  # older points of a path are dropped: they have faded by then
WINDOW_FISH = 4  # a window shows the first ones of a batch; more could not be drawn in real time
NO_WINDOW = "no window could be opened ({}): use render_mode='rgb_array', or write a file: fish_env play --save FILE"


class WindowClosed(gym.error.Error):
    """The user closed the window. The next call of `render` opens a new one."""


class Renderer:
    """Draws the fish of a `FishVectorEnv` as its `render_mode` and `picture` say, with the paths they have swum."""

    def __init__(self, env):
        if env.render_mode == "human" and not has_display():
            raise RuntimeError(NO_WINDOW.format("there is no display"))
        self.env, self.form = env, Format(**env.picture)
        self._look = look_of(env.tank.fish, self.form.levels)
        self._paths: list[deque[bytes]] = [deque(maxlen=PATH_POINTS) for _ in range(env.num_envs)]
        self._window: pygame.Surface | None = None
        self._clock = pygame.time.Clock()

    def restart(self, mask: np.ndarray) -> None:
        """Forget the paths of the fish of the boolean mask (B,)."""
        for i in np.flatnonzero(mask):
            self._paths[i].clear()

    def render(self) -> tuple[np.ndarray, ...] | None:
        """A picture (H,W,3) uint8 of each fish, or None after showing them in the window ("human")."""
        # WindowClosed if the user closed the window or pressed Escape, RuntimeError if there is no display to open one
        # on, and ResetNeeded before the first `reset`.
        if not self.env._started:
            raise gym.error.ResetNeeded("render was called before reset; call env.reset() first")
        for path, centre in zip(self._paths, self.env._pose.centre, strict=True):
            place = centre.tobytes()
            if not path or path[-1] != place:
                path.append(place)
        if self.env.render_mode == "human":
            self._show()
            return None
        return tuple(pixels_of(self._picture(i)) for i in range(self.env.num_envs))

    def path(self, i: int) -> np.ndarray:
        """Centres of mass of fish i at the calls of `render` since its restart, (K,3) m, the last one last."""
        return np.frombuffer(b"".join(self._paths[i])).reshape(-1, 3)

    def close(self) -> None:
        """Close the window, if there is one."""
        if self._has_window():
            pygame.display.quit()
        self._window = None

    def _picture(self, i: int) -> pygame.Surface:
        return draw_surface(make_frame(self.env, i, self.path(i), self._look), self.form)

    def _show(self) -> None:
        """Draw to the window, answer its events, and wait until the next picture is due."""
        shown = min(self.env.num_envs, WINDOW_FISH)
        columns = 1 if shown == 1 else 2
        width, height = self.form.size
        window = self._window
        if window is None or not self._has_window():
            window = self._window = open_window((columns * width, -(-shown // columns) * height), self.env.num_envs)
        for i in range(shown):
            window.blit(self._picture(i), (i % columns * width, i // columns * height))
        pygame.display.flip()
        self._clock.tick(self.env.metadata["render_fps"])
        for event in pygame.event.get():
            if event.type == pygame.QUIT or (event.type == pygame.KEYDOWN and event.key == pygame.K_ESCAPE):
                self.close()
                raise WindowClosed("the window was closed; call env.close(), or continue to open a new one")

    def _has_window(self) -> bool:
        """Return True if the window is open and still this renderer's: pygame has only one, and anyone may close it."""
        return self._window is not None and pygame.display.get_init() and pygame.display.get_surface() is self._window


def open_window(size: tuple[int, int], count: int) -> pygame.Surface:
    """Open pygame's window for so many fish; RuntimeError if there is no display to open it on."""
    try:
        pygame.display.init()
        window = pygame.display.set_mode(size)
    except pygame.error as error:
        raise RuntimeError(NO_WINDOW.format(error)) from error
    title = "fish_env" if count <= WINDOW_FISH else f"fish_env: the first {WINDOW_FISH} of {count} fish"
    pygame.display.set_caption(title)
    return window


def has_display() -> bool:
    """Return True if a window can be seen, as far as that can be known: SDL opens one without a display, too."""
    display = any(os.environ.get(name) for name in ("DISPLAY", "WAYLAND_DISPLAY", "SDL_VIDEODRIVER"))
    return display or not sys.platform.startswith("linux")
