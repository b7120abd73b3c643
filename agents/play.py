"""Watch a policy: in a window, or as a video where there is no display."""

import os
import sys
from pathlib import Path

import gymnasium as gym

from agents.policy import load_policy
from fish_env.render import WindowClosed


def play(path: Path, seed: int = 0, episodes: int = 3, video: Path | None = None) -> None:
    """Play episodes of a policy file, in a window or into one video file.

    Raises:
        FileNotFoundError, ValueError: if the file is not a policy, or there is no display and no video was asked for.
    """
    policy = load_policy(path)
    headless = sys.platform.startswith("linux") and not (os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))
    if video is None and headless and "SDL_VIDEODRIVER" not in os.environ:
        raise ValueError(f"there is no display; write a video instead: python train.py play {path} --video swim.mp4")
    mode = "human" if video is None else "rgb_array"
    env = gym.make(policy.about["env_id"], render_mode=mode, **policy.about["env_options"])
    frames = []
    try:
        for episode in range(episodes):
            obs, _ = env.reset(seed=seed + episode)
            over = False
            while not over:
                obs, _, terminated, truncated, info = env.step(policy(obs))
                over = terminated or truncated
                if video is not None:
                    frames.append(env.render())
            print(f"episode {episode}: {info['speed']:.2f} body lengths/s along the heading"
                  + (f"; ended by {info['failure']}" if "failure" in info else ""))  # fmt: skip
    except (KeyboardInterrupt, WindowClosed):
        print("stopped")
    finally:
        env.close()
    if frames:
        write_video(frames, env.metadata["render_fps"] / 2, video)
        print(f"written to {video}, at half speed")


def write_video(frames, fps: float, path: Path) -> None:
    """Write (H,W,3) uint8 frames as an .mp4."""
    from moviepy import ImageSequenceClip

    ImageSequenceClip(list(frames), fps=fps).write_videofile(str(path), logger=None, audio=False)
