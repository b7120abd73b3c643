"""Kernels compiled ahead of their first use: all that a user then needs is there."""

import os
import subprocess
import sys
from itertools import product
from pathlib import Path

import pytest
from pages import ROOT

from fish_env import __main__ as command_line
from fish_env.envs import ahead
from fish_env.kernels import cache as _cache
from fish_env.kernels.compile import njit

USE = """
import warnings
import gymnasium as gym, numpy as np, fish_env
warnings.simplefilter("error")
for env in (gym.make("FishEnv/Swim-v0"), gym.make_vec("FishEnv/Swim-v0", num_envs=256, variation={"mass": (0.9, 1.1)})):
    obs, _ = env.reset(seed=0)
    for _ in range(3):
        env.step(np.zeros(env.action_space.shape, np.float32))
fish = fish_env.make_fish()
fish_env.Tank(fish, 1, water=fish.water).swim([1.0] * 12, fish.control_interval)
"""


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """An empty folder of kernels."""
    monkeypatch.setattr(_cache, "_FOLDER", str(tmp_path))
    return tmp_path


def test_it_says_what_was_stored(folder, monkeypatch, capsys):
    """For each task and body, how many kernels are new, and how many there are."""
    tried = []

    def run(count, *words):
        tried.append((count, *words))
        if count == 1 and words[2] == "float64":
            factor = len(tried)
            njit(lambda a: factor * a)(1.0)

    monkeypatch.setattr(ahead, "use_kernels", run)
    words = ["compile", "swim", "turn", "--body", "planar", "--dtype", "float64", "float32", "--integrator", "rk4"]
    assert command_line.main(words) == 0
    assert capsys.readouterr().out.splitlines() == [
        "swim on planar: 1 new kernels, 1 in all", "turn on planar: 1 new kernels, 2 in all", f"0 MB in {folder}",
    ]  # fmt: skip
    each = product(("swim", "turn"), ("float64", "float32"), ahead.COUNTS)
    assert tried == [(count, task, "planar", dtype, "rk4") for task, dtype, count in each]


def test_mistakes_are_answered(folder, monkeypatch, capsys):
    """An unknown task or body, and a missing folder, are refused in one line."""
    for words, said in (
        (["swimm"], "unknown task 'swimm'"),
        (["swim", "--body", "eel"], "unknown body 'eel'; choose from mass_spring"),
        (["swim", "--dtype", "half"], "half"),
    ):
        assert command_line.main(["compile", *words]) == 2
        assert said in capsys.readouterr().err
    monkeypatch.setattr(_cache, "_FOLDER", None)
    assert command_line.main(["compile", "swim"]) == 2
    assert "set FISH_ENV_CACHE to one that can be written to" in capsys.readouterr().err


@pytest.mark.slow
def test_nothing_is_left_to_compile(tmp_path):
    """After the command, environments of one fish and of many, and a tank, find every kernel; nothing is stored."""
    environment = os.environ | {"FISH_ENV_CACHE": str(tmp_path), "PYTHONPATH": str(ROOT), "FISH_ENV_QUIET": ""}

    def run(*words):
        command = [sys.executable, *words]
        done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stderr
        return done, {path: path.stat().st_mtime_ns for path in Path(tmp_path).rglob("*.nbc")}

    first, before = run("-m", "fish_env", "compile", "swim")
    assert f"{len(before)} in all" in first.stdout and len(before) > 2
    second, after = run("-c", USE)
    assert after == before and "compiles" not in second.stderr
