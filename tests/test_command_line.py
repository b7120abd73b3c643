"""`python -m fish_env` and `train.py`: what they print and write, and that a mistake is answered in one line."""

import csv
import json
import os
import re
import shlex
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import gymnasium as gym
import numpy as np
import pytest

import fish_env
from fish_env import __main__ as command_line
from fish_env.control import chart, compare, load_policy, make_policy_env, play, shipped_policies, shipped_policy
from fish_env.control.console import run_command
from fish_env.control.evaluation import evaluate
from fish_env.control.statistics import means
from fish_env.physics.tank_options import longest_step

ROOT = Path(__file__).parent.parent


def run(*arguments, **environment):
    """A command in a process of its own, without a display."""
    variables = {name: value for name, value in os.environ.items() if name not in ("DISPLAY", "WAYLAND_DISPLAY")}
    variables.pop("SDL_VIDEODRIVER", None)
    return subprocess.run(
        [sys.executable, *map(str, arguments)], cwd=ROOT, capture_output=True, text=True, check=False,
        env=variables | environment,
    )  # fmt: skip


def test_list(capsys):
    """Without arguments every environment is listed with what it asks, every body, integrator and policy."""
    assert command_line.main([]) == 0
    printed = capsys.readouterr().out
    lines = {line.split()[0]: line for line in printed.splitlines() if line.startswith("  ")}
    ids = [id for id in gym.registry if id.startswith("FishEnv/")]
    assert len(ids) == 8
    for name in (*ids, *fish_env.BODIES, *fish_env.INTEGRATORS):
        assert len(lines[name].split()) > 4, name
    assert all(task in printed.splitlines()[-2] for task in shipped_policies())
    assert "Touch a target with the nose" in lines["FishEnv/Target-v0"]


def test_versions(capsys, monkeypatch):
    """Every package is named with its version, or as not installed."""
    monkeypatch.setattr(command_line, "PACKAGES", ("numpy", "no-such-package"))
    assert command_line.main(["versions"]) == 0
    found = dict(line.split(maxsplit=1) for line in capsys.readouterr().out.splitlines())
    assert found["numpy"] == np.__version__ and found["no-such-package"] == "not installed"
    assert found["fish_env"] == fish_env.__version__ and found["python"] == sys.version.split()[0]


def test_evaluate(tmp_path, capsys, monkeypatch):
    """The means it prints and writes are those of `evaluate`, and train.py finds the same."""
    file = tmp_path / "new" / "swim.json"
    assert command_line.main(["evaluate", "swim", "--episodes", "2", "--to", str(file)]) == 0
    policy = load_policy(shipped_policy("swim"))
    env = make_policy_env(policy, 2)
    wanted = means(evaluate(env, policy))
    record = json.loads(file.read_text())
    assert record["means"] == wanted and record["episodes"] == 2 and record["env_id"] == "FishEnv/Swim-v0"
    printed = dict(line.split(maxsplit=1) for line in capsys.readouterr().out.splitlines() if line.startswith("  "))
    assert printed["speed"] == f"{wanted['speed']:.4g}" and printed["failed"] == "0 (0 to 0.658)"
    assert record["intervals"] == {"failed": [0.0, 0.658]}
    arguments = ["evaluate", "swim", str(shipped_policy("swim")), "turn", "--episodes", "2", "--to", str(file)]
    monkeypatch.setattr(sys, "argv", ["train.py", *arguments])
    assert pytest.importorskip("train").main() == 0
    assert [record["means"] == wanted for record in json.loads(file.read_text())] == [True, True, False]
    printed = capsys.readouterr().out
    assert "FishEnv/Swim-v0: mean over 2" in printed and "FishEnv/Turn-v0: mean" in printed
    speed = f"{wanted['speed']:.4g}"
    assert next(line.split() for line in printed.splitlines() if "  speed " in line) == ["speed", speed, speed]
    short = ["--env-kwargs", "max_episode_steps=3", "body=planar", "--to", str(file)]
    assert command_line.main(["evaluate", "swim", "--episodes", "2", *short]) == 0
    record = json.loads(file.read_text())
    assert record["body"] == "planar" and record["means"]["seconds"] == pytest.approx(3 * env.control_interval)


def test_compare(capsys):
    """Two policies are compared in the same episodes, with intervals; one stands beside simple controllers."""
    few = ["--episodes", "8", "--seed", "7"]
    assert command_line.main(["compare", "left_after_right", "turn", *few]) == 0
    found = compare("left_after_right", "turn", seed=7, episodes=8)["heading_error"]
    cells = [f"{value:.4g} ({low:.4g} to {high:.4g})" for value, low, high in found]
    printed = capsys.readouterr().out
    assert "mean over 8 episodes, seeds from 7, with 95 % intervals\n" in printed
    lines = {line.split()[0]: line for line in printed.splitlines()}
    assert lines["left_after_right"].split() == ["left_after_right", "turn", "difference"]
    assert re.split("  +", lines["heading_error"].strip()) == ["heading_error", *cells]
    assert command_line.main(["compare", "swim", "--integrator", "semi_implicit", *few]) == 0
    printed = capsys.readouterr().out
    assert re.search("motor controllers +swim\n", printed) and "mean over 8 episodes, seeds from 7;" in printed


def test_play(tmp_path, capsys):
    """A shipped policy is played into a file, on another body too, and its metrics are printed."""
    video = tmp_path / "swim.gif"
    play("swim", 3, 2, video, body="planar", integrator=None, max_episode_steps=3)
    assert video.stat().st_size > 3_000
    printed = capsys.readouterr().out
    assert re.search(r"episode 0: seconds 0.06, work .*, speed ", printed) and "episode 1: " in printed


def test_play_gets_what_the_command_line_says(tmp_path, monkeypatch):
    """Both command lines hand policy, seed, number of episodes, file and options to the one function that plays."""
    given = []
    monkeypatch.setattr(command_line, "play", lambda *arguments, **options: given.append((*arguments, options)))
    policy, video = shipped_policy("swim"), tmp_path / "swim.gif"
    assert command_line.main(["play", "swim", "--to", str(video), "--body", "planar", "--seed", "3"]) == 0
    monkeypatch.setattr(sys, "argv", ["train.py", "play", str(policy), "--video", str(video), "--seed", "4"])
    train = pytest.importorskip("train")
    assert train.main() == 0
    (one, *first), (two, *second) = given
    assert one.about == two.about and one.about["env_id"] == "FishEnv/Swim-v0"
    assert first == [3, 1, video, {"body": "planar"}] and second == [4, 1, video, {}]


def test_a_run_for_each_seed(capsys, monkeypatch):
    """Each seed of --seeds is trained once, in a folder of its own, and the command that compares them is printed."""
    train = pytest.importorskip("fish_env.training.train")
    given = []
    monkeypatch.setattr(train, "train", lambda request: given.append(request) or Path(f"run{request.seed}"))
    assert command_line.main(["train", "swim", "--seeds", "3", "1", "3", "--timesteps", "2048"]) == 0
    assert [(one.seed, one.folder, one.changes) for one in given] == [(s, None, {"timesteps": 2048}) for s in (3, 1)]
    assert "fish_env report run3 run1\n" in capsys.readouterr().out
    assert command_line.main(["train", "swim", "--seeds", "2", "--task-module", "json"]) == 0
    assert given.pop().module == "json" and "report run2 --task-module json\n" in capsys.readouterr().out
    assert command_line.main(["train", "swim", "--seeds", "0", "-1"]) == 2 and len(given) == 2
    assert "seed is -1; give a whole number" in capsys.readouterr().err


def test_values_of_keywords():
    """Numbers, also infinite ones, lists and names."""
    words = ["refine=inf", "dt=1e-3", "action_delay=[0, 2]", "water=drag", "panel=true"]
    wanted = {"refine": np.inf, "dt": 1e-3, "action_delay": (0, 2), "water": "drag", "panel": True}
    assert command_line.settings_from("--env-kwargs", words) == wanted


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["play", "fly"], "there is no policy file fly; give the policy.npz of"),
        (["play"], "there is no policy; give one of avoid, "),
        (["play", "swim", "--policy", str(shipped_policy("turn"))], "cannot be played at once; give one policy"),
        (["evaluate", "swim", "--policy", "none.npz"], "there is no policy file none.npz"),
        (["evaluate", "swim", "--env-kwargs", "fins=3"], "unexpected keyword argument 'fins'"),
        (["evaluate", "swim", "--env-kwargs", "seed=3"], "seed cannot be options of the environment here"),
        (["evaluate", "swim", "--episodes", "0"], "episodes is 0; give a whole number, at least 1"),
        (["evaluate", "swim", "--seed", "-5"], "seed is -5; give a whole number, zero or more"),
        (["play", "swim", "--episodes", "0", "--to", "x.html"], "episodes is 0; give a whole number, at least 1"),
        (["play", "swim", "--to", "swim.avi"], "give a name that ends in .mp4 or .webp or .gif"),
        (["evaluate", "swim", "--to", "pyproject.toml/x.json"], "no file can be written in the folder"),
        (["evaluate", "docs"], "there is no policy file docs/policy.npz"),
        (["compare", "swim", "--task-module", "no.such"], "the module 'no.such' cannot be imported: No module"),
        (["chart", "--body", "eel"], "unknown body 'eel'; choose from 'mass_spring', "),
        (["chart", "--body", "no_such:fish"], "the module 'no_such' cannot be imported: No module named 'no_such'"),
        (["chart", "--body", "json:dumps_all"], "'json:dumps_all' is no function that returns a fish_env.Fish"),
        (["chart", "--error", "0"], "the error is 0 %; give a positive percentage"),
        (["chart", "--task", "fly"], "unknown task 'fly'; choose from 'swim', "),
        (["chart", "--save", "chart.png"], "give a name that ends in .svg"),
        (["train", "no_such:Own-v0"], "the module 'no_such' cannot be imported: No module named 'no_such'"),
        (["train", "fly"], "unknown task 'fly'; choose from swim, "),
        (["train", "CartPole-v1"], "is a CartPoleVectorEnv; give an environment whose batches are"),
        (["train", "swim", "--env-kwargs", "speed"], "--env-kwargs has 'speed'; give NAME=VALUE"),
        (["train", "target", "--env-kwargs", "goal_env=true"], "the environment observes goals, which are for HER"),
    ],
)
def test_mistakes(arguments, message, capsys, monkeypatch):
    """A mistake is answered by one line that says what to do, with exit status 2."""
    monkeypatch.chdir(ROOT)
    assert command_line.main(arguments) == 2
    printed = capsys.readouterr()
    assert printed.err.startswith("fish_env: ") and message in printed.err and printed.err.count("\n") == 1


def test_missing_extras(tmp_path):
    """Without pygame or moviepy, and without a display, it says what to install or to do, without a traceback."""
    code = "import sys; sys.modules[{0!r}] = None; from fish_env.__main__ import main; sys.exit(main({1!r}))"
    video = str(tmp_path / "swim.mp4")
    for missing in ("pygame", "moviepy"):
        done = run("-c", code.format(missing, ["play", "swim", "--to", video]))
        assert done.returncode == 2 and 'pip install "fish_env[render]"' in done.stderr
        assert "Traceback" not in done.stderr and not list(tmp_path.iterdir())
    done = run("-c", code.format("matplotlib", ["chart", "--save", str(tmp_path / "chart.svg")]))
    assert done.returncode == 2 and 'pip install "fish_env[train]"' in done.stderr and not list(tmp_path.iterdir())
    if sys.platform.startswith("linux"):
        done = run("-m", "fish_env", "play", "swim")
        assert done.returncode == 2 and "no display" in done.stderr and "Traceback" not in done.stderr


@pytest.fixture
def few_scenes(monkeypatch):
    """Charts of four short scenes and two methods."""
    for name, value in {"SECONDS": 0.2, "FAMILIES": ((chart.bang_bang, 2), (chart.sprints, 2)), "METHODS": ("rk4",),
                        "STEPS": {"leapfrog_chebyshev": (6, 12)}, "BATCH": 4, "REPEATS": 1}.items():  # fmt: skip
        monkeypatch.setattr(chart, name, value)


def test_chart(few_scenes, tmp_path, monkeypatch, capsys):
    """Of a fish that a function of the user returns: the sentence is what the table says, and the chart is written."""
    pytest.importorskip("matplotlib")
    (tmp_path / "my_fish.py").write_text("import fish_env\nshort = lambda: fish_env.make_fish(length=0.3)\n")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", [*sys.path])
    assert command_line.main(["chart", "--body", "my_fish:short", "--water", "drag", "--error", "0.2%"]) == 0
    del sys.modules["my_fish"]
    said = re.search(r"^take (\w+) with dt=0\.02 / (\d+): error (\S+) %, time (\S+) us", capsys.readouterr().out)
    fish = fish_env.make_fish(length=0.3)
    rows = list(csv.DictReader((tmp_path / "chart.csv").open()))
    good = [row for row in rows if row["failed"] == "0" and float(row["geometric_mean"]) <= 0.002]
    best = min(good, key=lambda row: float(row["us_per_interval"]))
    assert 0 < len(good) < len(rows) and {row["integrator"] for row in rows} == {fish.integrator, "rk4"}
    assert said and said[1] == best["integrator"] and said[2] == best["substeps"]
    assert float(said[3]) == pytest.approx(100 * float(best["geometric_mean"]), rel=0.06)
    drawn = (tmp_path / "chart.svg").read_text()
    assert drawn.startswith("<?xml") and "</svg>" in drawn


def test_recommended_steps():
    """The largest safe step is that below which nothing fails, unrefined, and at most the limit of linear theory."""
    fish = fish_env.make_fish()
    scenes = chart.random_scenes(fish, fish.water)

    def said(error, *found, lost=0):
        rows = [{"integrator": name, "refine": refine, "substeps": k, "failed": failed + lost, "scenes": 64,
                 "geometric_mean": mean, "us_per_interval": cost}
                for name, k, failed, mean, cost in found
                for refine in {np.inf, fish.refine if name == fish.integrator else np.inf}]  # fmt: skip
        return chart.recommend(scenes, rows, error)[1]

    own = [(fish.integrator, 2, 0, 0.03, 1.0), (fish.integrator, 5, 3, 0.02, 2.0), (fish.integrator, 8, 0, 0.01, 3.0)]
    rk4 = [("rk4", 1, 0, 0.3, 0.5), ("rk4", 32, 0, 0.001, 9.0)]
    assert said(0.01, *own, *rk4).startswith(f"take {fish.integrator} with dt=0.02 / 8: error 1 %, time 3 us")
    assert said(0.04, *own).endswith(
        "dt=0.02 / 2: error 3 %, time 1 us a control interval; the largest safe step is "
        f"{longest_step(fish, fish.water, fish_env.INTEGRATORS[fish.integrator]):.3g} s"
    )
    limit = fish_env.INTEGRATORS["rk4"].limit(fish.body, fish.water)
    assert said(0.002, *own, *rk4).endswith(f"the largest safe step is {limit:.3g} s")
    assert "the most accurate is rk4 with dt=0.02 / 32: error 0.1 %" in said(1e-4, *own, *rk4)
    assert said(0.002, *rk4, lost=2).endswith("; 2 of 64 scenes fail with every method")


def test_scenes_of_a_task(few_scenes):
    """Commands are those of the shipped policy in the task, for what each muscle is told; or random actions."""
    fish = fish_env.make_fish()
    turn = chart.task_scenes(fish, fish.water, "turn")
    assert turn.kinds == ("policy of turn",) * 4 and turn.goals.shape == (4, 10, 12)
    env = make_policy_env("turn", 4)
    obs, _ = env.reset(seed=chart.SEED)
    first = 0.5 + 0.5 * load_policy(shipped_policy("turn"))(obs)
    np.testing.assert_allclose(turn.goals[:, 0], first, atol=1e-6)
    slower = replace(fish, control_interval=0.03)
    random = chart.task_scenes(slower, fish.water, "swim")
    assert random.kinds[0] == "random actions in swim" and random.goals.shape[1] == 7


def test_an_environment_of_the_user(tmp_path, monkeypatch, capsys):
    """A module of the present folder is trained in; its run is used by its folder, once the module is imported."""
    pytest.importorskip("tensorboard")
    id, folder = "Elsewhere/AnyHeading-v0", tmp_path / "run"
    monkeypatch.chdir(ROOT / "examples" / "register_elsewhere" / "src")
    monkeypatch.setitem(fish_env.TASKS, "any_heading", None)  # undone at the end, as are the lines below
    monkeypatch.setattr(sys, "path", [*sys.path])
    keywords = ["speed=1.0", 'variation={"mass": [0.8, 1.2]}']
    words = ["--num-envs", "8", "--env-kwargs", *keywords, "--hyperparameters", "timesteps=1024", "hidden=[8,4]"]
    assert command_line.main(["train", f"swim_elsewhere:{id}", *words, "--folder", str(folder), "--no-pictures"]) == 0
    record = json.loads((folder / "config.json").read_text())
    assert record["config"]["hidden"] == [8, 4] and record["config"]["timesteps"] == 1024
    options = {"speed": 1.0, "variation": {"mass": [0.8, 1.2]}}
    assert record["config"]["env_options"] == load_policy(folder / "policy.npz").about["env_options"] == options
    again = command_line.make_parser()[0].parse_args(shlex.split(record["command"])[1:])
    assert (again.task, again.num_envs, again.timesteps) == (f"swim_elsewhere:{id}", 8, 1024)
    assert again.env_kwargs == keywords and again.hyperparameters == ["hidden=[8, 4]"]
    capsys.readouterr()
    assert command_line.main(["evaluate", str(folder), "--episodes", "1"]) == 0
    assert f"{id} with speed=1.0, variation={{'mass': [0.8, 1.2]}}: mean over 1 episodes" in capsys.readouterr().out
    del gym.registry[id], sys.modules["swim_elsewhere"]
    for words in (["evaluate", str(folder)], ["report", str(folder)]):
        assert command_line.main(words) == 2
        assert id in capsys.readouterr().err
    assert command_line.main(["evaluate", str(folder), "--episodes", "1", "--task-module", "swim_elsewhere"]) == 0
    del gym.registry[id]


def test_train_py(tmp_path):
    """`train.py` answers mistakes in one line without a traceback."""
    wrong = run("train.py", "play", tmp_path / "none.npz")
    assert wrong.returncode == 2 and "no policy file" in wrong.stderr and "Traceback" not in wrong.stderr
    assert run("train.py", "fly").returncode == 2


@pytest.mark.parametrize("arguments", [["replay", "."], ["evaluate", "swim", "--to", "x" * 300 + ".json"],
                                       ["evaluate", "--policy", "\0.npz"]])  # fmt: skip
def test_names_that_no_file_has(arguments, capsys, monkeypatch, tmp_path):
    """Names that are too long, or are those of folders, are mistakes like others, found before anything is computed."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("fish_env.training.report.evaluate", lambda *given: pytest.fail("it was computed"))
    assert command_line.main(arguments) == 2
    printed = capsys.readouterr()
    assert printed.err.startswith("fish_env: ") and printed.err.count("\n") == 1 and not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("error", "status", "said"),
    [
        (OSError(28, "No space left on device"), 2, "No space left"), (PermissionError(13, "denied"), 2, "denied"),
        (MemoryError(), 2, "MemoryError"), (gym.error.UnregisteredEnv("no such environment"), 2, "no such environment"),
        (ValueError("one\ntwo\n" * 9), 2, "one two one"), (ValueError("x" * 10**6), 2, "xxx ..."),
        (BrokenPipeError(), 141, ""), (KeyboardInterrupt(), 130, "Stopped."),
    ],
    ids=lambda value: type(value).__name__,
)  # fmt: skip
def test_how_commands_end(error, status, said, capsys):
    """What can go wrong outside the program is one line and a status, however long its text; a reader may leave."""

    def fail():
        raise error

    assert run_command("fish_env", fail) == status
    printed = capsys.readouterr().err
    assert said in printed and len(printed.strip().splitlines()) == bool(said) and len(printed) < 3000


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="there is no full disk to write to")
@pytest.mark.parametrize("arguments", [["-m", "fish_env", "versions"], ["-u", "-m", "fish_env"]], ids=" ".join)
@pytest.mark.parametrize("errors_too", [False, True])
def test_a_full_disk(arguments, errors_too):
    """Output that cannot be written is a mistake of status 2, said in one line where that can be read."""
    with open("/dev/full", "w") as full:
        done = subprocess.run([sys.executable, *arguments], stdout=full, stderr=full if errors_too else subprocess.PIPE,
                              cwd=ROOT, text=True, check=False)  # fmt: skip
    assert done.returncode == 2
    assert errors_too or (done.stderr.count("\n") == 1 and "No space left on device" in done.stderr)


@pytest.mark.skipif(sys.platform == "win32", reason="pipes end otherwise")
@pytest.mark.parametrize("options", [[], ["-u"]])
@pytest.mark.parametrize("arguments", [["-m", "fish_env", "versions"], ["train.py", "--help"]], ids=" ".join)
def test_a_reader_that_leaves(arguments, options):
    """`| head -0` ends a command without a word."""
    done = subprocess.Popen([sys.executable, *options, *arguments], stdout=subprocess.PIPE, stderr=subprocess.PIPE,
                            cwd=ROOT, text=True)  # fmt: skip
    assert done.stdout is not None and done.stderr is not None
    done.stdout.close()
    said = done.stderr.read()
    done.stderr.close()
    assert not said and done.wait() in (0, 141)  # argparse itself may take no notice
