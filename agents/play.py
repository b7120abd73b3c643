"""Watch a policy: in a window, or as a video where there is no display."""

import os
import sys
from pathlib import Path

import gymnasium as gym

from agents.config import RESULTS
from agents.evaluate import measuring, policy_controller
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
    env = gym.make(policy.about["env_id"], render_mode=mode, **measuring(policy.about.get("env_options", {})))
    controller = policy_controller(policy, env.unwrapped.fish)
    task, frames = policy.about.get("task"), []
    headline = RESULTS[task].metrics if task in RESULTS else ("speed",)
    try:
        for episode in range(episodes):
            obs, _ = env.reset(seed=seed + episode)
            over, time = False, 0.0
            while not over:
                obs, _, terminated, truncated, _ = env.step(controller(obs[None], time)[0])
                time += env.unwrapped.fish.control_interval
                over = terminated or truncated
                if video is not None:
                    frames.append(env.render())
            found = env.unwrapped.episode_info()
            said = ", ".join(f"{name} {found[name]:.2f}" for name in headline if name in found)
            print(f"episode {episode}: {said}" + (f"; ended by {found['failure']}" if "failure" in found else ""))
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
