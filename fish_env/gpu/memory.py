"""Packs in the memory of a GPU: the same words as on the host, with addresses of copies on the GPU.

Arrays of which every thread has its own (`fish_env.kernels.simd.warps`) are not copied: they are allocated for the
number of warps, and initialised with zeros.
"""

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from numba import types

from fish_env.envs.state import memory_of
from fish_env.kernels.simd import Pack, Scratch
from fish_env.kernels.simd.kinds import Lanes
from fish_env.kernels.simd.packs import PackType, describe
from fish_env.kernels.simd.types import THREAD


def gpu_type(kind):
    """Type of a pack's field for the GPU, with aligned numbers, which it would otherwise read by bytes."""
    if isinstance(kind, PackType):
        return PackType(kind.label, tuple((name, gpu_type(field), place) for name, field, place in kind.fields))
    if type(kind) is types.Array:
        return types.Array(kind.dtype, kind.ndim, kind.layout, aligned=True)
    return kind


def is_own(value) -> bool:
    """Return True if every thread has its own copy of a value."""
    return isinstance(value, Lanes) and (isinstance(value, Scratch) or value.kind.lanes == THREAD)


class Upload:
    """Copy of a pack of the host and its content in another memory, part of which each warp has for itself.

    `place(array)` copies a numpy array there, `place(shape, dtype)` makes one of zeros; `address(placed)` is where.
    `axes` are those of the fish (`fish_axes`) in arrays that have `num_fish` fish there, and begin with zeros.
    Two arrays of the pack that share memory on the host also share it there, if they begin at the same address.
    """

    def __init__(self, pack: Pack, warps: int, place: Callable[..., Any], address: Callable[[Any], int],
                 axes: Mapping[str, int] | None = None, num_fish: int = 0):  # fmt: skip
        self.type = gpu_type(pack.type)
        self._place, self._address, self._warps = place, address, warps
        self._axes, self._num_fish = axes or {}, num_fish
        self._placed: dict[tuple[int, int], Any] = {}
        self._words: list[Any] = []
        self._words.append(self._put(pack))
        self.address = address(self._words[-1])

    def _put(self, pack: Pack, prefix: str = ""):
        words = []
        for name, value in pack._kept.items():
            _, content = describe(name, value)
            if isinstance(value, Pack):
                self._words.append(self._put(value, f"{prefix}{name}."))
                content = [self._address(self._words[-1])]
            elif is_own(value):
                memory = value.memory
                placed = self._place((self._warps, *memory.shape), memory.dtype)
                self._placed[memory.ctypes.data, memory.nbytes] = placed
                content[0] = self._address(placed)
            elif isinstance(value, np.ndarray | Lanes):
                axis = self._axes.get(prefix + name)
                content[0] = self._address(self._copy(memory_of(value), axis))
                if axis is not None:
                    content[1 + axis] = self._num_fish
            words.extend(content)
        return self._place(np.array([np.int64(word) for word in words]))

    def _copy(self, memory: np.ndarray, axis: int | None):
        key = memory.ctypes.data, memory.nbytes
        if key not in self._placed:
            shape = None if axis is None else (*memory.shape[:axis], self._num_fish, *memory.shape[axis + 1 :])
            self._placed[key] = self._place(memory) if shape is None else self._place(shape, memory.dtype)
        return self._placed[key]

    def of(self, value):
        """Copy of an array of the pack; if every thread has its own, that of all warps, (warps,...,WARP)."""
        memory = memory_of(value)
        return self._placed[memory.ctypes.data, memory.nbytes]


def bytes_needed(pack: Pack, warps: int, axes: Mapping[str, int] | None = None, num_fish: int = 0) -> int:
    """Bytes that an `Upload` needs, without allocation."""
    taken = []

    def measure(what, dtype=None):
        taken.append(what.nbytes if dtype is None else int(np.prod(what)) * np.dtype(dtype).itemsize)

    Upload(pack, warps, measure, lambda placed: 0, axes, num_fish)
    return sum(taken)
