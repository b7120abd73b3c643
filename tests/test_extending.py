"""Extensions: the blocks of docs/extending.md run, and a force or a method of one's own acts like those of the package.

A block of the page whose title is the name of a file is that file; one that shows a difference is the line that a
table needs.
"""

import importlib
import os
import re
import shutil
import subprocess
import sys
from dataclasses import replace
from types import ModuleType

import numpy as np
import pytest
from moving import FIXED_STEP, tiered
from pages import ROOT, blocks
from scipy.sparse import issparse

import fish_env
from fish_env import INTEGRATORS, Tank
from fish_env.kernels.compile import part
from fish_env.physics import forces
from fish_env.physics.body import fix, make_body
from fish_env.physics.fish import ElasticObject
from fish_env.physics.forces.evaluate import Evaluator
from fish_env.physics.integrators import Integrator, leapfrog_chebyshev
from fish_env.physics.linalg import rates
from fish_env.physics.world import VACUUM

BLOCKS = blocks(ROOT / "docs/extending.md", "python")
FILES = {block.title: block.text for block in BLOCKS if re.fullmatch(r"\w+\.py", block.title)}
LINES = blocks(ROOT / "docs/extending.md", "diff")
KINDS = {"bodies": "minnow", "tasks": "dash", "physics/integrators": "heun", "physics/forces": "soft_floor"}
FISH = 8
SPEEDS = -np.linspace(0.5, 1.0, FISH)
STIFFNESS, MASS = 50.0, 0.02
plain = pytest.mark.usefixtures("kernels")


def module_of(text):
    """The force of the page, or an edited one, as a module of its own."""
    module = ModuleType("soft_floor")
    exec(text, module.__dict__)
    return module


def floor(stiffness=STIFFNESS, **others):
    """A world with the floor of the page at z = 0, N/m."""
    return VACUUM._replace(extra={"soft_floor": forces.FORCES["soft_floor"].SoftFloor(stiffness)}, **others)


# The page


def run(script, folder, package, **variables):
    """Run a program in a process of its own, against a copy of the package; it must end well."""
    (folder / "program.py").write_text(script)
    found = os.environ | {"PYTHONPATH": str(package)} | variables
    command = [sys.executable, str(folder / "program.py")]
    done = subprocess.run(command, env=found, cwd=folder, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_every_block_has_its_place():
    """The page holds a file and a line of a table for each of the four kinds, and every other block is run."""
    assert sorted(FILES) == sorted(f"{name}.py" for name in KINDS.values())
    assert [block.title.split(" in ")[1] for block in LINES] == [f"fish_env/{kind}/__init__.py" for kind in KINDS]
    others = [block for block in BLOCKS if block.title not in FILES]
    assert {block.title for block in others} == {"your own program"}
    assert "The blocks of this page run in order, as one program." in (ROOT / "docs/extending.md").read_text()


USED = """
swimming = gym.make("FishEnv/Swim-v0", body="minnow")
swimming.reset(seed=0)
for _ in range(10):
    assert not swimming.step(swimming.action_space.sample())[2]
assert swimming.action_space.shape == (4,)
assert gym.make("FishEnv/Swim-v0", body="minnow", water="drag").unwrapped.tank.world.added_mass is None
env.reset(seed=0, options={"distance": 0.001, "yaw": 1.0})
terminated = False
while not terminated:
    obs, reward, terminated, truncated, info = env.step(env.action_space.sample())
assert info["speed"] > 0.0 and not info["failure"]
for integrator in ("leapfrog_chebyshev", "heun"):
    tank = fish_env.Tank(make_minnow(), num_fish=3, integrator=integrator, dt=0.0005, water=world)
    tank.position[:, :, 2] -= 0.01
    tank.swim([1.0, -1.0, -1.0, 1.0], 0.01)
    assert tank.alive.all() and (tank.velocity[:, :, 2].mean(axis=1) > 0).all()  # the floor has pushed
"""


@pytest.mark.soft
@pytest.mark.parametrize("compiled", [False, pytest.param(True, marks=pytest.mark.slow)])
def test_in_a_program_of_ones_own(tmp_path, compiled):
    """The files beside a program, the other blocks in their order, and then a use of all four."""
    for name, text in FILES.items():
        (tmp_path / name).write_text(text)
    own = [block.text for block in BLOCKS if block.title not in FILES]
    run("\n\n".join([*own, USED]), tmp_path, ROOT, NUMBA_DISABLE_JIT="0" if compiled else "1")


ADDED = """
import gymnasium as gym, numpy as np, fish_env
from fish_env.physics import forces
from fish_env.physics.body import fix
from fish_env.physics.forces.evaluate import Evaluator

env = gym.make("FishEnv/Dash-v0", body="minnow")
assert gym.spec("FishEnv/Dash-v0").max_episode_steps == 200 and env.action_space.shape == (4,)
world = fish_env.make_world((0.0, 0.0, -9.8), [((0, 0, 1), -0.02, 0.0)])
world = world._replace(extra={"soft_floor": forces.FORCES["soft_floor"].SoftFloor(30.0)})
fish = fish_env.make_fish("minnow")
assert forces.present(fish.body, world) == ("springs", "gravity", "soft_floor", "contact")
tank = fish_env.Tank(fish, integrator="heun", dt=0.0005, water=world)
tank.advance(3)
assert tank.alive.all() and (tank.velocity[..., 2].mean(axis=1) > -9.8 * 0.0015).all()  # the floor has pushed
evaluator, rest, still = Evaluator(fish.body, world, ("soft_floor",)), fish.body.springs.rest_length, np.zeros((7, 3))
x, up = fish.body.position - [0.0, 0.0, 0.02], np.zeros((7, 3))
up[4, 2] = 1e-7  # the force is minus the gradient of the energy
below, above = (evaluator.energies(rest, x + side * up, still)["soft_floor"] for side in (-1.0, 1.0))
assert np.isclose(evaluator.force(rest, x, still)[4, 2], (below - above) / 2e-7)
print(fish_env.__file__)
"""


@pytest.mark.soft
def test_in_the_package(tmp_path):
    """Each is one new file and one line of one table, with its import; then all four are found, without a compiler."""
    package = tmp_path / "site"
    shutil.copytree(ROOT / "fish_env", package / "fish_env", ignore=shutil.ignore_patterns("__pycache__"))
    for block, (kind, name) in zip(LINES, KINDS.items(), strict=True):
        before = contents(package)
        table, home = block.title.split(" in ")
        imported, entry = (line.removeprefix("+") for line in block.text.splitlines())
        (package / "fish_env" / kind / f"{name}.py").write_text(FILES[f"{name}.py"])
        path = package / home
        path.write_text(with_line(path.read_text(), table, entry + "\n", imported))
        after = contents(package)
        changed = {file for file in after if before.get(file) != after[file]}
        assert changed == {f"fish_env/{kind}/{name}.py", home}
        lines = set(after[home].splitlines()) - set(before[home].splitlines())
        assert lines == {imported, entry}
    said = run(ADDED, tmp_path, package, NUMBA_DISABLE_JIT="1")
    assert said.strip() == str(package / "fish_env" / "__init__.py")


def contents(folder):
    """The text of every Python file under a folder, by its path from there."""
    return {path.relative_to(folder).as_posix(): path.read_text() for path in folder.rglob("*.py")}


def with_line(text, table, line, imported):
    """The source of a table with a line after its last entry, and the import of what the line names."""
    start = text.index(f"\n{table}: ")
    end = text.index("\n}", start)
    indent = re.match(" *", line)[0]
    last = [match.end() for match in re.finditer(rf"^{indent}\S.*\n", text[: end + 1], re.MULTILINE)][-1]
    text = text[:last] + line + text[last:]
    return re.sub(r"^(from fish_env)", rf"{imported}\n\1", text, count=1, flags=re.MULTILINE)


def swing_chain(lanes, dt=0.0005, floor=-0.02):
    """Positions (FISH,5,3) of a chain after 0.2 s under the method of the page, and the lowest ever.

    The chain hangs from its first node, which is fixed; the second moves along x at a set speed, an anchor draws the
    last one, and the others fall onto a floor.
    """
    position = np.array([[0.05 * k, 0.0, 0.0] for k in range(5)])
    body = make_body(position, np.full(5, 0.01), [[k, k + 1] for k in range(4)], [40.0] * 4, [0.02] * 4, [0.05] * 4, [])
    body = fix(fix(body, [0]), [1], "x")
    chain = ElasticObject(name="chain", body=body, length=0.2, time_step=dt, control_interval=0.01)
    world = fish_env.make_world(gravity=(0.0, 0.0, -9.8), planes=[((0, 0, 1), floor, 0.4)])
    tank, lowest = Tank(chain, FISH, "heun", dt, water=world, threads=1, lanes=lanes), np.inf
    tank.grab(4, (0.1, 0.1, 0.05), stiffness=1.0, damping=0.01)
    tank.velocity[:, 1, 0] = 0.05
    tank.velocity[:, 2:, 2] = -np.linspace(0.1, 1.0, FISH)[:, None]
    for _ in range(20):
        tank.advance(round(0.01 / dt))
        lowest = min(lowest, tank.position[:, :, 2].min())
    assert tank.alive.all()
    return tank.position.copy(), lowest


@pytest.mark.soft
def test_method_of_the_page(tmp_path, monkeypatch):
    """It is of second order; no node falls through a wall, fixed nodes keep their velocity; the same bits in lanes."""
    (tmp_path / "heun.py").write_text(FILES["heun.py"])
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.delitem(sys.modules, "heun", raising=False)
    method = importlib.import_module("heun").HEUN
    monkeypatch.setitem(INTEGRATORS, "heun", Integrator("heun", 2, "explicit", 2, 0, 0, "Heun 1900", method))
    found, lowest = swing_chain("xyz")
    np.testing.assert_array_equal(swing_chain(FISH)[0], found)
    assert -0.021 < lowest < -0.02  # on the floor, and at most a step's motion into it
    assert (found[:, 0] == 0.0).all()
    np.testing.assert_allclose(found[:, 1, 0], 0.05 + 0.05 * 0.2, rtol=1e-12)
    ends = [swing_chain("xyz", dt, floor=-9.0)[0] for dt in (0.0004, 0.0002, 0.0001)]
    assert 1.9 < np.log2(np.abs(ends[0] - ends[1]).max() / np.abs(ends[1] - ends[2]).max()) < 2.1


# A force of one's own: one module in the list


@pytest.fixture(autouse=True)
def registered(monkeypatch):
    """Put the floor of the page at the end of the list, and take it out again."""
    monkeypatch.setitem(forces.FORCES, "soft_floor", module_of(FILES["soft_floor.py"]))


def pair():
    """Two points that a level spring joins."""
    body = make_body([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0]], [MASS, MASS], [[0, 1]], [5.0], [0.1], [1.0], [])
    return ElasticObject(name="pair", body=body, length=1.0, time_step=1e-5, control_interval=0.01)


def thrown(name, lanes, h, steps):
    """A pair thrown onto the floor at different speeds, after some steps of h s: heights and speeds (FISH,)."""
    options = {} if INTEGRATORS[name].kind == "adaptive" else {"lanes": lanes}
    tank = Tank(pair(), FISH, name, h, water=floor(), threads=1, **options)
    tank.velocity[:, :, 2] = SPEEDS[:, None]
    tank.vary(3, mass=2.0)
    tank.advance(steps)
    assert tank.alive.all(), tank.failure
    return tank.position[:, 1, 2].copy(), tank.velocity[:, 1, 2].copy()


@plain
@pytest.mark.parametrize("name", tiered(INTEGRATORS, FIXED_STEP))
def test_every_method(name):
    """A pair on the floor swings back as on a spring, whatever moves it; the same bits one by one and in lanes."""
    time, steps = 0.02, 400
    rate = np.sqrt(STIFFNESS / (MASS * np.where(np.arange(FISH) == 3, 2.0, 1.0)))
    assert np.all(rate * time < np.pi)  # it is still in the floor
    heights, speeds = thrown(name, FISH, time / steps, steps)
    np.testing.assert_allclose(heights, SPEEDS / rate * np.sin(rate * time), rtol=5e-3)
    np.testing.assert_allclose(speeds, SPEEDS * np.cos(rate * time), rtol=5e-3, atol=5e-3)
    if INTEGRATORS[name].kind != "adaptive":
        np.testing.assert_array_equal(*(thrown(name, lanes, time / steps, 20) for lanes in ("xyz", FISH)))


@plain
def test_evaluated():
    """Its force and energy are in the sum, and the derivatives of the sum have its own, which it does not state."""
    body, still = pair().body, np.zeros((2, 3))
    x, rest, world = body.position - [0.0, 0.0, 0.1], body.springs.rest_length, floor(3.0)
    evaluator = Evaluator(body, world)
    assert evaluator.names == ("springs", "soft_floor")
    np.testing.assert_allclose(evaluator.force(rest, x, still), [[0.0, 0.0, 0.3]] * 2, rtol=1e-15)
    energies = evaluator.energies(rest, x, still)
    assert energies == pytest.approx({"kinetic": 0.0, "springs": 0.0, "soft_floor": 2 * 0.5 * 3.0 * 0.1**2})
    assert not evaluator.failures(rest, x)
    stiffness, damping = evaluator.jacobian(rest, x, still)
    alone = Evaluator(body, world, ("springs",)).jacobian(rest, x, still)
    np.testing.assert_allclose(stiffness - alone[0], np.diag([0.0, 0.0, 3.0] * 2), rtol=0, atol=1e-13)
    np.testing.assert_array_equal(damping, alone[1])
    assert forces.present(body, VACUUM) == ("springs",)


@pytest.mark.soft
def test_sparse():
    """The stiffness of a large body, assembled sparse, has the floor's once, not once for each piece or strip."""
    from fish_env.soft import sparse
    from fish_env.soft.conditions import make_anchors

    count = rates.DENSE // 3 + 50
    position = np.stack([0.1 * np.arange(count), 0.02 * np.sin(np.arange(count)), np.full(count, -0.01)], axis=1)
    position[::7, 2] = 0.01  # these are above the floor
    pairs = np.stack([np.arange(count - 1), np.arange(1, count)], axis=1)
    body = make_body(position, np.full(count, MASS), pairs, np.full(count - 1, 5.0), np.zeros(count - 1),
                     np.full(count - 1, 0.09), [])  # fmt: skip
    world = fish_env.make_world((0.0, 0.0, -9.8), [((0, 0, 1), -1.0, 0.5)])._replace(extra=floor().extra)
    world = world._replace(anchors=make_anchors([3, 3, count - 1], np.zeros((3, 3)), 7.0))
    found = sparse.tangent(body, world, body.springs.rest_length, position)
    assert issparse(found) and len(forces.present(body, world)) == 5
    wanted, _ = Evaluator(body, world).jacobian(body.springs.rest_length, position, np.zeros_like(position))
    np.testing.assert_allclose(found.toarray(), wanted, rtol=0, atol=1e-12)
    without = sparse.tangent(body, world._replace(extra=None), body.springs.rest_length, position)
    own = (found - without).toarray()
    np.testing.assert_allclose(own, np.diag(np.diag(own)), rtol=0, atol=1e-12)
    np.testing.assert_allclose(np.diag(own)[2::3], np.where(position[:, 2] < 0.0, STIFFNESS, 0.0), atol=1e-12)


@plain
@pytest.mark.soft
def test_beside_other_forces():
    """A free body comes to rest on the floor, and walls, which jump and so act last, take from the floor's force."""
    from fish_env.soft import statics

    body, still = pair().body, np.zeros((2, 3))
    world = fish_env.make_world((0.0, 0.0, -9.8))._replace(extra=floor().extra)
    x = statics.equilibrium(body, world, start=body.position - [0.0, 0.0, 0.02])  # its shifts are resisted
    np.testing.assert_allclose(x[:, 2], -9.8 * MASS / STIFFNESS, rtol=1e-9)
    for normal, wanted in (((0, 0, 1), 0.3), ((0, 0, -1), 0.0)):
        planes = np.array([[*normal, 1.0, 0.5]])  # behind which it is
        sunk = body.position - [0.0, 0.0, 0.1]
        found = Evaluator(body, floor(3.0, planes=planes)).force(body.springs.rest_length, sunk, still)
        np.testing.assert_allclose(found[:, 2], wanted, rtol=1e-15)


EDITED = FILES["soft_floor.py"].replace("world.soft_floor.stiffness", "3.0 * world.soft_floor.stiffness", 1)


def replaced():
    """A cell of a notebook that is run again: another force under the same name."""
    forces.FORCES["soft_floor"] = module_of(EDITED)


def reloaded():
    """`importlib.reload` after an edit: the same module with other functions."""
    exec(EDITED, forces.FORCES["soft_floor"].__dict__)


@plain
@pytest.mark.parametrize("change", [replaced, reloaded])
def test_defined_again(change):
    """New tanks and new evaluators have the force as it is defined now, and those of before go on as they were."""
    still, body, world = np.zeros((2, 3)), pair().body, floor()
    sunk = body.position - [0.0, 0.0, 0.01]

    def made():
        return Tank(pair(), 1, "leapfrog_chebyshev", 1e-5, water=world, threads=1), Evaluator(body, world)

    def pushed(tank, evaluator):
        before = tank.velocity[0, 0, 2]
        tank.position[...] = sunk
        tank.advance(1)
        force = evaluator.force(body.springs.rest_length, sunk, still)[0, 2]
        return (tank.velocity[0, 0, 2] - before) * MASS / 1e-5, force

    old = made()
    np.testing.assert_allclose(pushed(*old), 0.01 * STIFFNESS, rtol=1e-4)
    change()
    np.testing.assert_allclose(pushed(*made()), 3 * 0.01 * STIFFNESS, rtol=1e-4)
    np.testing.assert_allclose(pushed(*old), 0.01 * STIFFNESS, rtol=1e-4)


@pytest.mark.soft
def test_a_method_defined_again(monkeypatch):
    """So it is with a user's method: its kernels are those that it has now."""
    method = ModuleType("own_method")
    method.__dict__.update({name: getattr(leapfrog_chebyshev, name) for name in ("plan", "costs", "make_work")})
    method.make_run = leapfrog_chebyshev.make_run
    record = replace(INTEGRATORS["leapfrog_chebyshev"], name="own", method=method)
    monkeypatch.setitem(INTEGRATORS, "own", record)

    def fallen():
        tank = Tank(pair(), 1, "own", 1e-3, water=floor(), threads=1)
        tank.position[:, :, 2] = -0.01
        tank.advance(10)
        return tank.velocity[0, 0, 2]

    np.testing.assert_allclose(fallen(), 0.01 * STIFFNESS / MASS * 0.01, rtol=0.1)

    def stands(names):
        @part
        def run(body, world, control, x, v, work, cache, n):
            pass

        return run

    method.make_run = stands
    assert fallen() == 0.0
