"""Numbers and vectors without the compiler: numpy arrays of W lanes, and vectors of three of them.

This slow reference implementation serves kernels under NUMBA_DISABLE_JIT=1, for debugging and to measure coverage.
Functions of them are in `functions.py`.
"""

import operator

import numpy as np


class Dual:
    """Value and derivatives, an array (1 + D,), as in `fish_env.kernels.simd.dual`."""

    __slots__ = ("parts",)
    __array_ufunc__ = None  # numpy's numbers leave the arithmetic to this class

    def __init__(self, parts):
        self.parts = parts

    def __neg__(self):
        return Dual(-self.parts)

    def __abs__(self):
        return -self if self < 0.0 else self

    def __add__(self, other):
        return Dual(self.parts + parts(other, self))

    __radd__ = __add__

    def __sub__(self, other):
        return Dual(self.parts - parts(other, self))

    def __rsub__(self, other):
        return -self + other

    def __mul__(self, other):
        if isinstance(other, Vec3):
            return other * self
        other = parts(other, self)
        product = self.parts * other[0] + self.parts[0] * other
        product[0] = self.parts[0] * other[0]
        return Dual(product)

    __rmul__ = __mul__

    def __truediv__(self, other):
        other = parts(other, self)
        with np.errstate(all="ignore"):
            quotient = self.parts / other[0]
            found = quotient - quotient[0] * (other / other[0])
        found[0] = quotient[0]
        return Dual(found)

    def __rtruediv__(self, other):
        return Dual(parts(other, self)) / self

    def of_value(self, function, slope):
        """Apply a function of the value, whose derivative is slope(value, result)."""
        number = self.parts[0]
        with np.errstate(all="ignore"):
            result = function(number)
            found = slope(number, result) * self.parts
        found[0] = result
        return Dual(found)


def comparison(compare):
    """Make a method of `Dual` that compares values."""
    return lambda self, other: bool(compare(self.parts[0], parts(other, self)[0]))


for _compare in (operator.lt, operator.gt, operator.le, operator.ge):
    setattr(Dual, f"__{_compare.__name__}__", comparison(_compare))


def parts(number, like: Dual):
    """Value and derivatives of a number, dual or not."""
    if isinstance(number, Dual):
        return number.parts
    found = np.zeros_like(like.parts)
    found[0] = number
    return found


def read(row, lanes):
    """Read a number per fish from its floats in memory."""
    if lanes == "dual":
        return Dual(row.copy())
    return row[0] if len(row) == 1 else row.copy()


def write(memory, place, number, lanes):
    """Write a number to a place in memory; one without derivatives is a constant."""
    if lanes == "dual":
        memory[place] = parts(number, Dual(memory[place]))
    else:
        memory[place] = number


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
