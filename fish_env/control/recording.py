"""An episode as a file: what it was made of, its actions, and every state, so that it can be plotted and replayed."""

import json
import math
import platform
from collections.abc import Mapping
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np

import fish_env
from fish_env._cache import source_hash
from fish_env.control.files import DAMAGED, replacing, writable_file
from fish_env.envs import FishEnv
from fish_env.envs.layout import LAYOUT_VERSION

FORMAT = 1
"""Format of a recording's file."""

KIND = "fish_env recording"
ABOUT = ("env_id", "env_options", "seed", "options", "control_interval", "length", "term_names", "versions")
ENDING = ".npz"


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
    """(T+1,) index into `fish_env.failures.FAILURES`, 0 while the simulation is valid."""
    counters: np.ndarray
    """(T+1,C) what the simulation has cost since the reset, the names of `Tank.counters`."""
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
        """T, how many environment steps it holds."""
        return len(self.action)

    def save(self, path: str | Path) -> Path:
        """Write an .npz file, whole or not at all; nothing in it is pickled.

        Raises:
            ValueError: for another ending, or a folder that cannot be written to.
        """
        path = writable_file(path, (ENDING,))
        parts: dict[str, Any] = {"kind": KIND, "format": FORMAT, "about": json.dumps(dict(self.about))}
        with replacing(path) as partial:
            np.savez_compressed(partial, **parts, **arrays_of(self))
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

WHOLE, TRUTHS = ("failure", "counters"), ("terminated",)


def versions() -> dict[str, str]:
    """What the bits of a simulation depend on: versions of Python, of packages and of the layout, and the sources."""
    found = {name: version(name) for name in ("numpy", "numba", "gymnasium")}
    return {
        "fish_env": fish_env.__version__,
        "sources": source_hash(),
        "layout": str(LAYOUT_VERSION),
        "python": platform.python_version(),
        **found,
        "machine": platform.machine(),
    }


def plain(value: Any, name: str) -> Any:
    """`value` as JSON holds it: dicts, lists, text, numbers, truth values and None.

    Raises:
        ValueError: for anything else, such as a `Fish` or a `World`, naming the keyword.
    """
    if isinstance(value, Mapping) and all(isinstance(key, str) for key in value):
        return {key: plain(part, f"{name}[{key!r}]") for key, part in value.items()}
    if isinstance(value, np.ndarray | np.generic):
        return plain(value.tolist(), name)
    if type(value) in (list, tuple):  # not a World, which is a named tuple
        return [plain(part, f"{name}[{k}]") for k, part in enumerate(value)]
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
    if not path.is_file():
        raise FileNotFoundError(f"there is no recording {path}; give a file that Recording.save wrote")
    try:
        with path.open("rb") as opened, np.load(opened, allow_pickle=False) as file:
            held = {name: file[name] for name in file.files}
    except DAMAGED as error:
        raise ValueError(
            f"{path} is damaged, pickled or no recording ({error}); give a file that Recording.save wrote"
        ) from error
    kind, number = str(held.pop("kind", "")), held.pop("format", None)
    if kind != KIND or number is None:
        raise ValueError(f"{path} is no recording: it holds {sorted(held)}; give a file that Recording.save wrote")
    if number.shape != () or number != FORMAT:
        raise ValueError(
            f"{path} has format {number}; this package reads format {FORMAT}: record the episode again, or use the "
            "version of fish_env that wrote it"
        )
    about = _about(path, held.pop("about", None))
    _check_arrays(path, held, about)
    return Recording(about=about, **held)


def _about(path: Path, text: Any) -> dict[str, Any]:
    """The description of the episode, or ValueError."""
    try:
        about = json.loads(str(text))
    except ValueError:
        about = None
    if not isinstance(about, dict) or set(about) != set(ABOUT):
        raise ValueError(f"{path} describes no episode: its part 'about' must be JSON with {', '.join(ABOUT)}")
    seed, interval, names = about["seed"], about["control_interval"], about["term_names"]
    types = {"env_id": str, "env_options": dict, "options": dict, "versions": dict, "term_names": list}
    bad = [name for name, kind in types.items() if not isinstance(about[name], kind)]
    bad += [] if isinstance(seed, int) and not isinstance(seed, bool) and seed >= 0 else ["seed"]
    for name, number in (("control_interval", interval), ("length", about["length"])):
        good = isinstance(number, float) and math.isfinite(number) and number > 0.0
        bad += [] if good else [name]
    bad += [] if all(isinstance(name, str) for name in names) else ["term_names"]
    if bad:
        raise ValueError(f"{path} describes no episode: {bad[0]} is {about[bad[0]]!r}; record the episode again")
    return about


def _check_arrays(path: Path, held: dict[str, np.ndarray], about: dict[str, Any]) -> None:
    """ValueError unless the arrays are those of a recording, of the right kinds, finite and of shapes that agree."""
    if set(held) != set(SHAPES):
        raise ValueError(f"{path} holds {sorted(held)}; a recording holds {sorted(SHAPES)}: record the episode again")
    sizes: dict[Any, int] = {"K": len(about["term_names"])}
    for name, shape in SHAPES.items():
        array, kind = held[name], np.int64 if name in WHOLE else bool if name in TRUTHS else np.float64
        if array.dtype != kind or array.ndim != len(shape):
            raise ValueError(
                f"{path}: {name} is an array {array.shape} of {array.dtype}; a recording has {kind.__name__} ({shape})"
            )
        for axis, size in zip(shape, array.shape, strict=True):
            late = axis == "T+1"
            wanted = axis if isinstance(axis, int) else sizes.setdefault("T" if late else axis, size - late) + late
            if size != wanted:
                raise ValueError(f"{path}: {name} has shape {array.shape}, which does not fit the other arrays")
        if not np.isfinite(array).all():
            raise ValueError(f"{path}: {name} holds numbers that are not finite; record the episode again")


def env_of(about: Mapping[str, Any]) -> gym.Env:
    """The environment that a recording was made in.

    Raises:
        ValueError: if it is not registered, refuses the keywords, or is not one of fish.
    """
    try:
        env = gym.make(about["env_id"], disable_env_checker=True, **about["env_options"])
        if isinstance(env.unwrapped, FishEnv):
            return env
        env.close()
        raise ValueError("it is not an environment of fish")
    except (gym.error.Error, ValueError, TypeError, ImportError) as error:
        raise ValueError(
            f"the recording was made in {about['env_id']} with {about['env_options']}, which cannot be made here "
            f"({error}); import the package that registers it, or use the version of fish_env that recorded it"
        ) from error
