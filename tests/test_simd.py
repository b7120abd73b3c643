"""The notation of kernels means the same for every kind, with the compiler and without, and says what is wrong."""

import copy
import pickle
import subprocess
import sys

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fish_env.kernels import simd
from fish_env.kernels.compile import kernel, njit
from fish_env.kernels.simd import (
    Kind,
    Pack,
    all_lanes,
    any_lane,
    block_size,
    cross,
    dot,
    exp,
    floats,
    fma,
    lane,
    log,
    nowhere,
    select,
    sqrt,
    vec3,
    zero,
)

KINDS = [Kind(lanes, dtype) for dtype in ("float64", "float32") for lanes in ("xyz", 1, 2, 4, 8, 16, 32)]


@njit
def everything(p):
    """Every operation of the notation: v (V,) vectors and s (S,) numbers are filled."""
    a, b, q, r, v, s = p.a[0], p.b[0], p.q[0], p.r[0], p.v, p.s
    v[0] = a + b
    v[1] = a - b
    v[2] = -a
    v[3] = q * a
    v[4] = a * 1.5
    v[5] = a * b
    v[6] = a / q
    v[7] = cross(a, b)
    v[8] = fma(q, a, b)
    v[9] = fma(a, b, a)
    v[10] = select(q > r, a, b)
    v[11] = vec3(q, 2.0, r)
    v[12] = vec3(a.z, a.x, a.y)
    v[13] = p.row[0] + a
    v[14] = abs(a)
    v[15] = a
    v[15] += vec3(1.0, 2.0, 3.0)
    s[0] = q + r
    s[1] = q - r
    s[2] = q * r
    s[3] = q / r
    s[4] = 1.0 / r
    s[5] = -q
    s[6] = dot(a, b)
    s[7] = sqrt(abs(q))
    s[8] = exp(q)
    s[9] = log(abs(r))
    s[10] = fma(q, r, 0.5)
    s[11] = select((q > r) & (q > 0.0), q, r)
    s[12] = select((q <= r) | (r < 0.5), q, 0.25)
    s[13] = select(q >= r, q, p.number)
    s[14] = zero(s)
    s[15] = select(nowhere(s), q, r)
    s[16] = q
    s[16] -= 2 * r
    s[17] = p.scalar[0] * q


def expected(a, b, q, r, row):
    """The same with numpy, of a, b (3,W), q, r (W,) and row (3,)."""
    one = np.ones_like(q)
    vectors = [
        a + b, a - b, -a, q * a, 1.5 * a, a * b, a / q, np.cross(a, b, axis=0), q * a + b, a * b + a,
        np.where(q > r, a, b), np.stack([q, 2.0 * one, r]), a[[2, 0, 1]], row[:, None] + a, np.abs(a),
        a + np.array([[1.0], [2.0], [3.0]]),
    ]  # fmt: skip
    numbers = [
        q + r, q - r, q * r, q / r, 1 / r, -q, (a * b).sum(axis=0), np.sqrt(np.abs(q)), np.exp(q), np.log(np.abs(r)),
        q * r + 0.5, np.where((q > r) & (q > 0), q, r), np.where((q <= r) | (r < 0.5), q, 0.25),
        np.where(q >= r, q, 0.75), 0 * q, r, q - 2 * r, 3.0 * q,
    ]  # fmt: skip
    return vectors, numbers


def made(kind, a, b, q, r, row) -> Pack:
    """A pack of these values in lanes, and room for results."""
    pack = Pack(
        "test", a=kind.vectors(1), b=kind.vectors(1), q=kind.numbers(1), r=kind.numbers(1), v=kind.vectors(16),
        s=kind.numbers(18), row=kind.rows(row[None]), number=0.75, scalar=kind.scalars([3.0]),
    )  # fmt: skip
    for array, values in ((pack.a, a), (pack.b, b), (pack.q, q), (pack.r, r)):
        if kind.lanes == "dual":
            array.memory[0, ..., :1] = values
        else:
            array.memory.reshape(-1, kind.width)[: values.size // kind.width] = values
    return pack


def drawn(kind, seed=0):
    """Values for `made`, no number near zero or near another."""
    generator = np.random.default_rng(seed)
    a, b = generator.normal(size=(2, 3, kind.width)).astype(kind.dtype)
    q, r = (generator.choice([-1, 1], (2, kind.width)) * generator.uniform(0.3, 2.0, (2, kind.width))).astype(
        kind.dtype
    )
    return a, b, q, r, generator.normal(size=3).astype(kind.dtype)


@pytest.mark.parametrize("kind", KINDS, ids=lambda kind: f"{kind.lanes}-{kind.dtype}")
@pytest.mark.parametrize("compiled", [True, False], ids=["compiled", "python"])
def test_every_operation(kind, compiled):
    """Compiled or not, every operation is numpy's, to the rounding of a fused multiply-add."""
    values = drawn(kind)
    pack = made(kind, *values)
    (everything if compiled else everything.py_func)(pack)
    vectors, numbers = expected(*(np.asarray(value, dtype=np.float64) for value in values))
    tolerance = 1e-14 if kind.dtype == "float64" else 3e-6
    for i, wanted in enumerate(vectors):
        got = pack.v.memory[i].reshape(-1, kind.width)[:3]
        np.testing.assert_allclose(got, wanted, rtol=tolerance, atol=tolerance, err_msg=f"vector {i}")
    for i, wanted in enumerate(numbers):
        np.testing.assert_allclose(pack.s.memory[i], wanted, rtol=tolerance, atol=tolerance, err_msg=f"number {i}")


@pytest.mark.parametrize("compiled", [True, False], ids=["compiled", "python"])
def test_derivatives(compiled):
    """Dual numbers have the bits of plain ones, and with them the derivatives of numpy's operations."""
    kind, generator, h = Kind("dual"), np.random.default_rng(1), np.longdouble(1e-6)
    *values, row = drawn(Kind(1))
    slopes = [generator.normal(size=(*value.shape[:-1], simd.directions(kind.numbers(1)))) for value in values]
    pack, plain = made(kind, *values, row), made(Kind(1), *values, row)
    for name, slope in zip("abqr", slopes, strict=True):
        getattr(pack, name).memory[0, ..., 1:] = slope
    for each in (pack, plain):
        (everything if compiled else everything.py_func)(each)
    found = np.concatenate([pack.v.memory.reshape(48, -1), pack.s.memory])
    np.testing.assert_array_equal(found[:, 0], np.concatenate([plain.v.memory.ravel(), plain.s.memory[:, 0]]))

    def moved(part):
        groups = expected(*(value + part * slope for value, slope in zip(values, slopes, strict=True)), row)
        return np.concatenate([np.broadcast_to(each, (n, 7)) for n, group in zip((3, 1), groups, strict=True)
                               for each in group])  # fmt: skip

    wanted = (moved(h) - moved(-h)) / (2 * h)
    np.testing.assert_allclose(found[:, 1:], wanted.astype(float), rtol=0, atol=1e-10)


@settings(max_examples=30)
@given(seed=st.integers(0, 2**32 - 1))
def test_bits_do_not_depend_on_the_lanes(seed):
    """A lane has the bits that the one fish of a register has, in both precisions."""
    for dtype in ("float64", "float32"):
        wide = Kind(8, dtype)
        a, b, q, r, row = drawn(wide, seed)
        together = made(wide, a, b, q, r, row)
        everything(together)
        for lanes in ("xyz", 1):
            for fish in range(8):
                alone = made(Kind(lanes, dtype), *(value[..., fish : fish + 1] for value in (a, b, q, r)), row)
                everything(alone)
                vectors = alone.v.memory.reshape(16, -1)[:, :3]
                assert vectors.tobytes() == np.ascontiguousarray(together.v.memory[:, :, fish]).tobytes()
                assert alone.s.memory[:, 0].tobytes() == np.ascontiguousarray(together.s.memory[:, fish]).tobytes()


@njit
def looked_at(p):
    """What kernels can ask about a block: its size, any and all lanes, single lanes, raw memory."""
    flags, memory = p.flags, floats(p.a)
    flags[0] = any_lane(p.q[0] > 0.0)
    flags[1] = all_lanes(p.q[0] > 0.0)
    flags[2] = lane(p.q[0] > 0.0, block_size(p.q) - 1)
    p.out[0] = lane(p.q[0], 0)
    p.out[1] = memory[0, 1, block_size(p.a) - 1]
    p.out[2] = block_size(p.a)
    memory[0, 0, 0] = 7.0


@pytest.mark.parametrize("kind", KINDS, ids=lambda kind: f"{kind.lanes}-{kind.dtype}")
@pytest.mark.parametrize("compiled", [True, False], ids=["compiled", "python"])
def test_lanes_and_memory(kind, compiled):
    """Reductions over lanes, single lanes, and the memory behind vectors."""
    q, a = kind.numbers(1), kind.vectors(1)
    for values in (np.full(kind.width, 1.0), np.where(np.arange(kind.width) == 0, 1.0, -1.0)):
        q.memory[:] = values
        a.memory.reshape(1, -1, kind.width)[0, 1] = 5.0 + np.arange(kind.width)
        pack = Pack("test", q=q, a=a, flags=np.zeros(3, bool), out=np.zeros(3))
        (looked_at if compiled else looked_at.py_func)(pack)
        assert pack.flags.tolist() == [True, bool((values > 0).all()), bool(values[-1] > 0)]
        assert pack.out.tolist() == [1.0, 5.0 + kind.width - 1, kind.width]
        assert a.memory.ravel()[0] == 7.0


def test_packs_hold_what_they_name():
    """Arrays stay alive and shared; fields can be replaced by others of their type; copies have memory of their own."""

    @njit
    def doubled(p):
        for i in range(p.inner.x.size):
            p.inner.x[i] *= p.factor

    pack = Pack("outer", inner=Pack("inner", x=np.arange(3.0)), factor=2.0, count=3, flag=True)
    doubled(pack)
    assert pack.inner.x.tolist() == [0.0, 2.0, 4.0]
    pack.set(factor=10.0)
    pack.inner.set(x=np.ones(5))
    doubled(pack)
    assert pack.inner.x.tolist() == [10.0] * 5
    for clone in (copy.deepcopy(pack), pickle.loads(pickle.dumps(pack))):
        doubled(clone)
        assert clone.inner.x.tolist() == [100.0] * 5 and pack.inner.x.tolist() == [10.0] * 5
    with pytest.raises(ValueError, match=r"factor of .* would become int64; give float64"):
        pack.set(factor=1)
    with pytest.raises(TypeError, match="field name is a str; give an array, a pack or a number"):
        Pack("bad", name="x")
    with pytest.raises(ValueError, match="field x is not contiguous in memory"):
        Pack("bad", x=np.zeros((4, 4))[:, ::2])


def test_kernels_run_as_python():
    """A kernel that is called from Python runs as Python, not as machine code it has no entry for."""

    @kernel
    def norm(a):
        return sqrt(dot(a, a))

    assert norm(vec3(3.0, 0.0, 4.0)) == 5.0


@pytest.mark.parametrize(("lanes", "dtype"), [(3, "float64"), ("abc", "float64"), (True, "float64"), (8, "float16")])
def test_kinds_that_are_not_offered(lanes, dtype):
    """A number of lanes or a precision that is not offered is refused, saying what is."""
    with pytest.raises(ValueError, match=r"choose (from 'xyz', 1, 2, 4, 8, 16, 32|'float64' or 'float32')"):
        Kind(lanes, dtype)


def test_mixed_kinds_do_not_compile():
    """Numbers of different lanes or precisions are not mixed by mistake."""

    @njit
    def mixed(p):
        p.a[0] = p.a[0] + p.b[0]

    for one, other in ((Kind(4), Kind(8)), (Kind(8), Kind(8, "float32")), (Kind("xyz"), Kind(4))):
        with pytest.raises(Exception, match="No implementation of function"):
            mixed(Pack("test", a=one.vectors(1), b=other.vectors(1)))


def test_unknown_numba_falls_back():
    """With a numba that the types were not tested with, one lane of plain floats is used, and a warning says so."""
    code = """import numba, warnings
numba.__version__ = "9.9.9"
with warnings.catch_warnings(record=True) as seen:
    warnings.simplefilter("always")
    import fish_env
texts = [str(w.message) for w in seen if "numba" in str(w.message)]
assert any("9.9.9" in t and "0.68" in t for t in texts), texts
tank = fish_env.Tank(fish_env.make_fish(), 20)
assert tank.kind.lanes == 1, tank.kind
try:
    fish_env.Tank(fish_env.make_fish(), 20, lanes=8)
except ValueError as error:
    assert "9.9.9" in str(error) and "0.68" in str(error)
    print("ok")
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.stdout.strip() == "ok", done.stderr
