"""Training that is killed, and that shares a folder."""

import json
import os
import signal
import subprocess
import sys
import time
from itertools import count

import numpy as np
import pytest
from pages import ROOT
from trainings import train_short, training

from benchmarks.common.tables import read_rows
from fish_env.control import load_policy
from fish_env.training import callbacks

KILLED = {"timesteps": 400_000}
needs_fork = pytest.mark.skipif(not hasattr(os, "fork"), reason="this system cannot fork")


def read_run(folder):
    """Read every file of a run that is there; environment steps of its model, 0 without one."""
    if (folder / "config.json").exists():
        assert json.loads((folder / "config.json").read_text())["config"]
    if (folder / "curve.csv").exists():
        assert all(float(value) >= 0.0 for row in read_rows(folder / "curve.csv") for value in row.values())
    if (folder / "policy.npz").exists():
        load_policy(folder / "policy.npz")
    return training.PPO.load(folder / "model.zip", device="cpu").num_timesteps if (folder / "model.zip").exists() else 0


def saved_since(path, begun):
    """True if a file was written after a time."""
    return path.exists() and path.stat().st_mtime > begun


def alive(process):
    """True until a child process has ended; it is not reaped."""
    return os.waitid(os.P_PID, process, os.WEXITED | os.WNOHANG | os.WNOWAIT) is None


@needs_fork
@pytest.mark.slow
def test_a_run_that_is_killed(tmp_path, monkeypatch):
    """Killed at random times, also while it writes, and resumed: no file is broken, nothing saved is lost; it ends."""
    monkeypatch.setattr(training, "Checkpoint", lambda path: callbacks.Checkpoint(path, seconds=0.0))
    folder, generator, saved = tmp_path / "run", np.random.default_rng(0), 0
    for kill in count():
        request = {"resume": folder} if (folder / "model.zip").exists() else {"folder": folder, "changes": KILLED}
        process = os.fork()
        if not process:
            status = 1
            try:
                train_short(**{"changes": {}} | request)
                status = 0
            finally:
                os._exit(status)
        begun = time.time()
        while 0 < kill < 8 and not saved_since(folder / "model.zip", begun) and alive(process):
            time.sleep(0.01)
        if kill < 8:
            time.sleep(generator.uniform(0.0, 0.3))
            os.kill(process, signal.SIGKILL)
        ended = os.waitpid(process, 0)[1]
        assert read_run(folder) >= saved
        saved = read_run(folder)
        if ended == 0:
            break
        assert kill < 8
    assert saved >= KILLED["timesteps"] and json.loads((folder / "config.json").read_text())["resumed"] >= 1


@pytest.mark.slow
def test_two_programs_and_one_folder(tmp_path):
    """A second program is refused while the first one trains, from the first moment on, and changes nothing."""
    folder = tmp_path / "run"
    words = ["swim", "--timesteps", "10000000", "--num-envs", "8", "--torch-threads", "1", "--no-pictures"]
    command = [sys.executable, ROOT / "train.py", *words]
    first = subprocess.Popen([*command, "--folder", folder], stdout=subprocess.PIPE, stderr=subprocess.DEVNULL)
    try:
        while not (folder / "config.json").exists():
            assert first.poll() is None
            time.sleep(0.05)
        before = (folder / "config.json").read_bytes()
        second = subprocess.run([*command, "--seed", "7", "--folder", folder], capture_output=True, text=True)
        assert second.returncode == 2 and "another program is training in" in second.stderr
        assert "Traceback" not in second.stderr and (folder / "config.json").read_bytes() == before
        assert first.poll() is None
    finally:
        first.kill()
        first.wait()
    train_short(folder=folder)
