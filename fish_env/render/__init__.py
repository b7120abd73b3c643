"""Pictures of the fish, drawn with pygame. The only package here that loads pygame; needs the extra [render]."""

import os

from gymnasium.error import DependencyNotInstalled

try:
    os.environ.setdefault("PYGAME_HIDE_SUPPORT_PROMPT", "1")  # its greeting would land in the user's output
    import pygame  # noqa: F401
except ImportError as error:
    raise DependencyNotInstalled('drawing the fish needs pygame: pip install "fish_env[render]"') from error

from fish_env.render.flat import draw
from fish_env.render.labels import Format
from fish_env.render.renderer import Renderer, WindowClosed
from fish_env.scene.frame import Frame, make_frame

__all__ = ["Format", "Frame", "Renderer", "WindowClosed", "draw", "make_frame"]
