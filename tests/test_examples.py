"""Every example runs, shortened, and imports only public names."""

import ast
import importlib
import io
import json
import os
import re
import runpy
import shutil
import subprocess
import sys
import sysconfig
import venv
from contextlib import redirect_stdout

import gymnasium as gym
import pytest
from pages import ROOT

import fish_env

EXAMPLES = ROOT / "examples"
SCRIPTS = sorted(EXAMPLES.rglob("*.py"))
NOTEBOOK = json.loads((EXAMPLES / "quickstart.ipynb").read_text())
CODE = [cell for cell in NOTEBOOK["cells"] if cell["cell_type"] == "code"]
QUICKSTART = "\n\n".join("".join(cell["source"]) for cell in CODE)
SOURCES = {path.relative_to(EXAMPLES).as_posix(): path.read_text() for path in SCRIPTS} | {"quickstart": QUICKSTART}
LEARNERS = {"train_cleanrl.py", "train_torchrl.py", "train_sbx.py"}
QUICK = LEARNERS | {"train_ppo.py", "train_rllib.py", "train_gpu.py", "play.py", "pixels.py", "custom_task.py",
                    "custom_body.py", "plan_random_shooting.py", "plan_ilqr.py"}  # fmt: skip
"""The scripts that tests below run, those of `test_learners.py`, and one of `test_rllib.py` and `test_gpu.py`."""


def run(folder, *words, **variables):
    """What a Python program prints that is run in a folder of its own, as a user would; it must end well."""
    done = subprocess.run([sys.executable, *map(str, words)], cwd=folder, capture_output=True, text=True, check=False,
                          env=os.environ | {"PYTHONPATH": str(ROOT)} | variables)  # fmt: skip
    assert done.returncode == 0, done.stderr
    return done.stdout + done.stderr


def run_here(folder, script, *words, **variables):
    """What a script prints that is run in a folder of its own, in this process; what it registers is forgotten."""
    with pytest.MonkeyPatch.context() as patch, redirect_stdout(io.StringIO()) as said:
        patch.chdir(folder)
        patch.syspath_prepend(str(EXAMPLES))
        patch.setattr(sys, "argv", [str(script), *map(str, words)])
        for name, value in variables.items():
            patch.setenv(name, value)
        tables = ((fish_env.BODIES, "eel"), (fish_env.TASKS, "circle"), (gym.registry, "Examples/Circle-v0"))
        for module, name in tables:
            patch.setitem(module, name, None)
            patch.delitem(module, name)
        runpy.run_path(str(script), run_name="__main__")
    return said.getvalue()


def test_every_example_is_run():
    """No script is without a test, and the list for readers names each."""
    assert {path.name for path in EXAMPLES.glob("*.py")} == QUICK
    listed = set(re.findall(r"\]\(([^)]+)\)", (EXAMPLES / "README.md").read_text()))
    listed = {name for name in listed if not name.startswith("..")}  # pages
    assert listed == QUICK | {"quickstart.ipynb", "register_elsewhere"}


@pytest.mark.soft
@pytest.mark.parametrize("name", SOURCES)
def test_public_names_only(name):
    """Of fish_env an example imports what a module offers by `__all__`, or else what it names without underscore."""
    imports = [node for node in ast.walk(ast.parse(SOURCES[name])) if isinstance(node, ast.Import | ast.ImportFrom)]
    names = [alias.name for node in imports if isinstance(node, ast.Import) for alias in node.names]
    places = [node for node in imports if isinstance(node, ast.ImportFrom)]
    roots = {word.split(".")[0] for word in [*names, *(node.module for node in places)]}
    assert not roots & {"agents", "benchmarks", "tests"}
    for node in places:
        if node.module.split(".")[0] == "fish_env":
            if node.module == "fish_env.envs.rllib":
                pytest.importorskip("ray")
            module = importlib.import_module(node.module)
            offered = getattr(module, "__all__", vars(module))
            assert not any(word.startswith("_") for word in node.module.split("."))
            assert all(alias.name in offered and not alias.name.startswith("_") for alias in node.names)


def test_train_ppo(tmp_path):
    """It trains, saves what a user needs to resume, evaluates, says how well the fish turns, and overwrites nothing."""
    pytest.importorskip("stable_baselines3")
    words = ("--env-id", "FishEnv/Turn-v0", "--timesteps", 512, "--num-envs", 16, "--evaluations", 3, "--folder", "out")
    said = run_here(tmp_path, EXAMPLES / "train_ppo.py", *words)
    assert re.search(r"mean of 3 episodes: return -?\d.*, success \d", said) and "is_success" not in said
    with pytest.raises(SystemExit, match="out exists, and no run is overwritten; name another folder with --folder"):
        run_here(tmp_path, EXAMPLES / "train_ppo.py", *words)
    found = {path.name for path in (tmp_path / "out").iterdir()}
    assert found == {"args.json", "model.zip", "scaling.pkl", "scores.json"}
    assert json.loads((tmp_path / "out" / "args.json").read_text())["num_envs"] == 16
    assert json.loads((tmp_path / "out" / "scores.json").read_text())["seconds"] == 5.0


def test_pixels(tmp_path):
    """It trains from pictures alone, and saves."""
    pytest.importorskip("stable_baselines3")
    run_here(tmp_path, EXAMPLES / "pixels.py", "--timesteps", 16, "--rollout", 16)
    assert (tmp_path / "pixels.zip").exists()


@pytest.mark.soft
def test_train_gpu_without_a_gpu(tmp_path):
    """Without a GPU it says in one line what there is, and leaves no folder behind."""
    torch = pytest.importorskip("torch")
    if torch.cuda.is_available():
        pytest.skip("there is a GPU")
    with pytest.raises(SystemExit, match=r"^train_gpu.py: device is 'cuda', but torch .* there is: cpu. On the .*\)$"):
        run_here(tmp_path, EXAMPLES / "train_gpu.py", "--folder", "out")
    assert not list(tmp_path.iterdir())


def test_play(tmp_path):
    """It plays a shipped policy into a file."""
    pytest.importorskip("moviepy")
    words = ("swim", "--video", "swim.gif", "--steps", 12, "--episodes", 1)
    assert re.search(r"episode 0: .*'speed': \d", run_here(tmp_path, EXAMPLES / "play.py", *words))
    assert (tmp_path / "swim.gif").read_bytes()[:3] == b"GIF"


def test_custom_task(tmp_path):
    """Its environment runs, and reports the speed of every fish."""
    said = run_here(tmp_path, EXAMPLES / "custom_task.py")
    assert len(re.findall(r"-?\d\.\d*", said.split(":")[1])) == 4


def test_custom_body(tmp_path):
    """The eel swims forward, with another number of segments too, and the environments take it."""
    said = run(tmp_path, EXAMPLES / "custom_body.py", "--segments", 4, "--seconds", 1)  # as a user would
    forward = float(re.search(r"16 muscles: (\S+) body lengths forward", said)[1])
    assert 0.05 < forward < 3.0
    assert "actions (8,)" in said


def test_plan_random_shooting(tmp_path):
    """The planner is faster than the gait in every episode."""
    said = run_here(tmp_path, EXAMPLES / "plan_random_shooting.py", "--episodes", 2)
    found = re.findall(r"gait (\S+), planned (\S+) body lengths", said)
    assert len(found) == 2 and all(1.8 < float(gait) < float(planned) < 7.0 for gait, planned in found)


def test_plan_ilqr(tmp_path):
    """Derivatives leave little of a right angle, and the plan is found from any of the states."""
    said = run_here(tmp_path, EXAMPLES / "plan_ilqr.py", "--plans", 1)
    (left,) = re.findall(r"iLQR leaves (\S+) of 90 degrees", said)
    assert float(left) < 8.0


def test_register_elsewhere(tmp_path):
    """The package installs by itself; its id is found from a program that imports neither it nor fish_env."""
    pytest.importorskip("setuptools")
    pytest.importorskip("pip")
    copy, site = tmp_path / "package", tmp_path / "site"
    shutil.copytree(EXAMPLES / "register_elsewhere", copy)
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
    """The cells of the notebook run in order, as one program; they are stored with their outputs, none an error."""
    for module in ("stable_baselines3", "matplotlib", "pygame"):
        pytest.importorskip(module)
    assert len(CODE) >= 5 and NOTEBOOK["nbformat"] == 4
    outputs = [output for cell in CODE for output in cell["outputs"]]
    assert "display_data" in {output["output_type"] for output in outputs}
    assert {output["output_type"] for output in outputs} <= {"stream", "display_data", "execute_result"}
    (tmp_path / "quickstart.py").write_text(QUICKSTART)
    variables = {"QUICKSTART_TIMESTEPS": "8192", "MPLBACKEND": "agg", "SDL_VIDEODRIVER": "dummy"}
    said = run_here(tmp_path, tmp_path / "quickstart.py", **variables)
    assert "8192 steps" in said and re.search(r"mean speed: -?\d", said)


@pytest.mark.slow
def test_quickstart_installs_a_wheel(tmp_path):
    """In an environment without the package, the notebook installs the wheel that is named, trains and evaluates."""
    pytest.importorskip("setuptools", minversion="77")
    for module in ("stable_baselines3", "matplotlib", "pygame"):
        pytest.importorskip(module)
    source = tmp_path / "source"
    for name in ("fish_env", "pyproject.toml", "setup.py", "README.md", "LICENSE", "MANIFEST.in"):
        copy = shutil.copytree if (ROOT / name).is_dir() else shutil.copy
        source.mkdir(exist_ok=True)
        copy(ROOT / name, source / name)
    run(source, "-c", f"import setuptools.build_meta as backend; backend.build_wheel({str(tmp_path)!r})")
    (wheel,) = tmp_path.glob("*.whl")
    venv.create(tmp_path / "venv", with_pip=True)
    script = tmp_path / "quickstart.py"
    script.write_text(f"{QUICKSTART}\nprint(fish_env.__file__)\n")
    python = next(tmp_path.glob("venv/[bS]*/python*"))
    # other packages are those of this environment, in which a link to the checkout does not count
    others = {"PYTHONPATH": sysconfig.get_path("purelib"), "PIP_NO_INDEX": "1", "FISH_ENV_WHEEL": str(wheel)}
    done = subprocess.run([python, script], cwd=tmp_path, capture_output=True, text=True, check=False,
                          env=os.environ | others | {"MPLBACKEND": "agg", "SDL_VIDEODRIVER": "dummy"})  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert done.stdout.splitlines()[-1].startswith(str(tmp_path / "venv"))
    assert float(re.search(r"mean speed: (-?[\d.]+)", done.stdout)[1]) > 3.0
