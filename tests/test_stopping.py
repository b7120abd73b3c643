"""Runs that are stopped by a signal, and those that cannot begin: all is said in a line, nothing is lost or left."""

import json
import os
import shutil
import signal
import subprocess
import sys
import time
import zipfile
from itertools import count

import pytest
from moving import tiered
from pages import ROOT
from trainings import train_short, training

from fish_env import __main__ as command_line
from fish_env.control import console

LONG = ["swim", "--timesteps", "100000000", "--num-envs", "8", "--torch-threads", "1", "--no-pictures"]
SIGNALS = ("SIGINT", "SIGTERM", "SIGHUP")
on_unix = pytest.mark.skipif(os.name == "nt", reason="Windows has no such signals")


def hear(handler=signal.SIG_DFL):
    """Let a program hear SIGHUP, even if the tests were begun to ignore it."""
    signal.signal(signal.SIGHUP, handler)


def begun(*arguments, folder, ready="curve.csv", files=1, before=hear):
    """A program that trains in a folder: as many files of a name are there as it makes first."""
    command = [sys.executable, str(ROOT / "train.py"), *arguments]
    process = subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, cwd=folder, preexec_fn=before
    )
    while len(list(folder.rglob(ready))) < files:
        assert process.poll() is None, process.communicate()
        time.sleep(0.05)
    return process


def counted(folder):
    """Environment steps of the model in a folder."""
    with zipfile.ZipFile(folder / "model.zip") as file:
        return json.loads(file.read("data"))["num_timesteps"]


@on_unix
@pytest.mark.parametrize("name", tiered(SIGNALS, ("SIGTERM",)))
def test_a_signal_saves_the_run(name, tmp_path):
    """Ctrl-C, SIGTERM and SIGHUP save the model and say how to resume; so does a hail of them."""
    number = getattr(signal, name)
    process = begun(*LONG, "--folder", "run", folder=tmp_path)
    others = [getattr(signal, each) for each in SIGNALS] if name == "SIGTERM" else []
    for other in (number, *others, number):
        process.send_signal(other)
    said, errors = process.communicate()
    assert process.returncode in {128 + each for each in (number, *others)} and "Traceback" not in errors
    assert "fish_env train swim --resume run" in said and counted(tmp_path / "run") >= 0
    assert (tmp_path / "run" / "policy.npz").exists() and not list((tmp_path / "run").glob(".*"))


@on_unix
@pytest.mark.slow
def test_nohup_works_as_usual(tmp_path):
    """A run that was begun to ignore SIGHUP goes on; SIGTERM ends it."""
    process = begun(*LONG, "--folder", "run", folder=tmp_path, before=lambda: hear(signal.SIG_IGN))
    process.send_signal(signal.SIGHUP)
    with pytest.raises(subprocess.TimeoutExpired):
        process.wait(1.0)
    process.terminate()
    process.communicate()
    assert process.returncode == 128 + signal.SIGTERM


@on_unix
def test_all_runs_are_saved_by_a_signal(tmp_path):
    """`train.py all` hands a signal on: every run that is under way saves its model and ends."""
    arguments = ("all", "--runs", "runs", "--tasks", "swim", "--jobs", "2")
    process = begun(*arguments, folder=tmp_path, files=2)
    process.terminate()
    _, errors = process.communicate()
    assert process.returncode == 128 + signal.SIGTERM and "Resume: python train.py all" in errors
    for seed in range(2):
        folder = tmp_path / "runs" / "swim" / f"seed_{seed}"
        assert counted(folder) >= 0 and "--resume" in (folder / "log.txt").read_text()
        with training.lock_folder(folder):  # nobody trains there any more
            pass


@on_unix
def test_a_terminal_that_is_gone(tmp_path):
    """When the terminal closes, nothing can be printed, and the run is saved all the same."""
    pty = pytest.importorskip("pty")
    child, terminal = pty.fork()
    if not child:
        hear()
        os.chdir(tmp_path)
        os.execv(sys.executable, [sys.executable, str(ROOT / "train.py"), *LONG, "--folder", "run"])
    while not (tmp_path / "run" / "curve.csv").exists():
        time.sleep(0.05)
    os.close(terminal)
    _, status = os.waitpid(child, 0)
    assert os.waitstatus_to_exitcode(status) == 128 + signal.SIGHUP
    assert counted(tmp_path / "run") >= 0 and (tmp_path / "run" / "policy.npz").exists()


def test_ctrl_c_while_the_program_is_imported(tmp_path):
    """It ends with one line, and the status of a program that Ctrl-C ended."""
    shutil.copy(ROOT / "train.py", tmp_path)
    (tmp_path / "fish_env.py").write_text("raise KeyboardInterrupt")
    done = subprocess.run([sys.executable, tmp_path / "train.py", "swim"], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout, done.stderr) == (130, "", "\nStopped.\n")


def test_a_signal_while_the_finished_model_is_saved(tmp_path, monkeypatch, capsys):
    """It waits until the model is there, and the run says how it is evaluated."""
    save, calls = training.save_model, []

    def pressed(model, path):
        calls.append(path)
        if len(calls) == 1:
            raise KeyboardInterrupt
        save(model, path)

    monkeypatch.setattr(training, "save_model", pressed)
    with pytest.raises(training.Stopped):
        train_short(folder=tmp_path / "run")
    assert counted(tmp_path / "run") == 1024 and f"--resume {tmp_path / 'run'}" in capsys.readouterr().out


def test_an_interruption_that_is_lost(tmp_path, capsys):
    """If nothing came of the exception that a signal raised, as in a callback of C, the run ends with the next step."""
    looks = count()
    with pytest.raises(training.Stopped):
        train_short(
            folder=tmp_path / "run", changes={"timesteps": 10**8, "num_envs": 8}, stopped=lambda: next(looks) > 100
        )
    assert 0 < counted(tmp_path / "run") < 1024 and "Resume:" in capsys.readouterr().out


def test_only_the_first_signal_is_heard():
    """The handlers of before are there again afterwards."""
    before = [signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)]
    came = []
    with console.hear_first_signal(came):
        with pytest.raises(KeyboardInterrupt):
            signal.raise_signal(signal.SIGTERM)
        signal.raise_signal(signal.SIGINT)
        signal.raise_signal(signal.SIGTERM)
    assert came == [signal.SIGTERM, signal.SIGINT, signal.SIGTERM]
    assert [signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)] == before


# What cannot begin

OUT_OF_RANGE = {
    "seed": ["-1", str(2**32), str(10**30)],
    "num-envs": ["0", str(10**9), str(10**30)],
    "timesteps": ["0", str(10**30)],
    "torch-threads": ["0", str(10**9)],
    "dt": ["nan", "0", "inf", "1e9"],
}


@pytest.mark.parametrize(
    ("option", "value"), [(option, value) for option in OUT_OF_RANGE for value in OUT_OF_RANGE[option]]
)
def test_what_is_out_of_range_is_refused_before_a_folder_is_made(option, value, tmp_path, monkeypatch, capsys):
    """One line, and nothing at all lies in the folder."""
    monkeypatch.chdir(tmp_path)
    for place in ([], ["--folder", "run"]):
        assert command_line.main(["train", "swim", f"--{option}", value, "--no-pictures", *place]) == 2
        said = capsys.readouterr().err
        assert said.startswith("fish_env: ") and said.count("\n") == 1 and not list(tmp_path.iterdir())


@pytest.mark.parametrize(("asked", "message"), [
    ({"task": "fly"}, "unknown task 'fly'; choose from swim"), ({"body": "eel"}, "unknown body 'eel'; choose from"),
    ({"integrator": "euler"}, "unknown integrator 'euler'; choose from 'semi_implicit'"),
    ({"dt": -1.0}, "dt is -1.0; give a positive number of seconds"),
    ({"dt": 0.003}, "the control interval is 0.02 s; give a whole multiple of dt = 0.003 s"),
    ({"integrator": "semi_implicit", "body": "planar", "dt": 0.03}, "the control interval is 0.02 s"),
    ({"seed": True}, "seed is True"), ({"seed": 1.0}, "seed is 1.0"),
    *(({"changes": {name: value}}, message) for name, value, message in (
        ("timesteps", 1.5, "timesteps is 1.5"), ("num_envs", "8", "num_envs is '8'"), ("num_envs", 0, "num_envs is 0"),
        ("hidden", (), "hidden is"), ("hidden", (10**9,), "this machine has"), ("horizon", 0.0, "horizon is 0.0"),
        ("learning_rate", float("nan"), "learning_rate is nan"), ("env_options", {"body": "eel"}, "unknown body"),
        ("env_options", {"seed": 1}, "seed cannot"), ("env_options", {"fins": 3}, "fins"),
    )),
], ids=str)  # fmt: skip
def test_requests_that_are_not_allowed(asked, message, tmp_path):
    """In a script too, nothing is made before all is checked."""
    with pytest.raises(ValueError, match=message):
        train_short(**{"root": tmp_path / "runs"} | asked)
    assert not list(tmp_path.iterdir())


def test_folders_that_cannot_be_used(trained, tmp_path):
    """Folders that hold no run, or cannot be written to, and fewer steps than a run has are errors."""
    (tmp_path / "file").write_text("not a folder")
    with pytest.raises(FileNotFoundError, match="to resume"):
        train_short(resume=tmp_path)
    for place in ({"folder": tmp_path / "file" / "run"}, {"root": tmp_path / "file"}):
        with pytest.raises(ValueError, match="no file can be written in the folder"):
            train_short(**place)
    with pytest.raises(ValueError, match="begun with --seed 0, not 3"):
        train_short(seed=3, resume=trained)
    with pytest.raises(ValueError, match="trained for 1,024 environment steps already"):
        train_short(resume=trained, changes={"timesteps": 512})
    assert (tmp_path / "file").read_text() == "not a folder"


MISSING = """import importlib.metadata, runpy, sys
missing = sys.argv.pop(1)
distribution = importlib.metadata.distribution
def without(name):
    if name == missing:
        raise importlib.metadata.PackageNotFoundError(name)
    return distribution(name)
importlib.metadata.distribution = without
if missing != "fish_env":
    sys.modules[missing] = None
sys.path.insert(0, {root!r})
sys.argv[0] = {root!r} + "/train.py"
runpy.run_path(sys.argv[0], run_name="__main__")
"""


@pytest.mark.parametrize("missing", tiered(
    ("fish_env", "stable_baselines3", "tensorboard", "matplotlib", "numba"), ("fish_env", "numba")
))  # fmt: skip
def test_a_checkout_that_is_not_installed(missing, tmp_path):
    """Without a package, or without having been installed, training says in one line what to do, and makes nothing."""
    command = [sys.executable, "-c", MISSING.format(root=str(ROOT)), missing, "swim", "--folder", "run"]
    done = subprocess.run(command, capture_output=True, text=True, cwd=tmp_path)
    assert done.returncode == 2 and done.stderr.count("\n") == 1 and missing in done.stderr, done.stderr
    assert 'pip install -c constraints.txt -e ".[train]"' in done.stderr and not list(tmp_path.iterdir())
