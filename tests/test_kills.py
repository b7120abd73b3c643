"""Training that is killed, that shares a folder, and that runs while the clock jumps."""

import json
import mmap
import os
import signal
import subprocess
import sys
import time
from itertools import count

import numpy as np
import pytest
from pages import ROOT

torch = pytest.importorskip("torch")
pytest.importorskip("stable_baselines3")

import tqdm.std

from agents import train as training
from agents.records import read_rows

needs_fork = pytest.mark.skipif(not hasattr(os, "fork"), reason="this system cannot fork")


@pytest.fixture(autouse=True)
def one_thread():
    """Torch on one thread, as the scripts have it."""
    torch.set_num_threads(1)


@needs_fork
@pytest.mark.slow
@pytest.mark.parametrize("interval", [0.0, 0.3])
def test_a_run_that_is_killed(tmp_path, interval):
    """Killed at random times and resumed: no file is broken, little is lost, and the run ends as any other."""
    from benchmarks.learning import kills

    run = kills.Killed(tmp_path / "run", seed=0, timesteps=400_000, kills=8, interval=interval)
    assert run.done == 8 and run.half_written >= 1 and run.before_first >= 1
    assert run.bad == [] and run.finished and run.too_much == 0
    assert kills.trained(tmp_path / "run") >= 400_000 and kills.score(tmp_path / "run") > 0.5
    assert json.loads((tmp_path / "run" / "config.json").read_text())["resumed"] >= 1


@needs_fork
def test_what_a_kill_leaves_is_looked_at(tmp_path):
    """Broken files are named, and what was lost is the time since the environment steps that were saved."""
    from benchmarks.learning import kills

    (tmp_path / "model.zip").write_bytes(b"half")
    (tmp_path / "config.json").write_text('{"config": {')
    (tmp_path / "curve.csv").write_text("timesteps,seconds\n512,half\n")
    (tmp_path / "results.json").write_text('{"rows": {}}')
    assert [text.split(":")[0] for text in kills.broken_files(tmp_path)] == ["model.zip", "config.json", "curve.csv"]
    memory = mmap.mmap(-1, 8 + kills.RECORD.size * 10)
    diary = kills.Diary(memory)
    for steps in (0, 100, 200):
        diary.num_timesteps = steps
        diary._on_rollout_start()
    found = kills.Diary.read(memory)
    assert [steps for steps, _ in found] == [0, 100, 200]
    run = kills.Killed.__new__(kills.Killed)
    run.folder, run.interval, run.lost, run.bad = tmp_path, 0.0, 0.0, []
    run.done = run.half_written = run.before_first = run.too_much = 0
    for path in tmp_path.iterdir():
        path.unlink()
    begun = time.time_ns() - 10**9
    (tmp_path / ".model.partial.zip").touch()
    assert kills.half_written(tmp_path, begun) and not kills.half_written(tmp_path, begun + 10**11)
    process = os.fork()
    if not process:
        signal.pause()
    run.kill(process, 0.2, memory, begun)
    assert (run.done, run.half_written, run.before_first, run.bad) == (1, 1, 1, [])
    assert run.lost >= 0.2 and run.too_much == 0  # the last update was the slowest


def test_two_programs_and_one_folder(tmp_path):
    """A second program is refused while the first one trains, from the first moment on, and changes nothing."""
    folder = tmp_path / "run"
    command = [sys.executable, ROOT / "train.py", "swim", "--timesteps", "10000000", "--num-envs", "8", "--no-pictures"]
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
    training.train(training.Request("swim", folder=folder, changes={"timesteps": 512, "num_envs": 8}, pictures=False))


def test_a_clock_that_jumps(tmp_path, monkeypatch):
    """Days forward and back with every look at the clock: checkpoints, curve and names of folders are as without."""
    begun, looks = time.time(), count()
    monkeypatch.setattr(training, "report", lambda *args: None)

    def jumping() -> float:
        return begun + 1e5 * (-1) ** next(looks)

    monkeypatch.setattr(time, "time", jumping)
    monkeypatch.setattr(time, "time_ns", lambda: int(1e9 * jumping()))
    monkeypatch.setattr(tqdm.std, "time", jumping)
    monkeypatch.setattr(time, "strftime", lambda form: "2020-01-01_00-00-00")
    changes = {"timesteps": 2048, "num_envs": 8}
    runs = [training.train(training.Request("swim", 0, root=tmp_path, changes=changes)) for _ in range(2)]
    assert [run.name for run in runs] == ["2020-01-01_00-00-00", "2020-01-01_00-00-00_2"] and next(looks) > 10
    one, same = (np.load(run / "policy.npz")["weight0"] for run in runs)
    np.testing.assert_array_equal(one, same)
    seconds = [float(row["seconds"]) for run in runs for row in read_rows(run / "curve.csv")]
    assert seconds and all(0.0 <= value < 1000.0 for value in seconds)
