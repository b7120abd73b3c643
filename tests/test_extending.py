"""docs/extending.md: its blocks run, in a program of one's own and in the package, and what they add is correct.

A block whose title is the name of a file is that file; one that shows a difference is the line that a table needs.
"""

import importlib
import os
import re
import shutil
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest
from pages import ROOT, blocks

from fish_env import INTEGRATORS, Tank, make_world
from fish_env.physics.body import fix, make_body
from fish_env.physics.fish import ElasticObject
from fish_env.physics.integrators import Integrator
from fish_env.physics.integrators.runge_kutta import RungeKutta

BLOCKS = blocks(ROOT / "docs/extending.md", "python")
FILES = {block.title: block.text for block in BLOCKS if re.fullmatch(r"\w+\.py", block.title)}
LINES = blocks(ROOT / "docs/extending.md", "diff")
KINDS = {"bodies": "minnow", "tasks": "dash", "physics/integrators": "heun", "physics/forces": "soft_floor"}
FISH = 8


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
    assert {block.title for block in others} == {"", "your own program"}
    assert "The blocks of this page run in order, as one program." in (ROOT / "docs/extending.md").read_text()


def test_in_a_program_of_ones_own(tmp_path):
    """The files beside a program, and the other blocks in their order, with the assertions they hold."""
    for name, text in FILES.items():
        (tmp_path / name).write_text(text)
    own = [block.text for block in BLOCKS if block.title not in FILES]
    run("\n\n".join(own), tmp_path, ROOT)


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


# The method of the page, against the tableau that it says is the same


@pytest.fixture
def methods(tmp_path, monkeypatch):
    """The table with the method of the page, "heun", and its tableau, "tableau"."""
    (tmp_path / "heun.py").write_text(FILES["heun.py"])
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.delitem(sys.modules, "heun", raising=False)
    own = importlib.import_module("heun").Heun()
    for name, method in (("heun", own), ("tableau", RungeKutta((0.0, 1.0), (0.5, 0.5)))):
        monkeypatch.setitem(INTEGRATORS, name, Integrator(name, 2, "explicit", 2, 0, 0, "Heun 1900", method))


def chain():
    """Five points on a string that hangs from the first, which is fixed; the second moves along x at a set speed."""
    position = np.array([[0.05 * k, 0.0, 0.0] for k in range(5)])
    pairs = [[k, k + 1] for k in range(4)]
    body = make_body(position, np.full(5, 0.01), pairs, [40.0] * 4, [0.02] * 4, [0.05] * 4, [])
    body = fix(fix(body, [0]), [1], "x")
    return ElasticObject(name="chain", body=body, length=0.2, time_step=0.0005, control_interval=0.01)


def swung(name, lanes):
    """Positions after the chain has fallen onto a floor, its end drawn by an anchor, (FISH,5,3); the lowest ever."""
    world = make_world(gravity=(0.0, 0.0, -9.8), planes=[((0, 0, 1), -0.02, 0.4), ((1, 0, 0), -0.01, 0.0)])
    tank = Tank(chain(), FISH, name, 0.0005, water=world, threads=1, lanes=lanes)
    tank.grab(4, (0.1, 0.1, 0.05), stiffness=1.0, damping=0.01)
    tank.velocity[:, 1, 0] = 0.05
    tank.velocity[:, 2:, 2] = -np.linspace(0.1, 1.0, FISH)[:, None]
    lowest = np.inf
    for _ in range(20):
        tank.advance(20)
        lowest = min(lowest, tank.position[:, :, 2].min())
    assert tank.alive.all()
    return tank.position.copy(), lowest


def test_method_against_walls_anchors_and_fixed_nodes(methods):
    """It is its tableau: nothing falls through a wall, what is fixed keeps its velocity; the same bits in lanes."""
    found, lowest = swung("heun", "xyz")
    np.testing.assert_array_equal(swung("heun", FISH)[0], found)
    np.testing.assert_allclose(swung("tableau", "xyz")[0], found, rtol=0, atol=1e-12)
    assert -0.021 < lowest < -0.02  # on the floor, and at most a step's motion into it
    assert (found[:, 0] == 0.0).all()
    np.testing.assert_allclose(found[:, 1, 0], 0.05 + 0.05 * 0.2, rtol=1e-12)


def test_method_has_its_order(methods):
    """Second order on a fixed swinging chain, without walls."""
    ends = {}
    for name, dt in (("rk4", 0.00005), ("heun", 0.0004), ("heun", 0.0002)):
        tank = Tank(replace(chain(), time_step=dt), 1, name, dt, water=make_world((0.0, 0.0, -9.8)))
        tank.advance(round(0.04 / dt))
        ends[name, dt] = tank.position.copy()
    exact = ends.pop(("rk4", 0.00005))
    coarse, fine = (np.abs(end - exact).max() for end in ends.values())
    assert 1.9 < np.log2(coarse / fine) < 2.1
