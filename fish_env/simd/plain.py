"""Numbers and vectors without the compiler: numpy arrays of W lanes, and vectors of three of them.

Slow and obvious; it is what kernels work on under NUMBA_DISABLE_JIT=1, for debugging and to measure coverage. `fma`
rounds twice here, so results agree with the compiled ones to rounding, not to the bit.
"""

import numpy as np


class Vec3:
    """Three numbers: floats, or arrays (W,)."""

    __slots__ = ("x", "y", "z")
    __array_ufunc__ = None  # numpy's numbers leave the arithmetic to this class

    def __init__(self, x, y, z):
        self.x, self.y, self.z = x, y, z

    def __iter__(self):
        return iter((self.x, self.y, self.z))

    def __repr__(self):
        return f"Vec3({self.x}, {self.y}, {self.z})"

    def __add__(self, other):
        return Vec3(self.x + other.x, self.y + other.y, self.z + other.z)

    def __sub__(self, other):
        return Vec3(self.x - other.x, self.y - other.y, self.z - other.z)

    def __neg__(self):
        return Vec3(-self.x, -self.y, -self.z)

    def __abs__(self):
        return Vec3(abs(self.x), abs(self.y), abs(self.z))

    def __mul__(self, other):
        other = other if isinstance(other, Vec3) else Vec3(other, other, other)
        return Vec3(self.x * other.x, self.y * other.y, self.z * other.z)

    __rmul__ = __mul__

    def __truediv__(self, number):
        return Vec3(self.x / number, self.y / number, self.z / number)


def fma(a, b, c):
    """A * b + c."""
    product = b * a if isinstance(b, Vec3) else a * b
    return product + c


def dot(a, b):
    """Scalar product."""
    return a.x * b.x + a.y * b.y + a.z * b.z


def cross(a, b):
    """Vector product."""
    return Vec3(a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x)


def select(condition, a, b):
    """A where the condition holds, else b."""
    if isinstance(a, Vec3):
        return Vec3(*(np.where(condition, p, q) for p, q in zip(a, b, strict=True)))
    return np.where(condition, a, b)
