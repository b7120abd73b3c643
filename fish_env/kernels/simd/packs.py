"""Packs, the arguments of kernels: records of arrays behind one address.

A pack is one pointer to a block of 8-byte words, which kernels read as `pack.name`. It is passed ten times faster than
nested named tuples. It keeps its fields alive, compiled code does not: keep a reference to it while a kernel runs.
"""

import hashlib
from collections.abc import Callable
from typing import TYPE_CHECKING, Any
from weakref import WeakValueDictionary

import llvmlite.ir as ir
import numba
import numpy as np
from numba import types
from numba.core import cgutils
from numba.core.imputils import lower_builtin, lower_getattr_generic
from numba.core.typing.templates import AttributeTemplate, infer_getattr
from numba.extending import NativeValue, intrinsic, models, register_model, typeof_impl, unbox
from numba.np.numpy_support import from_dtype

from fish_env.kernels.simd.kinds import Kind, Lanes, Scratch
from fish_env.kernels.simd.types import THREAD, typed
from fish_env.kernels.simd.warps import WORD, ThreadArray, first_byte, steps

SIZES: dict[types.Type, int] = {}  # bytes of an element, cached because LLVM takes a millisecond
PACKS: WeakValueDictionary[int, "Pack"] = WeakValueDictionary()
"""Packs by their addresses, for kernels without the compiler."""


class PackType(types.Type):
    """Numba type of a `Pack`: names and types of its fields, in order."""

    def __init__(self, label: str, fields: tuple[tuple[str, types.Type, int], ...]):
        self.label, self.fields = label, fields
        self.places = {name: (kind, place) for name, kind, place in fields}
        text = ",".join(f"{name}:{kind}" for name, kind, _ in fields)
        super().__init__(name=f"Pack({label}#{hashlib.sha256(text.encode()).hexdigest()[:12]})")


class Pack:
    """Named arrays, numbers and other packs, passed to kernels by address.

    Args:
        label: a name for messages of the compiler.
        fields: numpy arrays (C-contiguous; a kernel may change them), `Numbers`, `Vectors`, packs, floats, integers,
            Booleans.
    """

    def __init__(self, label: str, /, **fields: Any):
        described, words, self._kept = [], [], fields
        for name, value in fields.items():
            kind, content = describe(name, value)
            described.append((name, kind, len(words)))
            words.extend(content)
            setattr(self, name, value)
        self._words = np.array([np.int64(word) for word in words], dtype=np.int64)
        self._address = self._words.ctypes.data
        self._numba_type_ = PackType(label, tuple(described))
        if numba.config.DISABLE_JIT:
            PACKS[self._address] = self

    if TYPE_CHECKING:  # every field is an attribute

        def __getattr__(self, name: str) -> Any: ...

    @property
    def address(self) -> int:
        """Address of the words, for `pack_at`."""
        return self._address

    @property
    def type(self) -> PackType:
        """Numba type of the pack."""
        return self._numba_type_

    def set(self, **values) -> None:
        """Replace the values of fields by others of the same types."""
        for name, value in values.items():
            wanted, place = self._numba_type_.places[name]
            kind, content = describe(name, value)
            if kind != wanted:
                raise ValueError(f"{name} of {self._numba_type_} would become {kind}; give {wanted}")
            self._kept[name] = value
            self._words[place : place + len(content)] = content
            setattr(self, name, value)

    def __reduce__(self):
        return restore_pack, (self._numba_type_.label, self._kept)


def packed(record, kind: Kind) -> Pack:
    """Make a pack for kernels of a kind from a named tuple of arrays and numbers, without the fields that are None.

    Floats become numbers of the kind's precision. Fields in VECTORS of the record's class, (3,) or (n,3), become
    vectors that are the same for every fish. Integers and Booleans are unchanged. Arrays are copied. Entries of a
    dictionary become fields of the pack.
    """
    fields = {}
    for name, value in record._asdict().items():
        if isinstance(value, tuple):
            fields[name] = packed(value, kind)
        elif isinstance(value, dict):
            fields |= {key: packed(part, kind) for key, part in value.items()}
        elif isinstance(value, np.ndarray) and value.dtype.kind == "f":
            vectors = name in getattr(record, "VECTORS", ())
            fields[name] = kind.rows(np.atleast_2d(value)) if vectors else kind.scalars(value)
        elif isinstance(value, np.ndarray):
            fields[name] = np.array(value, order="C")
        elif value is not None:
            fields[name] = float(value) if isinstance(value, float | np.floating) else value
    return Pack(type(record).__name__, **fields)


def restore_pack(label, fields):
    """Make a pack from a pickle, with the addresses of the new arrays."""
    return Pack(label, **fields)


def describe(name: str, value) -> tuple[types.Type, list[int]]:
    """Type of a field, and the words that represent it."""
    if isinstance(value, Lanes):
        own = isinstance(value, Scratch) or value.kind.lanes == THREAD
        dimension = len(value.shape)
        kind = (
            ThreadArray(value.element, dimension) if own else types.Array(value.element, dimension, "C", aligned=False)
        )
        return kind, address(name, value.memory, value.shape)
    if isinstance(value, np.ndarray):
        kind = types.Array(from_dtype(value.dtype), value.ndim, "C", aligned=False)
        return kind, address(name, value, value.shape)
    if isinstance(value, Pack):
        return value._numba_type_, [value._address]
    if isinstance(value, bool | np.bool_):
        return types.boolean, [int(value)]
    if isinstance(value, int | np.integer):
        return types.int64, [int(value)]
    if isinstance(value, float | np.floating):
        return types.float64, [int(np.float64(value).view(np.int64))]
    raise TypeError(f"field {name} is a {type(value).__name__}; give an array, a pack or a number")


def address(name, memory, shape) -> list[int]:
    """Words of an array: its address and its shape."""
    if not memory.flags.c_contiguous:
        raise ValueError(f"field {name} is not contiguous in memory; give np.ascontiguousarray of it")
    return [memory.ctypes.data, *shape]


@typeof_impl.register(Pack)
def _typeof_pack(value, c):
    return value._numba_type_


@register_model(PackType)
class PackModel(models.PrimitiveModel):
    """Data model of a pack: the address of its words."""

    def __init__(self, dmm, fe_type):
        super().__init__(dmm, fe_type, WORD.as_pointer())


@unbox(PackType)
def _unbox_pack(typ, obj, c):
    held = c.pyapi.object_getattr_string(obj, "_address")
    pointer = c.pyapi.long_as_voidptr(held)
    c.pyapi.decref(held)
    return NativeValue(
        c.builder.bitcast(pointer, WORD.as_pointer()), is_error=cgutils.is_not_null(c.builder, c.pyapi.err_occurred())
    )


@infer_getattr
class PackAttributes(AttributeTemplate):
    """Type of `pack.name`."""

    key = PackType

    def generic_resolve(self, kind, name):
        return kind.places[name][0] if name in kind.places else None


def field(pack, name: str) -> Any:
    """Field of a pack with a name from a kernel's closure, of which numba compiles no `getattr`; for "", the pack."""
    return getattr(pack, name) if name else pack


@typed(field)
def _type_of_field(pack, name):
    if not isinstance(pack, PackType) or not isinstance(name, types.StringLiteral):
        return None
    return pack.places[name.literal_value][0] if name.literal_value else pack


@lower_builtin(field, PackType, types.StringLiteral)
def _field(context, builder, sig, args):
    (kind, name), pointer = sig.args, args[0]
    return _pack_getattr(context, builder, kind, pointer, name.literal_value) if name.literal_value else pointer


def pack_at(kind: PackType) -> Callable[[int], Any]:
    """Make a function for kernels that returns the pack of this type at an address, an integer.

    It avoids a microsecond, which numba needs for the type of every argument that is neither a number nor an array.
    """
    if numba.config.DISABLE_JIT:
        return PACKS.__getitem__

    @intrinsic
    def at(typingctx, address):
        def generate(context, builder, sig, args):
            return builder.inttoptr(args[0], WORD.as_pointer())

        return kind(types.int64), generate

    at.cache_key = kind.name
    return at


def load_word(builder, pointer, place):
    """Emit the load of word number `place`; packs do not change while a kernel runs, so LLVM may load it once."""
    value = builder.load(builder.gep(pointer, [ir.Constant(WORD, place)]))
    value.set_metadata("invariant.load", builder.module.add_metadata([]))
    return value


@lower_getattr_generic(PackType)
def _pack_getattr(context, builder, kind, pointer, name):
    field, place = kind.places[name]
    word = load_word(builder, pointer, place)
    if isinstance(field, types.Array):
        shape = [load_word(builder, pointer, place + 1 + axis) for axis in range(field.ndim)]
        return array_at(context, builder, field, word, shape)
    if isinstance(field, PackType):
        return builder.inttoptr(word, WORD.as_pointer())
    if field is types.float64:
        return builder.bitcast(word, ir.DoubleType())
    return builder.trunc(word, ir.IntType(1)) if field is types.boolean else word


def array_at(context, builder, kind, word, shape):
    """Emit the array of a type at an address (one word), C-contiguous or the thread's own, without an owner."""
    # It is assembled field by field, because `populate_array` takes far longer and every read of a pack needs it.
    if kind.dtype not in SIZES:
        SIZES[kind.dtype] = context.get_abi_sizeof(context.get_data_type(kind.dtype))
    item = ir.Constant(WORD, SIZES[kind.dtype])
    strides, step = [], item
    if isinstance(kind, ThreadArray):
        strides = steps(builder, kind, shape)
    else:
        for length in reversed(shape):
            strides.insert(0, step)
            step = builder.mul(step, length)
    model = context.data_model_manager[kind]
    layout = model.get_value_type()
    array = ir.Constant(layout, None)  # the owner of the memory is null
    count = shape[0]
    for length in shape[1:]:
        count = builder.mul(count, length, flags=["nsw"])
    if isinstance(kind, ThreadArray):
        word = builder.add(word, first_byte(builder, kind, count))
    data = builder.inttoptr(word, layout.elements[model.get_field_position("data")])
    for name, value in (("nitems", count), ("itemsize", item), ("data", data)):
        array = builder.insert_value(array, value, model.get_field_position(name))
    for name, values in (("shape", shape), ("strides", strides)):
        place = model.get_field_position(name)
        for axis, value in enumerate(values):
            array = builder.insert_value(array, value, [place, axis])
    return array
