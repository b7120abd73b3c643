"""Properties of an array of numbers or vectors in kernels: its floats, its zero, its number of fish per element."""

from typing import Any

import llvmlite.ir as ir
import numpy as np
from numba import types
from numba.core import cgutils
from numba.core.imputils import impl_ret_borrowed, lower_builtin

from fish_env.kernels.simd.kinds import Numbers, Vectors
from fish_env.kernels.simd.packs import WORD, array_at
from fish_env.kernels.simd.types import (
    DIRECTIONS,
    DUAL,
    WARP,
    XYZ,
    Vec3,
    bits_of,
    floats_apart,
    floats_in,
    mask_type,
    typed,
    width,
)
from fish_env.kernels.simd.warps import ThreadArray, word


def floats(array) -> Any:
    """Memory of vectors (n,3 or 4,w) or of numbers (n,w), as plain floats."""
    n = array.shape[0]
    if isinstance(array, np.ndarray):
        return array.reshape(n, 1)
    w, apart = floats_in(array.kind.lanes), floats_apart(array.kind.lanes)
    return array.memory.reshape((n, -1, apart) if isinstance(array, Vectors) else (n, apart))[..., :w]


def zero(array) -> Any:
    """Zero of the type of an array's elements."""
    if isinstance(array, Vectors):
        return array[0] * 0.0
    return 0.0 * array[0]


def nowhere(array):
    """False for every fish of a block."""
    w = block_size(array)
    return np.zeros(w, dtype=bool) if w > 1 else False


def block_size(array):
    """Number of fish per element of the array."""
    return array.kind.width if isinstance(array, Numbers | Vectors) else 1


def directions(array):
    """Number of derivatives of the numbers in the array: 0 except for dual numbers."""
    return DIRECTIONS if isinstance(array, Numbers | Vectors) and array.kind.lanes == DUAL else 0


def epsilon(array):
    """Distance from 1 to the next number in the precision of an array's elements."""
    return float(np.finfo((array if isinstance(array, np.ndarray) else array.memory).dtype).eps)


@typed(floats)
def _type_of_floats(array):
    """Type of `floats` of a one-dimensional array."""
    mine = isinstance(array, ThreadArray)
    axes = 3 if isinstance(array.dtype, Vec3) else 2
    return types.Array(
        types.float64 if bits_of(array.dtype) == 64 else types.float32, axes, "A" if mine else "C", aligned=mine
    )


@lower_builtin(floats, types.Array)
def _floats(context, builder, sig, args):
    source = context.make_array(sig.args[0])(context, builder, args[0])
    kind = sig.args[0].dtype
    lanes = floats_in(lanes_of(sig.args[0]))
    tail = ([4 if kind.w == XYZ else 3] if isinstance(kind, Vec3) else []) + [lanes]
    shape = [cgutils.unpack_tuple(builder, source.shape, 1)[0], *(ir.Constant(WORD, length) for length in tail)]
    out = array_at(context, builder, sig.return_type, builder.ptrtoint(source.data, WORD), shape)
    if isinstance(sig.args[0], ThreadArray):
        item = sig.args[0].item
        strides = [word(length * item) for length in ((3 * WARP, WARP, 1) if len(tail) == 2 else (WARP, 1))]
        place = context.data_model_manager[sig.return_type].get_field_position("strides")
        for axis, stride in enumerate(strides):
            out = builder.insert_value(out, stride, [place, axis])
    return impl_ret_borrowed(context, builder, sig.return_type, out)


@lower_builtin(zero, types.Array)
@lower_builtin(nowhere, types.Array)
def _zero(context, builder, sig, args):
    return ir.Constant(context.get_value_type(sig.return_type), None)


@lower_builtin(directions, types.Array)
def _directions(context, builder, sig, args):
    return ir.Constant(WORD, DIRECTIONS if lanes_of(sig.args[0]) == DUAL else 0)


@lower_builtin(block_size, types.Array)
def _block_size(context, builder, sig, args):
    return ir.Constant(WORD, width(lanes_of(sig.args[0])))


@lower_builtin(epsilon, types.Array)
def _epsilon(context, builder, sig, args):
    kind = sig.args[0].dtype
    bits = getattr(kind, "bits", None) or kind.bitwidth
    return ir.Constant(ir.DoubleType(), float(np.finfo(f"float{bits}").eps))


def lanes_of(array):
    """Lanes of the elements of an array, by its type."""
    return getattr(array.dtype, "w", 1)


typed(zero)(lambda array: array.dtype)
typed(nowhere)(lambda array: mask_type(lanes_of(array)))
typed(block_size, directions)(lambda array: types.int64)
typed(epsilon)(lambda array: types.float64)
