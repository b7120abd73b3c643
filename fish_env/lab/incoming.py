"""Validation of messages from a page: anyone who can reach the address can send anything."""

from numbers import Real

import numpy as np


def is_finite(value) -> bool:
    """Return True for a finite number that is not a bool."""
    return isinstance(value, Real) and not isinstance(value, bool) and bool(np.isfinite(float(value)))


def vector(value, what: str) -> np.ndarray:
    """A point or a direction of a message, (3,).

    Raises:
        ValueError: naming it, unless it is three finite numbers.
    """
    if not (isinstance(value, list | tuple | np.ndarray) and len(value) == 3 and all(map(is_finite, value))):
        raise ValueError(f"{what} is {value!r}; give three finite numbers")
    return np.array(value, dtype=float)


def usable(value, otherwise: float) -> float:
    """Return `value`, which the page reports of its camera, if it is positive and finite, else `otherwise`."""
    return float(value) if is_finite(value) and value > 0.0 else otherwise
