"""Kinds of kernels, by their number of fish and precision; arrays of numbers and of vectors for such kernels.

Legend: n elements of an array; w lanes.
"""

from dataclasses import dataclass

import numpy as np
from numba.np.numpy_support import from_dtype

from fish_env.kernels.simd import plain
from fish_env.kernels.simd.types import DUAL, THREAD, WARP, XYZ, Vec3, floats_apart, floats_in, number_type, width

LANES = (XYZ, 1, 2, 4, 8, 16, 32)
ALIGNMENT = 64  # bytes: a cache line, and the widest register


@dataclass(frozen=True)
class Kind:
    """Number of fish that a kernel processes at once, and its precision."""

    lanes: str | int = XYZ
    """"xyz", one fish with its coordinates in a register; or the number of fish side by side: 1, 2, 4, 8, 16 or 32; or
    "dual", one fish of dual numbers, for derivatives of forces only; or "thread", one fish per thread of a GPU, whose
    memory is interleaved with that of the other threads of its warp."""
    dtype: str = "float64"
    """"float64" or "float32"."""

    def __post_init__(self):
        known = isinstance(self.lanes, str | int) and self.lanes in (*LANES, DUAL, THREAD)
        if not known or isinstance(self.lanes, bool):
            raise ValueError(f"lanes is {self.lanes!r}; choose from {', '.join(map(repr, LANES))}")
        if not isinstance(self.dtype, str) or self.dtype not in ("float64", "float32"):
            raise ValueError(f"dtype is {self.dtype!r}; choose 'float64' or 'float32'")

    @property
    def bits(self) -> int:
        """Bits of a number."""
        return 8 * np.dtype(self.dtype).itemsize

    @property
    def width(self) -> int:
        """Number of fish in a block."""
        return width(self.lanes)

    def numbers(self, count: int) -> "Numbers":
        """Array of `count` numbers per fish, all zero."""
        return Numbers(aligned_zeros((count, floats_apart(self.lanes)), self.dtype), self)

    def scratch(self, shape, dtype="float64") -> "np.ndarray | Scratch":
        """Array of numbers per block instead of per fish, all zero: scratch memory of kernels."""
        if self.lanes != THREAD:
            return np.zeros(shape, dtype=dtype)
        return Scratch(aligned_zeros((*np.atleast_1d(shape), WARP), dtype), self)

    def vectors(self, count: int) -> "Vectors":
        """Array of `count` vectors per fish, all zero."""
        shape = (count, 4) if self.lanes == XYZ else (count, 3, floats_apart(self.lanes))
        return Vectors(aligned_zeros(shape, self.dtype), self)

    def rows(self, array) -> "Vectors":
        """Copy the rows of an array (n,3) to vectors that are the same for every fish."""
        kind = self if self.lanes == XYZ else Kind(1, self.dtype)
        rows = kind.vectors(len(array))
        rows.memory.reshape(len(array), 4 if self.lanes == XYZ else 3)[:, :3] = array
        return rows

    def scalars(self, array) -> np.ndarray:
        """Copy an array of floats to this precision."""
        return np.array(array, dtype=self.dtype, order="C")


def aligned_zeros(shape, dtype) -> np.ndarray:
    """Array of zeros that begins at a cache line."""
    item = np.dtype(dtype).itemsize
    count = int(np.prod(shape))
    raw = np.zeros(count + ALIGNMENT // item, dtype=dtype)
    first = -raw.ctypes.data % ALIGNMENT // item
    return raw[first : first + count].reshape(shape)


class Lanes:
    """Array for kernels of a kind: its memory, and its shape without lanes."""

    def __init__(self, memory: np.ndarray, kind: Kind, shape: tuple[int, ...]):
        self.memory, self.kind, self.shape = memory, kind, shape

    @property
    def size(self) -> int:
        return int(np.prod(self.shape))


class Numbers(Lanes):
    """Array of n numbers per fish: memory (n,w)."""

    def __init__(self, memory: np.ndarray, kind: Kind):
        super().__init__(memory, kind, (len(memory),))
        self._rows = memory.reshape(len(memory), floats_apart(kind.lanes))[:, : floats_in(kind.lanes)]
        self.element = number_type(kind.lanes, kind.bits)

    def __getitem__(self, i):
        return plain.read(self._rows[i], self.kind.lanes)

    def __setitem__(self, i, value):
        plain.write(self._rows, i, value, self.kind.lanes)


class Vectors(Lanes):
    """Vectors, memory (...,3,w), or (...,4) for one fish in a register; one lane may omit the last axis."""

    def __init__(self, memory: np.ndarray, kind: Kind):
        tail = {XYZ: (4,), 1: (3,)}.get(kind.lanes, (3, floats_apart(kind.lanes)))
        if kind.lanes == 1 and memory.shape[-1:] == (1,):
            memory = memory[..., 0]
        if memory.shape[-len(tail) :] != tail or not memory.flags.c_contiguous or memory.dtype != kind.dtype:
            raise ValueError(f"memory is {memory.dtype}, {memory.shape}; give contiguous {kind.dtype}, (...,{tail})")
        super().__init__(memory, kind, memory.shape[: memory.ndim - len(tail)])
        self.element = Vec3(1 if kind.lanes == THREAD else kind.lanes, kind.bits)
        self._floats = floats_in(kind.lanes)

    def __getitem__(self, i):
        x, y, z, *_ = self.memory[i]
        if x.ndim == 0:
            return plain.Vec3(x, y, z)
        return plain.Vec3(*(plain.read(each[: self._floats], self.kind.lanes) for each in (x, y, z)))

    def __setitem__(self, i, value):
        for k, each in enumerate(value):
            plain.write(self.memory[i], k, each, self.kind.lanes)


class Scratch(Lanes):
    """Array of which every thread of a GPU has its own: memory (...,WARP)."""

    def __init__(self, memory: np.ndarray, kind: Kind):
        super().__init__(memory, kind, memory.shape[:-1])
        self.element = from_dtype(memory.dtype)

    def __getitem__(self, i):
        return self.memory[..., 0][i]

    def __setitem__(self, i, value):
        self.memory[..., 0][i] = value
