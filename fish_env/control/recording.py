"""An episode as a file: its environment, its actions, and every state, so that it can be plotted and replayed."""

import json
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
from fish_env.control.env_spec import check_environment, environment_of, make_checked_env
from fish_env.control.files import LARGEST, check_arrays, read_about, read_npz, replacing, writable_file
from fish_env.envs.layout import LAYOUT_VERSION
from fish_env.kernels.cache import source_hash
from fish_env.physics.failures import FAILURES

FORMAT = 1
"""Format of a recording's file."""

KIND = "fish_env recording"
ENDING = ".npz"

ABOUT = {
    "env_id": str, "env_options": dict, "seed": int, "options": dict, "control_interval": float, "length": float,
    "term_names": list, "versions": dict,
}  # fmt: skip
"""Parts of the description of an episode, and their types."""


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
        """Write an .npz file, whole or not at all, nothing in it pickled; ValueError for a path that cannot be."""
        path = writable_file(path, (ENDING,))
        parts: dict[str, Any] = {"kind": KIND, "format": FORMAT, "about": json.dumps(dict(self.about))}
        arrays = arrays_of(self)
        large = sum(array.nbytes for array in arrays.values()) > LARGEST  # then it is not read if it shrinks too much
        with replacing(path) as partial, partial.open("wb") as file:  # numpy adds an ending to some names
            (np.savez if large else np.savez_compressed)(file, **parts, **arrays)
        return path


def arrays_of(recording: Recording) -> dict[str, Any]:
    """The arrays of a recording by name."""
    return {name: getattr(recording, name) for name in SHAPES}


SHAPES: dict[str, tuple[Any, ...]] = {
    "action": ("steps", "A"),
    "position": ("states", "N", 3),
    "velocity": ("states", "N", 3),
    "rest_length": ("states", "E"),
    "time": ("states",),
    "failure": ("states",),
    "counters": ("states", "C"),
    "variation": (6,),
    "terms": ("steps", "K"),
    "reward": ("steps",),
    "terminated": ("steps",),
    "directions": ("states", "D", 3),
    "spheres": ("states", "S", 4),
}
"""Shape of every array; words stand for numbers that the arrays agree in, and there is one state more than steps."""

TYPES = dict.fromkeys(SHAPES, np.float64) | {"failure": np.int64, "counters": np.int64, "terminated": np.bool_}
"""Types of the arrays."""


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
    """Read a recording, for plots or to replay it; FileNotFoundError without a file, ValueError for any other."""
    path = Path(path)
    if not os.path.isfile(path):  # also for names that are too long
        raise FileNotFoundError(f"there is no recording {path}; give a file that Recording.save wrote")
    parts = read_npz(path, "recording", "give a file that Recording.save wrote")
    try:
        if str(parts.pop("kind", None)) != KIND:
            raise ValueError("it is no recording; give a file that Recording.save wrote")
        number, about = parts.pop("format", None), read_about(parts.pop("about", None))
        if not isinstance(number, int) or number != FORMAT:
            raise ValueError(
                f"it has format {number}; this package reads format {FORMAT}: record the episode again, or use the "
                "version of fish_env that wrote it"
            )
        _check_about(about)
        check_arrays(parts, SHAPES | {"terms": ("steps", len(about["term_names"]))}, TYPES)
        if len(parts["time"]) != len(parts["action"]) + 1:
            raise ValueError(f"it has {len(parts['time'])} states for {len(parts['action'])} steps")
        if not all(0 <= index < len(FAILURES) for index in parts["failure"]):
            raise ValueError("its part failure holds numbers that name no failure")
    except ValueError as error:
        raise ValueError(f"{path} cannot be used: {error}; record the episode again") from error
    return Recording(about=about, **parts)


def _check_about(about: dict[str, Any]) -> None:
    """ValueError unless it describes an episode."""
    if set(about) != set(ABOUT):
        raise ValueError(f"it describes no episode: its part 'about' must be JSON with {', '.join(ABOUT)}")
    check_environment(about)
    for name, kind in ABOUT.items():
        if type(about[name]) is not kind:
            raise ValueError(f"it describes no episode: {name} is {about[name]!r:.200}; it should be a {kind.__name__}")
    words, numbers = (*about["term_names"], *about["versions"].values()), (about["control_interval"], about["length"])
    if about["seed"] < 0 or not all(0.0 < number < math.inf for number in numbers):
        raise ValueError("it describes no episode: its seed is below zero, or an interval or a length is not positive")
    if not all(isinstance(word, str) and word.isprintable() for word in words):
        raise ValueError("it describes no episode: names of terms or versions are no printable texts")


def env_of(about: Mapping[str, Any]) -> gym.Env:
    """Create the environment of a recording; ValueError if it is not registered, or rejects the keywords."""
    try:
        return make_checked_env(*environment_of(about))
    except (gym.error.Error, ValueError) as error:
        raise ValueError(
            f"the recording was made in {about['env_id']} with {about['env_options']}, which cannot be made here "
            f"({error}); import the package that registers it, or use the version of fish_env that recorded it"
        ) from error
