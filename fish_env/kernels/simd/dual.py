"""Dual numbers: a value and its derivatives along DIRECTIONS directions, carried through every operation (exact).

A kernel called with dual positions returns dual forces: that is forward differentiation (Griewank & Walther 2008,
ch. 3), and all that exact Jacobians need. A value has the bits it has without derivatives. Comparisons look at values.

Legend: b the builder; p, q, r registers <value, derivatives>; p' the derivatives, with 0 in the place of the value.
"""

import llvmlite.ir as ir

from fish_env.kernels.simd.types import FIRST


def value(b, p):
    """The value of p."""
    return b.extract_element(p, FIRST)


def with_value(b, p, number):
    """Register p with a number in the place of its value."""
    return b.insert_element(p, number, FIRST)


def slopes(b, p):
    """P'."""
    return with_value(b, p, ir.Constant(p.type.element, 0.0))


def everywhere(b, number, like):
    """A number in every place of a register."""
    nothing = ir.Constant(like.type, ir.Undefined)
    places = ir.Constant(ir.VectorType(ir.IntType(32), like.type.count), [0] * like.type.count)
    return b.shuffle_vector(with_value(b, nothing, number), nothing, places)


def of_value(function, slope):
    """How a function of one number is emitted: function(b, number), and slope(b, number, result), its derivative."""

    def emit(b, p):
        number = value(b, p)
        found = function(b, number)
        return with_value(b, b.fmul(slopes(b, p), everywhere(b, slope(b, number, found), p)), found)

    return emit


def absolute(b, p):
    """|p|."""
    negative = b.fcmp_ordered("<", value(b, p), ir.Constant(p.type.element, 0.0))
    return b.select(negative, b.fneg(p), p)


def fused(multiply_add):
    """How p q + r is emitted, with `multiply_add(b, p, q, r)` of registers: (p q0 + r) + p0 q'."""

    def emit(b, p, q, r):
        by_p = multiply_add(b, p, everywhere(b, value(b, q), q), r)
        by_q = b.fmul(everywhere(b, value(b, p), p), slopes(b, q))
        return with_value(b, b.fadd(by_p, by_q), value(b, by_p))

    return emit


def times(b, p, q):
    """P q."""
    by_p = b.fmul(p, everywhere(b, value(b, q), q))
    by_q = b.fmul(everywhere(b, value(b, p), p), slopes(b, q))
    return with_value(b, b.fadd(by_p, by_q), value(b, by_p))


def over(b, p, q):
    """P / q."""
    below = everywhere(b, value(b, q), q)
    found = b.fdiv(p, below)
    by_q = b.fmul(everywhere(b, value(b, found), q), b.fdiv(slopes(b, q), below))
    return with_value(b, b.fsub(found, by_q), value(b, found))
