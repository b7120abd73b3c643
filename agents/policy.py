"""A trained policy as plain numbers: a multilayer perceptron in a `.npz` file that numpy alone can read and run."""

import json
import zipfile
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

FORMAT = 1


@dataclass(frozen=True)
class Policy:
    """tanh layers and a linear one, from the raw observation to the mean action, clipped to [-1, 1]."""

    weights: tuple[np.ndarray, ...]
    """One (inputs, outputs) float32 matrix a layer."""
    biases: tuple[np.ndarray, ...]
    """One (outputs,) float32 vector a layer."""
    about: Mapping[str, Any]
    """env_id, env_options, and whatever else a reader should know; JSON."""

    def __call__(self, obs: np.ndarray) -> np.ndarray:
        """Actions (..., A) for observations (..., D)."""
        h = np.asarray(obs, dtype=np.float32)
        for weight, bias in zip(self.weights[:-1], self.biases[:-1], strict=True):
            h = np.tanh(h @ weight + bias)
        return np.clip(h @ self.weights[-1] + self.biases[-1], -1.0, 1.0)

    def check(self, observations, actions) -> None:
        """ValueError unless the policy is made for such observations and actions, `Box` spaces of one fish."""
        wanted, given = (self.weights[0].shape[0], self.weights[-1].shape[1]), (*observations.shape, *actions.shape)
        if wanted != given:
            raise ValueError(
                f"the policy turns {wanted[0]} numbers into {wanted[1]} actions; the environment shows {given[0]} and "
                f"takes {given[1]}: train a new one, or give the options it was trained with"
            )

    def save(self, path: Path) -> None:
        """Write the policy; nothing in the file is pickled."""
        arrays = {f"weight{k}": weight for k, weight in enumerate(self.weights)}
        arrays |= {f"bias{k}": bias for k, bias in enumerate(self.biases)}
        np.savez(path, format=FORMAT, about=json.dumps(dict(self.about)), **arrays)


def load_policy(path: str | Path, env_id: str | None = None) -> Policy:
    """Read a policy file, refusing anything that is not one.

    Args:
        path: a file that `Policy.save` wrote.
        env_id: the environment it must be for; None takes any.

    Raises:
        FileNotFoundError: if there is no such file.
        ValueError: if it is truncated, pickled, of another format or environment, or does not fit together.
    """
    path = Path(path)
    if not path.is_file():
        raise FileNotFoundError(f"there is no policy file {path}; train one with: python train.py swim")
    try:
        with np.load(path, allow_pickle=False) as file:
            held = {name: file[name] for name in file.files}
        version, about = int(held.pop("format")), json.loads(str(held.pop("about")))
        layers = sum(name.startswith("weight") for name in held)
        weights = tuple(held.pop(f"weight{k}") for k in range(layers))
        biases = tuple(held.pop(f"bias{k}") for k in range(layers))
    except (ValueError, KeyError, EOFError, OSError, zipfile.BadZipFile, AttributeError) as error:
        raise ValueError(
            f"{path} is not a policy file, or is damaged or pickled ({error}); give a policy.npz that train.py wrote"
        ) from error
    if version != FORMAT or held:
        raise ValueError(
            f"{path} has format {version} and extra parts {sorted(held)}; this program reads format {FORMAT}"
        )
    _check_layers(path, weights, biases)
    if "env_id" not in about:
        raise ValueError(f"{path} does not say which environment it is for; give a policy.npz that train.py wrote")
    if env_id is not None and about.get("env_id") != env_id:
        raise ValueError(f"{path} was trained for {about.get('env_id')}, not {env_id}; choose a policy of that task")
    return Policy(weights, biases, about)


def _check_layers(path, weights, biases) -> None:
    width = weights[0].shape[0] if weights and weights[0].ndim == 2 else None
    for k, (weight, bias) in enumerate(zip(weights, biases, strict=True)):
        if weight.ndim != 2 or bias.shape != weight.shape[1:] or weight.shape[0] != width:
            raise ValueError(f"{path}: layer {k} has shapes {weight.shape} and {bias.shape}, which do not fit together")
        if not (np.isfinite(weight).all() and np.isfinite(bias).all()):
            raise ValueError(f"{path}: layer {k} holds numbers that are not finite")
        width = weight.shape[1]
    if width is None:
        raise ValueError(f"{path} holds no layers; give a policy.npz that train.py wrote")
