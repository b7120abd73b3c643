"""Training: a run can be trusted, stopped and resumed; a bad request is an error; a report shows what was done."""

import errno
import json
import os
import pkgutil
import pty
import re
import shutil
import signal
import subprocess
import sys
import time
import zipfile
from dataclasses import asdict, replace
from itertools import count
from pathlib import Path
from types import SimpleNamespace

import gymnasium as gym
import numpy as np
import pytest
import tqdm.std
import yaml
from moving import tiered
from pages import ROOT
from trainings import SHORT, torch, train_short, training

mpl = pytest.importorskip("matplotlib")


import fish_env
import train as program
from agents import train_all
from fish_env import __main__ as command_line
from fish_env.control import (
    evaluate,
    load_policy,
    make_eval_env,
    make_policy_env,
    random_actions,
    record,
    shipped_policy,
)
from fish_env.control.equivariant import reflection_of
from fish_env.control.files import write_csv
from fish_env.control.film import film_data
from fish_env.control.statistics import SIGNED
from fish_env.envs.sb3 import FishVecEnv
from fish_env.training import callbacks, report, report_charts, report_page
from fish_env.training.build import export_policy, make_env, make_model, start_from
from fish_env.training.config import CONFIGS, FINE_TUNING, PARENT, Request, settings_for, settings_of
from fish_env.training.run_folder import CURVE, open_folder, read_curve
from fish_env.training.synergy import SynergyWrapper, synergies

LONGER = {"timesteps": 2048}
FISH = fish_env.make_fish()


def learner(task="swim", shaken=0.0, seed=0, **settings):
    """A learner of few fish, its parameters shaken; a body is a keyword of its environment."""
    options = {name: settings.pop(name) for name in ("body",) if name in settings}
    config = replace(settings_for(Request(task, env_options=options))[0], **settings)
    model = make_model(config, make_env(config, 4, seed), seed)
    with torch.no_grad():
        for parameter in model.policy.parameters():
            parameter.add_(shaken * torch.randn_like(parameter))
    return model


def steps_in(folder):
    """Environment steps of the model in a folder."""
    with zipfile.ZipFile(folder / "model.zip") as file:
        return json.loads(file.read("data"))["num_timesteps"]


# Runs


@pytest.mark.parametrize(("task", "symmetric"), [*((task, True) for task in CONFIGS), ("turn", False)])
def test_exported_policy_acts_like_the_model(task, symmetric):
    """The exported numpy policy gives the model's deterministic actions on raw observations, and is symmetric."""
    model = learner(task, 0.1, symmetric=symmetric)
    env = model.get_env()
    env.reset()
    for _ in range(5):
        obs, *_ = env.step(np.random.default_rng(0).uniform(-1, 1, (4, env.action_space.shape[0])))
    expected = model.predict(obs, deterministic=True)[0] @ synergies(env.unwrapped.fish, env.action_space.shape[0]).T
    policy = export_policy(model, {})
    np.testing.assert_allclose(policy(obs), np.clip(expected, -1, 1), atol=2e-5)
    place, sign, swap = reflection_of(env.unwrapped.fish)
    mirrored = policy((obs[:, place] * sign).astype(np.float32))
    assert np.allclose(mirrored, policy(obs)[:, swap], atol=2e-5) == symmetric
    assert np.abs(policy(obs) - policy(obs)[:, swap]).max() > 0.05


def test_a_learner_without_twist():
    """It has an action for each pair, and its policy commands the upper and the lower muscle of every pair alike."""
    model = learner("swim", 0.1, twist=False)
    env = model.get_env()
    env.reset()
    obs, *_ = env.step(np.random.default_rng(0).uniform(-1, 1, (4, 6)))
    fish, policy = env.unwrapped.fish, export_policy(model, {})
    wanted = np.clip(model.predict(obs, deterministic=True)[0], -1, 1)[:, fish.tank.fish.grouping("pairs")]
    np.testing.assert_allclose(policy(obs), wanted, atol=2e-5)
    place, sign, swap = reflection_of(fish)
    np.testing.assert_allclose(policy((obs[:, place] * sign).astype(np.float32)), policy(obs)[:, swap], atol=2e-5)
    assert np.abs(policy(obs) - policy(obs)[:, swap]).max() > 0.05


@pytest.mark.parametrize("twist", [False, True])
@pytest.mark.parametrize("groups", ["muscles", "pairs"])
def test_one_muscle_on_each_side(groups, twist):
    """Where there is nothing to combine, a learner commands the muscles."""
    fish = fish_env.make_fish()
    upper = np.flatnonzero(fish.heights > 0.0)
    marks = fish.landmarks._replace(muscles=fish.landmarks.muscles[upper])
    kept = {name: getattr(fish, name)[upper] for name in ("muscles", "sides", "segments", "contracted")}
    thin = replace(fish, **kept, fibres=None, drives=None, landmarks=marks)
    env = SynergyWrapper(fish_env.make_sb3_vec_env("FishEnv/Swim-v0", 2, body=thin, muscle_groups=groups), twist)
    np.testing.assert_array_equal(env.synergy_matrix, np.eye(6))


def test_run_leaves_everything_behind(tmp_path, monkeypatch, capsys):
    """A training run leaves model, policy, configuration, curve and report, and prints what to do next."""
    monkeypatch.setattr(report, "EPISODES", 3)
    folder = train_short(seed=3, root=tmp_path, report=True, pictures=True)
    for name in ("model.zip", "policy.npz", "config.json", "results.json", "curve.csv", "report.html"):
        assert (folder / name).stat().st_size > 0, name
    assert list((folder / "tensorboard").rglob("events.*"))
    saved = json.loads((folder / "config.json").read_text())
    assert saved["seed"] == 3 and saved["config"]["timesteps"] == 1024 and saved["versions"]["torch"]
    assert saved["threads"]["torch"] == 1
    assert saved["command"] == "fish_env train swim --seed 3 --timesteps 1024 --num-envs 8"
    printed = capsys.readouterr().out
    assert f"fish_env play {folder}" in printed and "best open-loop gait" in printed
    last = read_curve(folder)[-1]
    assert list(last) == [*CURVE, "term_progress", "term_effort", "term_sway", "term_failure"]
    assert last["return"] == pytest.approx(sum(last[name] for name in last if name not in CURVE), abs=3e-4) != 0.0


def test_same_seed_same_policy_whatever_the_clock_says(trained, tmp_path, monkeypatch):
    """One seed gives the same bits, also with a clock that jumps by days; another seed gives another policy."""
    looks = count()

    def jumping() -> float:
        return 1.7e9 + 1e5 * (-1) ** next(looks)

    monkeypatch.setattr("time.time", jumping)
    monkeypatch.setattr("time.time_ns", lambda: int(1e9 * jumping()))
    monkeypatch.setattr(tqdm.std, "time", jumping)
    monkeypatch.setattr("time.strftime", lambda form: "2020-01-01_00-00-00")
    runs = [train_short(seed=seed, root=tmp_path) for seed in (0, 1)]
    assert [run.name for run in runs] == ["2020-01-01_00-00-00", "2020-01-01_00-00-00_2"] and next(looks) > 10
    one, same, other = (np.load(run / "policy.npz")["weight0"] for run in (trained, *runs))
    np.testing.assert_array_equal(one, same)
    assert (one != other).any()
    seconds = [row["seconds"] for run in runs for row in read_curve(run)]
    assert seconds and all(0.0 <= value < 1000.0 for value in seconds)


def test_short_training_learns(tmp_path):
    """A short PPO run swims faster than it did before, on the evaluation seeds."""
    env = make_eval_env("FishEnv/Swim-v0", 8, {})
    before = evaluate(env, export_policy(learner(), {}))["speed"].mean()
    folder = train_short(root=tmp_path, changes={"timesteps": 65_536, "num_envs": 64})
    after = evaluate(env, load_policy(folder / "policy.npz"))["speed"].mean()
    assert after > before + 0.1


# Ctrl-C and resuming


def numbers_of(folder):
    """The numbers of a saved policy and of its optimizer, by name."""
    saved = training.PPO.load(folder / "model.zip", device="cpu").get_parameters()
    moments = saved["policy.optimizer"]["state"].items()
    rates = {"rate": torch.tensor([group["lr"] for group in saved["policy.optimizer"]["param_groups"]])}
    return saved["policy"] | {f"{k} {name}": value for k, each in moments for name, value in each.items()} | rates


def test_a_run_goes_on_where_it_was(run_copy, tmp_path, monkeypatch):
    """Parameters, optimizer, learning rate and counts are those of `PPO.load`; the curve is cut to the model.

    A curve without the terms of the reward, as of older runs, goes on without them.
    """
    before = shutil.copytree(run_copy, tmp_path / "before")
    table = [line.split(",") for line in (run_copy / "curve.csv").read_text().splitlines()]
    write_csv(run_copy / "curve.csv", [*table, ["999999", *table[-1][1:]]])
    write_csv(before / "curve.csv", [row[: len(CURVE)] for row in table])
    train_short(changes=LONGER, resume=run_copy)
    load = lambda folder, config, env: training.PPO.load(before / "model.zip", env, device="cpu")  # noqa: E731
    monkeypatch.setattr(training, "load_model", load)
    train_short(changes=LONGER, resume=before)
    one, other = numbers_of(run_copy), numbers_of(before)
    assert one.keys() == other.keys() and one["rate"] < 1e-3 and len(one) > 20
    for name, value in one.items():
        assert torch.equal(value, other[name]), name
    assert [path.name for path in (run_copy / "tensorboard").iterdir()] == ["ppo_1"]
    assert all(tuple(row) == CURVE for row in read_curve(before))
    steps = [row["timesteps"] for row in read_curve(run_copy)]
    assert steps == sorted(steps) and steps[-1] == 2048
    saved = json.loads((run_copy / "config.json").read_text())
    assert saved["resumed"] == 1 and saved["command"].endswith(f" --timesteps 2048 --num-envs 8 --resume {run_copy}")
    assert settings_of(saved["config"]) == replace(CONFIGS["swim"], num_envs=8, timesteps=2048)


def test_ctrl_c_saves_the_model_and_resume_continues(tmp_path, monkeypatch, capsys):
    """Ctrl-C saves model and policy and says how to resume; --resume continues to the end."""
    advance = training.Progress._on_rollout_end

    def press(self):
        advance(self)
        if self.num_timesteps >= 512:
            raise KeyboardInterrupt

    folder = tmp_path / "run"
    with monkeypatch.context() as patch, pytest.raises(training.Stopped):
        patch.setattr(training.Progress, "_on_rollout_end", press)
        train_short(folder=folder)
    assert f"--resume {folder}" in capsys.readouterr().out and load_policy(folder / "policy.npz")
    assert train_short(resume=folder, changes={}) == folder and steps_in(folder) == 1024


STUB_OF_MINE = """
import gymnasium as gym
gym.register({!r}, "fish_env.envs.stub:StubEnv", vector_entry_point="fish_env.envs.stub:StubVectorEnv",
             max_episode_steps={}, kwargs={{"task": "swim"}})
"""


def test_ctrl_c_before_the_first_step_of_a_resumed_run(run_copy, monkeypatch):
    """The steps that it was trained for stay, and so does its curve."""
    steps, rows = steps_in(run_copy), (run_copy / "curve.csv").read_text()

    def press(self):
        raise KeyboardInterrupt

    with monkeypatch.context() as patch, pytest.raises(training.Stopped):
        patch.setattr(FishVecEnv, "reset", press)
        train_short(resume=run_copy, changes=LONGER)
    assert steps_in(run_copy) == steps > 0 and (run_copy / "curve.csv").read_text() == rows


def test_commands_of_an_environment_of_ones_own(tmp_path, monkeypatch, capsys):
    """Those that are printed name its module, and quote a folder with a space."""
    (tmp_path / "of_mine.py").write_text(STUB_OF_MINE.format("Mine/Stub-v0", 20))
    monkeypatch.chdir(tmp_path)
    short = ["--timesteps", "256", "--num-envs", "8", "--folder", "my run", "--no-pictures"]
    assert command_line.main(["train", "of_mine:Mine/Stub-v0", *short]) == 0
    assert command_line.main(["train", "of_mine:Mine/Stub-v0", *short]) == 2
    assert "resume it with: fish_env train of_mine:Mine/Stub-v0 --resume 'my run'" in capsys.readouterr().err
    record = json.loads((tmp_path / "my run" / "config.json").read_text())
    assert record["command"].startswith("fish_env train of_mine:Mine/Stub-v0 ")
    assert (
        Request("Mine/Stub-v0", module="of_mine").watching("my run") == "fish_env play 'my run' --task-module of_mine"
    )


@pytest.mark.parametrize("cause", ["parent", "lost", "saving"])
def test_other_ends_save_the_run_too(cause, tmp_path, monkeypatch, capsys):
    """A starter that is gone, an exception that C lost, and Ctrl-C while the finished model is saved."""
    looks, folder, save = count(), tmp_path / "run", training.save_model

    def pressed(model, path):
        if next(looks) == 0:
            raise KeyboardInterrupt
        save(model, path)

    if cause == "parent":
        monkeypatch.setenv(PARENT, "1")  # another program than the one that starts it here
    elif cause == "saving":
        monkeypatch.setattr(training, "save_model", pressed)
    stopped = {"stopped": lambda: next(looks) > 100} if cause == "lost" else {}
    with pytest.raises(training.Stopped):
        train_short(folder=folder, **stopped)
    assert f"--resume {folder}" in capsys.readouterr().out
    steps = steps_in(folder)
    assert steps == 1024 if cause == "saving" else steps == 0 if cause == "parent" else 0 < steps < 1024


LONG = ["swim", "--timesteps", "100000000", "--num-envs", "8", "--torch-threads", "1", "--no-pictures"]
SIGNALS = ("SIGINT", "SIGTERM", "SIGHUP")
on_unix = pytest.mark.skipif(os.name == "nt", reason="Windows has no such signals")


def begun(*arguments, folder, files=1):
    """A program that trains in a folder: as many curves are there as it makes first."""
    process = subprocess.Popen(
        [sys.executable, str(ROOT / "train.py"), *arguments], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
        cwd=folder, preexec_fn=lambda: signal.signal(signal.SIGHUP, signal.SIG_DFL),
    )  # fmt: skip
    while len(list(folder.rglob("curve.csv"))) < files:
        assert process.poll() is None, process.communicate()
        time.sleep(0.05)
    return process


@on_unix
@pytest.mark.parametrize("name", tiered(SIGNALS, ("SIGTERM",)))
def test_a_signal_saves_the_run(name, tmp_path):
    """Ctrl-C, SIGTERM and SIGHUP save the model and say how to resume; so does a hail of them."""
    number = getattr(signal, name)
    process = begun(*LONG, "--folder", "run", folder=tmp_path)
    others = [getattr(signal, each) for each in SIGNALS] if name == "SIGTERM" else []
    for other in (number, *others, number):
        process.send_signal(other)
    printed, errors = process.communicate()
    assert process.returncode in {128 + each for each in (number, *others)} and "Traceback" not in errors
    assert "fish_env train swim --resume run" in printed and steps_in(tmp_path / "run") >= 0
    assert (tmp_path / "run" / "policy.npz").exists() and not list((tmp_path / "run").glob(".*"))


@on_unix
def test_a_terminal_that_is_gone(tmp_path):
    """When the terminal closes, nothing can be printed, and the run is saved all the same."""
    child, terminal = pty.fork()
    if not child:
        signal.signal(signal.SIGHUP, signal.SIG_DFL)
        os.chdir(tmp_path)
        os.execv(sys.executable, [sys.executable, str(ROOT / "train.py"), *LONG, "--folder", "run"])
    while not (tmp_path / "run" / "curve.csv").exists():
        time.sleep(0.05)
    os.close(terminal)
    _, status = os.waitpid(child, 0)
    assert os.waitstatus_to_exitcode(status) == 128 + signal.SIGHUP
    assert steps_in(tmp_path / "run") >= 0 and (tmp_path / "run" / "policy.npz").exists()


# All tasks


def test_training_everything_can_be_stopped_and_resumed(trained, tmp_path, monkeypatch):
    """`train.py all` leaves finished runs unchanged, resumes stopped ones, and names those that fail."""
    started = []

    def start(self, processor):
        started.append(self.command())
        self.folder.mkdir(parents=True, exist_ok=True)
        self.process = subprocess.Popen(["true"])
        self.process.wait()

    monkeypatch.setattr(train_all, "POLL", 0.01)
    monkeypatch.setattr(train_all.Job, "start", start)
    monkeypatch.setattr(train_all, "CONFIGS", {"swim": replace(CONFIGS["swim"], **SHORT)})
    monkeypatch.setitem(train_all.SEEDS, "swim", 3)
    for seed in range(2):
        shutil.copytree(trained, tmp_path / f"swim/seed_{seed}")
    (tmp_path / "swim/seed_0/results.json").write_text("{}")
    with pytest.raises(RuntimeError, match=r"2 of 3 runs failed; see .*seed_1.*seed_2"):
        train_all.train_all(tmp_path, ["swim"], jobs=1)
    assert [words[-2:] for words in started] == [["--resume", str(tmp_path / "swim/seed_1")],
                                                 ["--folder", str(tmp_path / "swim/seed_2")]]  # fmt: skip
    started.clear()
    with pytest.raises(RuntimeError, match="3 of 3 runs failed"):
        train_all.train_all(tmp_path / "other", ["swim"], 1, "semi_implicit", 0.001)
    for words in started:
        assert words[words.index("--integrator") + 1] == "semi_implicit" and words[words.index("--dt") + 1] == "0.001"
    with pytest.raises(ValueError, match="unknown integrator 'euler'"):
        train_all.train_all(tmp_path / "third", ["swim"], 1, "euler")
    monkeypatch.setattr(train_all, "CONFIGS", {"swim": replace(CONFIGS["swim"], epochs=3)})
    with pytest.raises(ValueError, match="was trained with other settings"):
        train_all.train_all(tmp_path, ["swim"])
    with pytest.raises(ValueError, match="jobs is 0"):
        train_all.train_all(tmp_path, ["swim"], jobs=0)


@on_unix
@pytest.mark.slow
def test_all_runs_are_saved_by_a_signal(tmp_path):
    """`train.py all` hands a signal on: every run that is under way saves its model and ends."""
    process = begun("all", "--runs", "runs", "--tasks", "swim", "--jobs", "2", folder=tmp_path, files=2)
    process.terminate()
    _, errors = process.communicate()
    assert process.returncode == 128 + signal.SIGTERM and "Resume: python train.py all" in errors
    for seed in range(2):
        folder = tmp_path / "runs" / "swim" / f"seed_{seed}"
        assert steps_in(folder) >= 0 and "--resume" in (folder / "log.txt").read_text()
        with open_folder(Request("swim", resume=folder)):  # nobody trains there any more
            pass


# What is kept when something fails


def test_a_folder_takes_one_run(run_copy):
    """A folder with a run in it, or in which another program trains, stays as it is."""
    with pytest.raises(ValueError, match="holds a run; resume it with"):
        train_short(folder=run_copy)
    request = Request("swim", resume=run_copy)
    with open_folder(request), pytest.raises(RuntimeError, match="another program is training"):
        train_short(resume=run_copy, changes=LONGER)


@pytest.mark.parametrize("elsewhere", [True, False])
def test_a_full_disk_at_the_end(elsewhere, run_copy, tmp_path, monkeypatch):
    """The model that was there stays, whole; the new one goes to the first folder that takes it, or it is said."""
    before, save = {name: (run_copy / name).read_bytes() for name in ("model.zip", "policy.npz")}, training.PPO.save
    (tmp_path / "file").write_text("a file, and no folder")
    (tmp_path / "other").mkdir()

    def full(self, path, *rest, **options):
        if not elsewhere or run_copy in Path(path).parents:
            Path(path).write_bytes(b"half")
            raise OSError(errno.ENOSPC, "No space left on device")
        save(self, path, *rest, **options)

    monkeypatch.setattr(training.PPO, "save", full)
    monkeypatch.setattr(training, "FALLBACK_FOLDERS", (str(tmp_path / "file"), str(tmp_path / "other")))
    message = r"No space left.*saved in .*fish_env-.*: free some space, copy them" if elsewhere else "nor did others"
    with pytest.raises(RuntimeError, match=message):
        train_short(resume=run_copy, changes=LONGER)
    assert {name: (run_copy / name).read_bytes() for name in before} == before and not list(run_copy.glob(".*"))
    found = list((tmp_path / "other").glob("fish_env-*/*"))
    assert {path.name for path in found} == ({"model.zip", "policy.npz"} if elsewhere else set())
    assert all(steps_in(path.parent) == 2048 for path in found)


def test_a_full_disk_ends_the_training_and_keeps_the_model(tmp_path, monkeypatch):
    """A file that cannot be written ends the run; the model goes elsewhere, and the last checkpoint is whole."""
    monkeypatch.setattr(training, "Checkpoint", lambda *given: callbacks.Checkpoint(*given, seconds=0.0))
    folder, replace_file, written_files = tmp_path / "run", os.replace, []
    (tmp_path / "elsewhere").mkdir()

    def full_after_a_while(source, target):
        if folder in Path(target).parents:  # kernels are stored elsewhere
            written_files.append(Path(target).name)
            if len(written_files) > 4:
                raise OSError(errno.ENOSPC, "No space left on device")
        replace_file(source, target)

    with monkeypatch.context() as patch:
        patch.setattr(os, "replace", full_after_a_while)
        patch.setattr(training, "FALLBACK_FOLDERS", (str(tmp_path / "elsewhere"),))
        with pytest.raises(RuntimeError, match=r"did not take the model after .* are saved in .*elsewhere"):
            train_short(folder=folder, changes={"timesteps": 4096, "num_envs": 8})
    (kept,) = (tmp_path / "elsewhere").glob("fish_env-*")
    assert 0 < steps_in(folder) <= steps_in(kept) < 4096 and not list(folder.glob(".*"))
    train_short(resume=folder, changes={})
    assert steps_in(folder) == 4096


def test_a_diverged_training_ends_with_advice(run_copy, monkeypatch):
    """Parameters that are not finite end the run with an error, and the model that was saved stays."""
    before = (run_copy / "model.zip").read_bytes()

    def diverge(self):
        with torch.no_grad():
            self.policy.log_std[0] = np.nan

    monkeypatch.setattr(training.PPO, "train", diverge)
    for steps in (1280, 2048):  # at the end of the training, and before
        with pytest.raises(ValueError, match="not finite; resume the run from its last checkpoint"):
            train_short(resume=run_copy, changes={"timesteps": steps})
    assert (run_copy / "model.zip").read_bytes() == before


def changed_record(**changes):
    """A function that changes what is in config.json; None takes a field away."""

    def change(folder):
        path, others = folder / "config.json", dict(changes)
        saved = json.loads(path.read_text())
        saved["config"] |= others.pop("config", {})
        path.write_text(json.dumps({k: v for k, v in (saved | others).items() if v is not None}))

    return change


def cut(name, kept):
    """A function that keeps a part of a file."""
    return lambda folder: (folder / name).write_bytes((folder / name).read_bytes()[kept])


RECORD = r"config.json cannot be used \("
BROKEN = {
    "half": (cut("config.json", slice(-8)), RECORD),
    "empty": (cut("config.json", slice(0)), RECORD),
    "no seed": (changed_record(seed=None), RECORD + "'seed'"),
    "fish": (changed_record(config={"num_envs": "8"}), RECORD + ".*num_envs is '8'; give a whole number, at least 1"),
    "memory": (changed_record(config={"num_envs": 10**9}), RECORD + ".*this machine has"),
    "layers": (changed_record(config={"hidden": [64, "x"]}), RECORD + r".*hidden is \(64, 'x'\); give whole numbers"),
    "setting": (changed_record(config={"speed": 1}), RECORD + ".*not those of this version"),
    "unknown task": (changed_record(task="fly"), "unknown task 'fly'"),
    "module": (changed_record(config={"env_id": "this:FishEnv/Swim-v0"}), "is not that of a task 'swim' here"),
    "other task": (changed_record(task="turn", config={"env_id": "FishEnv/Turn-v0"}), "of task 'turn', not 'swim'"),
    "half a model": (cut("model.zip", slice(5000)), "model.zip cannot be read"),
    "other layers": (changed_record(config={"hidden": [8, 8]}), r"model.zip has hidden=\(32, 32\) and .*\(8, 8\)"),
    "row": (cut("curve.csv", slice(-8)), r"curve.csv cannot be read .*; delete it"),
    "head": (cut("curve.csv", slice(3, None)), r"curve.csv cannot be read \(its head is"),
}


@pytest.mark.parametrize("name", BROKEN)
def test_a_run_whose_files_are_broken_is_not_used(name, run_copy, tmp_path):
    """Each file that cannot be used is an error that names it, and no file of the run is changed."""
    damage, message = BROKEN[name]
    damage(run_copy)
    before = {path: path.read_bytes() for path in run_copy.rglob("*") if path.is_file()}
    with pytest.raises(ValueError, match=message):
        train_short(resume=run_copy, changes=LONGER)
    assert {path: path.read_bytes() for path in run_copy.rglob("*") if path.is_file()} == before
    if "config" in message or "model.zip cannot" in message:
        with pytest.raises(ValueError, match=message):
            train_short(start=run_copy, folder=tmp_path / "new")
        assert not (tmp_path / "new" / "config.json").exists()
    if "model" not in message and "not 'swim'" not in message:
        with pytest.raises(ValueError, match=message):
            report_page.write_report([run_copy], tmp_path / "page.html", 2)


def test_a_run_of_other_versions_is_resumed_with_a_warning(run_copy, capsys):
    """What is installed now differs: it is said, and the record has both versions."""
    saved = json.loads((run_copy / "config.json").read_text())
    installed = saved["versions"]["fish_env"]
    changed_record(versions=saved["versions"] | {"fish_env": "0.0.1"}, threads=None)(run_copy)
    train_short(resume=run_copy, changes=LONGER)
    printed = capsys.readouterr().out
    assert f"Warning: the run was trained with fish_env 0.0.1 (now {installed}). Training continues" in printed
    assert json.loads((run_copy / "config.json").read_text())["versions"]["fish_env"] == f"0.0.1, {installed}"


# Requests


@pytest.mark.parametrize(("words", "message"), [
    ("train swim --resume {} --folder other", "give --resume alone"),
    ("train swim --resume {} --hyperparameters initial_log_std=0.0", "initial_log_std is for a new one"),
    ("train swim --start-from {} --hyperparameters initial_log_std=0.0", "initial_log_std is for a new one"),
    ("compare --integrators --episodes 5 --policy mine.npz", "leave out episodes, policy"),
    ("train endless:Endless-v0 --folder other", "Endless-v0 has no time limit"),
])  # fmt: skip
def test_what_would_have_no_effect_is_refused(words, message, run_copy, tmp_path, monkeypatch, capsys):
    """Options that would be ignored, and an environment in which no policy can be evaluated."""
    (tmp_path / "endless.py").write_text(STUB_OF_MINE.format("Endless-v0", None))
    monkeypatch.chdir(tmp_path)
    assert command_line.main(words.format(run_copy).split(), program.make_parser()[0]) == 2
    assert message in capsys.readouterr().err and not Path("other").exists()


@pytest.mark.parametrize(("option", "value"), [
    ("seed", "-1"), ("seed", str(2**32)), ("num-envs", "0"), ("num-envs", "1000000000"), ("timesteps", "0"),
    ("timesteps", "1" + "0" * 30), ("torch-threads", "0"), ("dt", "nan"), ("dt", "0"), ("dt", "0.0015"),
    ("body", "eel"), ("integrator", "euler"), ("hyperparameters", "timesteps=1.5"), ("hyperparameters", "hidden=[]"),
    ("hyperparameters", "hidden=[1000000000]"), ("hyperparameters", "horizon=0"), ("env-kwargs", "fins=3"),
    ("hyperparameters", "learning_rate=NaN"), ("hyperparameters", "lr=3"), ("hyperparameters", "env_options=3"),
])  # fmt: skip
def test_what_is_not_allowed_is_refused_before_a_folder_is_made(option, value, tmp_path, monkeypatch, capsys):
    """One line, and nothing at all lies in the folder."""
    monkeypatch.chdir(tmp_path)
    assert command_line.main(["train", "swim", "--folder", "run", f"--{option}", value]) == 2
    printed = capsys.readouterr().err
    assert printed.startswith("fish_env: ") and printed.count("\n") == 1 and not list(tmp_path.iterdir())


def test_runs_that_cannot_be_used(trained, tmp_path):
    """No run, a place that cannot be written to, another seed, environment or task, and fewer steps are errors."""
    (tmp_path / "file").write_text("not a folder")
    for asked in ({"resume": tmp_path}, {"start": tmp_path, "root": tmp_path}):
        with pytest.raises(FileNotFoundError, match="give the folder of a run"):
            train_short(**asked)
    for place in ({"folder": tmp_path / "file" / "run"}, {"root": tmp_path / "file"}):
        with pytest.raises(ValueError, match="no file can be written in the folder"):
            train_short(**place)
    with pytest.raises(ValueError, match="begun with --seed 0, not 3"):
        train_short(seed=3, resume=trained)
    with pytest.raises(ValueError, match="trained for 1,024 environment steps already"):
        train_short(resume=trained, changes={"timesteps": 512})
    for asked in ({"body": "planar"}, {"dt": 0.001}, {"start": trained}):
        with pytest.raises(ValueError, match="has its environment and its starting point"):
            train_short(resume=trained, **asked)
    with pytest.raises(ValueError, match="is a run of task 'swim', not 'turn'"):
        train_short("turn", root=tmp_path, start=trained)
    assert [path.name for path in tmp_path.iterdir()] == ["file"]


MISSING = """import importlib.metadata, runpy, sys
distribution = importlib.metadata.distribution
importlib.metadata.distribution = lambda name: distribution("no-such" if name == {missing!r} else name)
if {missing!r} != "fish_env":
    sys.modules[{missing!r}] = None
sys.path.insert(0, {root!r})
runpy.run_path({root!r} + "/train.py", run_name="__main__")
"""


@pytest.mark.parametrize("missing", tiered(
    ("fish_env", "stable_baselines3", "tensorboard", "matplotlib", "numba"), ("fish_env", "numba")
))  # fmt: skip
def test_a_checkout_that_is_not_installed(missing, tmp_path):
    """Without a package, or without having been installed, training says in one line what to do, and makes nothing."""
    command = [sys.executable, "-c", MISSING.format(root=str(ROOT), missing=missing), "swim", "--folder", "run"]
    done = subprocess.run(command, capture_output=True, text=True, cwd=tmp_path)
    assert done.returncode == 2 and done.stderr.count("\n") == 1 and "pip install -c constraints" in done.stderr
    assert not list(tmp_path.iterdir())


# Other bodies and methods


@pytest.mark.parametrize("symmetric", [True, False])
def test_start_from_another_body(symmetric):
    """A policy trained in pairs on the flat fish moves both muscles of a pair alike on another body, and back again."""
    flat = learner(body="planar", shaken=0.3, symmetric=symmetric)
    solid, again = (learner(body=body, seed=1, symmetric=symmetric) for body in ("mass_spring", "planar"))
    noise = solid.policy.log_std.detach().clone()
    start_from(solid, flat)
    start_from(again, solid)
    obs = np.random.default_rng(0).normal(size=(20, flat.observation_space.shape[0])).astype(np.float32)
    pairs, muscles, back = (export_policy(model, {})(obs) for model in (flat, solid, again))
    np.testing.assert_allclose(muscles, pairs[:, FISH.grouping("pairs")], atol=1e-5)
    np.testing.assert_allclose(back, pairs, atol=1e-5)
    assert pairs.shape == (20, 6) and np.abs(pairs).max() > 0.1
    both = np.isin(solid.policy.log_std.detach().numpy(), flat.policy.log_std.detach().numpy())
    assert both.sum() == 6 and (solid.policy.log_std.detach()[~both] == noise[~both]).all()


def test_a_start_that_does_not_fit_is_refused():
    """Other tasks, networks and kinds of policy are refused, and the learner stays as it was."""
    model = learner(body="planar")
    before = {name: value.clone() for name, value in model.policy.state_dict().items()}
    for other in (learner("avoid", body="planar"), learner(hidden=(16, 16)), learner(body="planar", symmetric=False)):
        with pytest.raises(ValueError, match=r"start from a run of the\s+same task"):
            start_from(model, other)
    after = model.policy.state_dict()
    assert all(torch.equal(value, after[name]) for name, value in before.items())


def test_train_with_another_simulation(tmp_path):
    """Body, method and step are in the settings, the command and the policy; a run resumes so, and another goes on."""
    chosen = {"body": "planar", "integrator": "symplectic_euler", "dt": 0.00025}
    first = train_short(folder=tmp_path / "flat", **chosen)
    saved, policy = json.loads((first / "config.json").read_text()), load_policy(first / "policy.npz")
    options = chosen | {"muscle_groups": "pairs"}
    assert saved["config"]["env_options"] == policy.about["env_options"] == options
    assert saved["command"].endswith("""--env-kwargs 'body="planar"' 'integrator="symplectic_euler"' dt=0.00025""")
    env = make_policy_env(policy, 2)
    assert env.tank.fish.flat and env.tank.integrator.name == "symplectic_euler" and env.tank.dt == 0.00025
    env = make_policy_env(policy, 2, body="mass_spring")
    assert not env.tank.fish.flat and np.isfinite(evaluate(env, policy)["speed"]).all()
    train_short(resume=first, changes=LONGER)
    assert json.loads((first / "config.json").read_text())["config"]["env_options"] == options
    second = train_short(folder=tmp_path / "solid", body="mass_spring", start=first)
    saved = json.loads((second / "config.json").read_text())
    assert f"--start-from {first}" in saved["command"] and saved["start"] == str(first)
    assert {name: saved["config"][name] for name in FINE_TUNING} == FINE_TUNING | SHORT


# Files of others


def test_zoo_file_agrees_with_the_settings():
    """agents/rl_zoo3.yml has the settings of CONFIGS, for as many environment steps an update."""
    zoo = yaml.safe_load((ROOT / "agents" / "rl_zoo3.yml").read_text())
    assert set(zoo) == {config.env_id for config in CONFIGS.values()}
    for task in fish_env.TASKS:
        config = CONFIGS[task]
        given, update = zoo[config.env_id], config.num_envs * config.rollout
        assert given["n_envs"] * given["n_steps"] == update and given["n_timesteps"] % update == 0
        assert given["n_timesteps"] == pytest.approx(config.timesteps, abs=update)
        interval = config.env_options.get("control_interval", 0.02)
        assert given["gamma"] == pytest.approx(config.discount(interval), abs=1e-4)
        wanted = (config.batch_size, config.epochs, config.gae_lambda, config.clip_range, config.entropy_weight)
        assert tuple(given[k] for k in ("batch_size", "n_epochs", "gae_lambda", "clip_range", "ent_coef")) == wanted
        assert given["learning_rate"] == f"lin_{config.learning_rate:.0e}".replace("e-0", "e-")
        assert given["policy_kwargs"] == {"net_arch": list(config.hidden), "log_std_init": config.initial_log_std}
        assert given.get("env_kwargs", {}) == config.env_options


@pytest.mark.parametrize("name", [
    "agents.build.falling", "agents.layers.Tanh", "fish_env.training.build.falling",
    "fish_env.control.equivariant.Reflection", "fish_env.control.equivariant.EquivariantPolicy",
])  # fmt: skip
def test_names_in_saved_models(name):
    """What `model.zip` files refer to has its old name, so that `PPO.load` of Stable-Baselines3 reads them."""
    assert isinstance(pkgutil.resolve_name(name), type)


# Reports


@pytest.fixture(scope="module")
def runs(tmp_path_factory):
    """The files that a report reads, of two runs that differ in their seeds and of one with another learning rate."""
    root = tmp_path_factory.mktemp("runs")
    for name, seed, rate, gain in (("seed0", 0, 1e-3, 1.0), ("seed1", 1, 1e-3, 1.5), ("other", 1, 5e-4, 3.0)):
        (root / name).mkdir()
        config = asdict(replace(CONFIGS["swim"], timesteps=5000, learning_rate=rate))
        saved = {"task": "swim", "seed": seed, "config": config, "command": f"fish_env train swim --seed {seed}"}
        (root / name / "config.json").write_text(json.dumps(saved))
        shutil.copy(shipped_policy("swim"), root / name)
        rows = [(1000 * k, k, 10, gain * k, 2 * gain * k, 3 * gain * k, -gain * k, 0.0) for k in range(1, 6)]
        write_csv(root / name / "curve.csv", [(*CURVE, "term_progress", "term_effort", "term_sway"), *rows])
    return root


def sections(text):
    """The text of a page by its headings."""
    parts = re.split(r"<h2>(.*?)</h2>", text)
    return dict(zip(parts[1::2], parts[2::2], strict=True))


CHARTS = ("Learning curves", "Path", "Gait")


def test_page_of_a_run(runs, capsys):
    """One run: film, metrics beside untrained controllers, curves, path, gait, failures, settings; nothing is loaded.

    There is no curve of a term that is always zero, and no row of a metric that is always the same.
    """
    assert command_line.main(["report", str(runs / "seed0"), "--episodes", "3"]) == 0
    path = runs / "seed0" / "report.html"
    assert f"written to {path}" in capsys.readouterr().out
    text = path.read_text()
    found = sections(text)
    assert list(found) == ["Film", "swim: results", *CHARTS, "Failures", "swim: the run"]
    assert [found[name].count("<svg") for name in CHARTS] == [4, 1, 1]
    for title in ("speed, BL/s", "return, per episode", "reward term progress", "reward term effort"):
        assert f">{title}<" in found["Learning curves"], title
    assert "fish_env train swim --seed 0" in text and "<td>learning_rate</td>" in text
    assert ">5,000 of 5,000<" in found["swim: the run"]
    assert "trained policy: none of 3 episodes" in found["Failures"]
    assert "srcdoc=" in found["Film"] and "film_player" not in found["Film"]
    for loaded in ("http", 'src="', "@import", "<link"):
        assert loaded not in text, loaded
    assert len(text) < 3_000_000
    policy = report_page.read_run(runs / "seed0").policy
    table = [re.findall(r"<t[hd].*?>(.*?)</t[hd]>", row) for row in found["swim: results"].split("<tr>")[1:]]
    assert table[0] == ["metric", "trained policy", "random", "best open-loop gait", "motor controllers"]
    speed = evaluate(make_policy_env(policy, 3), policy)["speed"].mean()
    assert table[1][0] == "speed, BL/s" and table[1][1].partition(" (")[0] == f"{speed:.3g}"
    rows = {row[0]: row[1:] for row in table}
    assert rows["failed, %"] == ["0 (0 to 56.1)"] * 4 and "seconds" not in rows


def test_page_of_several_runs(runs, tmp_path, monkeypatch):
    """Seeds are put together, other settings are named, and every chart shows both groups, up to its colours."""
    path = report_page.write_report([runs / name for name in ("seed0", "other", "seed1", "seed0")], episodes=2)
    assert path == runs / "report.html"
    text = path.read_text()
    found = sections(text)
    assert "3 training runs" in text and "<iframe" not in text
    assert found["swim: the runs"].count("<tr>") == 4 and "<td>learning_rate 0.001</td>" in found["swim: the runs"]
    assert "learning_rate 0.001 (2 seeds)" in found["swim: results"]
    for name in CHARTS:
        assert "learning_rate 0.0005" in found[name] and "learning_rate 0.001" in found[name], name
    monkeypatch.setattr(report_charts, "COLOURS", report_charts.COLOURS[:1])
    with pytest.raises(ValueError, match="2 different settings; compare at most 1"):
        report_page.write_report([runs / "seed0", runs / "other"], episodes=2)


def test_metrics_that_one_of_several_runs_lacks():
    """They stand in the table whatever run comes first."""
    shared = {name: np.arange(3.0) for name in ("return", "speed")}
    scores = shared | {"failed": np.zeros(3), "success": np.ones(3)}, shared | {"speed_error": np.arange(3.0)}
    groups = [
        SimpleNamespace(label=f"run {k}", episodes=[each], runs=[0], untrained={}) for k, each in enumerate(scores)
    ]
    for order in (groups, groups[::-1]):
        table = report_page.tabulate_metrics(order, "speed")
        assert "speed error" in table and "success" in table


def test_a_page_that_cannot_be_written(runs, tmp_path):
    """Folders that are no runs, no episodes and another ending are refused; a run without a row has a page."""
    bad, page = tmp_path / "bad", tmp_path / "page.html"
    for folders, options, message in (
        ([bad], {}, "bad is not a training run: it is not a folder"),
        ([tmp_path], {}, "it holds no config.json, curve.csv, policy.npz; give a folder that"),
        ([runs / "seed0"], {"episodes": 0}, "episodes is 0"),
        ([], {}, "there is no folder"),
        ([runs / "seed0"], {"path": tmp_path / "page.pdf"}, r"give a name that ends in .html"),
    ):
        with pytest.raises(ValueError, match=message):
            report_page.write_report(folders, **{"path": page} | options)
    shutil.copytree(runs / "seed0", bad)
    write_csv(bad / "curve.csv", [CURVE])
    assert not page.exists() and report_page.write_report([bad], page, 2).exists()  # interrupted before the first row


@pytest.mark.parametrize("score", ["return", "speed", "success"])
def test_learning_curves(score):
    """A small change looks small, as axes have zero. Shares are in per cent. The return as the score has one chart."""
    curve = {"timesteps": np.array([1e6, 2e6]), "score": np.array([1.0138, 1.015]), "return": -np.ones(2)}
    with mpl.rc_context(report_charts.STYLE):
        pictures = report_charts.draw_learning_curves([[curve]], score)
    found = {}
    for picture in pictures:
        *words, title = re.findall(r">([^<>]*)</text>", picture)
        found[title] = [float(word.replace("\u2212", "-")) for word in words[words.index("environment steps") + 1 :]]
    assert list(found) == list(dict.fromkeys([report_charts.shown(score)[0], "return, per episode"]))
    assert all(0.0 in ticks for ticks in found.values())
    assert max(next(iter(found.values()))) == {"return": 0.0, "speed": 1.0, "success": 100.0}[score]


@pytest.mark.parametrize("id, keywords", [
    *((config.env_id, {}) for config in CONFIGS.values()),
    ("FishEnv/Swim-v0", {"speed": 1.0}), ("FishEnv/Target-v0", {"goal_env": True}),
])  # fmt: skip
def test_every_metric_has_a_unit(id, keywords):
    """Those of every task, but for what is its own unit and what has no meaningful mean."""
    env = make_eval_env(id, 1, keywords)
    assert evaluate(env, random_actions(env)).keys() - report_charts.UNITS.keys() <= {"seconds", *SIGNED}


def test_failures_are_counted_and_listed(runs):
    """Episodes that the physics ended are counted, and the worst ones are listed with their seeds."""
    group = report_page.measure_group("a", [report_page.read_run(runs / "seed0")], 3)
    scores = group.episodes[0]
    assert not scores["failed"].any()
    failing = scores | {"failed": np.array([1.0, 0.0, 1.0])}
    text = report_page.list_failures(replace(group, episodes=[failing, failing]))
    assert "a: 4 of 6 episodes were ended by a failure" in text and "class=bad" in text
    assert all(f">{1_000_000 + k}<" in text for k in range(3))


def test_motion_of_a_stiff_fish():
    """A stiff fish that is carried about has the path that it was given, the first command along +x."""
    one = record(gym.make("FishEnv/Swim-v0"), np.zeros((40, 12)), 1)
    angle = np.linspace(0.2, 0.2 + 1.5 * np.pi, 41)  # past half a turn
    turn = np.zeros((41, 3, 3))
    turn[:, 0, 0] = turn[:, 1, 1] = np.cos(angle)
    turn[:, 1, 0], turn[:, 0, 1], turn[:, 2, 2] = np.sin(angle), -np.sin(angle), 1.0
    centre = np.column_stack([np.linspace(0, 1, 41), np.linspace(0, -2, 41) ** 2, np.zeros(41)]) * FISH.length
    rest = FISH.body.position - FISH.body.mass @ FISH.body.position / FISH.body.mass.sum()
    one.position[:] = np.einsum("tij,nj->tni", turn, rest) + centre[:, None]
    one.directions[:, 0] = (0.0, 1.0, 0.0)
    found = report_page.measure_motion(one, film_data([one]).episodes[0], FISH)
    moved = centre[:, :2] / FISH.length
    np.testing.assert_allclose(found.path, np.column_stack([moved[:, 1], -moved[:, 0]]), atol=1e-12)  # +x is +y
    order, names = report_page.order_muscles(FISH)
    assert sorted(order) == list(range(12)) and names[0] == "Lu 1" and names[-1] == "Rl 3"
    assert (FISH.sides[order[:6]] > 0).all()
