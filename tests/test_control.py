"""Trained policies as files, controllers and evaluation: without torch, and nothing that was written is lost."""

import json
import subprocess
import sys
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

import fish_env
from fish_env.control import (
    Gait,
    Policy,
    best_gait,
    evaluate,
    gait_controller,
    load_policy,
    make_eval_env,
    make_policy_env,
    policy_controller,
    shipped_policies,
    shipped_policy,
    write_video,
)
from fish_env.control.files import writable_file

ROOT = Path(__file__).parent.parent


@pytest.fixture
def policy():
    """A small policy of no particular use."""
    rng = np.random.default_rng(0)
    sizes = (156, 8, 6)
    weights = [rng.normal(size=pair).astype(np.float32) for pair in pairwise(sizes)]
    return Policy(tuple(weights), tuple(np.zeros(n, np.float32) for n in sizes[1:]), {"env_id": "FishEnv/Swim-v0"})


def test_policy_file_round_trip(policy, tmp_path):
    """A policy read back from its file acts the same, bit for bit."""
    policy.save(tmp_path / "policy.npz")
    obs = np.random.default_rng(1).normal(size=(5, 156))
    np.testing.assert_array_equal(load_policy(tmp_path / "policy.npz", "FishEnv/Swim-v0")(obs), policy(obs))


def test_bad_policy_files_are_errors(policy, tmp_path):
    """Missing, truncated, pickled, foreign, ill-fitting and non-finite files are errors with a reason."""
    good = tmp_path / "good.npz"
    policy.save(good)

    def refused(content, message, error=ValueError):
        path = tmp_path / "bad.npz"
        path.unlink(missing_ok=True)
        if isinstance(content, bytes):
            path.write_bytes(content)
        elif content is not None:
            np.savez(path, **content)
        with pytest.raises(error, match=message):
            load_policy(path, "FishEnv/Swim-v0")

    refused(None, "no policy file", FileNotFoundError)
    refused(good.read_bytes()[:-200], "not a policy file, or is damaged or pickled")
    refused(b"", "not a policy file")
    refused(b"hello", "not a policy file")
    whole = dict(np.load(good))
    refused(whole | {"weight0": np.array([{"pickled": 1}], dtype=object)}, "damaged or pickled")
    refused({key: value for key, value in whole.items() if key != "bias1"}, "not a policy file")
    refused(whole | {"format": 99}, "format 99")
    refused({key: value for key, value in whole.items() if key != "layout"} | {"format": 1}, r"format 1 .* format 2")
    refused(whole | {"layout": 7}, r"version 7 of the observation layout; this package has version 1 .*: train the")
    refused(whole | {"weight1": whole["weight1"][:-1]}, "do not fit together")
    refused(whole | {"bias1": whole["bias1"] * np.nan}, "not finite")
    refused(whole | {"about": json.dumps({"env_id": "FishEnv/Other-v0"})}, "trained for FishEnv/Other-v0")
    refused(whole | {"about": "{}"}, "does not say which environment it is for")


def test_gait_is_what_it_says():
    """Left and right contract exactly out of phase, within [0, amplitude], at the stated frequency."""
    fish, gait = fish_env.make_fish(), Gait(2.0, (0.3, 0.6, 1.0), (0.0, 1.0, 2.0))
    time = np.linspace(0, 1, 101)
    contraction = gait.contraction(fish, time)
    assert contraction.shape == (101, 12)
    amplitude = np.array(gait.amplitude)[fish.segments]
    assert (contraction >= 0).all() and (contraction <= amplitude).all()
    left, right = (contraction[:, fish.sides == side] for side in (1, -1))
    np.testing.assert_allclose(left + right, np.broadcast_to(amplitude[fish.sides == 1], left.shape), atol=1e-12)
    np.testing.assert_allclose(contraction, gait.contraction(fish, time + 0.5), atol=1e-12)
    for bad in ({"frequency": 0.0}, {"amplitude": (1.0, 1.0, 1.5)}, {"lag": (0.0, np.nan, 0.0)}):
        with pytest.raises(ValueError, match=next(iter(bad))):
            replace(gait, **bad)


def test_gait_swims():
    """The best open-loop gait swims along its heading, and far better than random twitching."""
    env = make_eval_env("FishEnv/Swim-v0", 4, {"muscle_groups": "pairs"})
    gait = evaluate(gait_controller(best_gait(), env), env)
    rng = np.random.default_rng(0)
    twitching = evaluate(lambda obs, time: rng.uniform(-1, 1, env.action_space.shape), env)
    assert not gait["failed"].any() and not twitching["failed"].any()
    assert gait["speed"].min() > 1.0 and gait["speed"].min() > 3 * np.abs(twitching["speed"]).max()


def test_evaluation_is_repeatable():
    """Evaluating twice gives the same numbers."""
    env = make_eval_env("FishEnv/Swim-v0", 3, {"muscle_groups": "pairs"})
    one, other = (evaluate(gait_controller(best_gait(), env), env) for _ in range(2))
    np.testing.assert_array_equal(one["speed"], other["speed"])


BARS = {
    "swim": {"speed": 2.45},
    "turn": {"success": 0.98},
    "left_after_right": {"success": 0.95},
    "target": {"targets": 12.0},
    "target_3d": {"success": 0.9},
    "avoid": {"avoided": 0.95},
}
"""What a shipped policy must reach on the mean of the evaluation episodes."""


@pytest.mark.parametrize("task", BARS)
def test_shipped_policy_keeps_its_bar(task):
    """The policy shipped for every task does it well, on the evaluation seeds, and no physics fails."""
    path = shipped_policy(task)
    assert path.stat().st_size < 300_000
    policy = load_policy(path)
    assert policy.about["task"] == task
    env = make_policy_env(policy)
    scores = evaluate(policy_controller(policy, env), env)
    assert not scores["failed"].any()
    for metric, bar in BARS[task].items():
        assert scores[metric].mean() >= bar


def test_every_shipped_policy_is_known():
    """There is a policy for each of the tasks above, with the settings of its training; another name is an error."""
    assert set(shipped_policies()) == set(BARS)
    for task, path in shipped_policies().items():
        settings = json.loads(path.with_name("config.json").read_text())
        assert settings["task"] == task and settings["config"]["env_id"] == load_policy(path).about["env_id"]
    with pytest.raises(ValueError, match=r"no policy is shipped for 'fly'; choose from avoid"):
        shipped_policy("fly")


def test_a_policy_for_another_environment_is_an_error():
    """A policy does not act on observations or actions of another size."""
    policy = load_policy(shipped_policy("swim"))
    with pytest.raises(ValueError, match=r"turns 156 numbers into 12 actions; the environment returns 162"):
        policy_controller(policy, make_eval_env("FishEnv/Avoid-v0", 1, {}))


@pytest.mark.parametrize("times", [(0.0, 0.0), (0.015, 0.05)], ids=["limited rate", "first order"])
def test_a_policy_of_a_longer_interval(policy, times):
    """Told in two intervals what it was trained to say in one, muscles end where the long interval would have ended."""
    fish, interval = fish_env.make_fish(activation_time=times), 0.04
    slower = replace(policy, about=policy.about | {"env_options": {"control_interval": interval}})
    env = make_eval_env("FishEnv/Swim-v0", 4, {"body": fish, "muscle_groups": "pairs"})
    obs, _ = env.reset(seed=0)
    control, start = policy_controller(slower, env), env.tank.contraction.copy()
    goal = 0.5 * (np.clip(policy(obs), -1.0, 1.0) + 1.0)[:, fish.grouping("pairs")]
    for k in range(2):
        obs, *_ = env.step(np.clip(control(obs, k * env.control_interval), -1.0, 1.0))
    if times[0]:
        part = 1.0 - np.exp(-interval / np.where(goal > start, *times))
        wanted = start + part * (goal - start)
    else:
        limit = interval / fish.contraction_time
        wanted = start + np.clip(goal - start, -limit, limit)
    np.testing.assert_allclose(env.tank.contraction, wanted, rtol=0, atol=1e-6)  # actions are of single precision
    assert np.ptp(wanted - start) > 0.1


def test_policy_needs_only_numpy():
    """A policy file can be run, and the controllers imported, without torch, Stable-Baselines3 or pygame."""
    code = """import sys; from fish_env.control import load_policy, shipped_policy; import gymnasium as gym
p = load_policy(shipped_policy("swim")); e = gym.make(p.about["env_id"], **p.about["env_options"])
print(p(e.reset(seed=0)[0]).shape, {"torch", "stable_baselines3", "pygame", "moviepy"} & set(sys.modules))"""
    done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=True)
    assert done.stdout.split()[-1] == "set()"


def test_a_policy_is_written_whole(policy, tmp_path, monkeypatch):
    """If writing fails half way, the file that was there is still there."""
    path = tmp_path / "policy.npz"
    policy.save(path)
    before = path.read_bytes()

    def fail(file, **arrays):
        file.write_bytes(b"half")
        raise OSError("no space left on device")

    monkeypatch.setattr(np, "savez", fail)
    with pytest.raises(OSError, match="no space left"):
        policy.save(path)
    assert path.read_bytes() == before and list(tmp_path.iterdir()) == [path]


def test_files_are_tried_before_anything_is_computed(tmp_path):
    """A folder in place of a file, a file in place of a folder and an unknown ending are errors that change nothing."""
    taken = tmp_path / "taken"
    taken.write_text("content")
    for path, message in ((taken / "x.gif", "no file can be written in the folder"), (tmp_path, "ends in ''"),
                          (tmp_path / "x.avi", r"give a name that ends in .mp4 or .gif")):  # fmt: skip
        with pytest.raises(ValueError, match=message):
            writable_file(path, (".mp4", ".gif"))
    (tmp_path / "folder.gif").mkdir()
    with pytest.raises(ValueError, match="is a folder"):
        writable_file(tmp_path / "folder.gif", (".gif",))
    assert writable_file(tmp_path / "new" / "x.gif", (".gif",)).parent.is_dir()
    assert taken.read_text() == "content" and not list((tmp_path / "new").iterdir())


@pytest.mark.parametrize("ending", [".mp4", ".webp", ".gif"])
def test_videos_are_written_whole(ending, tmp_path, monkeypatch):
    """A video replaces the one that was there only when it is complete."""
    moviepy, pictures = pytest.importorskip("moviepy"), pytest.importorskip("PIL.Image")
    frames = list(np.random.default_rng(0).integers(0, 255, (5, 32, 32, 3), dtype=np.uint8))
    path = tmp_path / f"video{ending}"
    path.write_bytes(b"before")
    with monkeypatch.context() as patch:
        patch.setattr(moviepy.ImageSequenceClip, "write_videofile", lambda *a, **k: 1 / 0)
        patch.setattr(pictures.Image, "save", lambda *a, **k: 1 / 0)
        with pytest.raises(ZeroDivisionError):
            write_video(frames, 25, path)
    assert path.read_bytes() == b"before"
    write_video(frames, 25, path)
    assert path.stat().st_size > 500 and list(tmp_path.iterdir()) == [path]


@pytest.mark.parametrize("ending", [".webp", ".gif"])
def test_moving_pictures_are_small(ending, tmp_path):
    """Half the size of the frames, all of them, for as long as they take, without end; what stands still is free."""
    pictures = pytest.importorskip("PIL.Image")
    frames = [np.full((120, 200, 3), 200, dtype=np.uint8) for _ in range(40)]
    for k, frame in enumerate(frames):
        frame[40:80, 4 * k : 4 * k + 40] = (20, 90, 180)
    write_video(frames, 25, tmp_path / f"x{ending}")
    with pictures.open(tmp_path / f"x{ending}") as found:
        assert (found.size, found.n_frames, found.info["loop"]) == ((100, 60), 40, 0)
        found.seek(3)
        found.load()
        assert found.info["duration"] == 40
        assert np.abs(np.asarray(found.convert("RGB"))[30, 10].astype(int) - (20, 90, 180)).max() < 30
    assert (tmp_path / f"x{ending}").stat().st_size < 20_000
