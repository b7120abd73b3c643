"""Compiled code is never older than its source: whatever a kernel is made of, and however that is edited."""

import importlib.util
import sys
import warnings

import numpy as np
import pytest
from fuzzing import examples
from hypothesis import assume, given
from hypothesis import strategies as st
from numba import njit as plain_njit

from fish_env.kernels import cache as _cache
from fish_env.kernels.compile import kernel, njit
from fish_env.kernels.fingerprint import UnknownValueError, fingerprint

NUMBERS = st.sampled_from([0.0, -0.0, 1.0, 2.0, 30.0, 60.0, 1e-300, 1.0 + 2**-52, float("inf"), float("nan")])
WHOLE = st.integers(-3, 3)


@st.composite
def arrays(draw):
    """An expression for an array: small or large, of some type and order, one number of it drawn."""
    size, dtype = draw(st.sampled_from([1, 4, 6000])), draw(st.sampled_from(["float64", "float32", "int64", "uint8"]))
    place, value = draw(st.integers(0, size - 1)), draw(WHOLE.map(abs))
    shape, order = draw(st.sampled_from([(size,), (1, size), (size, 1)])), draw(st.sampled_from("CF"))
    digits = draw(st.sampled_from([0.0, 1e-12])) if dtype == "float64" else 0
    return (f"np.where(np.arange({size}) == {place}, {value} + {digits}, 7).astype('{dtype}')"
            f".reshape({shape}, order='{order}')")  # fmt: skip


SCALARS = st.one_of(
    NUMBERS.map(lambda x: f"float('{x}')"),
    WHOLE.map(str),
    st.booleans().map(str),
    st.tuples(WHOLE, WHOLE).map(lambda z: f"complex{z}"),
    st.tuples(st.sampled_from(["float64", "float32", "int8", "uint16", "complex64"]), st.integers(0, 3)).map(
        lambda pair: f"np.{pair[0]}({pair[1]})"
    ),
)
"""Expressions for numbers that kernels take."""
VALUES = st.one_of(
    arrays().map(lambda text: (text, "np.sum(K) + 100.0 * K.argmin() + K.ndim + 0.1 * K.itemsize")),
    SCALARS.map(lambda text: (text, "K * 2.0")),
    SCALARS.map(lambda text: (f"(1.0, ({text}, 2))", "K[1][0] * 2.0 + K[0]")),
    st.tuples(SCALARS, SCALARS).map(lambda pair: (f"Pair({pair[0]}, {pair[1]})", "K.a * 2.0 + K.b")),
    st.sampled_from(["low", "high", "höher", ""]).map(
        lambda text: (repr(text), "1.0 if K == 'high' else len(K) + 2.0")
    ),
    st.integers(0, 2).map(lambda number: (f"Gear({number})", "K.value * 2.0")),
    st.integers(0, 2).map(lambda number: (f"Level({number})", "K.value * 3.0")),
)
"""Pairs: an expression for a value K of a kernel, and one for a number that follows from it."""

HEAD = """
import enum
from collections import namedtuple
import numpy as np
from fish_env.kernels.compile import kernel, njit
class Gear(enum.Enum):
    FIRST, SECOND, THIRD = 0, 1, 2
class Level(enum.IntEnum):
    LOW, MIDDLE, HIGH = 0, 1, 2
Pair = namedtuple("Pair", "a b")
"""
INNER = "\ndef inner(x):\n    return x * ({use})\n"
CALLED = "@njit\ndef call(x):\n    return inner(x)\n"
WAYS = {
    "global": "K = {value}\n@njit" + INNER.replace("inner", "call"),
    "global of a called kernel": "K = {value}\n@kernel" + INNER + CALLED,
    "global of another library's kernel": "import numba\nK = {value}\n@numba.njit" + INNER + CALLED,
    "closure": "def make(K):\n    @njit\n    def call(x):\n        return x * ({use})\n    return call\n"
    "call = make({value})\n",
    "closure of a called kernel": "def make(K):\n    @kernel\n    def inner(x):\n        return x * ({use})\n"
    "    return inner\ninner = make({value})\n" + CALLED,
    "inner function": "K = {value}\n@njit\ndef call(x):\n    def inner(y):\n        return y * ({use})\n"
    "    return inner(x)\n",
    "lambda": "K = {value}\n@njit\ndef call(x):\n    f = lambda y: y * ({use})\n    return f(x)\n",
    "comprehension": "K = {value}\n@njit\ndef call(x):\n    return [x * ({use}) for _ in range(2)][1]\n",
    "module": "import types\nm = types.ModuleType('m')\nm.K = {value}\n@njit\ndef call(x):\n    K = m.K\n"
    "    return x * ({use})\n",
}
"""Ways in which a kernel comes by a value."""
NUMBERED = {
    "default": "@njit\ndef call(x, k={value}):\n    return x * k\n",
    "default of a called kernel": "@kernel\ndef inner(x, k={value}):\n    return x * k\n" + CALLED,
    "constant of an inner function": "@njit\ndef call(x):\n    def inner(y):\n        return y * {value}\n"
    "    return inner(x)\n",
    "constant of a lambda": "@njit\ndef call(x):\n    return (lambda y: y * {value})(x)\n",
    "constant of a comprehension": "@njit\ndef call(x):\n    return [x * {value} for _ in range(2)][1]\n",
    "member of an enumeration": "class Gear(enum.Enum):\n    FIRST = {value}\n@njit\ndef call(x):\n"
    "    return x * Gear.FIRST.value\n",
    "default of a named tuple": "from typing import NamedTuple\nclass P(NamedTuple):\n    k: float = {value}\n"
    "P0 = P()\n@njit\ndef call(x):\n    return x * P0.k\n",
}
"""The same for plain numbers."""


@pytest.fixture(scope="module", autouse=True)
def folder(tmp_path_factory):
    """A folder of compiled code of this module's own."""
    before, _cache._FOLDER = _cache._FOLDER, str(tmp_path_factory.mktemp("kernels"))
    yield
    _cache._FOLDER = before


def loaded(path, text):
    """The module of a file as another process would have it, its kernels not compiled yet."""
    path.write_text(text)
    name = "edited"
    spec = importlib.util.spec_from_file_location(name, path)
    sys.modules[name] = module = importlib.util.module_from_spec(spec)
    exec(compile(text, str(path), "exec"), module.__dict__)
    return module


def python_of(text, x):
    """What the text means without a compiler."""
    plain = text.replace("from fish_env.kernels.compile import kernel, njit", "kernel = njit = lambda f: f")
    plain = plain.replace("@numba.njit", "@njit")
    space = {"__name__": "plain"}
    with np.errstate(all="ignore"), warnings.catch_warnings():
        warnings.simplefilter("ignore")
        exec(plain, space)
        return space["call"](x)


def is_right(path, text, x=3.0):
    """Check what the compiled text makes of a number, and return the module."""
    module = loaded(path, text)
    wanted, found = python_of(text, x), module.call(x)
    np.testing.assert_allclose(found, wanted, rtol=1e-14)
    if wanted == 0.0 and not isinstance(wanted, complex | np.complexfloating):
        assert np.signbit(found) == np.signbit(wanted)
    return module


@given(way=st.sampled_from(list(WAYS)), values=st.lists(VALUES, min_size=2, max_size=3))
@examples(30)
def test_values_are_seen(tmp_path_factory, way, values):
    """Whatever value a kernel comes by in whatever way, compiled code is of the value that it has now."""
    path = tmp_path_factory.mktemp("edited") / "edited.py"
    assume(way != "module" or not any("arange" in value for value, _ in values))  # numba takes no arrays of modules
    for value, use in (*values, values[0]):
        is_right(path, HEAD + WAYS[way].format(value=value, use=use))


@given(way=st.sampled_from(list(NUMBERED)), values=st.lists(st.sampled_from(["1.0", "2.0", "3", "-0.0", "True"]),
                                                            min_size=2, max_size=3))  # fmt: skip
@examples(15)
def test_numbers_are_seen(tmp_path_factory, way, values):
    """So it is for defaults, constants of nested functions and members of enumerations."""
    path = tmp_path_factory.mktemp("edited") / "edited.py"
    for value in (*values, values[0]):
        is_right(path, HEAD + NUMBERED[way].format(value=value))


TEXTS = {
    "function of numpy": ("np.sin(x)", "np.cos(x)"),
    "operator": ("x + 2.0", "x - 2.0"),
    "attribute": ("np.float64(x).real", "np.float64(x).imag"),
    "order of arguments": ("np.arctan2(x, 2.0)", "np.arctan2(2.0, x)"),
    "set": ("1.0 if int(x) in (1, 2, 3) else 0.0", "1.0 if int(x) in (1, 2, 4) else 0.0"),
    "type": ("np.float32(x / 7.0)", "np.float64(x / 7.0)"),
}


@pytest.mark.parametrize("name", TEXTS)
def test_code_is_seen(tmp_path, name):
    """A change of the code itself is seen where the bytecode stays the same; what has not changed is found."""
    one, other = (HEAD + f"@njit\ndef call(x):\n    return {text}\n" for text in TEXTS[name])
    for text, hits in ((one, 0), (one, 1), (other, 0), (other, 1), (one, 1)):
        module = is_right(tmp_path / "edited.py", text)
        assert sum(module.call.stats.cache_hits.values()) == hits, text


def test_values_are_found_again(tmp_path):
    """A kernel whose values are the same is loaded, whatever stands elsewhere in its file."""
    body = "K = np.arange(6000.0)\n@njit\ndef call(x):\n    return x + K[17]\n"
    assert sum(is_right(tmp_path / "edited.py", HEAD + body).call.stats.cache_hits.values()) == 0
    assert sum(is_right(tmp_path / "edited.py", HEAD + body).call.stats.cache_hits.values()) == 1
    edited = HEAD + body + "other = 3\n\n\ndef unrelated():\n    return other\n"
    assert sum(is_right(tmp_path / "edited.py", edited).call.stats.cache_hits.values()) == 1


OUTER = "def outer(x):\n    return x * {value}\n"
CALLS_OUTER = CALLED.replace("inner", "outer")
ELSEWHERE = {
    "overload": "from numba.extending import overload\n" + OUTER + "@overload(outer)\ndef _(x):\n"
    "    return lambda x: x * {value}\n" + CALLS_OUTER,
    "function of an overload": "from numba.extending import overload\ndef outer(x):\n    raise NotImplementedError\n"
    + OUTER.replace("outer", "inner") + "@overload(outer)\ndef _(x):\n    return inner\n" + CALLS_OUTER,
    "jitable": "from numba.extending import register_jitable\n@register_jitable\n" + OUTER + CALLS_OUTER,
}  # fmt: skip


@pytest.mark.parametrize("name", ELSEWHERE)
def test_overloads_are_seen(tmp_path, name):
    """What numba compiles in place of a function is part of what calls it, and found again."""
    for value, hits in (("2.0", 0), ("2.0", 1), ("5.0", 0)):
        module = loaded(tmp_path / "edited.py", HEAD + ELSEWHERE[name].format(value=value))
        assert module.call(3.0) == 3.0 * float(value)
        assert sum(module.call.stats.cache_hits.values()) == hits


UFUNC = "import numba\n@numba.vectorize\n" + OUTER + CALLS_OUTER


def test_what_is_unknown_is_not_stored(tmp_path):
    """A kernel that calls what cannot be told by value is compiled in every process, and one warning says so."""
    for value in ("2.0", "5.0"):
        _cache.warn_unstored.cache_clear()
        with pytest.warns(RuntimeWarning, match="cannot store the compiled call, .*outer"):
            module = loaded(tmp_path / "edited.py", HEAD + UFUNC.format(value=value))
            assert module.call(3.0) == 3.0 * float(value)
        with pytest.raises(UnknownValueError, match="outer"):
            fingerprint(module.call.py_func)


def test_closures_of_one_process():
    """Kernels that close over arrays which differ in one of 6,000 numbers are told apart, inlined or not."""

    def made(array, how):
        @how
        def inner(i):
            return array[i]

        return inner

    first, second = np.zeros(6000), np.zeros(6000)
    second[3000] = 1.0
    for how in (kernel, njit, plain_njit):
        calls = []
        for array in (first, second):
            calls.append(njit(_calling(made(array, how))))
        assert [call(3000) for call in calls] == [0.0, 1.0]


def _calling(inner):
    def call(i):
        return inner(i)

    return call


def test_keyword_defaults():
    """A default that only a keyword replaces, which numba takes in no call yet, is seen as well."""

    def made(k):
        def call(x, *, k=k):
            return x * k

        return call

    assert fingerprint(made(1.0)) == fingerprint(made(1.0)) != fingerprint(made(2.0))


def test_recursion_and_twins():
    """Functions that call themselves have a fingerprint, and one called twice is not taken for another of its name."""

    def made(k):
        @kernel
        def inner(x):
            return k * x

        return inner

    one, other = made(1.0), made(2.0)

    def pair(f, g, h):
        def call(x):
            return f(x) + g(x) + h(x)

        return call

    assert fingerprint(pair(one, other, one)) != fingerprint(pair(one, other, other))

    @plain_njit
    def factorial(n):
        return 1 if n < 2 else n * factorial(n - 1)

    assert len(fingerprint(factorial.py_func)) == 64
