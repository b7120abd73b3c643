"""Parameters of a body that `benchmarks/calibration/fit.py` fitted."""

import json

import numpy as np

from fish_env.checks import positive_array
from fish_env.kernels.data import data


def fitted(body: str, shapes: dict[str, tuple], **given) -> list[np.ndarray]:
    """Parameters as arrays of the given shapes; None is replaced by the fitted value.

    Raises:
        ValueError: for an array of another shape, or a number that is not positive.
    """
    if any(value is None for value in given.values()):
        found = json.loads(data("fish_env.bodies", f"{body}.json").read_text())["parameters"]
        given = {name: found[name] if value is None else value for name, value in given.items()}
    return [positive_array(value, shapes[name], name) for name, value in given.items()]
