"""Numba types of numbers, masks and 3-vectors, and their layout in registers and in memory.

A *kind* is the number of fish that a kernel processes at once, and its precision. `lanes` is "xyz" for one fish whose
3-vectors fill a SIMD register with their coordinates, or W for W fish side by side, a coordinate of all of them in a
register. One lane in float64 is numba's own float64. "dual" is one fish of dual numbers, with derivatives along some
directions, also in a register (`fish_env.kernels.simd.dual`). "thread" is one fish, like one lane, whose memory is
interleaved with that of the other fish of its warp (`fish_env.kernels.simd.warps`).

Legend: w lanes of a type ("xyz", "dual" or a whole number), bits 64 or 32, parts the LLVM values that make up one
value.
"""

import llvmlite.ir as ir
from numba import types
from numba.core import cgutils
from numba.core.typeconv import Conversion
from numba.core.typing.templates import AbstractTemplate, Signature, infer_global, signature
from numba.extending import lower_cast, models, register_model

XYZ, DUAL, THREAD = "xyz", "dual", "thread"
DIRECTIONS = 7  # number of derivatives of a dual number: with its value, they fill one or two registers
WARP = 32  # number of threads of a GPU that run in step: values that they load at once should be adjacent


class Num(types.Type):
    """One number per fish: W lanes, one lane in float32, or dual. A plain number becomes the same for every fish."""

    def __init__(self, w, bits):
        self.w, self.bits = w, bits
        super().__init__(name=f"Num({w},{bits})")

    def can_convert_from(self, typingctx, other):
        return Conversion.unsafe if isinstance(other, types.Float | types.Integer) else None


class Mask(types.Type):
    """One Boolean per fish, W lanes with W > 1."""

    def __init__(self, w):
        self.w = w
        super().__init__(name=f"Mask({w})")


class Vec3(types.Type):
    """One 3-vector per fish. A vector of a single lane becomes the same for every fish."""

    def __init__(self, w, bits):
        self.w, self.bits = w, bits
        super().__init__(name=f"Vec3({w},{bits})")

    def can_convert_from(self, typingctx, other):
        loose = isinstance(other, Vec3) and other.w == 1 and other.bits in (64, self.bits)
        return Conversion.unsafe if loose else None


def typed(*functions):
    """Make a decorator that registers `rule(*types)` for the result types of calls of these functions."""
    # The rule receives the arguments' types. It returns the type of the result, or a whole signature if the arguments
    # are converted, or None if the call is not one of this package's.

    def register(rule):
        class Template(AbstractTemplate):
            def generic(self, args, kws):
                kind = None if kws else rule(*args)
                return kind if kind is None or isinstance(kind, Signature) else signature(kind, *args)

        for function in functions:
            infer_global(function)(Template)
        return rule

    return register


def bits_of(kind) -> int:
    """Bits of a number of this type, or of a coordinate; 64 for numba's own."""
    return getattr(kind, "bits", 64)


FIRST = ir.Constant(ir.IntType(32), 0)


def scalar(bits):
    """Floating-point type of LLVM with this number of bits."""
    return ir.DoubleType() if bits == 64 else ir.FloatType()


def width(w) -> int:
    """Number of fish of a type with these lanes."""
    return 1 if w in (XYZ, DUAL, THREAD) else w


def floats_in(w) -> int:
    """Number of floats of a number with these lanes."""
    return 1 + DIRECTIONS if w == DUAL else width(w)


def floats_apart(w) -> int:
    """Stride of a number with these lanes, in floats of memory, including interleaved ones of other fish."""
    return WARP if w == THREAD else floats_in(w)


def number_llvm(w, bits):
    """Layout of a number in registers."""
    return scalar(bits) if floats_in(w) == 1 else ir.VectorType(scalar(bits), floats_in(w))


def number_type(w, bits):
    """Numba type of a number of this kind."""
    if w == DUAL:
        return Num(DUAL, bits)
    return types.float64 if (width(w), bits) == (1, 64) else Num(width(w), bits)


def mask_type(w):
    """Numba type of a comparison of numbers of this kind."""
    return types.boolean if width(w) == 1 else Mask(w)


def vector_llvm(w, bits):
    """Layout of a 3-vector in registers: one register of x, y, z and an unused number, or one per coordinate."""
    return ir.VectorType(scalar(bits), 4) if w == XYZ else ir.ArrayType(number_llvm(w, bits), 3)


@register_model(Num)
class NumModel(models.PrimitiveModel):
    """Data model of a number: a float or a vector of them; memory must be aligned to one number only."""

    def __init__(self, dmm, fe_type):
        super().__init__(dmm, fe_type, number_llvm(fe_type.w, fe_type.bits))

    def load_from_data_pointer(self, builder, ptr, align=None):
        return builder.load(ptr, align=self._fe_type.bits // 8)


@register_model(Mask)
class MaskModel(models.PrimitiveModel):
    """Data model of a mask: a vector of bits."""

    def __init__(self, dmm, fe_type):
        super().__init__(dmm, fe_type, ir.VectorType(ir.IntType(1), fe_type.w))


@register_model(Vec3)
class Vec3Model(models.PrimitiveModel):
    """Data model of a 3-vector: three numbers, or one register of four."""

    def __init__(self, dmm, fe_type):
        super().__init__(dmm, fe_type, vector_llvm(fe_type.w, fe_type.bits))

    def load_from_data_pointer(self, builder, ptr, align=None):
        align = self._fe_type.bits // 8
        if self._fe_type.w == XYZ:
            return builder.load(ptr, align=align)
        value = ir.Constant(self.get_value_type(), ir.Undefined)
        for k in range(3):  # three loads: LLVM would split one load of the whole too late
            part = builder.load(cgutils.gep_inbounds(builder, ptr, 0, k), align=align)
            value = builder.insert_value(value, part, k)
        return value


@lower_cast(types.Float, Num)
@lower_cast(types.Integer, Num)
@lower_cast(Vec3, Vec3)
def _cast(context, builder, kind, target, value):
    return whole(builder, parts_of(builder, value, kind, target), target)


def broadcast(builder, value, count, bits):
    """Emit a scalar in each of `count` lanes, or dual; an integer or another precision is converted first."""
    if isinstance(value.type, ir.IntType):
        value = builder.sitofp(value, ir.DoubleType())
    if value.type != scalar(bits):
        value = builder.fptrunc(value, scalar(bits)) if bits == 32 else builder.fpext(value, scalar(bits))
    if count == 1:
        return value
    if count == DUAL:
        return builder.insert_element(ir.Constant(number_llvm(DUAL, bits), None), value, FIRST)
    vector = ir.VectorType(scalar(bits), count)
    if isinstance(value, ir.Constant):
        return ir.Constant(vector, [value.constant] * count)
    nothing = ir.Constant(vector, ir.Undefined)
    first = builder.insert_element(nothing, value, FIRST)
    return builder.shuffle_vector(first, nothing, ir.Constant(ir.VectorType(ir.IntType(32), count), [0] * count))


def parts_of(builder, value, kind, target):
    """Emit the parts of `value`, of the numba type `kind`, with the lanes of `target`."""
    # A number becomes every part of a vector; a single lane becomes every lane.
    if isinstance(kind, Vec3):
        if kind.w == XYZ:
            return [value]
        parts = [builder.extract_value(value, k) for k in range(3)]
        if kind.w == 1 and kind.bits != target.bits:
            parts = [broadcast(builder, part, 1, target.bits) for part in parts]
        if target.w == XYZ:
            register = ir.Constant(vector_llvm(XYZ, target.bits), ir.Undefined)
            for k in range(3):
                register = builder.insert_element(register, parts[k], ir.Constant(ir.IntType(32), k))
            return [register]
        if kind.w == target.w:
            return parts
        return [broadcast(builder, part, target.w, target.bits) for part in parts]
    several = isinstance(target, Vec3) and target.w != XYZ
    if isinstance(kind, Num) and kind.w != 1:
        one = value
    else:
        lanes = 4 if isinstance(target, Vec3) and target.w == XYZ else target.w
        one = broadcast(builder, value, lanes, target.bits)
    return [one] * (3 if several else 1)


def whole(builder, parts, kind):
    """Emit the value of the numba type `kind` with these parts."""
    if len(parts) == 1:
        return parts[0]
    value = ir.Constant(vector_llvm(kind.w, kind.bits), ir.Undefined)
    for k in range(3):
        value = builder.insert_value(value, parts[k], k)
    return value


def coordinates(builder, value, kind):
    """Emit the three coordinates of a vector, numbers of its kind."""
    if kind.w != XYZ:
        return [builder.extract_value(value, k) for k in range(3)]
    return [builder.extract_element(value, ir.Constant(ir.IntType(32), k)) for k in range(3)]
