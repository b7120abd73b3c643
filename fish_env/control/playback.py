"""Watch a policy: in a window, as a video or a page, or keep an episode as a recording."""

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np

from fish_env.control.environments import environment_of, make_checked_env
from fish_env.control.evaluation import checked_episodes, evaluation_options, policy_controller
from fish_env.control.files import writable_file
from fish_env.control.film import PAGE, write_film
from fish_env.control.policy import Policy
from fish_env.control.recording import ENDING, Recording
from fish_env.control.replaying import record
from fish_env.control.video import SLOWER, VIDEOS, load_writer, write_video
from fish_env.envs import FishEnv


def play(policy: Policy, seed: int = 0, episodes: int = 3, video: str | Path | None = None, **changes) -> None:
    """Play episodes of a policy, in a window or into one file, and print how each went.

    Args:
        policy: as `load_policy` reads it.
        seed: of the first episode; the next ones count up from it.
        episodes: how many, at least 1.
        video: a file to write instead of opening a window: an .mp4, .webp or .gif video; an .html page that turns in
            3-D; or an .npz recording of one episode.
        changes: keywords of the environment that replace those of the training, such as `body`; None is ignored.

    Raises:
        ValueError: for no episode or a seed below zero; if there is no display and no file was requested, the file
            cannot be written, a keyword is not allowed, or an .npz file was requested with several episodes.
        gymnasium.error.DependencyNotInstalled: without pygame, or without moviepy for a video.
    """
    from fish_env.render import WindowClosed  # pygame is loaded only when something is drawn

    episodes, seed = checked_episodes(episodes, seed)
    if video is not None:
        video = writable_file(video, (*VIDEOS, PAGE, ENDING))
        if video.suffix.lower() in (PAGE, ENDING):
            return _keep(policy, seed, episodes, video, changes)
        load_writer(video)
    elif not has_display():
        raise ValueError(
            "there is no display to open a window on; write a file: an .mp4, .webp or .gif video, or an .html page"
        )
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


def _keep(policy: Policy, seed: int, episodes: int, path: Path, changes: dict[str, Any]) -> None:
    """Record episodes, and write them as a page, or the one as a recording."""
    page = path.suffix.lower() == PAGE
    if not page and episodes != 1:
        raise ValueError(f"an {ENDING} file holds one episode, not {episodes}; ask for one, or for an {PAGE} page")
    found: list[Recording] = []
    with _environment(policy, None, changes) as (env, bare):
        try:
            for episode in range(episodes):
                found.append(record(env, policy, seed + episode))
                print(f"episode {episode}: {summary(bare.episode_info())}")
        except KeyboardInterrupt:
            print("stopped")
    if found:
        written = write_film(found, path) if page else found[0].save(path)
        print(f"written to {written}")


def has_display() -> bool:
    """Return True if a window can be opened, as far as that can be known without trying."""
    display = any(os.environ.get(name) for name in ("DISPLAY", "WAYLAND_DISPLAY", "SDL_VIDEODRIVER"))
    return display or not sys.platform.startswith("linux")


@contextmanager
def _environment(policy: Policy, mode: str | None, changes: dict[str, Any]) -> Iterator[tuple[gym.Env, FishEnv]]:
    """The environment of a policy, in its wrappers and without them."""
    env_id, options = environment_of(policy.about)
    changed = {name: value for name, value in changes.items() if value is not None}
    env = make_checked_env(env_id, evaluation_options(options) | changed, mode)
    bare = env.unwrapped
    assert isinstance(bare, FishEnv)  # `make_checked_env` allows no other
    try:
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
    numbers = {name: float(value) for name, value in info.items() if name not in ("terms", "failure", "is_success")}
    said = ", ".join(f"{name} {value:.2f}" for name, value in numbers.items() if np.isfinite(value))
    return said + (f"; ended by {info['failure']}" if info["failure"] else "")
