"""Wheel and source archive hold all that the installed package needs, and it runs without the checkout."""

import inspect
import json
import re
import shutil
import tarfile
import typing
import zipfile
from functools import partial

import pytest
from pages import ROOT
from test_examples import run

import fish_env
from fish_env import control
from fish_env.__main__ import make_parser

PARTS = ("fish_env", "pyproject.toml", "setup.py", "README.md", "LICENSE", "MANIFEST.in", "tests")
BUILD = "import setuptools.build_meta as backend, sys; print(getattr(backend, 'build_' + sys.argv[1])(sys.argv[2]))"

ALONE = """
import sys
import gymnasium as gym
import fish_env
from fish_env.bodies import BODIES, make_fish
from fish_env.control import best_gait, load_policy, record, shipped_policies, write_film
from fish_env.control.motor import load_tables
where, film = sys.argv[1:]
assert fish_env.__file__.startswith(where), fish_env.__file__
for name in BODIES:
    make_fish(name)
best_gait(), load_tables()
ids = [id for id in gym.registry if id.startswith("FishEnv/")]
assert len(ids) == 8
for id in ids:
    assert gym.make(id).observation_space.shape == (fish_env.observation_layout(id).size,)
policies = {task: load_policy(path) for task, path in shipped_policies().items()}
assert len(policies) == 7 and all(policy.about["task"] == task for task, policy in policies.items())
assert not {"torch", "stable_baselines3", "pygame"} & set(sys.modules)
kept = record(gym.make("FishEnv/Stub-v0"), policies["swim"], 0, steps=3)
assert write_film(kept, film).stat().st_size > 100_000
"""
"""What must work wherever the package lies, without the checkout."""


def build(what, source, target):
    """Build "sdist" or "wheel" of a source tree, downloading nothing; returns the archive."""
    target.mkdir()
    run(source, "-c", BUILD, what, target)
    (archive,) = target.iterdir()
    return archive


@pytest.mark.soft
def test_public_names():
    """Every public name exists, has a docstring if it is a class or a function, and is there after a plain import."""
    wanted = {"BODIES", "INTEGRATORS", "TASKS", "Fish", "FishEnv", "FishVectorEnv", "Integrator", "Option", "Tank",
              "Task", "World", "make_body", "make_fish", "make_sb3_vec_env", "make_water", "make_world",
              "observation_layout", "prescribe"}  # fmt: skip
    assert set(fish_env.__all__) == wanted
    for package in (fish_env, fish_env.envs, control):
        for name in package.__all__:
            found = getattr(package, name)
            kind = inspect.isclass(found) and typing.get_origin(found) is None  # Python 3.10 calls aliases classes
            assert not (kind or inspect.isfunction(found)) or inspect.getdoc(found), name
    with pytest.raises(AttributeError, match="no attribute 'sb4'"):
        fish_env.envs.sb4  # noqa: B018


def test_a_plain_import_warns_of_nothing(tmp_path):
    """A program that makes errors of all warnings can import the package, whose import prints nothing."""
    code = "import fish_env, fish_env.control, fish_env.envs"
    assert run(tmp_path, "-W", "error", "-c", code) == ""


def test_vec_env_after_a_plain_import(tmp_path):
    """Stable-Baselines3 is loaded by the first use, by either name, and the two are one function."""
    pytest.importorskip("stable_baselines3")
    code = """import sys, fish_env
before = "stable_baselines3" in sys.modules
same = fish_env.envs.make_sb3_vec_env is fish_env.make_sb3_vec_env and bool(fish_env.envs.sb3.FishVecEnv)
import fish_env.training.build, fish_env.control as control
same &= control.export_policy is fish_env.training.build.export_policy is control.equivariant.export_policy
print(before, same, type(fish_env.make_sb3_vec_env("FishEnv/Stub-v0", num_envs=2)).__name__)"""
    assert run(tmp_path, "-c", code).split()[-3:] == ["False", "True", "VecMonitor"]


def test_what_the_image_is_built_from():
    """The Dockerfile may copy all that the package is built from, and its commands are those of the package."""
    given = {line[1:] for line in (ROOT / ".dockerignore").read_text().splitlines() if line.startswith("!")}
    assert given == {*PARTS, "constraints.txt"} - {"tests"} and all((ROOT / name).exists() for name in given)
    text = (ROOT / "Dockerfile").read_text()
    for extra in re.findall(r"\.\[(\w+)\]", text):
        assert re.search(rf"^{extra} = ", (ROOT / "pyproject.toml").read_text(), re.MULTILINE)
    assert re.findall(r"RUN python -m fish_env (\w+)", text) == ["compile"]
    command = json.loads(re.search(r"^CMD (.*)$", text, re.MULTILINE)[1])
    assert command[:3] == ["python", "-m", "fish_env"]
    assert make_parser()[0].parse_args(command[3:]).command == "evaluate"
    variable = re.search(r"FISH_ENV_CACHE=(\S+)", text)[1]
    assert re.search(rf"install -d -o fish {variable}\n", text)
    assert text.index("USER fish") < text.index("RUN python -m")


def check_metadata(folder):
    """The program is installed by its name, and links of the description lead from an index to what is there."""
    assert "fish_env = fish_env.__main__:main" in (folder / "entry_points.txt").read_text()
    text = (folder / "METADATA").read_text()
    (address,) = re.findall(r"^Project-URL: Repository, (.*)$", text, re.MULTILINE)
    links = re.findall(r"\]\(([^)#]*)", text.split("\n\n", 1)[1])
    held = [link.removeprefix(address).split("/", 3) for link in links if link.startswith(address)]
    inside = re.findall(r"\]\((?!\w+://|#)", (ROOT / "README.md").read_text(encoding="utf-8"))
    assert len(held) == len(inside) > 0 and all("://" in link for link in links)
    for _, kind, branch, path in held:
        assert kind in ("blob", "raw") and branch == "main" and (ROOT / path).exists(), path


@pytest.mark.slow
def test_wheel_of_the_source_archive(tmp_path):
    """The wheel that is built of the source archive lists, trains, plays, evaluates and compares by itself."""
    pytest.importorskip("setuptools", minversion="77")
    source, empty, unpacked = (tmp_path / name for name in ("source", "empty", "unpacked"))
    source.mkdir(), empty.mkdir()
    for name in PARTS:  # a copy, so that nothing is left in the checkout
        copy = shutil.copytree if (ROOT / name).is_dir() else shutil.copy
        copy(ROOT / name, source / name)
    archive = build("sdist", source, tmp_path / "sdist")
    with tarfile.open(archive) as file:
        assert not [name for name in file.getnames() if "/tests/" in name]  # they need more than the archive holds
        file.extractall(tmp_path / "from_sdist", filter="data")
    (tree,) = (tmp_path / "from_sdist").iterdir()
    wheel = build("wheel", tree, tmp_path / "wheel")
    with zipfile.ZipFile(wheel) as file:
        names = file.namelist()
        assert not [name for name in names if name.startswith(("agents", "benchmarks", "tests"))]
        assert all(info.file_size < 700_000 for info in file.infolist())
        file.extractall(unpacked)
    kinds = (".py", ".json", ".npz", ".js", ".html")
    held = {str(path.relative_to(ROOT)) for path in ROOT.glob("fish_env/**/*") if path.suffix in kinds}
    assert held <= set(names) and "fish_env/control/pretrained/swim/policy.npz" in names
    check_metadata(next(unpacked.glob("*.dist-info")))

    alone = partial(run, empty, PYTHONPATH=str(unpacked))
    assert "FishEnv/Swim-v0" in alone("-m", "fish_env")
    alone("-c", ALONE, unpacked, tmp_path / "film.html")
    folder = tmp_path / "run"
    said = alone("-m", "fish_env", "train", "swim", "--timesteps", "20000", "--folder", folder)
    assert "best open-loop gait" in said and (folder / "report.html").exists()
    alone("-m", "fish_env", "play", folder, "--save", tmp_path / "swim.html")
    assert f"  {folder}" in alone("-m", "fish_env", "evaluate", "swim", folder, "--episodes", "1")
    assert f"  {folder}" in alone("-m", "fish_env", "compare", folder)
    assert not list(empty.iterdir())


def test_in_an_archive(tmp_path):
    """From a zip archive on the path the package finds bodies, gaits, tables, policies and the parts of a film."""
    archive = tmp_path / "fish.zip"
    with zipfile.ZipFile(archive, "w", zipfile.ZIP_DEFLATED) as file:
        for path in sorted((ROOT / "fish_env").rglob("*")):
            if path.is_file() and "__pycache__" not in path.parts:
                file.write(path, path.relative_to(ROOT))
    run(tmp_path, "-c", ALONE, archive, tmp_path / "film.html", PYTHONPATH=str(archive), NUMBA_DISABLE_JIT="1")
