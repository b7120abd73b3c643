"""Arrays of a thread of a GPU: each thread moves one fish, and the numbers of a warp's fish are interleaved.

The threads of a warp run in step, so element i of all WARP of them is loaded at once. Memory is (n,WARP), or (n,3,WARP)
for vectors, as for a block of WARP fish. Every thread accesses one lane of it only, an array (n,) of plain numbers or
3-vectors. The memory of all warps is consecutive, from the address in a pack. Compiled for the processor, there is one
thread, the first.
"""

import operator

import llvmlite.ir as ir
from numba import types
from numba.core.datamodel import models
from numba.core.imputils import lower_builtin
from numba.core.typing.templates import signature
from numba.extending import register_model

from fish_env.kernels.simd.types import WARP, Vec3, typed

WORD = ir.IntType(64)


class ThreadArray(types.Array):
    """Type of an array of which every thread has its own: numbers, 3-vectors of one lane, or integers."""

    def __init__(self, dtype, ndim):
        super().__init__(dtype, ndim, "A", name=f"ThreadArray({dtype},{ndim})")

    @property
    def coordinates(self) -> int:
        """Number of coordinates of an element: 3 for a vector."""
        return 3 if isinstance(self.dtype, Vec3) else 1

    @property
    def item(self) -> int:
        """Bytes of one coordinate."""
        return (self.dtype.bits if hasattr(self.dtype, "bits") else self.dtype.bitwidth) // 8


register_model(ThreadArray)(models.ArrayModel)


def on_gpu(builder) -> bool:
    """Return True if the code is compiled for a GPU."""
    return builder.module.triple.startswith("nvptx")


def register(builder, name):
    """Emit the read of a thread's special register, 64 bits: `tid`, `ctaid` or `ntid`."""
    reader = f"llvm.nvvm.read.ptx.sreg.{name}.x"
    function = builder.module.globals.get(reader)
    if function is None:
        function = ir.Function(builder.module, ir.FunctionType(ir.IntType(32), []), reader)
    return builder.zext(builder.call(function, []), WORD)


def first_byte(builder, kind: ThreadArray, count):
    """Emit the offset of the thread's part of an array of `count` elements, in bytes from the first thread's."""
    if not on_gpu(builder):
        return ir.Constant(WORD, 0)
    tid = register(builder, "tid")
    thread = builder.add(builder.mul(register(builder, "ctaid"), register(builder, "ntid")), tid)
    warp, lane = builder.udiv(thread, word(WARP)), builder.urem(tid, word(WARP))
    before = builder.mul(builder.mul(warp, count), word(kind.coordinates * WARP))
    return builder.mul(builder.add(before, lane), word(kind.item))


def word(number: int):
    """Integer constant of 64 bits."""
    return ir.Constant(WORD, number)


def steps(builder, kind: ThreadArray, shape):
    """Emit the strides, in bytes, along each axis."""
    found, step = [], word(kind.coordinates * WARP * kind.item)
    for length in reversed(shape):
        found.insert(0, step)
        step = builder.mul(step, length)
    return found


@typed(operator.getitem)
def _type_of_element(array, place):
    """Type of an element by its index, or by one index per axis; indices count from the front."""
    return array.dtype if isinstance(array, ThreadArray) and is_index(array, place) else None


@typed(operator.setitem)
def _type_of_assignment(array, place, value):
    """Type of an assignment to an element."""
    ours = isinstance(array, ThreadArray) and is_index(array, place)
    return signature(types.none, array, place, array.dtype) if ours else None


def is_index(array, place) -> bool:
    """Return True if a type is that of an index of one element."""
    if isinstance(place, types.BaseTuple):
        return len(place) == array.ndim and all(isinstance(kind, types.Integer) for kind in place)
    return array.ndim == 1 and isinstance(place, types.Integer)


def parts_at(context, builder, sig, args):
    """Emit pointers to the numbers of the element, one or three, and return their type as well."""
    kind, place = sig.args[0], sig.args[1]
    array = context.make_array(kind)(context, builder, args[0])
    if isinstance(place, types.BaseTuple):
        indices = [
            context.cast(builder, builder.extract_value(args[1], k), each, types.int64) for k, each in enumerate(place)
        ]
    else:
        indices = [context.cast(builder, args[1], place, types.int64)]
    strides = [builder.extract_value(array.strides, axis) for axis in range(kind.ndim)]
    address = builder.ptrtoint(array.data, WORD)
    for index, stride in zip(indices, strides, strict=True):
        address = builder.add(address, builder.mul(index, stride))
    element = context.get_data_type(kind.dtype)
    if isinstance(kind.dtype, Vec3):
        element = element.element
    first = builder.inttoptr(address, element.as_pointer())
    return [builder.gep(first, [word(k * WARP)], inbounds=True) for k in range(kind.coordinates)]


def _get(context, builder, sig, args):
    numbers = [builder.load(part) for part in parts_at(context, builder, sig, args)]
    if len(numbers) == 1:
        return context.data_model_manager[sig.return_type].from_data(builder, numbers[0])
    value = ir.Constant(context.get_value_type(sig.return_type), ir.Undefined)
    for k, number in enumerate(numbers):
        value = builder.insert_value(value, number, k)
    return value


def _set(context, builder, sig, args):
    pointers, kind = parts_at(context, builder, sig, args), sig.args[0].dtype
    if len(pointers) == 1:
        builder.store(context.data_model_manager[kind].as_data(builder, args[2]), pointers[0])
        return
    for k, pointer in enumerate(pointers):
        builder.store(builder.extract_value(args[2], k), pointer)


for _place in (types.Integer, types.BaseTuple):
    lower_builtin(operator.getitem, ThreadArray, _place)(_get)
    lower_builtin(operator.setitem, ThreadArray, _place, types.Any)(_set)
