"""A trained policy as plain numbers: a multilayer perceptron in a `.npz` file that numpy alone can read and run."""

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from gymnasium.spaces import Box

from fish_env.checks import as_floats, check_names, similar
from fish_env.control.env_spec import check_environment
from fish_env.control.exchange import onnx_model, read_onnx, write_onnx, write_torchscript
from fish_env.control.files import check_arrays, read_about, read_npz, replacing, writable_file
from fish_env.envs.layout import LAYOUT_VERSION
from fish_env.kernels.data import data

FORMAT = 3
"""Format of a policy file. Format 2, which is read too, had tanh layers and clipped actions only."""

PRETRAINED = data("fish_env.control", "pretrained")
"""Folder of the shipped policies: <task>/policy.npz, with the settings of its training in <task>/config.json."""

HIDDEN = {"tanh": np.tanh, "relu": lambda h: np.maximum(h, 0.0)}
"""Activations of the hidden layers."""
OUTPUT = {"clip": lambda action: np.clip(action, -1.0, 1.0), "tanh": np.tanh}
"""What brings the last layer's numbers into [-1, 1]."""


class Normalisation(NamedTuple):
    """Normalisation of observations as in `VecNormalize`: (obs - mean) / deviation, clipped to [-limit, limit]."""

    mean: np.ndarray
    """(D,) float64."""
    deviation: np.ndarray
    """(D,) float64, above zero."""
    limit: float
    """Above zero; it may be infinite."""

    def __call__(self, obs: np.ndarray) -> np.ndarray:
        """Normalised observations (..., D)."""
        return np.clip((obs - self.mean) / self.deviation, -self.limit, self.limit)


@dataclass(frozen=True)
class Policy:
    """Layers from the raw observation to the model's deterministic action, in [-1, 1]."""

    weights: tuple[np.ndarray, ...]
    """One (inputs, outputs) float32 matrix a layer."""
    biases: tuple[np.ndarray, ...]
    """One (outputs,) float32 vector a layer."""
    about: Mapping[str, Any]
    """env_id, env_options, and whatever else a reader should know; JSON."""
    layout_version: int = LAYOUT_VERSION
    """Version of the observation layout that it was trained with."""
    hidden: str = "tanh"
    """Activation of all layers but the last: "tanh" or "relu"."""
    output: str = "clip"
    """How actions get into [-1, 1]: "clip" or "tanh"."""
    normalisation: Normalisation | None = None
    """Of the observations before the first layer; None where the first layer takes them as they are."""

    def __post_init__(self):
        for name, allowed in (("hidden", HIDDEN), ("output", OUTPUT)):
            check_names(f"{name} is", allowed, getattr(self, name))
        for name in ("weights", "biases"):
            object.__setattr__(self, name, tuple(np.asarray(each, np.float32) for each in getattr(self, name)))

    def __call__(self, obs: np.ndarray) -> np.ndarray:
        """Actions (..., A) for observations (..., D); ValueError for other shapes, and for text."""
        if type(obs) is not np.ndarray or obs.dtype.kind not in "fiub":
            try:
                obs = as_floats(obs)
            except (TypeError, OverflowError, RecursionError) as error:
                raise ValueError(f"the observation is {obs!r} ({error}); give real numbers") from error
        if obs.shape[-1:] != self.weights[0].shape[:1]:
            raise ValueError(f"the observation has shape {obs.shape}; give (..., {self.weights[0].shape[0]})")
        if self.normalisation is not None:
            obs = self.normalisation(obs)
        h = np.array(obs, np.float32, order="C")[..., None, :]  # one by one: in batches products are rounded otherwise
        for weight, bias in zip(self.weights[:-1], self.biases[:-1], strict=True):
            h = HIDDEN[self.hidden](h @ weight + bias)
        return OUTPUT[self.output](h @ self.weights[-1] + self.biases[-1])[..., 0, :]

    def check(self, observations: Box, actions: Box) -> None:
        """ValueError unless the policy is made for such observations and actions, the spaces of one fish."""
        wanted, given = (self.weights[0].shape[0], self.weights[-1].shape[1]), (*observations.shape, *actions.shape)
        if wanted != given:
            raise ValueError(
                f"the policy turns {wanted[0]} numbers into {wanted[1]} actions; the environment returns {given[0]} "
                f"and takes {given[1]}: train a new policy, or give the options that it was trained with"
            )

    def save(self, path: str | Path) -> None:
        """Write the policy, whole or not at all; nothing in the file is pickled.

        An `env_id` such as "module:Name-v0" loses its module: no file can have one imported. ValueError for another
        ending than `.npz`, and for what `load_policy` would refuse.
        """
        parts = self.parts()
        _policy_of(parts, None)  # now, as the model is still there
        with replacing(writable_file(path, (".npz",))) as partial, partial.open("wb") as file:  # it keeps any name
            np.savez(file, **parts)

    def to_onnx(self, path: str | Path) -> None:
        """Write an `.onnx` model from `observation` (B,D) to `action` (B,A), float32; `load_policy` reads it again.

        ImportError without onnx, of the extra [onnx]; ValueError for another ending.
        """
        write_onnx(self.parts(), writable_file(path, (".onnx",)))

    def to_torchscript(self, path: str | Path) -> None:
        """Write a TorchScript module from observations (B,D) to actions (B,A), float32, for `torch.jit.load`.

        ImportError without torch, of the extra [train]; ValueError for another ending than `.pt`.
        """
        write_torchscript(self.parts(), writable_file(path, (".pt",)))

    def parts(self) -> dict[str, Any]:
        """All that its file holds, by name: texts, whole numbers and arrays."""
        about = dict(self.about)
        if isinstance(about.get("env_id"), str):
            about["env_id"] = about["env_id"].rpartition(":")[2]
        parts: dict[str, Any] = {"format": FORMAT, "layout": self.layout_version, "about": json.dumps(about)}
        parts |= {"hidden": self.hidden, "output": self.output}
        parts |= {f"weight{k}": weight for k, weight in enumerate(self.weights)}
        parts |= {f"bias{k}": bias for k, bias in enumerate(self.biases)}
        scaled = self.normalisation
        return parts if scaled is None else parts | scaled._asdict() | {"limit": float(scaled.limit)}


def shipped_policies() -> dict[str, Path]:
    """The policy files that come with the package, by the name of what they were trained for."""
    found = {folder.name: folder / "policy.npz" for folder in PRETRAINED.iterdir()}
    return {name: path for name, path in sorted(found.items()) if path.is_file()}


def shipped_policy(task: str) -> Path:
    """The policy file that comes with the package for a task, such as "turn"; ValueError names those there are."""
    found = shipped_policies()
    check_names("no policy is shipped for", found, task)
    return found[task]


def load_policy(path: str | Path, env_id: str | None = None) -> Policy:
    """Read a policy file.

    Args:
        path: the name of a shipped policy, such as "swim"; a `.npz` file that `Policy.save` wrote; or an `.onnx` file
            that `Policy.to_onnx` wrote, for which the extra [onnx] is needed.
        env_id: the environment that it must have been trained for; None for any.

    Raises:
        FileNotFoundError: if there is no such file.
        ImportError: for an `.onnx` file without onnx.
        ValueError: if it is truncated, pickled, of another format, observation layout or environment, or if its layers
            do not fit together.
    """
    if isinstance(path, str):  # one in a zip archive is no Path
        path = shipped_policies().get(path, Path(path))
    if path.name.lower().endswith(".zip"):
        raise ValueError(f"{path} is a Stable-Baselines3 model: load it and pass it, or give what export_policy makes")
    try:
        found = path.is_file()
    except OSError:  # of a name that is too long
        found = False
    if not found:
        shipped = shipped_policies()
        raise FileNotFoundError(
            f"there is no policy file {path}{similar(str(path), shipped)}; give the policy.npz of a training, or "
            f"one of those that are shipped: {', '.join(shipped)}"
        )
    parts, graph = (
        read_onnx(path)
        if path.name.lower().endswith(".onnx")
        else (read_npz(path, "policy file", "give the policy.npz of a training"), None)
    )
    try:
        policy = _policy_of(parts, env_id)
        if graph is not None and onnx_model(policy.parts()).graph != graph:
            raise ValueError("its graph is another one than Policy.to_onnx writes")
    except ValueError as error:
        raise ValueError(f"{path} cannot be used: {error}; give the policy.npz of a training") from error
    return policy


def _policy_of(parts: dict[str, Any], env_id: str | None) -> Policy:
    """The policy of these parts of a file, which are checked."""
    version, layout = parts.get("format"), parts.get("layout")
    if not isinstance(version, int) or version not in (2, FORMAT):
        raise ValueError(
            f"it has format {version} and not 2 or {FORMAT}; train the policy again, or use the version of fish_env "
            "that wrote it"
        )
    if not isinstance(layout, int) or layout != LAYOUT_VERSION:
        raise ValueError(
            f"it was trained with version {layout} of the observation layout; this package has version "
            f"{LAYOUT_VERSION} (fish_env.envs.LAYOUT_VERSION): train the policy again, or use the version of fish_env "
            "that it was trained with"
        )
    texts: dict[str, Any] = {name: str(parts.get(name)) for name in ("hidden", "output")} if version == FORMAT else {}
    layers = sum(name.startswith("weight") for name in parts)
    shapes: dict[str, tuple] = {f"weight{k}": (f"width {k}", f"width {k + 1}") for k in range(layers)}
    shapes |= {f"bias{k}": (f"width {k + 1}",) for k in range(layers)}
    if scaled := version == FORMAT and "mean" in parts:
        shapes |= {"mean": ("width 0",), "deviation": ("width 0",)}
    apart = {"format", "layout", "about", *texts, *(["limit"] if scaled else [])}
    check_arrays({name: part for name, part in parts.items() if name not in apart}, shapes, {})
    if not layers:
        raise ValueError("it holds no layers")
    about = read_about(parts.get("about"))
    if "env_id" not in about:
        raise ValueError("it does not say which environment it is for")
    check_environment(about)
    if env_id is not None and about["env_id"] != env_id:
        raise ValueError(f"it was trained for {about['env_id']}, not {env_id}; choose a policy of that environment")
    weights, biases = (tuple(parts[f"{kind}{k}"] for k in range(layers)) for kind in ("weight", "bias"))
    scaling = Normalisation(parts["mean"], parts["deviation"], parts.get("limit", np.nan)) if scaled else None
    if scaling and not (isinstance(scaling.limit, float) and scaling.limit > 0.0 and (scaling.deviation > 0.0).all()):
        raise ValueError("the normalisation has no limit above zero, or deviations of zero or less")
    return Policy(weights, biases, about, normalisation=scaling, **texts)
