"""What kernels are handed: arrays of numbers and vectors, and packs, records of arrays behind one address.

A nested named tuple of 25 arrays takes 5 us to hand to a compiled function, a `Pack` of any size a tenth of that: it is
one pointer to a block of 8-byte words, which kernels read as `pack.name`. What a pack names is kept alive by the pack,
not by the compiled code: hold on to it while a kernel runs.

Legend: n elements of an array; w lanes; words the block behind a pack.
"""

import hashlib
import warnings
from dataclasses import dataclass
from typing import Any

import llvmlite.ir as ir
import numba
import numpy as np
from numba import types
from numba.core import cgutils
from numba.core.imputils import impl_ret_borrowed, lower_builtin, lower_getattr_generic
from numba.core.typing.templates import AbstractTemplate, AttributeTemplate, infer_getattr, infer_global, signature
from numba.extending import NativeValue, intrinsic, models, register_model, typeof_impl, unbox
from numba.np.arrayobj import populate_array

from fish_env.simd import plain
from fish_env.simd.types import DIRECTIONS, DUAL, XYZ, Vec3, floats_in, mask_type, number_type, width

LANES = (XYZ, 1, 2, 4, 8, 16, 32)
TESTED = ("0.60", "0.61", "0.65", "0.66", "0.67", "0.68")
"""Versions of numba whose compiler the types were tested with."""
SUPPORTED = numba.__version__.startswith(tuple(f"{version}." for version in TESTED))
if not SUPPORTED:
    warnings.warn(
        f"fish_env's vector types were tested with numba {', '.join(TESTED)}, not {numba.__version__}: kernels work on "
        'one fish at a time, several times slower; pip install "numba>=0.65,<0.69" for the full speed',
        RuntimeWarning,
        stacklevel=2,
    )
ALIGNMENT = 64  # bytes: a cache line, and the widest register
WORD = ir.IntType(64)
SIZES: dict[types.Type, int] = {}  # bytes of an element: LLVM takes a millisecond to tell


@dataclass(frozen=True)
class Kind:
    """How many fish a kernel works on at once, and in which precision."""

    lanes: str | int = XYZ if SUPPORTED else 1
    """"xyz", one fish with its coordinates in a register; or how many fish side by side: 1, 2, 4, 8, 16 or 32; or
    "dual", one fish with derivatives, which moves nothing but tells how forces change."""
    dtype: str = "float64"
    """"float64" or "float32"."""

    def __post_init__(self):
        if self.lanes not in (*LANES, DUAL) or isinstance(self.lanes, bool):
            raise ValueError(f"lanes is {self.lanes!r}; choose from {', '.join(map(repr, LANES))}")
        if not SUPPORTED and self.lanes not in (1, DUAL):
            raise ValueError(
                f"lanes is {self.lanes!r}, which was not tested with numba {numba.__version__}; give 1, or install one "
                f"of {', '.join(TESTED)}"
            )
        if self.dtype not in ("float64", "float32"):
            raise ValueError(f"dtype is {self.dtype!r}; choose 'float64' or 'float32'")

    @property
    def bits(self) -> int:
        """Bits of a number."""
        return 8 * np.dtype(self.dtype).itemsize

    @property
    def width(self) -> int:
        """Fish in a block."""
        return width(self.lanes)

    def numbers(self, count: int) -> "Numbers":
        """`count` numbers a fish, all zero."""
        return Numbers(aligned((count, floats_in(self.lanes)), self.dtype), self)

    def vectors(self, count: int) -> "Vectors":
        """`count` vectors a fish, all zero."""
        shape = (count, 4) if self.lanes == XYZ else (count, 3, floats_in(self.lanes))
        return Vectors(aligned(shape, self.dtype), self)

    def rows(self, array) -> "Vectors":
        """The rows of an array (n,3) as vectors that are the same for every fish: a copy."""
        kind = self if self.lanes == XYZ else Kind(1, self.dtype)
        rows = kind.vectors(len(array))
        rows.memory.reshape(len(array), 4 if self.lanes == XYZ else 3)[:, :3] = array
        return rows

    def scalars(self, array) -> np.ndarray:
        """An array of floats in this precision: a copy."""
        return np.array(array, dtype=self.dtype, order="C")


def aligned(shape, dtype) -> np.ndarray:
    """Zeros that begin at a cache line."""
    item = np.dtype(dtype).itemsize
    count = int(np.prod(shape))
    raw = np.zeros(count + ALIGNMENT // item, dtype=dtype)
    first = -raw.ctypes.data % ALIGNMENT // item
    return raw[first : first + count].reshape(shape)


class Numbers:
    """n numbers a fish: memory (n,w)."""

    def __init__(self, memory: np.ndarray, kind: Kind):
        self.memory, self.kind = memory, kind
        self._rows = memory.reshape(len(memory), floats_in(kind.lanes))
        self.element, self.shape = number_type(kind.lanes, kind.bits), (len(memory),)

    @property
    def size(self) -> int:
        return self.shape[0]

    def __getitem__(self, i):
        return plain.read(self._rows[i], self.kind.lanes)

    def __setitem__(self, i, value):
        plain.write(self._rows, i, value, self.kind.lanes)


class Vectors:
    """Vectors, memory (...,3,w), or (...,4) for one fish in a register; one lane may leave the last axis out."""

    def __init__(self, memory: np.ndarray, kind: Kind):
        tail = {XYZ: (4,), 1: (3,)}.get(kind.lanes, (3, floats_in(kind.lanes)))
        if kind.lanes == 1 and memory.shape[-1:] == (1,):
            memory = memory[..., 0]
        if memory.shape[-len(tail) :] != tail or not memory.flags.c_contiguous or memory.dtype != kind.dtype:
            raise ValueError(f"memory is {memory.dtype}, {memory.shape}; give contiguous {kind.dtype}, (...,{tail})")
        self.memory, self.kind = memory, kind
        self.element, self.shape = Vec3(kind.lanes, kind.bits), memory.shape[: memory.ndim - len(tail)]

    @property
    def size(self) -> int:
        return int(np.prod(self.shape))

    def __getitem__(self, i):
        x, y, z, *_ = self.memory[i]
        lanes = 1 if self.kind.lanes == XYZ else self.kind.lanes
        return plain.Vec3(*(plain.read(np.atleast_1d(each), lanes) for each in (x, y, z)))

    def __setitem__(self, i, value):
        for k, each in enumerate(value):
            plain.write(self.memory[i], k, each, self.kind.lanes)


class PackType(types.Type):
    """The type of a `Pack`: names and types of what is in it, in order."""

    def __init__(self, label: str, fields: tuple[tuple[str, types.Type, int], ...]):
        self.label, self.fields = label, fields
        self.places = {name: (kind, place) for name, kind, place in fields}
        text = ",".join(f"{name}:{kind}" for name, kind, _ in fields)
        super().__init__(name=f"Pack({label}#{hashlib.sha256(text.encode()).hexdigest()[:12]})")


class Pack:
    """Named arrays, numbers and other packs, handed to kernels by address.

    Args:
        label: what it is, for messages of the compiler.
        fields: numpy arrays (C-contiguous; a kernel may change them), `Numbers`, `Vectors`, packs, floats, whole
            numbers, truth values.
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

    @property
    def address(self) -> int:
        """Where the words are, for `pack_at`."""
        return self._address

    @property
    def type(self) -> PackType:
        """What numba takes it for."""
        return self._numba_type_

    def set(self, **values) -> None:
        """Give fields other values of the same types."""
        for name, value in values.items():
            wanted, place = self._numba_type_.places[name]
            kind, content = describe(name, value)
            if kind != wanted:
                raise ValueError(f"{name} of {self._numba_type_} would become {kind}; give {wanted}")
            self._kept[name] = value
            self._words[place : place + len(content)] = content
            setattr(self, name, value)

    def __reduce__(self):
        return remade, (self._numba_type_.label, self._kept)


def packed(record, kind: Kind) -> Pack:
    """A named tuple of arrays and numbers as kernels of a kind read it; what is None is left out.

    Floats become numbers of the kind's precision; the fields that the record's class names in VECTORS, (3,) or (n,3),
    become vectors, the same for every fish. Whole numbers and truth values stay what they are. What is in a dictionary
    stands beside the other fields.
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
            fields[name] = np.ascontiguousarray(value)
        elif value is not None:
            fields[name] = float(value) if isinstance(value, float | np.floating) else value
    return Pack(type(record).__name__, **fields)


def remade(label, fields):
    """A pack out of a pickle: its addresses are those of the new arrays."""
    return Pack(label, **fields)


def describe(name: str, value) -> tuple[types.Type, list[int]]:
    """The type of a field, and the words that stand for it."""
    if isinstance(value, Numbers | Vectors):
        return types.Array(value.element, len(value.shape), "C", aligned=False), address(
            name, value.memory, value.shape
        )
    if isinstance(value, np.ndarray):
        kind = types.Array(typeof_dtype(value.dtype), value.ndim, "C", aligned=False)
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


def typeof_dtype(dtype):
    """The numba type of an array's elements."""
    from numba.np.numpy_support import from_dtype

    return from_dtype(dtype)


def address(name, memory, shape) -> list[int]:
    """Where an array is, and its shape."""
    if not memory.flags.c_contiguous:
        raise ValueError(f"field {name} is not contiguous in memory; give np.ascontiguousarray of it")
    return [memory.ctypes.data, *shape]


@typeof_impl.register(Pack)
def _typeof_pack(value, c):
    return value._numba_type_


@register_model(PackType)
class PackModel(models.PrimitiveModel):
    """The address of the words."""

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
    """`pack.name`."""

    key = PackType

    def generic_resolve(self, kind, name):
        return kind.places[name][0] if name in kind.places else None


def pack_at(kind: PackType):
    """A function for kernels that takes the address of a pack of this type, a whole number, and returns the pack.

    Numba looks up the type of every argument that is neither a number nor an array, which takes a microsecond.
    """

    @intrinsic
    def at(typingctx, address):
        def generate(context, builder, sig, args):
            return builder.inttoptr(args[0], WORD.as_pointer())

        return kind(types.int64), generate

    at.cache_key = kind.name
    return at


def load_word(builder, pointer, place):
    """Word number `place`; packs do not change while a kernel runs, so LLVM may load it once."""
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
    """The array of a type at an address (one word), C-contiguous, owned by nobody."""
    if kind.dtype not in SIZES:
        SIZES[kind.dtype] = context.get_abi_sizeof(context.get_data_type(kind.dtype))
    item = SIZES[kind.dtype]
    strides, step = [], ir.Constant(WORD, item)
    for length in reversed(shape):
        strides.insert(0, step)
        step = builder.mul(step, length)
    array = context.make_array(kind)(context, builder)
    data = builder.inttoptr(word, array.data.type)
    populate_array(array, data=data, shape=shape, strides=strides, itemsize=ir.Constant(WORD, item), meminfo=None)
    return array._getvalue()


def floats(array):
    """The memory of vectors (n,3 or 4,w) or of numbers (n,w), as plain floats."""
    n = array.shape[0]
    if isinstance(array, np.ndarray):
        return array.reshape(n, 1)
    w = floats_in(array.kind.lanes)
    return array.memory.reshape(n, -1, w) if isinstance(array, Vectors) else array.memory.reshape(n, w)


def zero(array):
    """The zero of an array's elements."""
    if isinstance(array, Vectors):
        return array[0] * 0.0
    return 0.0 * array[0]


def nowhere(array):
    """False for every fish of a block."""
    w = block_size(array)
    return np.zeros(w, dtype=bool) if w > 1 else False


def block_size(array):
    """How many fish an element of the array is for."""
    return array.kind.width if isinstance(array, Numbers | Vectors) else 1


def directions(array):
    """How many derivatives the numbers in the array carry with them: 0, but for dual numbers."""
    return DIRECTIONS if isinstance(array, Numbers | Vectors) and array.kind.lanes == DUAL else 0


def epsilon(array):
    """The distance from 1 to the next number in the precision of an array's elements."""
    return float(np.finfo((array if isinstance(array, np.ndarray) else array.memory).dtype).eps)


@infer_global(floats)
class Floats(AbstractTemplate):
    """Of a one-dimensional array."""

    def generic(self, args, kws):
        kind = args[0].dtype
        bits = getattr(kind, "bits", 64)
        number = types.float64 if bits == 64 else types.float32
        return signature(types.Array(number, 3 if isinstance(kind, Vec3) else 2, "C", aligned=False), args[0])


@lower_builtin(floats, types.Array)
def _floats(context, builder, sig, args):
    source = context.make_array(sig.args[0])(context, builder, args[0])
    kind = sig.args[0].dtype
    lanes = floats_in(getattr(kind, "w", 1))
    tail = ([4 if kind.w == XYZ else 3] if isinstance(kind, Vec3) else []) + [lanes]
    shape = [cgutils.unpack_tuple(builder, source.shape, 1)[0], *(ir.Constant(WORD, length) for length in tail)]
    out = array_at(context, builder, sig.return_type, builder.ptrtoint(source.data, WORD), shape)
    return impl_ret_borrowed(context, builder, sig.return_type, out)


@infer_global(zero)
class Zero(AbstractTemplate):
    """Of any array of floats, numbers or vectors."""

    def generic(self, args, kws):
        return signature(args[0].dtype, args[0])


@lower_builtin(zero, types.Array)
def _zero(context, builder, sig, args):
    return ir.Constant(context.get_value_type(sig.return_type), None)


@infer_global(nowhere)
class Nowhere(AbstractTemplate):
    """Of an array of numbers or vectors."""

    def generic(self, args, kws):
        return signature(mask_type(getattr(args[0].dtype, "w", 1)), args[0])


lower_builtin(nowhere, types.Array)(_zero)


@infer_global(block_size)
@infer_global(directions)
class Count(AbstractTemplate):
    """Of an array of numbers or vectors."""

    def generic(self, args, kws):
        return signature(types.int64, args[0])


@lower_builtin(directions, types.Array)
def _directions(context, builder, sig, args):
    return ir.Constant(WORD, DIRECTIONS if getattr(sig.args[0].dtype, "w", 1) == DUAL else 0)


@lower_builtin(block_size, types.Array)
def _block_size(context, builder, sig, args):
    return ir.Constant(WORD, width(getattr(sig.args[0].dtype, "w", 1)))


@infer_global(epsilon)
class Epsilon(AbstractTemplate):
    """Of an array of floats, numbers or vectors."""

    def generic(self, args, kws):
        return signature(types.float64, args[0])


@lower_builtin(epsilon, types.Array)
def _epsilon(context, builder, sig, args):
    kind = sig.args[0].dtype
    bits = getattr(kind, "bits", None) or kind.bitwidth
    return ir.Constant(ir.DoubleType(), float(np.finfo(f"float{bits}").eps))
