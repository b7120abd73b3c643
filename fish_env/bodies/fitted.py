"""What `benchmarks/calibration/fit.py` fitted for a body, and levels of detail."""

import json
from numbers import Integral
from pathlib import Path

import numpy as np

from fish_env.checks import positive_array


def checked_level(level, most) -> int:
    """A level of detail from 1 to `most`, or ValueError."""
    if not (isinstance(level, Integral) and not isinstance(level, bool) and 1 <= int(level) <= most):
        raise ValueError(f"level is {level!r}; give a whole number from 1 to {most}")
    return int(level)


def fitted(body: str, level: int, shapes: dict[str, tuple], **given) -> list[np.ndarray]:
    """The numbers a user gave, and in place of those that are None what was fitted; arrays of the given shapes.

    Raises:
        ValueError: for an array of another shape, or a number that is not positive.
    """
    if any(value is None for value in given.values()):
        found = json.loads(Path(__file__).with_name(f"{body}.json").read_text())["levels"][str(level)]
        given = {name: found[name] if value is None else value for name, value in given.items()}
    return [positive_array(value, shapes[name], name) for name, value in given.items()]
