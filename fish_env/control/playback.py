"""Watch a policy: in a window, or as a video where there is no display."""

import importlib
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium.error import DependencyNotInstalled

from fish_env.control.evaluation import evaluation_options, policy_controller
from fish_env.control.files import replacing, writable_file
from fish_env.control.policy import Policy
from fish_env.envs import FishEnv

VIDEOS = (".mp4", ".webp", ".gif")
COLOURS = 128  # of a .gif
SLOWER = 2  # times slower than life: a tail beats faster than the eye follows


def play(policy: Policy, seed: int = 0, episodes: int = 3, video: str | Path | None = None, **changes) -> None:
    """Play episodes of a policy, in a window or into one video file, and print how each went.

    Args:
        policy: as `load_policy` reads it.
        seed: of the first episode; the next ones count up from it.
        episodes: how many.
        video: an .mp4, .webp or .gif file to write instead of opening a window.
        changes: keywords of the environment that replace those of the training, such as `body`; None is ignored.

    Raises:
        ValueError: if there is no display and no video was asked for, the video cannot be written, or a keyword is not
            allowed.
        gymnasium.error.DependencyNotInstalled: without pygame, or without moviepy for a video.
    """
    from fish_env.render import WindowClosed  # pygame is loaded only when something is drawn

    if video is not None:
        video = writable_file(video, VIDEOS)
        load_writer(video)
    elif not has_display():
        raise ValueError("there is no display to open a window on; write a video, to an .mp4, .webp or .gif file")
    frames: list[np.ndarray] = []
    with _environment(policy, "human" if video is None else "rgb_array", changes) as (env, bare):
        try:
            for episode in range(episodes):
                for picture in _episode(policy, env, bare, seed + episode):
                    frames += [] if picture is None else [picture]
                print(f"episode {episode}: {summary(bare.episode_info())}")
        except (KeyboardInterrupt, WindowClosed):
            print("stopped")
    if frames and video is not None:
        write_video(frames, env.metadata["render_fps"] / SLOWER, video)
        print(f"written to {video}, at half speed")


def has_display() -> bool:
    """Whether a window can be opened, as far as that can be known without trying."""
    display = any(os.environ.get(name) for name in ("DISPLAY", "WAYLAND_DISPLAY", "SDL_VIDEODRIVER"))
    return display or not sys.platform.startswith("linux")


@contextmanager
def _environment(policy: Policy, mode: str, changes: dict[str, Any]) -> Iterator[tuple[gym.Env, FishEnv]]:
    """The environment of a policy, in its wrappers and without them."""
    options = evaluation_options(policy.about.get("env_options", {}))
    options |= {name: value for name, value in changes.items() if value is not None}
    env = gym.make(policy.about["env_id"], render_mode=mode, **options)
    try:
        bare = env.unwrapped
        if not isinstance(bare, FishEnv):
            raise ValueError(f"the policy is for {policy.about['env_id']}, which is not an environment of fish")
        yield env, bare
    finally:
        env.close()


def _episode(policy: Policy, env: gym.Env, bare: FishEnv, seed: int) -> Iterator[np.ndarray | None]:
    """The picture after every environment step; None where a window shows it."""
    controller = policy_controller(policy, bare.fish)
    obs, _ = env.reset(seed=seed)
    over, time = False, 0.0
    while not over:
        obs, _, terminated, truncated, _ = env.step(controller(obs[None], time)[0])
        time += bare.fish.control_interval
        over = terminated or truncated
        yield None if bare.render_mode == "human" else bare.render()


def summary(info: dict[str, Any]) -> str:
    """The metrics of an episode in one line, from its `episode_info`."""
    numbers = {name: float(value) for name, value in info.items() if name not in ("terms", "failure")}
    said = ", ".join(f"{name} {value:.2f}" for name, value in numbers.items() if np.isfinite(value))
    return said + (f"; ended by {info['failure']}" if "failure" in info else "")


def load_writer(path: Path):
    """The module that writes videos of this ending: Pillow moving pictures, moviepy the rest.

    Raises:
        gymnasium.error.DependencyNotInstalled: without it.
    """
    try:
        return importlib.import_module("moviepy" if path.suffix.lower() == ".mp4" else "PIL.Image")
    except ImportError as error:
        raise DependencyNotInstalled(
            'writing a video needs moviepy and Pillow: pip install "fish_env[render]"'
        ) from error


def write_video(frames: list[np.ndarray], fps: float, path: str | Path) -> None:
    """Write (H,W,3) uint8 frames as an .mp4, or at half their size as an animated .webp or .gif: whole or not at all.

    Raises:
        ValueError: for another ending, or a folder that cannot be written to.
        gymnasium.error.DependencyNotInstalled: without moviepy, or Pillow.
    """
    path = writable_file(path, VIDEOS)
    writer = load_writer(path)
    with replacing(path) as partial:
        if path.suffix.lower() == ".mp4":
            clip = writer.ImageSequenceClip(list(frames), fps=fps)
            clip.write_videofile(str(partial), logger=None, audio=False)
            return
        pictures = [writer.fromarray(frame).reduce(2) for frame in frames]
        if path.suffix.lower() == ".gif":
            palette = pictures[0].quantize(COLOURS, method=writer.Quantize.MAXCOVERAGE)  # rare colours, muscles, too
            pictures = [
                picture.quantize(palette=palette, dither=writer.Dither.NONE) for picture in pictures
            ]  # what stands still is free
        pictures[0].save(
            partial, save_all=True, append_images=pictures[1:], duration=round(1000 / fps), loop=0, quality=60
        )
