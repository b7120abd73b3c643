"""Frames as a video file."""

import importlib
from pathlib import Path

import numpy as np
from gymnasium.error import DependencyNotInstalled

from fish_env.control.files import replacing, writable_file

VIDEOS = (".mp4", ".webp", ".gif")
COLOURS = 128  # of a .gif
WIDEST = 320  # pixels
SLOWDOWN = 2  # times slower than life: a tail beats faster than the eye follows
SPEED = "half speed"  # which the pictures say


def load_writer(path: Path):
    """The module that writes videos of this ending: Pillow, moviepy for .mp4; DependencyNotInstalled without it."""
    try:
        return importlib.import_module("moviepy" if path.suffix.lower() == ".mp4" else "PIL.Image")
    except ImportError as error:
        raise DependencyNotInstalled(
            'writing a video needs moviepy and Pillow: pip install "fish_env[render]"'
        ) from error


def write_video(frames: list[np.ndarray], fps: float, path: str | Path) -> None:
    """Write (H,W,3) uint8 frames as an .mp4 or an animated .webp or .gif: whole or not at all.

    Frames of a .webp or .gif that are wider than WIDEST pixels are written at half their size. ValueError for another
    ending or a folder that cannot be written to, DependencyNotInstalled without moviepy, or Pillow.
    """
    path = writable_file(path, VIDEOS)
    writer = load_writer(path)
    with replacing(path) as partial:
        if path.suffix.lower() == ".mp4":
            clip = writer.ImageSequenceClip(list(frames), fps=fps)
            clip = clip.with_duration((len(frames) + 0.5) / fps)  # moviepy rounds the number of pictures down
            clip.write_videofile(str(partial), logger=None, audio=False)
            return
        pictures = [writer.fromarray(frame).reduce(2 if frame.shape[1] > WIDEST else 1) for frame in frames]
        if path.suffix.lower() == ".gif":
            palette = pictures[0].quantize(COLOURS, method=writer.Quantize.MAXCOVERAGE)  # rare colours, muscles, too
            # without dither, what stands still is free
            pictures = [picture.quantize(palette=palette, dither=writer.Dither.NONE) for picture in pictures]
        pictures[0].save(
            partial, save_all=True, append_images=pictures[1:], duration=round(1000 / fps), loop=0, quality=60
        )
