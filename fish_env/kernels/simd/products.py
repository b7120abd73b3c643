"""Compilation of selections, products of vectors, coordinates, and operations on single lanes."""

import math

import llvmlite.ir as ir
import numpy as np
from numba import types
from numba.core.imputils import lower_builtin, lower_getattr
from numba.core.typing.templates import AttributeTemplate, infer_getattr, signature

from fish_env.kernels.simd import dual
from fish_env.kernels.simd.arithmetic import (
    OPERANDS,
    SCALARS,
    all_or_none_vectors,
    common_lanes,
    emit_fma,
    emit_fma_dual,
    emit_negative,
    result_type,
)
from fish_env.kernels.simd.functions import all_lanes, any_lane, cross, dot, exp, lane, log, select, vec3
from fish_env.kernels.simd.types import (
    DUAL,
    XYZ,
    Mask,
    Num,
    Vec3,
    bits_of,
    coordinates,
    number_type,
    parts_of,
    typed,
    whole,
)


@typed(select)
def _type_of_select(condition, a, b):
    """Type of `select` of a mask, or of a Boolean, and two numbers or two vectors."""
    if isinstance(condition, types.Boolean):
        return result_type((a, b)) or types.float64
    if not isinstance(condition, Mask) or not all_or_none_vectors((a, b)):
        return None
    lanes = common_lanes((a, b, Num(condition.w, getattr(a, "bits", bits_of(b)))))
    if lanes is None:
        return None
    return Vec3(*lanes) if isinstance(a, Vec3) else number_type(*lanes)


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
    """Register a product of two vectors, whose type is `of(lanes, bits)`."""

    def add(lower):
        @typed(function)
        def rule(*kinds):
            lanes = common_lanes(kinds) if all(isinstance(kind, Vec3) for kind in kinds) else None
            return None if lanes is None else of(*lanes)

        lower_builtin(function, Vec3, Vec3)(lower)
        return lower

    return add


@register_product(dot, number_type)
def _dot(context, builder, sig, args):
    target = Vec3(*common_lanes(sig.args))
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
        return emit_fma(builder, a, b, emit_negative(builder, builder.fmul(c, d)))

    if target.w != XYZ:
        turns = [((k + 1) % 3, (k + 2) % 3) for k in range(3)]
        return whole(builder, [minor(p[i], q[j], p[j], q[i]) for i, j in turns], target)
    order = ir.Constant(ir.VectorType(ir.IntType(32), 4), [1, 2, 0, 3])

    def turned(v):
        return builder.shuffle_vector(v, v, order)

    return turned(minor(p[0], turned(q[0]), turned(p[0]), q[0]))


@typed(vec3)
def _type_of_vec3(*kinds):
    """Type of `vec3` of three numbers, with the lanes of any of them; one lane for plain floats."""
    if any(isinstance(kind, Vec3) for kind in kinds) or not all(isinstance(kind, OPERANDS) for kind in kinds):
        return None
    return Vec3(*common_lanes(kinds))


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
    """Type of `v.x`, `v.y` and `v.z`: numbers."""

    key = Vec3

    def generic_resolve(self, kind, name):
        return number_type(kind.w, kind.bits) if name in ("x", "y", "z") else None


for _k, _name in enumerate("xyz"):

    @lower_getattr(Vec3, _name)
    def _coordinate(context, builder, kind, value, k=_k):
        return coordinates(builder, value, kind)[k]


def register_reduction(function, combine):
    """Register a reduction of a mask: true in any lane, or in all lanes."""
    typed(function)(lambda kind: types.boolean if isinstance(kind, Mask | types.Boolean) else None)

    def lower(context, builder, sig, args):
        bits = ir.IntType(sig.args[0].w)
        return combine(builder, builder.bitcast(args[0], bits), bits)

    lower_builtin(function, Mask)(lower)
    lower_builtin(function, types.Boolean)(lambda context, builder, sig, args: args[0])


register_reduction(any_lane, lambda builder, value, bits: builder.icmp_unsigned("!=", value, ir.Constant(bits, 0)))
register_reduction(all_lanes, lambda builder, value, bits: builder.icmp_unsigned("==", value, ir.Constant(bits, -1)))


def register_by_lane(function, scalar_function, slope):
    """Register a function of the C library, lane by lane: the same bits for every number of lanes."""
    # `slope(builder, number, result)` emits its derivative.
    typed(function)(lambda kind: kind if isinstance(kind, Num) else signature(types.float64, types.float64))

    def lower(context, builder, sig, args):
        kind = sig.args[0]
        one = types.float32 if bits_of(kind) == 32 else types.float64
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


@typed(lane)
def _type_of_lane(kind, index):
    """Type of `lane`: a float, or a Boolean."""
    if isinstance(kind, Mask | types.Boolean):
        return types.boolean
    return types.float64 if bits_of(kind) == 64 else types.float32


def _lane(context, builder, sig, args):
    value = args[0]
    if isinstance(value.type, ir.VectorType):
        value = builder.extract_element(value, args[1])
    return context.cast(builder, value, types.boolean, types.boolean) if sig.return_type is types.boolean else value


for _kind in (Num, Mask, types.Float, types.Boolean):
    lower_builtin(lane, _kind, types.Integer)(_lane)
