"""Functions that kernels may use, in addition to + - * / and comparisons.

Every function here is a plain Python function, on `plain.Vec3` and numpy arrays, so that kernels also run without the
compiler. All compiled arithmetic is IEEE's, rounded after each operation. Nothing is reordered or contracted except by
an explicit `fma`, so results are bitwise independent of the lanes. The compilation is in `arithmetic.py` (operations
part by part) and `products.py` (all others).

The product of two vectors with `*` is that of their coordinates; `dot` and `cross` are the other products.
"""

from typing import Any

import numpy as np

from fish_env.kernels.simd.plain import Dual, Vec3


def fma(a, b, c) -> Any:
    """Fused multiply-add of numbers or vectors: a * b + c, rounded once; without the compiler, rounded twice."""
    return (b * a if isinstance(b, Vec3) else a * b) + c


def dot(a, b) -> Any:
    """Scalar product of two vectors."""
    return a.x * b.x + a.y * b.y + a.z * b.z


def cross(a, b) -> Any:
    """Vector product of two vectors."""
    return Vec3(a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x)


def select(condition, a, b) -> Any:
    """Select a if the condition is true, else b, lane by lane; both are computed."""
    if any(isinstance(getattr(each, "x", each), Dual) for each in (a, b)):
        return a if condition else b
    if isinstance(a, Vec3):
        return Vec3(*(np.where(condition, p, q) for p, q in zip(a, b, strict=True)))
    return np.where(condition, a, b)


def vec3(x, y, z) -> Any:
    """Vector of three numbers."""
    return Vec3(x, y, z)


def sqrt(a) -> Any:
    """Square root of a number."""
    return a.of_value(np.sqrt, lambda number, root: 0.5 / root) if isinstance(a, Dual) else np.sqrt(a)


def any_lane(condition) -> Any:
    """Return True if the condition is true for any fish."""
    return bool(np.any(condition))


def all_lanes(condition) -> Any:
    """Return True if the condition is true for every fish."""
    return bool(np.all(condition))


def exp(a) -> Any:
    """Exponential function, lane by lane."""
    return a.of_value(np.exp, lambda number, result: result) if isinstance(a, Dual) else np.exp(a)


def log(a) -> Any:
    """Natural logarithm, lane by lane."""
    with np.errstate(all="ignore"):
        return a.of_value(np.log, lambda number, result: 1.0 / number) if isinstance(a, Dual) else np.log(a)


def lane(a, i) -> Any:
    """Number, or Boolean, of fish i of the block."""
    return a.parts[i] if isinstance(a, Dual) else np.atleast_1d(a)[i]
