"""An episode as a file: its environment, its actions, and every state, so that it can be plotted and replayed."""

import math
import os
import platform
from collections.abc import Mapping
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np

import fish_env
from fish_env.control.environments import check_environment, environment_of, make_checked_env
from fish_env.control.files import replacing, writable_file
from fish_env.control.npz import LARGEST, Npz, Part, write_about
from fish_env.envs.layout import LAYOUT_VERSION
from fish_env.kernels.cache import source_hash
from fish_env.physics.failures import FAILURES

FORMAT = 1
"""Format of a recording's file."""

KIND = "fish_env recording"
ABOUT = ("env_id", "env_options", "seed", "options", "control_interval", "length", "term_names", "versions")
ENDING = ".npz"
WORD = 200  # characters of a version, or of the name of a term


@dataclass(frozen=True, eq=False, kw_only=True)
class Recording:
    """One episode of T environment steps: T actions and T + 1 states, of which the first is that of the reset.

    N nodes, E springs, A actions, K reward terms, D directions of the task, S spheres in the water.
    """

    about: Mapping[str, Any]
    """env_id, env_options, seed and options of the reset, control_interval (s), length (m), term_names, versions."""
    action: np.ndarray
    """(T,A) float64, as the environment was given them."""
    position: np.ndarray
    """(T+1,N,3) m."""
    velocity: np.ndarray
    """(T+1,N,3) m/s."""
    rest_length: np.ndarray
    """(T+1,E) m, of every spring; those of the muscles follow the actions."""
    time: np.ndarray
    """(T+1,) clock of the fish, s."""
    failure: np.ndarray
    """(T+1,) index into `fish_env.physics.failures.FAILURES`, 0 while the simulation is valid."""
    counters: np.ndarray
    """(T+1,C) cost of the simulation since the reset, in the order of `Tank.counters`."""
    variation: np.ndarray
    """(6,) factors on stiffness, mass and drag, and the current, m/s (`Tank.vary`)."""
    terms: np.ndarray
    """(T,K) terms of the reward."""
    reward: np.ndarray
    """(T,) their sum."""
    terminated: np.ndarray
    """(T,) whether the physics or the task ended the episode; a time limit ends it too, after the last row."""
    directions: np.ndarray
    """(T+1,D,3) world vectors that the task tells the fish, such as the commanded heading."""
    spheres: np.ndarray
    """(T+1,S,4) targets and obstacles: centres, m, and radii, body lengths; a radius of 0 where there is none."""

    @property
    def steps(self) -> int:
        """T, the number of environment steps."""
        return len(self.action)

    def save(self, path: str | Path) -> Path:
        """Write an .npz file, whole or not at all; nothing in it is pickled.

        Raises:
            ValueError: for another ending, a folder that cannot be written to, or an `about` that could not be read.
        """
        path = writable_file(path, (ENDING,))
        parts: dict[str, Any] = {"kind": KIND, "format": FORMAT, "about": write_about(self.about)}
        arrays = arrays_of(self)
        large = sum(array.nbytes for array in arrays.values()) > LARGEST  # then it is not read if it shrinks too much
        with replacing(path) as partial:
            (np.savez if large else np.savez_compressed)(partial, **parts, **arrays)
        return path


def arrays_of(recording: Recording) -> dict[str, Any]:
    """The arrays of a recording by name."""
    return {name: getattr(recording, name) for name in SHAPES}


SHAPES: dict[str, tuple[Any, ...]] = {
    "action": ("T", "A"),
    "position": ("T+1", "N", 3),
    "velocity": ("T+1", "N", 3),
    "rest_length": ("T+1", "E"),
    "time": ("T+1",),
    "failure": ("T+1",),
    "counters": ("T+1", "C"),
    "variation": (6,),
    "terms": ("T", "K"),
    "reward": ("T",),
    "terminated": ("T",),
    "directions": ("T+1", "D", 3),
    "spheres": ("T+1", "S", 4),
}
"""Shape of every array; letters stand for numbers that the arrays agree in."""

TYPES = {"failure": np.int64, "counters": np.int64, "terminated": np.bool_}
"""Types of the arrays, where it is not float64."""


def versions() -> dict[str, str]:
    """Versions that the bits of a simulation depend on: Python, packages, the layout and the sources."""
    return {
        "fish_env": fish_env.__version__,
        "sources": source_hash(),
        "layout": str(LAYOUT_VERSION),
        "python": platform.python_version(),
        **{name: version(name) for name in ("numpy", "numba", "gymnasium")},
        "machine": platform.machine(),
    }


def as_json(value: Any, name: str) -> Any:
    """`value` as JSON holds it; ValueError for what it cannot hold, such as a `Fish`, naming the keyword."""
    if isinstance(value, Mapping) and all(isinstance(key, str) for key in value):
        return {key: as_json(part, f"{name}[{key!r}]") for key, part in value.items()}
    if isinstance(value, np.ndarray | np.generic):
        return as_json(value.tolist(), name)
    if type(value) in (list, tuple):  # not a World, which is a named tuple
        return [as_json(part, f"{name}[{k}]") for k, part in enumerate(value)]
    if value is None or isinstance(value, bool | int | float | str):
        return value
    raise ValueError(
        f"{name} is a {type(value).__name__}, which a recording cannot hold; give numbers, text, or lists and dicts of "
        "them: a body by its name, the water as keywords of fish_env.make_water"
    )


def load_recording(path: str | Path) -> Recording:
    """Read a recording, for plots or to replay it.

    Raises:
        FileNotFoundError: if there is no such file.
        ValueError: if it is truncated, pickled, of another kind or format, or if its parts do not fit together.
    """
    path = Path(path)
    if not os.path.isfile(path):  # also for names that are too long
        raise FileNotFoundError(f"there is no recording {path}; give a file that Recording.save wrote")
    with Npz(path, "recording", "give a file that Recording.save wrote") as file:
        number = file.whole("format")
        if number is None or file.text("kind") != KIND:
            raise ValueError(
                f"{path} is no recording: it holds {sorted(file.parts)}; give a file that Recording.save wrote"
            )
        if number != FORMAT:
            raise ValueError(
                f"{path} has format {number}; this package reads format {FORMAT}: record the episode again, or use the "
                "version of fish_env that wrote it"
            )
        about = file.about()
        _check_about(path, about)
        parts = {name: part for name, part in file.parts.items() if name not in ("kind", "format", "about")}
        _check_shapes(path, parts, len(about["term_names"]))
        held = {name: file.read(name) for name in parts}
    _check_numbers(path, held)
    return Recording(about=about, **held)


def _check_about(path: Path, about: dict[str, Any]) -> None:
    """ValueError unless it describes an episode."""
    if set(about) != set(ABOUT):
        raise ValueError(f"{path} describes no episode: its part 'about' must be JSON with {', '.join(ABOUT)}")
    seed, interval, names = about["seed"], about["control_interval"], about["term_names"]
    types = {"env_id": str, "env_options": dict, "options": dict, "versions": dict, "term_names": list}
    bad = [name for name, kind in types.items() if not isinstance(about[name], kind)]
    bad += [] if isinstance(seed, int) and not isinstance(seed, bool) and seed >= 0 else ["seed"]
    for name, number in (("control_interval", interval), ("length", about["length"])):
        good = isinstance(number, float) and math.isfinite(number) and number > 0.0
        bad += [] if good else [name]
    for name, words in (("term_names", names), ("versions", list(about["versions"].values()) if not bad else [])):
        bad += [] if bad or all(isinstance(w, str) and w.isprintable() and len(w) <= WORD for w in words) else [name]
    if bad:
        raise ValueError(f"{path} describes no episode: {bad[0]} is {about[bad[0]]!r}; record the episode again")
    try:
        check_environment(about)
    except ValueError as error:
        raise ValueError(f"{path} describes no episode: {error}") from error


def _check_shapes(path: Path, parts: dict[str, Part], terms: int) -> None:
    """ValueError unless the arrays are those of a recording, of the right kinds and of shapes that agree."""
    if set(parts) != set(SHAPES):
        raise ValueError(f"{path} holds {sorted(parts)}; a recording holds {sorted(SHAPES)}: record the episode again")
    sizes: dict[Any, int] = {"K": terms}
    for name, shape in SHAPES.items():
        array, kind = parts[name], TYPES.get(name, np.float64)
        if array.dtype != kind or len(array.shape) != len(shape):
            raise ValueError(
                f"{path}: {name} is an array {array.shape} of {array.dtype}; a recording has {kind.__name__} ({shape})"
            )
        for axis, size in zip(shape, array.shape, strict=True):
            late = axis == "T+1"
            wanted = axis if isinstance(axis, int) else sizes.setdefault("T" if late else axis, size - late) + late
            if size != wanted:
                raise ValueError(f"{path}: {name} has shape {array.shape}, which does not fit the other arrays")


def _check_numbers(path: Path, held: dict[str, np.ndarray]) -> None:
    """ValueError unless they are finite, and failures have names."""
    for name, array in held.items():
        if not np.isfinite(array).all():
            raise ValueError(f"{path}: {name} holds numbers that are not finite; record the episode again")
    failure = held["failure"]
    if failure.size and not 0 <= failure.min() <= failure.max() < len(FAILURES):
        raise ValueError(f"{path}: failure holds numbers that name no failure; record the episode again")


def env_of(about: Mapping[str, Any]) -> gym.Env:
    """Create the environment of a recording; ValueError if it is not registered, or rejects the keywords."""
    try:
        return make_checked_env(*environment_of(about))
    except (gym.error.Error, ValueError) as error:
        raise ValueError(
            f"the recording was made in {about['env_id']} with {about['env_options']}, which cannot be made here "
            f"({error}); import the package that registers it, or use the version of fish_env that recorded it"
        ) from error
