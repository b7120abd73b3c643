"""Dual numbers: a value and its derivatives along DIRECTIONS directions, exact in every operation.

A kernel called with dual positions returns dual forces: that is forward differentiation (Griewank & Walther 2008,
ch. 3), which suffices for exact Jacobians. Values have the same bits as without derivatives. Comparisons use values.

Legend: b the builder; p, q, r registers <value, derivatives>; p' the derivatives, with 0 in the place of the value.
"""

import llvmlite.ir as ir

from fish_env.kernels.simd.types import FIRST


def value(b, p):
    """Emit the value of p."""
    return b.extract_element(p, FIRST)


def with_value(b, p, number):
    """Emit p with another number as its value."""
    return b.insert_element(p, number, FIRST)


def slopes(b, p):
    """Emit p', the derivatives of p."""
    return with_value(b, p, ir.Constant(p.type.element, 0.0))


def everywhere(b, number, like):
    """Emit a register with a number in every element."""
    nothing = ir.Constant(like.type, ir.Undefined)
    places = ir.Constant(ir.VectorType(ir.IntType(32), like.type.count), [0] * like.type.count)
    return b.shuffle_vector(with_value(b, nothing, number), nothing, places)


def of_value(function, slope):
    """Make the emitter of a function of one number from function(b, number) and its slope(b, number, result)."""

    def emit(b, p):
        number = value(b, p)
        found = function(b, number)
        return with_value(b, b.fmul(slopes(b, p), everywhere(b, slope(b, number, found), p)), found)

    return emit


def absolute(b, p):
    """Emit the absolute value of p."""
    negative = b.fcmp_ordered("<", value(b, p), ir.Constant(p.type.element, 0.0))
    return b.select(negative, b.fneg(p), p)


def fused(multiply_add):
    """Make the emitter of p q + r, with `multiply_add(b, p, q, r)` of registers: (p q0 + r) + p0 q'."""

    def emit(b, p, q, r):
        by_p = multiply_add(b, p, everywhere(b, value(b, q), q), r)
        by_q = b.fmul(everywhere(b, value(b, p), p), slopes(b, q))
        return with_value(b, b.fadd(by_p, by_q), value(b, by_p))

    return emit


def times(b, p, q):
    """Emit the product of p and q."""
    by_p = b.fmul(p, everywhere(b, value(b, q), q))
    by_q = b.fmul(everywhere(b, value(b, p), p), slopes(b, q))
    return with_value(b, b.fadd(by_p, by_q), value(b, by_p))


def over(b, p, q):
    """Emit the quotient of p and q."""
    below = everywhere(b, value(b, q), q)
    found = b.fdiv(p, below)
    by_q = b.fmul(everywhere(b, value(b, found), q), b.fdiv(slopes(b, q), below))
    return with_value(b, b.fsub(found, by_q), value(b, found))
