"""What the fuzz tests share: odd values, arrays in odd memory, and how many examples they try.

FISH_ENV_FUZZ=20 tries twenty times as many examples as a usual run does, and others in every run.
"""

import dataclasses
import os
import warnings
from decimal import Decimal
from fractions import Fraction

import gymnasium as gym
import numpy as np
from hypothesis import HealthCheck, settings
from hypothesis import strategies as st

FACTOR = int(os.environ.get("FISH_ENV_FUZZ", "1"))
REFUSED = (ValueError, TypeError, gym.error.Error)
"""What a call may raise: a value that is not allowed, a keyword that there is not, what Gymnasium has a name for."""


def examples(count: int, **options):
    """So many examples, the same ones in every usual run; more, and others, where FISH_ENV_FUZZ asks for it."""
    return settings(
        max_examples=count * FACTOR, derandomize=FACTOR == 1, deadline=None, suppress_health_check=list(HealthCheck),
        **options,
    )  # fmt: skip


def call(function, *args, refused=REFUSED, **keywords):
    """The result of a call, or None if it was refused by an exception that is documented; others are the test's."""
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        warnings.simplefilter("ignore", RuntimeWarning)  # numpy's, of numbers that overflow: outcomes are looked at
        warnings.filterwarnings(
            "ignore", message=".*(a masked element to nan|Using the latest versioned|(will|may) fail on)"
        )
        try:
            return function(*args, **keywords)
        except refused as error:
            assert str(error), f"{function} raised {type(error).__name__} without a word"
            return None


# Odd values

EDGES = [0.0, -0.0, 1.0, -1.0, 0.5, 2.0, 5e-324, 1e-300, 1e-12, 1e12, 1e154, 1e300, 1.7e308, np.inf, -np.inf, np.nan]
WHOLE = [-(10**400), -(2**63), -1, 0, 1, 2, 3, 5, 7, 2**53, 2**63, 2**64, 10**400]
"""None of them is a size that takes long: sizes are small, or larger than any memory."""
RARE = [
    True, np.True_, np.float32(0.2), np.float16(0.2), np.longdouble(0.2), np.int8(2), np.uint64(2**64 - 1),
    Fraction(1, 3), Fraction(10**400), Fraction(1, 10**400), Decimal("0.2"), Decimal("NaN"), 1j, np.complex128(1.0),
    np.datetime64("2001-01-01"), np.timedelta64(1, "s"), np.array(0.2), np.array([0.2]), np.ma.masked,
]  # fmt: skip
THINGS = [
    None, "", "0.2", "xyz", "\0", b"0.2", bytearray(8), [], (), {}, set(), [[]], [1.0, [2.0]], [None], {"a": 1},
    {1: 2}, object(), object, len, range(3), iter([]), slice(None), ..., NotImplemented, ValueError("x"),
    memoryview(b"12345678"), np.array(None), np.array(["a", "b", "c"]), np.zeros(3, "M8[s]"), np.zeros(3, complex),
    np.zeros(0), np.zeros((0, 3)), np.zeros(3, [("a", float)]), np.ma.masked_array([1.0, 2.0, 3.0], [0, 1, 0]),
    np.array([1.0, None, "x"], dtype=object), float, np.float64,
]  # fmt: skip
loop: list = [1.0]
loop.append(loop)
THINGS.append(loop)

numbers = st.one_of(st.sampled_from(EDGES), st.floats(width=64).filter(lambda x: not 1e12 < abs(x) < 1e154),
                    st.sampled_from(WHOLE), st.sampled_from(RARE))  # fmt: skip
DTYPES = ["f8", ">f8", "f4", "f2", "i8", "i4", "u8", "?", "c16", "O", "g", "U3", "S3", "M8[s]", "m8[s]"]


@st.composite
def arrays(draw):
    """Arrays of any type, with up to three axes, in any order, of small or of extreme numbers."""
    shape = tuple(draw(st.lists(st.integers(0, 4), max_size=3)))
    content = np.array(draw(st.lists(st.sampled_from(EDGES), min_size=1, max_size=4)))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        array = np.resize(content, shape).astype(draw(st.sampled_from(DTYPES)))
    return draw(st.sampled_from([array, array.T, array[::-1] if array.ndim else array, array.tolist()]))


odd = st.one_of(st.sampled_from(THINGS), numbers, arrays(), st.lists(numbers, max_size=6), st.tuples(numbers, numbers))


JSON = st.recursive(st.one_of(st.none(), st.booleans(), st.integers(-5, 10**30), st.floats(), st.text(max_size=5)),
                    lambda inner: st.one_of(st.lists(inner, max_size=2), st.dictionaries(st.text(max_size=5), inner,
                                            max_size=2)), max_leaves=4)  # fmt: skip
"""What a JSON file may hold."""


def scaled(array):
    """Near what is allowed: an array of the right shape, one number of it anything."""

    @st.composite
    def one(draw):
        changed = np.array(array, dtype=float)
        if changed.size:
            place = draw(st.integers(0, changed.size - 1))
            changed.flat[place] = draw(st.one_of(st.sampled_from(EDGES), st.floats(-2.0, 2.0)))
        return changed

    return one()


# Arrays in odd memory


def misaligned(array):
    """The same numbers, an odd number of bytes from where their type would have them."""
    raw = np.zeros(array.nbytes + 1, dtype=np.uint8)
    out = raw[1:].view(array.dtype).reshape(array.shape)
    out[...] = array
    assert not out.flags.aligned or array.size == 0
    return out


def read_only(array):
    """The same numbers, not to be written to."""
    out = array.copy()
    out.flags.writeable = False
    return out


def spread(array):
    """The same numbers, every third of a larger array along the last axis, backwards."""
    out = np.full((*array.shape[:-1], 3 * array.shape[-1]), np.nan)[..., ::-3]
    out[...] = array
    return out


LAYOUTS = {
    "Fortran": np.asfortranarray,
    "misaligned": misaligned,
    "read-only": read_only,
    "spread": spread,
    "big-endian": lambda array: array.astype(">f8"),
    "float32": lambda array: array.astype(np.float32),
    "long double": lambda array: array.astype(np.longdouble),
    "objects": lambda array: array.astype(object),
    "lists": lambda array: array.tolist(),
    "masked": np.ma.masked_array,
    "fractions": lambda array: np.array([Fraction(x) for x in array.flat], dtype=object).reshape(array.shape),
    "negative strides": lambda array: np.array(array[::-1])[::-1],
    "matrix": lambda array: array.view(np.recarray) if array.ndim == 0 else array.view(type("Sub", (np.ndarray,), {})),
}
"""Numbers that float32 holds too, as arrays that hold them in another way."""


def single(array):
    """Numbers that float32 holds exactly."""
    return np.asarray(array, dtype=np.float32).astype(float)


# Results


def unsound(value, name="result", infinite=()):
    """Name of the first number in a record, a dictionary or a list that is not finite; None if there is none."""
    if dataclasses.is_dataclass(value):
        value = {field.name: getattr(value, field.name) for field in dataclasses.fields(value)}
    elif hasattr(value, "_asdict"):
        value = value._asdict()
    if isinstance(value, dict):
        parts = value.items()
    elif isinstance(value, tuple | list):
        parts = enumerate(value)
    else:
        kind = isinstance(value, float | np.ndarray | np.floating) and np.asarray(value).dtype.kind == "f"
        return name if kind and not np.isfinite(value).all() else None
    found = (unsound(part, f"{name}.{key}", infinite) for key, part in parts if key not in infinite)
    return next((place for place in found if place), None)
