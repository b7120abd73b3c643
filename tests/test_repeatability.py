"""The same seed, the same bits: with other numbers of threads, in other processes and folders."""

import hashlib
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from fish_env.envs import FishVectorEnv

ROOT = Path(__file__).parent.parent
LIBRARIES = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS")


def digest(threads=1, steps=20, **keywords):
    """Digest of all that is observed and rewarded, and of all positions and velocities, over the ends of episodes."""
    env = FishVectorEnv(64, threads=threads, autoreset_mode="SameStep", max_episode_steps=8, **keywords)
    actions = np.random.default_rng(0).uniform(-1.0, 1.0, (steps, *env.action_space.shape)).astype(np.float32)
    seen = hashlib.sha256(env.reset(seed=5)[0].tobytes())
    for action in actions:
        for part in (*env.step(action)[:4], env.tank.position, env.tank.velocity):
            seen.update(np.ascontiguousarray(part).tobytes())
    env.close()
    return seen.hexdigest()


def digest_of_process(checkout=ROOT, **variables):
    """Digest that another process finds in a checkout, with three threads for the fish and for the libraries."""
    environment = os.environ | {"PYTHONPATH": f"{checkout}:{ROOT / 'tests'}"} | dict.fromkeys(LIBRARIES, "3")
    command = [sys.executable, "-c", "from test_repeatability import digest; print(digest(3))"]
    done = subprocess.run(
        command, cwd=checkout, check=True, capture_output=True, text=True, env=environment | variables
    )
    return done.stdout.split()[-1]


def test_threads_and_processes_change_no_bit():
    """One to three threads, and another process whose libraries have three threads of their own, see the same bits."""
    assert digest(1) == digest(2) == digest(3) == digest_of_process()


@pytest.mark.slow
def test_folders_change_no_bit(tmp_path):
    """A clone in another folder, which compiles kernels of its own, simulates to the same bits."""
    subprocess.run(["git", "clone", "--quiet", str(ROOT), str(tmp_path / "clone")], check=True)
    assert digest_of_process(tmp_path / "clone", FISH_ENV_CACHE=str(tmp_path / "kernels")) == digest()


def test_digests_see_what_differs():
    """One step more, or another option of the task, gives another digest."""
    assert len({digest(steps=2), digest(steps=3), digest(steps=2, speed=0.5)}) == 3
