"""Kernels: their notation, the forces in every kind of lanes, and whole steps, compiled and as plain Python."""

import copy
import json
import os
import pickle
import subprocess
import sys
from functools import cache
from itertools import product
from pathlib import Path

import numpy as np
import pytest
import small_bodies
from hypothesis import given, settings
from hypothesis import strategies as st
from moving import Block, close, tiered
from pages import ROOT
from small_bodies import ALL

from fish_env import TASKS
from fish_env.envs import FishVectorEnv
from fish_env.kernels import simd
from fish_env.kernels.compile import kernel, njit
from fish_env.kernels.simd import Kind, Pack, cross, dot, fma, select, sqrt, vec3
from fish_env.physics import forces
from fish_env.physics.body import fix
from fish_env.physics.elements import make_sections
from fish_env.physics.linalg import ldlt
from fish_env.soft.forces.tets import MANY_STAGES

# The notation

KINDS = {
    f"{lanes}-{dtype}": Kind(lanes, dtype) for dtype in ("float64", "float32") for lanes in ("xyz", 1, 2, 4, 8, 16, 32)
}
each_kind = pytest.mark.parametrize("name", tiered(KINDS, ("xyz-float64", "1-float64", "8-float64", "16-float32")))
each_way = pytest.mark.parametrize("compiled", [True, False], ids=["compiled", "python"])


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
    s[8] = simd.exp(q)
    s[9] = simd.log(abs(r))
    s[10] = fma(q, r, 0.5)
    s[11] = select((q > r) & (q > 0.0), q, r)
    s[12] = select((q <= r) | (r < 0.5), q, 0.25)
    s[13] = select(q >= r, q, p.number)
    s[14] = simd.zero(s)
    s[15] = select(simd.nowhere(s), q, r)
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


@each_kind
@each_way
def test_every_operation(name, compiled):
    """Compiled or not, every operation is numpy's, to the rounding of a fused multiply-add."""
    kind = KINDS[name]
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


@each_way
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
    flags, memory = p.flags, simd.floats(p.a)
    flags[0] = simd.any_lane(p.q[0] > 0.0)
    flags[1] = simd.all_lanes(p.q[0] > 0.0)
    flags[2] = simd.lane(p.q[0] > 0.0, simd.block_size(p.q) - 1)
    p.out[0] = simd.lane(p.q[0], 0)
    p.out[1] = memory[0, 1, simd.block_size(p.a) - 1]
    p.out[2] = simd.block_size(p.a)
    memory[0, 0, 0] = 7.0


@each_kind
@each_way
def test_lanes_and_memory(name, compiled):
    """Reductions over lanes, single lanes, and the memory behind vectors."""
    kind = KINDS[name]
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


# Forces

FISH = 16
SUMS = ("add_force", "add_force_cached", "add_inertia", "constrain")
AFTER = {"add_force_cached": ("add_tangent", "add_change", "add_reaction"), "add_system": ("add_tangent",)}
"""What needs what another function has kept."""
BLOCKS = ("add_system", "add_damping")
VELOCITIES = ("decay", "finish")
NUMBERS = ("energy", "loss", "failed")


def with_sections(body):
    """The body with sections of four nodes each, from the foremost on, and the skyline that they need."""
    order, x = np.argsort(-body.position[:, 0], kind="stable"), body.position
    groups = np.array_split(order, len(order) // 4)
    edges = [[max(groups[2], key=lambda i: x[i, 2])], [min(groups[2], key=lambda i: x[i, 2])]]
    outline = np.linspace(0.0, np.ptp(x[:, 0]), 5), np.full(5, 0.05), np.full(5, 0.1)
    sections = make_sections(x, body.mass, groups, edges, outline)
    body = body._replace(sections=sections)
    shape = ldlt.profile_of(body)
    springs = body.springs._replace(entry=ldlt.entries(shape, body.springs.nodes))
    return body._replace(profile=shape, springs=springs)


BODY = fix(with_sections(ALL), [1], "yz")
WORLD = small_bodies.world_with_all(ALL, offset=0.05)._replace(added_mass=np.array([900.0, 700.0]), righting=0.1)
FORCES = forces.loaded(BODY, WORLD)
FUNCTIONS = [
    (name, function)
    for name, module in FORCES.items()
    for function in (*SUMS, *BLOCKS, *VELOCITIES, *NUMBERS, "add_lagged")
    if hasattr(module, function)
]


@cache
def scene():
    """States (W,N,3) m and m/s of FISH fish, bent, some of them broken; rest lengths, what sets them apart; a field."""
    rng = np.random.default_rng(11)
    states = [small_bodies.bent("two layers", rng) for _ in range(FISH)]
    x, v = (np.array(part) for part in zip(*states, strict=True))
    x[3, 18] += [0.0, 0.0, 0.7]  # a torn tetrahedron
    x[5, 8] += 4.0 * (x[5, 0] - x[5, 8])  # through the outer layer
    x[6, 8:16] = x[6, 8:16].mean(axis=0) - 1e-3 * (x[6, 8:16] - x[6, 8:16].mean(axis=0))  # inside out
    x[7, 16:] *= [1.0, 1.0, 1e-9]  # flat
    x[9, 2] = WORLD.anchors.point[0]  # an anchor without a direction
    rest = ALL.springs.rest_length * rng.uniform(0.9, 1.1, (FISH, ALL.springs.rest_length.size))
    apart = np.concatenate([rng.uniform(0.7, 1.4, (FISH, 3)), rng.uniform(-0.5, 0.5, (FISH, 3))], axis=1)
    return x, v, rest, apart, rng.normal(size=x.shape)


def results(name, function, kind) -> dict[str, np.ndarray]:
    """What a function of a force makes of the scene, in blocks of a kind, (W,...), and what needs what it has kept."""
    x, v, rest, apart, y = scene()
    found: dict[str, list] = {}

    def block(p, **numbers):
        q = p + kind.width
        return Block((name,), BODY, WORLD, kind, rest[p:q], apart[p:q], h=0.01, **numbers).set(x[p:q], v[p:q])

    for p in range(0, FISH, kind.width):
        one, y_part = block(p, factor=1.2, least=0.1), y[p : p + kind.width]
        if function == "add_lagged":
            made = one.lagged()
        elif function in NUMBERS:
            made = {function: np.reshape(one.number(function), -1)}
        elif function in SUMS:
            made = {function: one.add(function, f=y_part)}
        else:
            made = {function: (one.blocks if function in BLOCKS else one.velocities)(function)}
        for after in AFTER.get(function, ()):
            if hasattr(FORCES[name], after):
                made[f"{function}, {after}"] = one.add(after, f=y_part if after == "add_reaction" else 0.0, v=y_part)
        if name == "tets" and function == "add_force_cached":  # which keeps something else for many stages
            many = block(p, stages=MANY_STAGES)
            many.add(function)
            made["add_tangent of many stages"] = many.add("add_tangent", v=y_part)
        for key, value in made.items():
            found.setdefault(key, []).extend(value if kind.width > 1 or function in NUMBERS else value[None])
    return {key: np.array(value) for key, value in found.items()}


def all_of(name, kind) -> dict[str, np.ndarray]:
    """The results of all functions of a force."""
    return {key: value for _, function in CHOSEN[name] for key, value in results(name, function, kind).items()}


NAMES = tuple(FORCES)
LANES = ("xyz", 1, 4)
CHOSEN = {name: [pair for pair in FUNCTIONS if pair[0] == name] for name in NAMES}


@cache
def alone(name):
    """The results of the kernels of one lane."""
    return all_of(name, Kind(1))


def pairs_of(names, kinds, quick):
    """Parameters: every force in every kind; slow, but for those pairs that are quick."""
    return [pytest.param(*pair, marks=[pytest.mark.slow] * (pair not in quick)) for pair in product(names, kinds)]


@pytest.mark.parametrize(("name", "lanes"), pairs_of(NAMES, ("xyz", 4, 8, 16), [("springs", "xyz"), ("water", 8)]))
def test_same_bits_in_every_kind(name, lanes):
    """What a fish gets does not depend on the lanes it is worked out in, nor on the fish beside it, to the last bit."""
    found, wanted = all_of(name, Kind(lanes)), alone(name)
    assert found.keys() == wanted.keys()
    for key, value in wanted.items():
        np.testing.assert_array_equal(found[key], value, err_msg=key)
        assert np.any(value), key


@pytest.mark.parametrize(("name", "lanes"), pairs_of(NAMES, ("xyz", 16), [("springs", 16)]))
def test_single_precision(name, lanes):
    """In float32 everything is what it is in float64, to single precision; of the fish that have not failed."""
    found, wanted = all_of(name, Kind(lanes, "float32")), alone(name)
    valid = np.setdiff1d(np.arange(FISH), [3, 5, 6, 7, 9])
    for key, value in wanted.items():
        close(found[key][valid].astype(float), value[valid], 3e-5)


# Without the compiler

CASES = {
    **{f"{task}, 1 fish": {"task": task, "num_envs": 1} for task in TASKS},
    "2 fish in 8 lanes": {"num_envs": 2, "lanes": 8, "variation": {"mass": (0.5, 2.0), "current": (0.0, 1.0)}},
    **{
        f"{method} on {body}": {"num_envs": 1, "integrator": method, "body": body, "dt": dt}
        for body, shortest in (("mass_spring", 0.002), ("planar", 0.004), ("two_layer", 0.004))
        for method, dt in (("semi_implicit", shortest), ("linearly_implicit", 0.01), ("rk4", shortest))
    },
}
QUICK = ("swim, 1 fish", "linearly_implicit on planar")


def stepped(options):
    """Observations, rewards and positions of two environment steps, as one row."""
    env = FishVectorEnv(**options, threads=1)
    action = np.random.default_rng(3).uniform(-1.0, 1.0, (2, *env.action_space.shape)).astype(np.float32)
    found = [env.reset(seed=5)[0]]
    for each in action:
        obs, reward, *_ = env.step(each)
        found += [obs, reward]
    found += [env.tank.position, [list(count) for count in env.tank.counters.values()]]
    env.close()
    return np.concatenate([np.ravel(part).astype(float) for part in found])


def run_uncompiled(pairs, cases, path):
    """Write what forces in kinds, and whole steps, give to a file of arrays."""
    np.seterr(all="ignore")  # compiled kernels say nothing either
    found = {case: stepped(CASES[case]) for case in cases}
    for name, lanes in pairs:
        found |= {f"{name} {lanes} {key}": value for key, value in all_of(name, Kind(lanes)).items()}
    np.savez(path, **found)


@pytest.fixture(scope="module")
def uncompiled(request, tmp_path_factory):
    """The results of this run's cases, by name, by a process without the compiler."""
    own = [item for item in request.session.items if item.path == Path(__file__) and "uncompiled" in item.fixturenames]
    given = [item.callspec.params for item in own]
    pairs = [(each["name"], each["lanes"]) for each in given if "lanes" in each]
    path, cases = tmp_path_factory.mktemp("plain") / "results.npz", [each["case"] for each in given if "case" in each]
    environment = os.environ | {
        "NUMBA_DISABLE_JIT": "1",
        "PYTHONPATH": os.pathsep.join([str(ROOT), str(ROOT / "tests")]),
    }
    subprocess.run([sys.executable, __file__, json.dumps([pairs, cases, str(path)])], check=True, env=environment)
    with np.load(path) as found:
        return dict(found)


@pytest.mark.parametrize(
    ("name", "lanes"), pairs_of(NAMES, LANES, [(name, LANES[k % 3]) for k, name in enumerate(NAMES)])
)
def test_forces_without_the_compiler(name, lanes, uncompiled):
    """The same kernels run as plain Python give the same, to rounding: a fused product is rounded twice there."""
    for key, value in all_of(name, Kind(lanes)).items():
        found = uncompiled[f"{name} {lanes} {key}"]
        if key in NUMBERS:
            np.testing.assert_allclose(found, value, rtol=1e-12)
        else:
            close(found, value)


@pytest.mark.parametrize("case", tiered(CASES, QUICK))
def test_steps_without_the_compiler(case, uncompiled):
    """To rounding: a fused product is rounded twice there, observations are of single precision; the same counters."""
    np.testing.assert_allclose(uncompiled[case], stepped(CASES[case]), rtol=1e-4, atol=1e-6)


if __name__ == "__main__":
    run_uncompiled(*json.loads(sys.argv[1]))
