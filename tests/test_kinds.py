"""Every function of every force in kernels of every kind: the same bits in float64, and the same with no compiler."""

import os
import subprocess
import sys
from functools import cache
from pathlib import Path

import numpy as np
import pytest
import small_bodies
from moving import Block, close
from small_bodies import ALL

from fish_env.kernels.simd import Kind
from fish_env.physics import forces
from fish_env.physics.body import fix, joined
from fish_env.physics.elements import make_sections
from fish_env.physics.linalg import ldlt

FISH = 16
SUMS = ("add_force", "add_force_cached", "add_inertia", "constrain")
AFTER = {"add_force_cached": ("add_tangent", "add_change", "add_reaction"), "add_system": ("add_tangent",)}
"""What needs what another function has kept."""
BLOCKS = ("add_system", "add_damping")
VELOCITIES = ("decay", "finish")
NUMBERS = ("energy", "loss", "failed")
FUNCTIONS = [
    (name, function)
    for name, module in forces.FORCES.items()
    for function in (*SUMS, *BLOCKS, *VELOCITIES, *NUMBERS, "add_lagged")
    if hasattr(module, function)
]


def with_sections(body):
    """The body with sections of four nodes each, from the foremost on, and the skyline that they need."""
    order, n = np.argsort(-body.position[:, 0], kind="stable"), len(body.mass)
    groups, x = np.array_split(order, n // 4), body.position
    edges = [[max(groups[2], key=lambda i: x[i, 2])], [min(groups[2], key=lambda i: x[i, 2])]]
    outline = np.linspace(0.0, np.ptp(x[:, 0]), 5), np.full(5, 0.05), np.full(5, 0.1)
    sections = make_sections(x, body.mass, groups, edges, outline)
    shape = ldlt.profile(joined(body.springs.nodes, body.faces.nodes, body.tets, sections), n)
    springs = body.springs._replace(entry=ldlt.entries(shape, body.springs.nodes))
    return body._replace(sections=sections, profile=shape, springs=springs)


BODY = fix(with_sections(ALL), [1], "yz")
WORLD = small_bodies.world_with_all(ALL, offset=0.05)._replace(added_mass=np.array([900.0, 700.0]), righting=0.1)


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
            if hasattr(forces.FORCES[name], after):
                made[f"{function}, {after}"] = one.add(after, f=y_part if after == "add_reaction" else 0.0, v=y_part)
        if name == "tets" and function == "add_force_cached":  # which keeps something else for many stages
            many = block(p, stages=forces.tets.MANY_STAGES)
            many.add(function)
            made["add_tangent of many stages"] = many.add("add_tangent", v=y_part)
        for key, value in made.items():
            found.setdefault(key, []).extend(value if kind.width > 1 or function in NUMBERS else value[None])
    return {key: np.array(value) for key, value in found.items()}


def everything(name, kind) -> dict[str, np.ndarray]:
    """The results of all functions of a force."""
    return {key: value for _, function in CHOSEN[name] for key, value in results(name, function, kind).items()}


NAMES = tuple(forces.FORCES)
LANES = ("xyz", 1, 4)  # without the compiler
CHOSEN = {name: [pair for pair in FUNCTIONS if pair[0] == name] for name in NAMES}


@cache
def alone(name):
    """The results of the kernels of one lane."""
    return everything(name, Kind(1))


def chosen_kinds(kinds, chosen):
    """Every force in every kind; slow, but for the kind that `chosen` names for the force of a number."""
    return [pytest.param(name, lanes, marks=() if chosen(k) == lanes else pytest.mark.slow)
            for k, name in enumerate(NAMES) for lanes in kinds]  # fmt: skip


@pytest.mark.parametrize(("name", "lanes"), chosen_kinds(("xyz", 4, 8, 16), lambda k: ("xyz", 8)[k % 2]))
def test_same_bits_in_every_kind(name, lanes):
    """What a fish gets does not depend on the lanes it is worked out in, nor on the fish beside it, to the last bit."""
    found, wanted = everything(name, Kind(lanes)), alone(name)
    assert found.keys() == wanted.keys()
    for key, value in wanted.items():
        np.testing.assert_array_equal(found[key], value, err_msg=key)
        assert np.any(value), key


@pytest.mark.parametrize(
    ("name", "lanes"), chosen_kinds(("xyz", 16), lambda k: 16 if NAMES[k] == "green_lagrange" else None)
)
def test_single_precision(name, lanes):
    """In float32 everything is what it is in float64, to single precision; of the fish that have not failed."""
    found, wanted = everything(name, Kind(lanes, "float32")), alone(name)
    valid = np.setdiff1d(np.arange(FISH), [3, 5, 6, 7, 9])
    for key, value in wanted.items():
        close(found[key][valid].astype(float), value[valid], 3e-5)


@pytest.fixture(scope="module")
def uncompiled(tmp_path_factory):
    """The results of kernels of one and of four lanes without the compiler, by name."""
    path, here = tmp_path_factory.mktemp("plain") / "results.npz", Path(__file__).parent
    environment = os.environ | {"NUMBA_DISABLE_JIT": "1", "PYTHONPATH": f"{here}{os.pathsep}{here.parent}"}
    subprocess.run([sys.executable, __file__, str(path)], check=True, env=environment)
    with np.load(path) as found:
        return dict(found)


@pytest.mark.parametrize("lanes", LANES)
@pytest.mark.parametrize("name", NAMES)
def test_without_the_compiler(name, lanes, uncompiled):
    """The same kernels run as plain Python give the same, to rounding: a fused product is rounded twice there."""
    for key, value in alone(name).items():
        found = uncompiled[f"{name} {lanes} {key}"]
        if key in NUMBERS:
            np.testing.assert_allclose(found, value, rtol=1e-12)
        else:
            close(found, value)


if __name__ == "__main__":
    np.seterr(all="ignore")  # compiled kernels say nothing either
    found = {(name, lanes): everything(name, Kind(lanes)) for name in NAMES for lanes in LANES}
    np.savez(sys.argv[1], **{f"{name} {lanes} {key}": value for (name, lanes), results in found.items()
                             for key, value in results.items()})  # fmt: skip
