"""What kernels may write besides + - * / and comparisons: the functions of this file.

Every function here is also a plain Python function, on `plain.Vec3` and numpy arrays, so that kernels run with the
compiler switched off. All arithmetic is IEEE's, rounded operation by operation: nothing is reordered or contracted but
by an explicit `fma`, so that a fish has the same bits whatever the lanes. How they are compiled is in `arithmetic.py`
(what is taken part by part) and `products.py` (the rest).

Vectors times vectors are taken coordinate by coordinate; `dot` and `cross` are the other products.
"""

from typing import Any

import numpy as np

from fish_env.kernels.simd import plain


def fma(a, b, c) -> Any:
    """A * b + c, rounded once; of numbers and vectors."""
    return plain.fma(a, b, c)


def dot(a, b) -> Any:
    """Scalar product of two vectors."""
    return plain.dot(a, b)


def cross(a, b) -> Any:
    """Vector product of two vectors."""
    return plain.cross(a, b)


def select(condition, a, b) -> Any:
    """A where the condition holds, else b; both are worked out."""
    return plain.select(condition, a, b)


def vec3(x, y, z) -> Any:
    """The vector of three numbers."""
    return plain.Vec3(x, y, z)


def sqrt(a) -> Any:
    """Square root of a number."""
    return plain.sqrt(a)


def any_lane(condition) -> Any:
    """Whether the condition holds for any fish."""
    return bool(np.any(condition))


def all_lanes(condition) -> Any:
    """Whether the condition holds for every fish."""
    return bool(np.all(condition))


def exp(a) -> Any:
    """The exponential function, lane by lane."""
    return plain.exp(a)


def log(a) -> Any:
    """The natural logarithm, lane by lane."""
    return plain.log(a)


def lane(a, i) -> Any:
    """The number, or the truth value, of fish i of the block."""
    return a.parts[i] if isinstance(a, plain.Dual) else np.atleast_1d(a)[i]
