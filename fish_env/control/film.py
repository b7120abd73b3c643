"""Recorded episodes as a film: a video, or one HTML page that turns in 3-D and needs neither network nor server.

The page has the landmarks of every state in 16 bits a coordinate and the skin as weights of landmarks. A renderer in
plain JavaScript and WebGL draws them (`scene/renderer.js`, `film_player.js`).
"""

import json
from collections.abc import Sequence
from contextlib import closing
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from fish_env.checks import fits_memory, representable
from fish_env.control.files import writable_file, write_text
from fish_env.control.recording import Recording, env_of
from fish_env.control.video import SLOWDOWN, SPEED, VIDEOS, load_writer, write_video
from fish_env.envs import FishEnv
from fish_env.kernels.data import data
from fish_env.physics.failures import FAILURES
from fish_env.physics.muscles import contraction_of
from fish_env.scene.frame import AHEAD, REACH, Body, Frame, command_arrows, task_name
from fish_env.scene.look import PALETTE, as_text, look_of, pack_look, pack_numbers

PAGE = ".html"
HERE = data("fish_env.control")
SCRIPTS = (data("fish_env.scene", "renderer.js"), HERE / "film_player.js")
LARGEST = 3_000_000  # bytes of a page
STATES = 10_000  # of all episodes together: a page with more leaves out every second, third ... one
AREA = 25.0  # body lengths squared: pictures of such spheres take 100 MB


class FilmEpisode(NamedTuple):
    """One episode of T states, with L landmarks, M muscles and S spheres."""

    title: str
    interval: float  # s between two states
    time: np.ndarray  # (T,) s
    points: np.ndarray  # (T,L,3) landmarks, m
    centre: np.ndarray  # (T,3) centre of mass, m
    speed: np.ndarray  # (T,) of the centre of mass, body lengths per second
    contraction: np.ndarray  # (T,M) 0 natural, 1 full
    command: np.ndarray  # (T,3) commanded direction, of any length
    spheres: np.ndarray  # (T,S,4) centres, m, and radii, body lengths
    gained: np.ndarray  # (T,) sum of the rewards so far
    note: str  # why the physics failed, if it did


class FilmData(NamedTuple):
    """Episodes of a film, and what they share."""

    fish: Any
    touchable: bool  # whether spheres are targets, or obstacles
    task: str
    picture: dict[str, Any]  # width, height, camera and panel of its environment
    episodes: list[FilmEpisode]


def write_film(recordings: Recording | Sequence[Recording], path: str | Path) -> Path:
    """Write recorded episodes of one environment as an .html page, or as an .mp4, .webp or .gif video at half speed.

    A video has the size, the camera and the panel of its environment. Its pictures say "half speed".

    Raises:
        ValueError: for no recording, recordings of several environments, numbers too large to draw, another ending, a
            page of more than 3 MB, or a folder that cannot be written to.
        gymnasium.error.DependencyNotInstalled: without pygame, or moviepy or Pillow for a video.
    """
    path = writable_file(path, (PAGE, *VIDEOS))
    found = [recordings] if isinstance(recordings, Recording) else list(recordings)
    if not all(isinstance(one, Recording) and one.steps for one in found):
        raise ValueError("give recordings, as `record` and `load_recording` return them, of a step or more each")
    if path.suffix.lower() == PAGE:
        write_text(path, film_text(found))
    else:
        load_writer(path)
        with representable("the film"):
            film = film_data(found)
            area = max(float((one.spheres[..., 3] ** 2).sum(axis=1).max()) for one in film.episodes)
            if area > AREA:
                raise ValueError(
                    f"the squares of the radii of the spheres add up to {area:g}, which is more than {AREA:g}, for a "
                    f"video; write an {PAGE} page"
                )
            size = 3 * film.picture["width"] * film.picture["height"]  # bytes; all pictures are in memory
            fits_memory(sum(len(one.points) for one in film.episodes), size, "the number of states of the video")
            pictures = [picture for one in film.episodes for picture in _pictures(film, one)]
        write_video(pictures, 1.0 / (SLOWDOWN * film.episodes[0].interval), path)
    return path


def film_text(recordings: Sequence[Recording]) -> str:
    """The page of `write_film` as text, with the same errors."""
    with representable("the film"):
        text = page_text(film_data(recordings))
    if len(text) > LARGEST:
        raise ValueError(f"the page would have {len(text):,} bytes, more than {LARGEST:,}; give fewer episodes")
    return text


def film_data(recordings: Sequence[Recording]) -> FilmData:
    """The data of a film; ValueError unless the recordings are of one environment and of its fish."""
    made_of = [(one.about["env_id"], one.about["env_options"]) for one in recordings]
    if not made_of or any(one != made_of[0] for one in made_of):
        raise ValueError(f"there are {len(made_of)} recordings; give at least one, all of one environment and keywords")
    with closing(env_of(recordings[0].about)) as env:
        bare = env.unwrapped
    assert isinstance(bare, FishEnv)  # `record` and the checks of a file allow no other
    fish, task, interval = bare.tank.fish, bare.fish.task, recordings[0].about["control_interval"]
    if bare.fish.control_interval != interval:
        raise ValueError(
            f"the recording holds a state every {interval} s, and its environment makes one every "
            f"{bare.fish.control_interval} s; it is damaged, or was made by another version: record it again"
        )
    episodes = [_episode(one, fish) for one in recordings]
    return FilmData(fish, bool(getattr(task, "touchable", False)), task_name(task), bare.fish.picture, episodes)


def _episode(recording: Recording, fish: Any) -> FilmEpisode:
    """An episode of this fish; ValueError if it is of another fish."""
    held = recording.position.shape[1:], recording.velocity.shape[1:], recording.rest_length.shape[1:]
    needed = fish.body.position.shape, fish.body.position.shape, fish.body.springs.rest_length.shape
    if held != needed:
        raise ValueError(
            f"the recording holds positions, velocities and rest lengths of shapes {held} a state, and the fish of its "
            f"environment has {needed}; it is damaged, or was made by another version: record the episode again"
        )
    mass = fish.body.mass / fish.body.mass.sum()
    return FilmEpisode(
        title=f"seed {recording.about['seed']}",
        interval=recording.about["control_interval"],
        time=recording.time,
        points=fish.points(recording.position),
        centre=np.einsum("n,tnk->tk", mass, recording.position),
        speed=np.linalg.norm(np.einsum("n,tnk->tk", mass, recording.velocity), axis=1) / fish.length,
        contraction=np.clip(contraction_of(fish, recording.rest_length), 0.0, 1.0),
        command=recording.directions[:, 0] if recording.directions.shape[1] else np.zeros((recording.steps + 1, 3)),
        spheres=recording.spheres,
        gained=np.concatenate([[0.0], np.cumsum(recording.reward)]),
        note=FAILURES[int(recording.failure[-1])].partition(":")[0],
    )


def _pictures(film: FilmData, one: FilmEpisode):
    """Every state as a picture (H,W,3) uint8."""
    from fish_env.render import Format, draw  # pygame is loaded only when something is drawn

    form, last = Format(**film.picture), len(one.points) - 1
    look = look_of(film.fish, form.levels).of_landmarks()
    for t in range(1, len(one.points)):
        spheres, note, middle = one.spheres[t], one.note if t == last else "", one.centre[t]
        spheres = spheres[spheres[:, 3] > 0.0]
        yield draw(Frame(
            [Body(look, one.points[t], one.contraction[t])], middle,
            command_arrows(middle, one.command[t], look.length, spheres, film.touchable),
            path=one.centre[: t + 1], spheres=spheres, touchable=film.touchable, time=float(one.time[t]),
            speed=float(one.speed[t]), caption=f"{SPEED}, {note}" if note else SPEED, task=film.task,
        ), form)  # fmt: skip


def page_text(film: FilmData) -> str:
    """The template with the renderer and the data put in."""
    every = -(-sum(len(one.points) for one in film.episodes) // STATES)
    look = look_of(film.fish).of_landmarks()
    data = {
        "task": film.task,
        "palette": PALETTE,
        "touchable": film.touchable,
        "arrow": [AHEAD, AHEAD + REACH],
        "nose": int(look.rest[:, 0].argmax()),
        "tail": int(look.rest[:, 0].argmin()),
        "look": pack_look(look),
        "reels": [_pack_episode(one, every) for one in film.episodes],
    }
    text = (HERE / "film.html").read_text(encoding="utf-8")
    script = "".join(part.read_text(encoding="utf-8") for part in SCRIPTS)
    packed = json.dumps(data).replace("</", "<\\/")  # no end of the script within it
    return text.replace("/*SCRIPT*/", script).replace("/*DATA*/", packed)


def _pack_episode(one: FilmEpisode, every: int) -> dict[str, Any]:
    """Every so many-th state of an episode, as JSON."""
    size = np.linalg.norm(one.command, axis=1, keepdims=True)
    numbers = {
        "points": one.points, "centre": one.centre, "speed": one.speed[:, None], "gained": one.gained[:, None],
        "command": one.command / np.maximum(size, 1e-300), "spheres": one.spheres,
    }  # fmt: skip
    return {
        "title": one.title, "note": one.note, "interval": every * one.interval, "states": len(one.points[::every]),
        "contraction": as_text((255 * one.contraction[::every]).round().astype(np.uint8)),
        "sphereCount": one.spheres.shape[1],
    } | {name: pack_numbers(part[::every]) for name, part in numbers.items()}  # fmt: skip
