"""Input validation: arrays of the right shape, finite, positive, with valid node numbers."""

import copy
import math
import os
from collections.abc import Callable, Collection, Iterable, Iterator
from contextlib import contextmanager, suppress
from difflib import get_close_matches
from functools import cache, wraps
from inspect import signature
from numbers import Real
from pathlib import Path
from typing import Any, TypeGuard, TypeVar

import numpy as np

F = TypeVar("F", bound=Callable)


class UnknownOptionError(ValueError, TypeError):
    """A keyword that a function does not have: a TypeError as well, as other libraries expect."""


def similar(name: object, names: Iterable[str]) -> str:
    """Hint for a message: the one of the names that an unknown name resembles, if there is one."""
    close = get_close_matches(name, names, 1) if isinstance(name, str) else []
    return f" (did you mean {close[0]!r}?)" if close else ""


def check_names(said: str, allowed: Collection[str], *given: object, error: type[ValueError] = ValueError) -> None:
    """Raise an error, which begins with `said` and suggests the nearest name, unless all names given are allowed."""
    for name in given:
        if not isinstance(name, str) or name not in allowed:
            raise error(f"{said} {name!r}{similar(name, allowed)}; choose from {', '.join(map(repr, allowed))}")


def checked_keywords(function: F) -> F:
    """Decorate a function so that a keyword that it does not have raises UnknownOptionError with a suggestion."""
    allowed = [name for name in signature(function).parameters if name != "self"]
    said = f"{function.__qualname__.removesuffix('.__init__')} has no keyword"

    @wraps(function)
    def call(*args: Any, **given: Any) -> Any:
        check_names(said, allowed, *given, error=UnknownOptionError)
        return function(*args, **given)

    return call  # pyright: ignore[reportReturnType]


def is_whole(value) -> TypeGuard[int]:
    """Return True if `value` is an integer of Python or numpy; Booleans and numpy's durations are not."""
    return isinstance(value, int | np.integer) and not isinstance(value, bool | np.timedelta64)


def real(value) -> float:
    """Convert `value` to a float: nan if it is no real number, infinite if it is beyond the largest float."""
    if not isinstance(value, Real):
        return math.nan
    try:
        return float(value)
    except OverflowError:  # a whole number or a fraction
        return math.inf


@contextmanager
def representable(what: str) -> Iterator[None]:
    """Raise ValueError if products or quotients of valid numbers overflow in this block."""
    try:
        with np.errstate(over="raise", divide="raise", invalid="raise"):
            yield
    except (OverflowError, FloatingPointError, ZeroDivisionError) as error:
        raise ValueError(f"{what} follows from numbers that are too large or too small together: {error}") from error


def as_floats(value) -> np.ndarray:
    """Convert `value` to a float64 array, such an array to itself; TypeError, ValueError or OverflowError else."""
    # TypeError also for what numpy would convert silently: text, dates, complex numbers, masked values, and tensors of
    # torch that require a gradient, which would be lost here.
    if getattr(getattr(value, "dtype", None), "is_floating_point", False):  # of torch, perhaps one that numpy lacks
        value = value.double()
    try:
        array = np.asarray(value)
    except RuntimeError as error:  # torch's
        raise TypeError(str(error)) from error
    masked = isinstance(value, np.ma.MaskedArray) and np.ma.is_masked(value)
    texts = array.dtype.kind == "O" and any(isinstance(each, str | bytes | complex) for each in array.flat)
    if array.dtype.kind not in "biufO" or masked or texts:
        raise TypeError(f"not real numbers but {array.dtype}{', some of them masked' * masked}")
    with np.errstate(over="ignore"):  # large numbers of higher precision become infinite
        return array.astype(np.float64, copy=False)


def finite_array(value, shape, name) -> np.ndarray:
    """Convert `value` to a new, finite float64 array of the given shape; ValueError states actual and valid values."""
    try:
        array = np.array(as_floats(value), order="C")
    except (TypeError, ValueError, OverflowError, RecursionError) as error:
        why = f" ({error})" if hasattr(value, "requires_grad") else ""  # the message of torch
        raise ValueError(f"{name} is {value!r}{why}; give finite numbers of shape {shape}") from error
    if array.shape != tuple(shape):
        raise ValueError(f"{name} has shape {array.shape}; give shape {tuple(shape)}")
    if not np.isfinite(array).all():
        where = tuple(int(k) for k in np.argwhere(~np.isfinite(array))[0])
        raise ValueError(f"{name} is {array[where]} at {where}; give finite numbers")
    return array


def positive_array(value, shape, name, zero=False) -> np.ndarray:
    """Convert `value` like `finite_array`, and require every element to be positive (or zero, if `zero` is True)."""
    array = finite_array(value, shape, name)
    bad = array < 0 if zero else array <= 0
    if bad.any():
        where = tuple(int(k) for k in np.argwhere(bad)[0])
        raise ValueError(f"{name} is {array[where]} at {where}; give {'zero or ' if zero else ''}positive numbers")
    return array


def node_array(value, width, num_nodes, name) -> np.ndarray:
    """Convert `value` to an int64 array (K, width) of valid node numbers; ValueError otherwise."""
    array = np.array(value)
    if array.size == 0:
        return np.zeros((0, width), dtype=np.int64)
    if array.ndim != 2 or array.shape[1] != width or array.dtype.kind not in "iu":
        raise ValueError(f"{name} have shape {array.shape} and type {array.dtype}; give whole numbers (K, {width})")
    if array.min() < 0 or array.max() >= num_nodes:
        bad = int(array[(array < 0) | (array >= num_nodes)][0])
        raise ValueError(f"{name} contain node {bad}; valid numbers are 0 to {num_nodes - 1}")
    return np.ascontiguousarray(array, dtype=np.int64)


def check_numbers(name: str, array, shape: tuple, below: int, lowest: int = 0) -> None:
    """Raise ValueError unless `array` contains whole numbers from `lowest` to `below` - 1; None in the shape is any."""
    array = np.asarray(array)
    fits = array.ndim == len(shape) and all(n is None or n == m for n, m in zip(shape, array.shape, strict=True))
    if not fits or array.dtype.kind not in "iu":
        wanted = ", ".join("any" if n is None else str(n) for n in shape)
        raise ValueError(f"{name} has shape {array.shape} and type {array.dtype}; give whole numbers ({wanted})")
    outside = array[(array < lowest) | (array >= below)]
    if outside.size:
        raise ValueError(f"{name} contains {outside[0]}; valid numbers are {lowest} to {below - 1}")


def check_record(prefix: str, record, patterns: dict[str, str], **sizes: int) -> None:
    """Raise ValueError unless the arrays of a record have the shapes and the numbers of their patterns."""
    # Patterns have, for names such as "springs.nodes", the sizes of the axes. A letter is one size in all of them, that
    # of the first array unless it is in `sizes`. "< N" after them asks for whole numbers below N, "from -1" for numbers
    # from -1 on instead of 0. "?" before them allows None. Fields of a part that is None are left out.
    for name, pattern in patterns.items():
        part, _, field = name.rpartition(".")
        holder = getattr(record, part) if part else record
        if holder is None or (getattr(holder, field) is None and pattern.startswith("?")):
            continue
        value = getattr(holder, field)
        axes, _, limits = pattern.lstrip("?").partition("<")
        wanted, shape = axes.split(), np.shape(value)
        if len(wanted) == len(shape):
            sizes = dict(zip(wanted, shape, strict=True)) | sizes
        expected = tuple(int(axis) if axis.isdigit() else sizes.get(axis) for axis in wanted)
        if limits:
            bound, _, lowest = limits.partition("from")
            bound = bound.strip()
            below = int(bound) if bound.isdigit() else sizes[bound]
            check_numbers(prefix + name, value, expected, below, int(lowest or 0))
        else:
            finite_array(value, shape if None in expected else expected, prefix + name)


def fits_memory(count: int, each: int, what: str) -> None:
    """Raise ValueError if `count` items of `each` bytes exceed the memory that this process may use."""
    memory = available_memory()
    if memory is not None and count * each > memory:
        raise ValueError(
            f"{what} is {count}, which takes {real(count * each) / 2**30:.3g} GiB; this machine has "
            f"{memory / 2**30:.3g} GiB for this program: give at most {memory // (2 * each)}"
        )


@cache
def available_memory(groups: Path = Path("/sys/fs/cgroup")) -> int | None:
    """Bytes of memory of this machine, or of the container around this process; None if the system does not say."""
    sizes = []
    with suppress(AttributeError, ValueError, OSError):  # not available on this system
        sizes.append(os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE"))
    for name in ("memory.max", "memory/memory.limit_in_bytes"):
        with suppress(OSError, ValueError):  # "max" is not a number
            sizes.append(int((groups / name).read_text("utf-8")))
    return min(sizes, default=None)


class ReadOnly:
    """Base class whose attributes in `READ_ONLY` are read-only after construction."""

    READ_ONLY: tuple[str, ...] = ()

    def __setattr__(self, name, value):
        if name in self.READ_ONLY and hasattr(self, name):
            raise AttributeError(f"{type(self).__name__}.{name} is read-only; create a new {type(self).__name__}")
        super().__setattr__(name, value)

    def _set_read_only(self, **values) -> None:
        """Replace the values of read-only attributes."""
        for name, value in values.items():  # reading `__dict__` would slow down later attribute access
            object.__setattr__(self, name, value)


def frozen(record):
    """Return `record`, an array or a nested record of arrays, tuples and dictionaries, with all arrays read-only."""
    if isinstance(record, np.ndarray):
        record.flags.writeable = False
    else:
        parts = record if isinstance(record, tuple) else vars(record).values() if hasattr(record, "__dict__") else ()
        for part in record.values() if isinstance(record, dict) else parts:
            frozen(part)
    return record


def own(state: dict, sample: np.ndarray) -> dict:
    """Return the state of a pickle, copied if its arrays, such as `sample`, are in read-only memory."""
    # An object store, such as that of Ray, returns read-only arrays.
    return state if sample.flags.writeable else copy.deepcopy(state)
