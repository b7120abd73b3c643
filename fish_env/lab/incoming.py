"""What a page hands over, checked where it comes in: whoever reaches the address can send anything in its place."""

from numbers import Real

import numpy as np


def is_finite(value) -> bool:
    """Whether a value is a finite number, and no truth value."""
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
    """What the page says of its own camera, or `otherwise` unless that is a positive finite number."""
    return float(value) if is_finite(value) and value > 0.0 else otherwise
