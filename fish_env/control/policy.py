"""A trained policy as plain numbers: a multilayer perceptron in a `.npz` file that numpy alone can read and run."""

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from gymnasium.spaces import Box

from fish_env._data import data
from fish_env.checks import as_floats
from fish_env.control.files import DAMAGED, replacing
from fish_env.envs.layout import LAYOUT_VERSION

FORMAT = 2
"""Format of a policy file. Format 1 lacked the version of the observation layout."""

PRETRAINED = data("fish_env.control", "pretrained")
"""Folder of the shipped policies: <task>/policy.npz, with the settings of its training in <task>/config.json."""


@dataclass(frozen=True)
class Policy:
    """Layers with tanh and a linear one, from the raw observation to the mean action, clipped to [-1, 1]."""

    weights: tuple[np.ndarray, ...]
    """One (inputs, outputs) float32 matrix a layer."""
    biases: tuple[np.ndarray, ...]
    """One (outputs,) float32 vector a layer."""
    about: Mapping[str, Any]
    """env_id, env_options, and whatever else a reader should know; JSON."""
    layout_version: int = LAYOUT_VERSION
    """Version of the observation layout that it was trained with."""

    def __call__(self, obs: np.ndarray) -> np.ndarray:
        """Actions (..., A) for observations (..., D); ValueError for what are no real numbers, such as text."""
        if type(obs) is not np.ndarray or obs.dtype.kind not in "fiub":
            try:
                obs = as_floats(obs)
            except (TypeError, OverflowError, RecursionError) as error:
                raise ValueError(f"the observation is {obs!r} ({error}); give real numbers") from error
        h = np.array(obs, np.float32, order="C")  # in another order products are rounded otherwise
        for weight, bias in zip(self.weights[:-1], self.biases[:-1], strict=True):
            h = np.tanh(h @ weight + bias)
        return np.clip(h @ self.weights[-1] + self.biases[-1], -1.0, 1.0)

    def check(self, observations: Box, actions: Box) -> None:
        """ValueError unless the policy is made for such observations and actions, the spaces of one fish."""
        wanted, given = (self.weights[0].shape[0], self.weights[-1].shape[1]), (*observations.shape, *actions.shape)
        if wanted != given:
            raise ValueError(
                f"the policy turns {wanted[0]} numbers into {wanted[1]} actions; the environment shows {given[0]} and "
                f"takes {given[1]}: train a new policy, or give the options that it was trained with"
            )

    def save(self, path: str | Path) -> None:
        """Write the policy, whole or not at all; nothing in the file is pickled."""
        parts: dict[str, Any] = {"format": FORMAT, "layout": self.layout_version, "about": json.dumps(dict(self.about))}
        parts |= {f"weight{k}": weight for k, weight in enumerate(self.weights)}
        parts |= {f"bias{k}": bias for k, bias in enumerate(self.biases)}
        with replacing(Path(path)) as partial:
            np.savez(partial, **parts)


def shipped_policies() -> dict[str, Path]:
    """The policy files that come with the package, by the name of what they were trained for."""
    found = {folder.name: folder / "policy.npz" for folder in PRETRAINED.iterdir()}
    return {name: path for name, path in sorted(found.items()) if path.is_file()}


def shipped_policy(task: str) -> Path:
    """The policy file that comes with the package for a task: `load_policy(shipped_policy("turn"))`.

    Raises:
        ValueError: if there is none, naming those that there are.
    """
    found = shipped_policies()
    if task not in found:
        raise ValueError(f"no policy is shipped for {task!r}; choose from {', '.join(found)}, or give a policy file")
    return found[task]


def load_policy(path: str | Path, env_id: str | None = None) -> Policy:
    """Read a policy file.

    Args:
        path: a `.npz` file that `Policy.save` wrote.
        env_id: the environment that it must have been trained for; None for any.

    Raises:
        FileNotFoundError: if there is no such file.
        ValueError: if it is truncated, pickled, of another format, observation layout or environment, or if its layers
            do not fit together.
    """
    path = Path(path) if isinstance(path, str) else path  # one in a zip archive is no Path
    if not path.is_file():
        shipped = ", ".join(shipped_policies())
        raise FileNotFoundError(
            f"there is no policy file {path}; give a policy.npz that train.py wrote, or one of those that are shipped "
            f"(fish_env.control.shipped_policy: {shipped})"
        )
    try:
        with path.open("rb") as opened, np.load(opened, allow_pickle=False) as file:
            held = {name: file[name] for name in file.files}
        version, layout = int(held.pop("format")), int(held.pop("layout", 0))
        about = json.loads(str(held.pop("about")))
        layers = sum(name.startswith("weight") for name in held)
        weights = tuple(held.pop(f"weight{k}") for k in range(layers))
        biases = tuple(held.pop(f"bias{k}") for k in range(layers))
        if not isinstance(about, dict):
            raise TypeError(f"about is {about!r}, not a dictionary")
    except (*DAMAGED, KeyError, OverflowError) as error:
        raise ValueError(
            f"{path} is not a policy file, or is damaged or pickled ({error}); give a policy.npz that train.py wrote"
        ) from error
    if version != FORMAT or held:
        raise ValueError(
            f"{path} has format {version} and extra parts {sorted(held)}; this package reads format {FORMAT}: train "
            "the policy again, or use the version of fish_env that wrote it"
        )
    _check_layout(path, layout)
    _check_layers(path, weights, biases)
    _check_environment(path, about, env_id)
    return Policy(weights, biases, about, layout)


def _check_layout(path: Path, layout: int) -> None:
    if layout != LAYOUT_VERSION:
        raise ValueError(
            f"{path} was trained with version {layout} of the observation layout; this package has version "
            f"{LAYOUT_VERSION} (fish_env.envs.LAYOUT_VERSION): train the policy again, or use the version of fish_env "
            "that it was trained with"
        )


def _check_layers(path: Path, weights: tuple[np.ndarray, ...], biases: tuple[np.ndarray, ...]) -> None:
    width = weights[0].shape[0] if weights and weights[0].ndim == 2 else None
    for k, (weight, bias) in enumerate(zip(weights, biases, strict=True)):
        if weight.dtype.kind != "f" or bias.dtype.kind != "f":
            raise ValueError(f"{path}: layer {k} is of {weight.dtype} and {bias.dtype}; give floating-point numbers")
        if weight.ndim != 2 or bias.shape != weight.shape[1:] or weight.shape[0] != width:
            raise ValueError(f"{path}: layer {k} has shapes {weight.shape} and {bias.shape}, which do not fit together")
        if not (np.isfinite(weight).all() and np.isfinite(bias).all()):
            raise ValueError(f"{path}: layer {k} holds numbers that are not finite")
        width = weight.shape[1]
    if width is None:
        raise ValueError(f"{path} holds no layers; give a policy.npz that train.py wrote")


def _check_environment(path: Path, about: Mapping[str, Any], env_id: str | None) -> None:
    if "env_id" not in about:
        raise ValueError(f"{path} does not say which environment it is for; give a policy.npz that train.py wrote")
    if env_id is not None and about["env_id"] != env_id:
        raise ValueError(f"{path} was trained for {about['env_id']}, not {env_id}; choose a policy of that environment")
