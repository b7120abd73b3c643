"""Input validation: arrays of the right shape, finite, positive, naming nodes that exist."""

import copy
import math
import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from functools import cache
from numbers import Real
from pathlib import Path, PurePosixPath
from typing import TypeGuard

import numpy as np


def is_whole(value) -> TypeGuard[int]:
    """Whether `value` is a whole number of Python or numpy; truth values are not, nor are numpy's durations."""
    return isinstance(value, int | np.integer) and not isinstance(value, bool | np.timedelta64)


def real(value) -> float:
    """`value` as a float: nan if it is no real number, infinite if it is beyond the largest float."""
    if not isinstance(value, Real):
        return math.nan
    try:
        return float(value)
    except OverflowError:  # a whole number or a fraction
        return math.inf


@contextmanager
def representable(what: str) -> Iterator[None]:
    """A ValueError in place of products and quotients that no float holds, of numbers that are allowed one by one."""
    try:
        with np.errstate(over="raise", divide="raise", invalid="raise"):
            yield
    except (OverflowError, FloatingPointError, ZeroDivisionError) as error:
        raise ValueError(f"{what} follows from numbers that are too large or too small together: {error}") from error


def as_floats(value) -> np.ndarray:
    """`value` as a float64 array, itself if it is one.

    Raises:
        TypeError: for what numpy would read numbers out of: text, dates, complex numbers, what is under a mask; and for
            a tensor of torch that requires a gradient, which would end here.
        ValueError: for rows of different lengths.
        OverflowError: for a whole number beyond the largest float.
    """
    if getattr(getattr(value, "dtype", None), "is_floating_point", False):  # torch's, perhaps one that numpy lacks
        value = value.double()
    try:
        array = np.asarray(value)
    except RuntimeError as error:  # torch's
        raise TypeError(str(error)) from error
    masked = isinstance(value, np.ma.MaskedArray) and np.ma.is_masked(value)
    texts = array.dtype.kind == "O" and any(isinstance(each, str | bytes | complex) for each in array.flat)
    if array.dtype.kind not in "biufO" or masked or texts:
        raise TypeError(f"not real numbers but {array.dtype}{', some of them masked' * masked}")
    with np.errstate(over="ignore"):  # of numbers of more precision; they become infinite
        return array.astype(np.float64, copy=False)


def finite_array(value, shape, name) -> np.ndarray:
    """`value` as a new float64 array of the given shape, or ValueError saying what it is and what it should be."""
    try:
        array = np.array(as_floats(value), order="C")
    except (TypeError, ValueError, OverflowError, RecursionError) as error:
        why = f" ({error})" if hasattr(value, "requires_grad") else ""  # torch's own words
        raise ValueError(f"{name} is {value!r}{why}; give finite numbers of shape {shape}") from error
    if array.shape != tuple(shape):
        raise ValueError(f"{name} has shape {array.shape}; give shape {tuple(shape)}")
    if not np.isfinite(array).all():
        where = tuple(int(k) for k in np.argwhere(~np.isfinite(array))[0])
        raise ValueError(f"{name} is {array[where]} at {where}; give finite numbers")
    return array


def positive_array(value, shape, name, zero=False) -> np.ndarray:
    """As `finite_array`, and every element positive (or zero, where `zero` allows it)."""
    array = finite_array(value, shape, name)
    bad = array < 0 if zero else array <= 0
    if bad.any():
        where = tuple(int(k) for k in np.argwhere(bad)[0])
        raise ValueError(f"{name} is {array[where]} at {where}; give {'zero or ' if zero else ''}positive numbers")
    return array


def node_array(value, width, num_nodes, name) -> np.ndarray:
    """`value` as an int64 array (K, width) of existing node numbers, or ValueError."""
    array = np.array(value)
    if array.size == 0:
        return np.zeros((0, width), dtype=np.int64)
    if array.ndim != 2 or array.shape[1] != width or array.dtype.kind not in "iu":
        raise ValueError(f"{name} have shape {array.shape} and type {array.dtype}; give whole numbers (K, {width})")
    if array.min() < 0 or array.max() >= num_nodes:
        bad = int(array[(array < 0) | (array >= num_nodes)][0])
        raise ValueError(f"{name} name node {bad}, which is missing; nodes are numbered 0 to {num_nodes - 1}")
    return np.ascontiguousarray(array, dtype=np.int64)


def fits_memory(count: int, each: int, what: str) -> None:
    """Raise ValueError if `count` of something, `each` bytes large, are more than this process may have of memory."""
    memory = available_memory()
    if memory is not None and count * each > memory:
        raise ValueError(
            f"{what} is {count}, which takes {real(count * each) / 2**30:.3g} GiB; this machine has "
            f"{memory / 2**30:.3g} GiB for this program: give at most {memory // (2 * each)}"
        )


@cache
def available_memory(root: Path = Path("/")) -> int | None:
    """Bytes of memory of this machine, or fewer where the control groups of this process (containers) allow fewer.

    None if the system does not tell.

    Args:
        root: of the file system.
    """
    sizes, groups = [], []
    with suppress(AttributeError, ValueError, OSError):  # no such question on this system
        sizes.append(os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE"))
    with suppress(OSError):
        groups = (root / "proc/self/cgroup").read_text().splitlines()
    for group in groups:
        _, controllers, path = group.split(":", 2)
        if controllers and "memory" not in controllers.split(","):
            continue
        place, name = ("", "memory.max") if not controllers else ("memory", "memory.limit_in_bytes")
        folder = PurePosixPath(path.lstrip("/"))
        for each in (folder, *folder.parents):  # each may allow less than those within it
            with suppress(OSError, ValueError):  # "max" is no number
                sizes.append(int((root / "sys/fs/cgroup" / place / each / name).read_text()))
    return min(sizes, default=None)


class Settled:
    """What is made once: the attributes that `SETTLED` names cannot be given another value from outside."""

    SETTLED: tuple[str, ...] = ()

    def __setattr__(self, name, value):
        if name in self.SETTLED and hasattr(self, name):
            raise AttributeError(f"{name} of a {type(self).__name__} is settled when it is made; make another one")
        super().__setattr__(name, value)

    def _settle_anew(self, **values) -> None:
        """Give such attributes other values after all."""
        for name, value in values.items():  # attributes are looked up faster while no `__dict__` was asked for
            object.__setattr__(self, name, value)


def frozen(record):
    """`record`, an array or a record of arrays, tuples and dictionaries of them, with all of them read-only."""
    if isinstance(record, np.ndarray):
        record.flags.writeable = False
    else:
        parts = record if isinstance(record, tuple) else vars(record).values() if hasattr(record, "__dict__") else ()
        for part in record.values() if isinstance(record, dict) else parts:
            frozen(part)
    return record


def own(state: dict, sample: np.ndarray) -> dict:
    """What was in a pickle, copied if its arrays, of which `sample` is one, lie in memory that is only lent.

    An object store, such as that of Ray, gives out arrays that must not be written to.
    """
    return state if sample.flags.writeable else copy.deepcopy(state)
