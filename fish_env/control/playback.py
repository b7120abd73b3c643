"""Watch a policy: in a window, as a video or a page, or keep an episode as a recording."""

from contextlib import closing
from pathlib import Path
from typing import Any

import numpy as np

from fish_env.control.env_spec import make_checked_env
from fish_env.control.evaluation import NOT_SCORES, checked_episodes, environment_for
from fish_env.control.files import writable_file
from fish_env.control.film import PAGE, write_film
from fish_env.control.policy import Policy, load_policy
from fish_env.control.recording import ENDING, Recording
from fish_env.control.replaying import record
from fish_env.control.video import SPEED, VIDEOS, load_writer


def play(
    policy: str | Path | Policy, seed: int = 0, episodes: int = 3, video: str | Path | None = None, **changes
) -> None:
    """Play episodes of a policy, in a window or into one file, and print how each went.

    Args:
        policy: the name of a shipped policy, a policy file, or a `Policy`.
        seed: of the first episode; the next ones count up from it.
        episodes: how many, at least 1.
        video: a file to write instead of opening a window: an .mp4, .webp or .gif video; an .html page that turns in
            3-D; or an .npz recording of one episode.
        changes: keywords of the environment, plain ones, that replace those of the training, such as `body`; None is
            ignored.

    Raises:
        FileNotFoundError: if there is no such policy.
        ValueError: for no episode or a seed below zero; if the file cannot be written, a keyword is not allowed, or an
            .npz file was requested with several episodes.
        RuntimeError: if there is no display, and no file was requested.
        gymnasium.error.DependencyNotInstalled: without pygame for a window or a video, or without moviepy for a video.
    """
    episodes, seed = checked_episodes(episodes, seed)
    path = None if video is None else _checked_path(video, episodes)
    stops: tuple[type[BaseException], ...] = (KeyboardInterrupt,)
    if path is None or path.suffix.lower() in VIDEOS:
        from fish_env.render import WindowClosed  # pygame is loaded only when something is drawn

        stops += (WindowClosed,)
    policy = load_policy(policy) if isinstance(policy, str | Path) else policy
    mode = "human" if path is None else None
    found: list[Recording] = []
    with closing(make_checked_env(*environment_for(policy, changes), mode)) as env:
        try:
            for episode in range(episodes):
                one = record(env, policy, seed + episode)
                found += [] if path is None else [one]
                print(f"episode {episode}: {summary(env.get_wrapper_attr('episode_info')())}")
        except stops:
            print("stopped")
    if path is not None and found:
        written = found[0].save(path) if path.suffix.lower() == ENDING else write_film(found, path)
        print(f"written to {written}" + (f", at {SPEED}" if path.suffix.lower() in VIDEOS else ""))


def _checked_path(video: str | Path, episodes: int) -> Path:
    """The file that is to be written, before anything is computed, or ValueError."""
    path = writable_file(video, (*VIDEOS, PAGE, ENDING))
    if path.suffix.lower() == ENDING and episodes != 1:
        raise ValueError(f"an {ENDING} file holds one episode, not {episodes}; ask for one, or for an {PAGE} page")
    if path.suffix.lower() in VIDEOS:
        load_writer(path)
    return path


def summary(info: dict[str, Any]) -> str:
    """The metrics of an episode in one line, from its `episode_info`."""
    numbers = {name: float(value) for name, value in info.items() if name not in NOT_SCORES}
    said = ", ".join(f"{name} {value:.2f}" for name, value in numbers.items() if np.isfinite(value))
    return said + (f"; ended by {info['failure']}" if info["failure"] else "")
