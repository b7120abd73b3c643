"""Parameters of bodies, read from the files beside this one that `benchmarks/calibration` writes."""

import json

import numpy as np

from fish_env.checks import positive_array
from fish_env.kernels.data import data

SHAPES = {"bending": (5,), "pull": (3,), "shear": (), "drag": (6,), "damping": ()}


def read_calibration(body: str) -> dict:
    """Contents of a body's file: its "parameters", and how they were found."""
    return json.loads(data("fish_env.bodies", f"{body}.json").read_text())


def fitted_parameters(body: str, *given) -> list[np.ndarray]:
    """Parameters as arrays, in the order and of the shapes of SHAPES; None is replaced by the fitted value.

    Raises:
        ValueError: for an array of another shape, or a number that is not positive.
    """
    found = read_calibration(body)["parameters"]
    return [
        positive_array(found[name] if value is None else value, shape, name)
        for (name, shape), value in zip(SHAPES.items(), given, strict=True)
    ]
