"""What kernels may write: + - * / between numbers and vectors, comparisons, and the functions of this file.

Every function here is also a plain Python function, on `plain.Vec3` and numpy arrays, so that kernels run with the
compiler switched off. All arithmetic is IEEE's, rounded operation by operation: nothing is reordered or contracted but
by an explicit `fma`, so that a fish has the same bits whatever the lanes.

Vectors times vectors are taken coordinate by coordinate; `dot` and `cross` are the other products.
"""

import math
import operator

import llvmlite.ir as ir
import numpy as np
from numba import types
from numba.core import cgutils
from numba.core.imputils import lower_builtin, lower_getattr
from numba.core.registry import cpu_target
from numba.core.typing.templates import AbstractTemplate, AttributeTemplate, infer_getattr, infer_global, signature

from fish_env.simd import dual, plain
from fish_env.simd.types import (
    DUAL,
    XYZ,
    Mask,
    Num,
    Vec3,
    coordinates,
    mask_type,
    number_type,
    parts_of,
    whole,
)

SCALARS = (types.Float, types.Integer)
OPERANDS = (Num, Vec3, *SCALARS)
ORDERED = (
    operator.add, operator.iadd, operator.sub, operator.isub, operator.mul, operator.imul, operator.truediv,
    operator.itruediv, operator.neg, operator.gt, operator.lt, operator.ge, operator.le, operator.and_,
    operator.or_, abs,
)  # fmt: skip
LOOSE = Vec3(1, 64)  # a vector of constants goes with every kind, as a float does


def fma(a, b, c):
    """A * b + c, rounded once; of numbers and vectors."""
    return plain.fma(a, b, c)


def dot(a, b):
    """Scalar product of two vectors."""
    return plain.dot(a, b)


def cross(a, b):
    """Vector product of two vectors."""
    return plain.cross(a, b)


def select(condition, a, b):
    """A where the condition holds, else b; both are worked out."""
    return plain.select(condition, a, b)


def vec3(x, y, z):
    """The vector of three numbers."""
    return plain.Vec3(x, y, z)


def sqrt(a):
    """Square root of a number."""
    return plain.sqrt(a)


def any_lane(condition):
    """Whether the condition holds for any fish."""
    return bool(np.any(condition))


def all_lanes(condition):
    """Whether the condition holds for every fish."""
    return bool(np.all(condition))


def exp(a):
    """The exponential function, lane by lane."""
    return plain.exp(a)


def log(a):
    """The natural logarithm, lane by lane."""
    return plain.log(a)


def lane(a, i):
    """The number, or the truth value, of fish i of the block."""
    return a.parts[i] if isinstance(a, plain.Dual) else np.atleast_1d(a)[i]


def common(kinds):
    """(lanes, bits) of an operation on values of these types; None if they do not go together."""
    typed = [kind for kind in kinds if isinstance(kind, Num | Vec3)]
    typed = [kind for kind in typed if kind != LOOSE] or typed
    wide = {kind.w for kind in typed if kind.w != 1}
    if len(wide) > 1 or len({kind.bits for kind in typed}) > 1:
        return None
    return (wide.pop() if wide else 1), (typed[0].bits if typed else 64)


def result(kinds):
    """The type of an operation taken part by part; None if it is none of ours."""
    if not all(isinstance(kind, OPERANDS) for kind in kinds) or not any(isinstance(k, Num | Vec3) for k in kinds):
        return None
    lanes = common(kinds)
    if lanes is None:
        return None
    return Vec3(*lanes) if any(isinstance(kind, Vec3) for kind in kinds) else number_type(*lanes)


def by_parts(emit, emit_dual=None):
    """Lowering of an operation that is taken part by part: `emit(builder, *parts)` gives a part of the result.

    `emit_dual` does so where the parts are dual numbers; what is linear needs none.
    """

    def lower(context, builder, sig, args):
        target = sig.return_type
        emit_part = emit_dual if emit_dual and target.w == DUAL else emit
        parts = [parts_of(builder, value, kind, target) for value, kind in zip(args, sig.args, strict=True)]
        return whole(builder, [emit_part(builder, *each) for each in zip(*parts, strict=True)], target)

    return lower


def intrinsic(builder, name, *args):
    """Call LLVM's intrinsic of that name for the type of the arguments."""
    kind = args[0].type
    if isinstance(kind, ir.VectorType):
        suffix = f"v{kind.count}f{64 if kind.element == ir.DoubleType() else 32}"
    else:
        suffix = "f64" if kind == ir.DoubleType() else "f32"
    function = ir.FunctionType(kind, [kind] * len(args))
    return builder.call(cgutils.get_or_insert_function(builder.module, function, f"llvm.{name}.{suffix}"), args)


def emit_fma(builder, a, b, c):
    """One part of `fma`."""
    return intrinsic(builder, "fma", a, b, c)


emit_fma_dual = dual.fused(emit_fma)


def register_arithmetic(function, emit, arity, allowed=lambda kinds: True, emit_dual=None):
    """Let kernels call a function, an operator for example, on our types, part by part."""

    class Template(AbstractTemplate):
        def generic(self, args, kws):
            if len(args) == arity and not kws and allowed(args):
                kind = result(args)
                return kind and signature(kind, *args)
            return None

    infer_global(function)(Template)
    lower = by_parts(emit, emit_dual)
    for kinds in np.ndindex(*[len(OPERANDS)] * arity):
        chosen = [OPERANDS[k] for k in kinds]
        if Num in chosen or Vec3 in chosen:
            lower_builtin(function, *chosen)(lower)


def all_or_none_vectors(kinds):
    """Of a sum: a number is not added to a vector."""
    return len({isinstance(kind, Vec3) for kind in kinds}) == 1


def vector_over_number(kinds):
    """Of a quotient: nothing is divided by a vector."""
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
    """One part of `sqrt`."""
    return intrinsic(builder, "sqrt", a)


def half_over(builder, number, root):
    """The derivative of a square root."""
    return builder.fdiv(ir.Constant(root.type, 0.5), root)


register_arithmetic(operator.neg, lambda builder, a: builder.fneg(a), 1)
register_arithmetic(abs, lambda builder, a: intrinsic(builder, "fabs", a), 1, emit_dual=dual.absolute)
register_arithmetic(fma, emit_fma, 3, emit_dual=emit_fma_dual)
register_arithmetic(sqrt, emit_sqrt, 1, lambda kinds: isinstance(kinds[0], Num), dual.of_value(emit_sqrt, half_over))


def register_float(function, emit, arity):
    """Let kernels call a function of ours on plain floats, which are one lane of float64."""

    class Template(AbstractTemplate):
        def generic(self, args, kws):
            if len(args) == arity and all(isinstance(kind, SCALARS) for kind in args):
                return signature(types.float64, *[types.float64] * arity)
            return None

    infer_global(function)(Template)
    lower_builtin(function, *[types.Float] * arity)(lambda context, builder, sig, args: emit(builder, *args))


register_float(fma, emit_fma, 3)
register_float(sqrt, emit_sqrt, 1)


def register_comparison(function, name):
    """Let kernels compare numbers of our types; not a number compares false."""

    class Template(AbstractTemplate):
        def generic(self, args, kws):
            kind = result(args) if len(args) == 2 else None
            return signature(mask_type(kind.w), *args) if isinstance(kind, Num) else None

    infer_global(function)(Template)

    def lower(context, builder, sig, args):
        target = result(sig.args)
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
    """Let kernels combine masks by `&`, `|` and `~`."""

    class Template(AbstractTemplate):
        def generic(self, args, kws):
            masks = all(isinstance(kind, Mask) and kind == args[0] for kind in args)
            return signature(args[0], *args) if masks else None

    infer_global(function)(Template)
    for arity in (1, 2):
        lower_builtin(function, *[Mask] * arity)(lambda context, builder, sig, args: emit(builder, *args))


register_logic(operator.and_, lambda builder, a, b: builder.and_(a, b))
register_logic(operator.or_, lambda builder, a, b: builder.or_(a, b))
register_logic(operator.invert, lambda builder, a: builder.not_(a))


@infer_global(select)
class Select(AbstractTemplate):
    """Of a mask, or of a truth value, and two numbers or two vectors."""

    def generic(self, args, kws):
        condition, a, b = args
        if not isinstance(condition, Mask | types.Boolean):
            return None
        if isinstance(condition, Mask):
            lanes = common((a, b, Num(condition.w, getattr(a, "bits", getattr(b, "bits", 64)))))
            if lanes is None or not all_or_none_vectors((a, b)):
                return None
            return signature(Vec3(*lanes) if isinstance(a, Vec3) else number_type(*lanes), *args)
        kind = result((a, b))
        return signature(kind or types.float64, *args)


def _select(context, builder, sig, args):
    target = sig.return_type
    if isinstance(target, Num | Vec3):
        a, b = (parts_of(builder, args[i], sig.args[i], target) for i in (1, 2))
        return whole(builder, [builder.select(args[0], p, q) for p, q in zip(a, b, strict=True)], target)
    return builder.select(args[0], *(context.cast(builder, args[i], sig.args[i], target) for i in (1, 2)))


for _condition in (Mask, types.Boolean):
    for _a in OPERANDS:
        for _b in OPERANDS:
            lower_builtin(select, _condition, _a, _b)(_select)


def register_product(function, of):
    """A product of two vectors, whose type is `of(lanes, bits)`."""

    def add(lower):
        class Template(AbstractTemplate):
            def generic(self, args, kws):
                lanes = common(args) if all(isinstance(kind, Vec3) for kind in args) else None
                return lanes and signature(of(*lanes), *args)

        infer_global(function)(Template)
        lower_builtin(function, Vec3, Vec3)(lower)
        return lower

    return add


@register_product(dot, number_type)
def _dot(context, builder, sig, args):
    target = Vec3(*common(sig.args))
    p, q = (
        coordinates(builder, whole(builder, parts_of(builder, value, kind, target), target), target)
        for value, kind in zip(args, sig.args, strict=True)
    )
    if target.w == DUAL:
        first, add = dual.times(builder, p[0], q[0]), emit_fma_dual
    else:
        first, add = builder.fmul(p[0], q[0]), emit_fma
    return add(builder, p[2], q[2], add(builder, p[1], q[1], first))


@register_product(cross, Vec3)
def _cross(context, builder, sig, args):
    target = sig.return_type
    p, q = (parts_of(builder, value, kind, target) for value, kind in zip(args, sig.args, strict=True))

    def minor(a, b, c, d):  # a b - c d
        if target.w == DUAL:
            return emit_fma_dual(builder, a, b, builder.fneg(dual.times(builder, c, d)))
        return emit_fma(builder, a, b, builder.fneg(builder.fmul(c, d)))

    if target.w != XYZ:
        turns = [((k + 1) % 3, (k + 2) % 3) for k in range(3)]
        return whole(builder, [minor(p[i], q[j], p[j], q[i]) for i, j in turns], target)
    order = ir.Constant(ir.VectorType(ir.IntType(32), 4), [1, 2, 0, 3])

    def turned(v):
        return builder.shuffle_vector(v, v, order)

    return turned(minor(p[0], turned(q[0]), turned(p[0]), q[0]))


@infer_global(vec3)
class MakeVec3(AbstractTemplate):
    """Of three numbers, at least one of which has lanes; of plain floats, one lane."""

    def generic(self, args, kws):
        if any(isinstance(kind, Vec3) for kind in args) or not all(isinstance(kind, OPERANDS) for kind in args):
            return None
        return signature(Vec3(*common(args)), *args)


def _vec3(context, builder, sig, args):
    target = number_type(sig.return_type.w, sig.return_type.bits)
    if not isinstance(target, Num):
        return whole(builder, [context.cast(builder, a, k, target) for a, k in zip(args, sig.args, strict=True)],
                     sig.return_type)  # fmt: skip
    parts = [parts_of(builder, a, kind, target)[0] for a, kind in zip(args, sig.args, strict=True)]
    return whole(builder, parts, sig.return_type)


for _kinds in np.ndindex(3, 3, 3):
    lower_builtin(vec3, *[(Num, *SCALARS)[k] for k in _kinds])(_vec3)


@infer_getattr
class Vec3Attributes(AttributeTemplate):
    """`v.x`, `v.y` and `v.z`: numbers."""

    key = Vec3

    def generic_resolve(self, kind, name):
        return number_type(kind.w, kind.bits) if name in ("x", "y", "z") else None


for _k, _name in enumerate("xyz"):

    @lower_getattr(Vec3, _name)
    def _coordinate(context, builder, kind, value, k=_k):
        return coordinates(builder, value, kind)[k]


def register_reduction(function, combine):
    """Whether a mask holds anywhere, or everywhere."""

    class Template(AbstractTemplate):
        def generic(self, args, kws):
            return signature(types.boolean, *args) if isinstance(args[0], Mask | types.Boolean) else None

    infer_global(function)(Template)

    def lower(context, builder, sig, args):
        bits = ir.IntType(sig.args[0].w)
        return combine(builder, builder.bitcast(args[0], bits), bits)

    lower_builtin(function, Mask)(lower)
    lower_builtin(function, types.Boolean)(lambda context, builder, sig, args: args[0])


register_reduction(any_lane, lambda builder, value, bits: builder.icmp_unsigned("!=", value, ir.Constant(bits, 0)))
register_reduction(all_lanes, lambda builder, value, bits: builder.icmp_unsigned("==", value, ir.Constant(bits, -1)))


def register_by_lane(function, scalar_function, slope):
    """A function of the C library, taken lane by lane: the same bits for every number of lanes.

    `slope(builder, number, result)` emits its derivative.
    """

    class Template(AbstractTemplate):
        def generic(self, args, kws):
            ours = isinstance(args[0], Num)
            return signature(args[0], args[0]) if ours else signature(types.float64, types.float64)

    infer_global(function)(Template)

    def lower(context, builder, sig, args):
        kind = sig.args[0]
        one = types.float32 if getattr(kind, "bits", 64) == 32 else types.float64
        call = context.get_function(scalar_function, signature(one, one))
        if not isinstance(kind, Num) or kind.w == 1:
            return call(builder, args)
        if kind.w == DUAL:
            return dual.of_value(lambda builder, number: call(builder, [number]), slope)(builder, args[0])
        value = args[0]
        for k in range(kind.w):
            place = ir.Constant(ir.IntType(32), k)
            value = builder.insert_element(value, call(builder, [builder.extract_element(value, place)]), place)
        return value

    lower_builtin(function, Num)(lower)
    lower_builtin(function, types.Float)(lower)


register_by_lane(exp, math.exp, lambda builder, number, result: result)
register_by_lane(log, math.log, lambda builder, number, result: builder.fdiv(ir.Constant(number.type, 1.0), number))


@infer_global(lane)
class LaneOf(AbstractTemplate):
    """A float, or a truth value."""

    def generic(self, args, kws):
        kind = args[0]
        if isinstance(kind, Mask | types.Boolean):
            return signature(types.boolean, *args)
        bits = getattr(kind, "bits", 64)
        return signature(types.float64 if bits == 64 else types.float32, *args)


def _lane(context, builder, sig, args):
    value = args[0]
    if isinstance(value.type, ir.VectorType):
        value = builder.extract_element(value, args[1])
    return context.cast(builder, value, types.boolean, types.boolean) if sig.return_type is types.boolean else value


for _kind in (Num, Mask, types.Float, types.Boolean):
    lower_builtin(lane, _kind, types.Integer)(_lane)


def come_first() -> None:
    """Have numba try the types of this package before its own: of all that a kernel is made of, most are ours.

    Each of numba's attempts to read `a + b` as a sum of lists, sets or texts takes a fraction of a millisecond.
    """
    context = cpu_target.typing_context
    context.refresh()
    for function in ORDERED:
        kind = context.resolve_value_type(function)
        ours = [each for each in kind.templates if any(base.__module__ == __name__ for base in each.__mro__)]
        kind.templates = (*ours, *(each for each in kind.templates if each not in ours))
