"""Functions that kernels may use, in addition to + - * / and comparisons.

Every function here is also a plain Python function, on `plain.Vec3` and numpy arrays, so that kernels also run without
the compiler. All arithmetic is IEEE's, rounded after each operation. Nothing is reordered or contracted except by an
explicit `fma`, so results are bitwise independent of the lanes. The compilation is in `arithmetic.py` (operations part
by part) and `products.py` (all others).

The product of two vectors with `*` is that of their coordinates; `dot` and `cross` are the other products.
"""

from typing import Any

import numpy as np

from fish_env.kernels.simd import plain


def fma(a, b, c) -> Any:
    """Fused multiply-add of numbers or vectors: a * b + c, rounded once."""
    return plain.fma(a, b, c)


def dot(a, b) -> Any:
    """Scalar product of two vectors."""
    return plain.dot(a, b)


def cross(a, b) -> Any:
    """Vector product of two vectors."""
    return plain.cross(a, b)


def select(condition, a, b) -> Any:
    """Select a if the condition is true, else b, lane by lane; both are computed."""
    return plain.select(condition, a, b)


def vec3(x, y, z) -> Any:
    """Vector of three numbers."""
    return plain.Vec3(x, y, z)


def sqrt(a) -> Any:
    """Square root of a number."""
    return plain.sqrt(a)


def any_lane(condition) -> Any:
    """Return True if the condition is true for any fish."""
    return bool(np.any(condition))


def all_lanes(condition) -> Any:
    """Return True if the condition is true for every fish."""
    return bool(np.all(condition))


def exp(a) -> Any:
    """Exponential function, lane by lane."""
    return plain.exp(a)


def log(a) -> Any:
    """Natural logarithm, lane by lane."""
    return plain.log(a)


def lane(a, i) -> Any:
    """Number, or Boolean, of fish i of the block."""
    return a.parts[i] if isinstance(a, plain.Dual) else np.atleast_1d(a)[i]
