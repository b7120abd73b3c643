"""Every example runs, shortened, and imports only public names."""

import ast
import importlib
import json
import os
import re
import shutil
import subprocess
import sys

import pytest
from pages import ROOT

EXAMPLES = ROOT / "examples"
SCRIPTS = sorted(EXAMPLES.rglob("*.py"))
NOTEBOOK = json.loads((EXAMPLES / "quickstart.ipynb").read_text())
LEARNERS = {"train_cleanrl.py", "train_torchrl.py", "train_sbx.py"}
QUICK = {"train_ppo.py", "train_rllib.py", "play.py", "custom_task.py", "custom_body.py"} | LEARNERS | {"train_gpu.py"}
"""The scripts that tests below run, those of `test_learners.py`, and one of `test_rllib.py` and `test_torch_env.py`."""


def run(folder, *words, **variables):
    """What a Python program prints that is run in a folder of its own, as a user would; it must end well."""
    found = os.environ | {"PYTHONPATH": str(ROOT)} | variables
    done = subprocess.run(
        [sys.executable, *map(str, words)], env=found, cwd=folder, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


def sources():
    """(name, source) of every script, and of the notebook as one."""
    yield from ((path.relative_to(EXAMPLES).as_posix(), path.read_text()) for path in SCRIPTS)
    yield "quickstart.ipynb", "\n\n".join(cells())


def cells():
    """The source of every code cell of the notebook."""
    return ["".join(cell["source"]) for cell in NOTEBOOK["cells"] if cell["cell_type"] == "code"]


SOURCES = list(sources())


def test_every_example_is_run():
    """No script is without a test, and the list for readers names each."""
    assert {path.name for path in EXAMPLES.glob("*.py")} == QUICK
    listed = set(re.findall(r"\]\(([^)]+)\)", (EXAMPLES / "README.md").read_text()))
    assert listed == QUICK | {"quickstart.ipynb", "register_elsewhere"}


@pytest.mark.parametrize(("name", "source"), SOURCES, ids=lambda part: part if "\n" not in part else "")
def test_public_names_only(name, source):
    """Of fish_env an example imports what a module offers by `__all__`, or else what it names without underscore."""
    imports = [node for node in ast.walk(ast.parse(source)) if isinstance(node, ast.Import | ast.ImportFrom)]
    names = [alias.name for node in imports if isinstance(node, ast.Import) for alias in node.names]
    places = [node for node in imports if isinstance(node, ast.ImportFrom)]
    roots = {word.split(".")[0] for word in [*names, *(node.module for node in places)]}
    assert not roots & {"agents", "benchmarks", "tests"}
    for node in places:
        if node.module.split(".")[0] == "fish_env":
            assert not any(part.startswith("_") for part in node.module.split("."))
            if node.module == "fish_env.envs.rllib":
                pytest.importorskip("ray")
            module = importlib.import_module(node.module)
            for alias in node.names:
                offered = getattr(module, "__all__", None)
                assert alias.name in (vars(module) if offered is None else offered), f"{node.module}.{alias.name}"
                assert not alias.name.startswith("_")


def test_train_ppo(tmp_path):
    """It trains, saves what a user needs to resume, evaluates, and says how well the fish swims."""
    pytest.importorskip("stable_baselines3")
    said = run(
        tmp_path, EXAMPLES / "train_ppo.py", "--timesteps", 512, "--num-envs", 16, "--evaluations", 3, "--folder", "out"
    )
    assert re.search(r"mean of 3 episodes: return -?\d.*, speed -?\d", said)
    assert {path.name for path in (tmp_path / "out").iterdir()} == {
        "args.json", "model.zip", "scaling.pkl", "scores.json",
    }  # fmt: skip
    assert json.loads((tmp_path / "out" / "args.json").read_text())["num_envs"] == 16
    assert json.loads((tmp_path / "out" / "scores.json").read_text())["seconds"] == 5.0


def test_train_gpu_without_a_gpu(tmp_path):
    """Without a GPU it says in one line what there is, and leaves no folder behind."""
    torch = pytest.importorskip("torch")
    if torch.cuda.is_available():
        pytest.skip("there is a GPU")
    done = subprocess.run(
        [sys.executable, str(EXAMPLES / "train_gpu.py"), "--folder", "out"], cwd=tmp_path, capture_output=True,
        env=os.environ | {"PYTHONPATH": str(ROOT)}, text=True, check=False,
    )  # fmt: skip
    assert done.returncode == 1 and not list(tmp_path.iterdir())
    assert re.fullmatch(
        r"train_gpu.py: device is 'cuda', but torch .* there is: cpu. On the processor: .*\n", done.stderr
    )


def test_play(tmp_path):
    """It plays a shipped policy into a file."""
    pytest.importorskip("moviepy")
    said = run(
        tmp_path, EXAMPLES / "play.py", "swim", "--video", "swim.gif", "--steps", 12, "--episodes", 1,
        SDL_VIDEODRIVER="dummy",
    )  # fmt: skip
    assert re.search(r"episode 0: .*'speed': \d", said)
    assert (tmp_path / "swim.gif").read_bytes()[:3] == b"GIF"


def test_custom_task(tmp_path):
    """Its environment runs, and reports the speed of every fish."""
    said = run(tmp_path, EXAMPLES / "custom_task.py")
    assert len(re.findall(r"-?\d\.\d*", said.split(":")[1])) == 4


def test_custom_body(tmp_path):
    """The eel swims forward, with another number of segments too, and the environments take it."""
    said = run(tmp_path, EXAMPLES / "custom_body.py", "--segments", 4, "--seconds", 1)
    forward = float(re.search(r"16 muscles: (\S+) body lengths forward", said)[1])
    assert 0.05 < forward < 3.0
    assert "actions (16,)" in said


def test_register_elsewhere(tmp_path):
    """The package installs by itself; its id is found from a program that imports neither it nor fish_env."""
    pytest.importorskip("setuptools")
    pytest.importorskip("pip")
    copy = tmp_path / "package"
    shutil.copytree(EXAMPLES / "register_elsewhere", copy)
    site = tmp_path / "site"
    run(tmp_path, "-m", "pip", "install", "--quiet", "--no-deps", "--no-build-isolation", "--target", site, copy)
    assert not list(copy.rglob("*.egg-info")) or (site / "swim_elsewhere").is_dir()
    script = (
        "import sys, gymnasium as gym, swim_elsewhere\n"
        "assert 'fish_env' not in sys.modules\n"
        "for env in (gym.make('swim_elsewhere:Elsewhere/AnyHeading-v0'), gym.make('Elsewhere/AnyHeading-v0')):\n"
        "    assert env.unwrapped.fish.task.heading_error > 3.14\n"
        "assert env.spec.max_episode_steps == 250\n"
        "obs, _ = env.reset(seed=0)\n"
        "assert env.observation_space.contains(obs)\n"
        "assert gym.make_vec('Elsewhere/AnyHeading-v0', num_envs=3).num_envs == 3\n"
    )
    run(tmp_path, "-c", script, PYTHONPATH=f"{site}{os.pathsep}{ROOT}")


def test_quickstart(tmp_path):
    """The cells of the notebook run in order, as one program; they are stored without outputs."""
    pytest.importorskip("stable_baselines3")
    pytest.importorskip("matplotlib")
    pytest.importorskip("pygame")
    code = [cell for cell in NOTEBOOK["cells"] if cell["cell_type"] == "code"]
    assert len(code) >= 5 and NOTEBOOK["nbformat"] == 4
    assert all(cell["outputs"] == [] and cell["execution_count"] is None for cell in code)
    (tmp_path / "quickstart.py").write_text("\n\n".join(cells()))
    said = run(
        tmp_path, "quickstart.py", QUICKSTART_TIMESTEPS="8192", MPLBACKEND="agg", SDL_VIDEODRIVER="dummy"
    )  # fmt: skip
    assert "8192 steps" in said and re.search(r"mean speed: -?\d", said)
