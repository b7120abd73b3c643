"""Compilation of arithmetic between numbers and vectors, comparisons and masks: part by part, lane by lane."""

import operator

import llvmlite.ir as ir
import numpy as np
from numba import types
from numba.core import cgutils
from numba.core.imputils import lower_builtin
from numba.core.registry import cpu_target
from numba.core.typing.templates import signature

from fish_env.kernels.simd import dual
from fish_env.kernels.simd.functions import fma, sqrt
from fish_env.kernels.simd.types import DUAL, Mask, Num, Vec3, mask_type, number_type, parts_of, typed, whole
from fish_env.kernels.simd.warps import on_gpu

SCALARS = (types.Float, types.Integer)
OPERANDS = (Num, Vec3, *SCALARS)
ORDERED = (
    operator.add, operator.iadd, operator.sub, operator.isub, operator.mul, operator.imul, operator.truediv,
    operator.itruediv, operator.neg, operator.gt, operator.lt, operator.ge, operator.le, operator.and_,
    operator.or_, abs, operator.getitem, operator.setitem,
)  # fmt: skip
FIRST = (__name__.rpartition(".")[0], "numba.core.typing.arraydecl")
CONSTANT_VECTOR = Vec3(1, 64)  # a vector of constants is compatible with every kind, like a float


def common_lanes(kinds):
    """Lanes and bits of an operation on values of these types; None if they are incompatible."""
    typed = [kind for kind in kinds if isinstance(kind, Num | Vec3)]
    typed = [kind for kind in typed if kind != CONSTANT_VECTOR] or typed
    wide = {kind.w for kind in typed if kind.w != 1}
    if len(wide) > 1 or len({kind.bits for kind in typed}) > 1:
        return None
    return (wide.pop() if wide else 1), (typed[0].bits if typed else 64)


def result_type(kinds):
    """Type of the result of an operation part by part; None if it has no type of this package."""
    if not all(isinstance(kind, OPERANDS) for kind in kinds) or not any(isinstance(k, Num | Vec3) for k in kinds):
        return None
    lanes = common_lanes(kinds)
    if lanes is None:
        return None
    return Vec3(*lanes) if any(isinstance(kind, Vec3) for kind in kinds) else number_type(*lanes)


def by_parts(emit, emit_dual=None):
    """Make the lowering of an operation part by part: `emit(builder, *parts)` returns a part of the result."""
    # `emit_dual` does so for dual numbers; linear operations do not need it.

    def lower(context, builder, sig, args):
        target = sig.return_type
        emit_part = emit_dual if emit_dual and target.w == DUAL else emit
        parts = [parts_of(builder, value, kind, target) for value, kind in zip(args, sig.args, strict=True)]
        return whole(builder, [emit_part(builder, *each) for each in zip(*parts, strict=True)], target)

    return lower


def intrinsic(builder, name, *args):
    """Emit a call of LLVM's intrinsic of that name for the type of the arguments."""
    kind = args[0].type
    if isinstance(kind, ir.VectorType):
        suffix = f"v{kind.count}f{64 if kind.element == ir.DoubleType() else 32}"
    else:
        suffix = "f64" if kind == ir.DoubleType() else "f32"
    function = ir.FunctionType(kind, [kind] * len(args))
    return builder.call(cgutils.get_or_insert_function(builder.module, function, f"llvm.{name}.{suffix}"), args)


def emit_fma(builder, a, b, c):
    """Emit one part of `fma`."""
    return intrinsic(builder, "fma", a, b, c)


emit_fma_dual = dual.fused(emit_fma)


def register_arithmetic(function, emit, arity, allowed=lambda kinds: True, emit_dual=None):
    """Register a function, for example an operator, for this package's types, part by part."""

    @typed(function)
    def rule(*kinds):
        return result_type(kinds) if len(kinds) == arity and allowed(kinds) else None

    lower = by_parts(emit, emit_dual)
    for kinds in np.ndindex(*[len(OPERANDS)] * arity):
        chosen = [OPERANDS[k] for k in kinds]
        if Num in chosen or Vec3 in chosen:
            lower_builtin(function, *chosen)(lower)


def all_or_none_vectors(kinds):
    """Return True if the types of a sum are valid: a number cannot be added to a vector."""
    return len({isinstance(kind, Vec3) for kind in kinds}) == 1


def vector_over_number(kinds):
    """Return True if the types of a quotient are valid: nothing can be divided by a vector."""
    return not isinstance(kinds[1], Vec3)


for _plain, _inplace, _emit, _allowed, _dual in (
    (operator.add, operator.iadd, lambda builder, a, b: builder.fadd(a, b), all_or_none_vectors, None),
    (operator.sub, operator.isub, lambda builder, a, b: builder.fsub(a, b), all_or_none_vectors, None),
    (operator.mul, operator.imul, lambda builder, a, b: builder.fmul(a, b), lambda kinds: True, dual.times),
    (operator.truediv, operator.itruediv, lambda builder, a, b: builder.fdiv(a, b), vector_over_number, dual.over),
):
    register_arithmetic(_plain, _emit, 2, _allowed, _dual)
    register_arithmetic(_inplace, _emit, 2, _allowed, _dual)


def emit_sqrt(builder, a):
    """Emit one part of `sqrt`."""
    return intrinsic(builder, "sqrt", a)


def emit_negative(builder, a):
    """Emit one part of `-a`, for which compilers for GPUs have no instruction."""
    return builder.fsub(ir.Constant(a.type, -0.0), a) if on_gpu(builder) else builder.fneg(a)


def emit_absolute(builder, a):
    """Emit one part of `abs(a)`; it clears the sign bit if there is no intrinsic."""
    if not on_gpu(builder):
        return intrinsic(builder, "fabs", a)
    bits = ir.IntType(64 if a.type == ir.DoubleType() else 32)
    unsigned = builder.and_(builder.bitcast(a, bits), ir.Constant(bits, (1 << (bits.width - 1)) - 1))
    return builder.bitcast(unsigned, a.type)


def half_over(builder, number, root):
    """Emit the derivative of a square root."""
    return builder.fdiv(ir.Constant(root.type, 0.5), root)


register_arithmetic(operator.neg, emit_negative, 1)
register_arithmetic(abs, emit_absolute, 1, emit_dual=dual.absolute)
register_arithmetic(fma, emit_fma, 3, emit_dual=emit_fma_dual)
register_arithmetic(sqrt, emit_sqrt, 1, lambda kinds: isinstance(kinds[0], Num), dual.of_value(emit_sqrt, half_over))


def register_float(function, emit, arity):
    """Register a function of this package for plain floats, which are one lane of float64."""

    @typed(function)
    def rule(*kinds):
        ours = len(kinds) == arity and all(isinstance(kind, SCALARS) for kind in kinds)
        return signature(types.float64, *[types.float64] * arity) if ours else None

    lower_builtin(function, *[types.Float] * arity)(lambda context, builder, sig, args: emit(builder, *args))


register_float(fma, emit_fma, 3)
register_float(sqrt, emit_sqrt, 1)


def register_comparison(function, name):
    """Register a comparison of numbers of this package's types; it is False for NaN."""

    @typed(function)
    def rule(*kinds):
        kind = result_type(kinds) if len(kinds) == 2 else None
        return mask_type(kind.w) if isinstance(kind, Num) else None

    def lower(context, builder, sig, args):
        target = result_type(sig.args)
        a, b = (parts_of(builder, value, kind, target)[0] for value, kind in zip(args, sig.args, strict=True))
        if target.w == DUAL:
            a, b = dual.value(builder, a), dual.value(builder, b)
        return builder.fcmp_ordered(name, a, b)

    for kinds in np.ndindex(len(OPERANDS), len(OPERANDS)):
        chosen = [OPERANDS[k] for k in kinds]
        if Num in chosen:
            lower_builtin(function, *chosen)(lower)


for _operator, _name in ((operator.gt, ">"), (operator.lt, "<"), (operator.ge, ">="), (operator.le, "<=")):
    register_comparison(_operator, _name)


def register_logic(function, emit):
    """Register an operation on masks: `&`, `|` or `~`."""

    @typed(function)
    def rule(*kinds):
        return kinds[0] if all(isinstance(kind, Mask) and kind == kinds[0] for kind in kinds) else None

    for arity in (1, 2):
        lower_builtin(function, *[Mask] * arity)(lambda context, builder, sig, args: emit(builder, *args))


register_logic(operator.and_, lambda builder, a, b: builder.and_(a, b))
register_logic(operator.or_, lambda builder, a, b: builder.or_(a, b))
register_logic(operator.invert, lambda builder, a: builder.not_(a))


def prefer_own_types() -> None:
    """Make numba try the types of this package before its own, because most values in a kernel have them."""
    # Each of numba's attempts to type `a + b` as a sum of lists, sets or texts takes a fraction of a millisecond. So
    # does each attempt to type `a[i]` as anything except an element of an array.
    context = cpu_target.typing_context
    context.refresh()
    for function in ORDERED:
        kind = context.resolve_value_type(function)
        first = [each for each in kind.templates if any(base.__module__.startswith(FIRST) for base in each.__mro__)]
        kind.templates = (*first, *(each for each in kind.templates if each not in first))
