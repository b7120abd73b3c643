"""Trained policies, the gait and evaluation, without torch; videos of what they do."""

import json
from dataclasses import replace

import gymnasium as gym
import numpy as np
import pytest

import fish_env
from fish_env.control import (
    Gait,
    Policy,
    best_gait,
    compare,
    evaluate,
    evaluation_options,
    gait_controller,
    load_policy,
    make_eval_env,
    make_policy_env,
    policy_controller,
    random_actions,
    record,
    shipped_policies,
    shipped_policy,
    write_video,
)

PAIRS = {"muscle_groups": "pairs"}


def test_gait_is_what_it_says():
    """Left and right contract exactly out of phase, within [0, amplitude], at the stated frequency."""
    fish, gait, time = fish_env.make_fish(), Gait(2.0, (0.3, 0.6, 1.0), (0.0, 1.0, 2.0)), np.linspace(0, 1, 101)
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
    """The best open-loop gait swims along its heading, better than random twitching, and the same way twice."""
    env = make_eval_env("FishEnv/Swim-v0", 4, PAIRS)
    gait, again = (evaluate(env, gait_controller(best_gait(), env)) for _ in range(2))
    twitching = evaluate(env, random_actions(env))
    assert not gait["failed"].any() and not twitching["failed"].any()
    assert gait["speed"].min() > 1.0 and gait["speed"].min() > 1.3 * np.abs(twitching["speed"]).max()
    np.testing.assert_array_equal(gait["speed"], again["speed"])


BARS = {
    "swim": ("speed", 4.9),
    "turn": ("success", 0.98),
    "left_after_right": ("success", 0.98),
    "target": ("targets", 27.0),
    "target_3d": ("success", 0.97),
    "avoid": ("avoided", 0.95),
    "fast_start": ("escape_distance", 3.6),
}
"""What a shipped policy must reach on the mean of the evaluation episodes."""


@pytest.mark.parametrize("task", BARS)
def test_shipped_policy_keeps_its_bar(task):
    """The policy shipped for every task does it well, on the evaluation seeds, and no physics fails."""
    path = shipped_policy(task)
    assert path.stat().st_size < 300_000
    policy, settings = load_policy(path), json.loads(path.with_name("config.json").read_text())
    assert policy.about["task"] == settings["task"] == task
    assert policy.about["env_id"] == settings["config"]["env_id"]
    env = make_policy_env(policy)
    scores = evaluate(env, policy)
    metric, bar = BARS[task]
    assert not scores["failed"].any() and scores[metric].mean() >= bar


def test_wrong_policies():
    """There is a policy for each of the tasks above and no other; none acts on observations of another size."""
    assert set(shipped_policies()) == set(BARS)
    with pytest.raises(ValueError, match=r"no policy is shipped for 'fly'; choose from avoid"):
        shipped_policy("fly")
    with pytest.raises(
        ValueError, match=r"only the policy has none, only the environment has obstacle's nearness \(3\)"
    ):
        policy_controller(load_policy(shipped_policy("swim")), make_eval_env("FishEnv/Avoid-v0", 1, {}))


SHORT = {"max_episode_steps": 25}


def test_every_kind_of_policy_is_taken(tmp_path):
    """A name, a file, a `Policy` and a function give the same episodes, of a batch in both modes and of one fish."""
    policy = load_policy("left_after_right")
    policy.save(tmp_path / "mine.npz")
    options = {"severity": 0.5} | SHORT
    env = make_policy_env("left_after_right", 3, **options)
    by_hand = policy_controller(policy, env)
    kinds = ("left_after_right", tmp_path / "mine.npz", str(tmp_path / "mine.npz"), policy, by_hand)
    scores = [evaluate(env, kind, 5) for kind in kinds]
    id, settings = policy.about["env_id"], evaluation_options(policy.about["env_options"]) | options
    scores.append(evaluate(gym.make_vec(id, num_envs=3, **settings), policy, 5))
    watched = gym.wrappers.RecordEpisodeStatistics(gym.make(id, **settings))
    scores.append(evaluate(watched, policy, 5, episodes=3))
    for found in scores[1:]:
        assert found.keys() == scores[0].keys()
        for name, values in found.items():
            np.testing.assert_array_equal(values, scores[0][name], err_msg=name)
    kept = [record(watched, kind, 5) for kind in kinds[:4]]
    assert all(np.array_equal(one.position, kept[0].position) for one in kept)
    assert kept[0].reward.sum() == pytest.approx(scores[0]["return"][0], abs=1e-4)  # products of one row or of three
    assert watched.episode_count == 4 and watched.return_queue[0] == pytest.approx(kept[0].reward.sum())


def test_noise_of_the_held_out_set():
    """It is on every part of the observation, whatever the options of the training."""
    policy = Policy((), (), {"env_id": "FishEnv/Swim-v0"})
    condition = fish_env.protocols.Condition("noisy", noise=0.1)
    noise = fish_env.protocols.condition_options(policy, {"speed": 1.0}, condition)["observation_noise"]
    assert list(noise) == ["position", "velocity", "rest length", "vertical", "commanded velocity"]


def test_held_out_in_three_dimensions():
    """A flat body is left out; the others have a row each."""
    built, flat, noisy = (fish_env.protocols.HELD_OUT[k] for k in (0, 1, -3))
    rows = fish_env.protocols.evaluate_held_out("target_3d", 1, (built, flat, noisy))
    assert [row["condition"] for row in rows] == ["as built", "noise 0.1"]


def test_policies_are_compared():
    """Intervals hold their means; a policy equals itself, and is far from none; a list is the seeds of one training."""
    env = make_policy_env("swim", 6, **SHORT)
    still = random_actions(env)
    found = compare("swim", lambda obs, time: 0.0 * still(obs, time), env)
    for interval in (*found["speed"], *found["return"]):
        assert interval.low <= interval.value <= interval.high
    assert found["speed"].difference.low > 0.2 and found["failed"] == ((0.0,) * 3,) * 3
    speed = evaluate(env, "swim")["speed"]
    assert found["speed"].policy.value == pytest.approx(speed.mean())
    assert found["speed"].difference.value == found["speed"].policy.value - found["speed"].other.value
    same = compare(["swim", "swim"], load_policy("swim"), env)["speed"]
    assert same.difference == (0.0, 0.0, 0.0) and same.other.value == found["speed"].policy.value


def stub(**options):
    """Batch of stubs, of which each runs one episode."""
    return make_eval_env("FishEnv/Stub-v0", 2, options)


@pytest.mark.parametrize(
    ("call", "error", "message"),
    [
        (lambda: evaluate(load_policy("swim"), stub()), ValueError, r"the policy after it: evaluate\(env, policy\)"),
        (lambda: evaluate("swim", stub()), ValueError, r"the environment is 'swim'; give a batch of fish"),
        (lambda: evaluate(stub(), "swym"), FileNotFoundError, "no policy file swym; .* shipped: avoid, fast"),
        (lambda: evaluate(stub(), 3), ValueError, "the policy is a int; give the name of a shipped policy"),
        (lambda: evaluate(stub(), "swim", episodes=3), ValueError, "episodes is 3, and the batch has 2 fish"),
        (lambda: evaluate(stub(muscle_groups="pairs"), "swim"), ValueError,
         "trained with muscle_groups='muscles', and the environment has 'pairs'; give"),
        (lambda: evaluate(gym.make("CartPole-v1"), "swim"), ValueError, "is a CartPoleEnv; give one fish"),
        (lambda: evaluate(gym.make_vec("FishEnv/Stub-v0", 2, autoreset_mode="Disabled"), "swim"),
         ValueError, "begin again by themselves"),
        (lambda: record(gym.make("FishEnv/Target-v0"), "swim"), ValueError,
         r"only the policy has commanded heading \(3\), only the environment has direction of the target \(3\), way"),
        (lambda: evaluate(gym.make("FishEnv/Stub-v0", max_episode_steps=-1), "swim"), ValueError, "has no time limit"),
        (lambda: compare(np.cos, np.sin), ValueError, "give env, a batch of fish"),
        (lambda: compare([], "swim"), ValueError, "a list of policies is empty"),
        (lambda: Policy((), (), {}, hidden="elu"), ValueError, "hidden is 'elu'; choose from tanh, relu"),
    ],
)  # fmt: skip
def test_wrong_calls(call, error, message):
    """Each is refused with one line, which says what is right."""
    with pytest.raises(error, match=message):
        call()


@pytest.mark.parametrize("times", [(0.0, 0.0), (0.015, 0.05)], ids=["limited rate", "first order"])
def test_a_policy_of_a_longer_interval(times):
    """Told in two intervals what it was trained to say in one, muscles end where the long interval would have ended."""
    weight = np.random.default_rng(0).normal(size=(156, 6)).astype(np.float32)
    policy = Policy((weight,), (np.zeros(6, np.float32),), {"env_id": "FishEnv/Swim-v0"})
    fish, interval = fish_env.make_fish(activation_time=times), 0.04
    slower = replace(policy, about=policy.about | {"env_options": {"control_interval": interval} | PAIRS})
    env = make_eval_env("FishEnv/Swim-v0", 4, {"body": fish, "variation": {"strength": 0.8}} | PAIRS)
    obs, _ = env.reset(seed=0)
    control, start = policy_controller(slower, env), env.tank.contraction.copy()
    goal = 0.4 * (np.clip(policy(obs), -1.0, 1.0) + 1.0)[:, fish.grouping("pairs")]
    for k in range(2):
        obs, *_ = env.step(np.clip(control(obs, k * env.control_interval), -1.0, 1.0))
    if times[0]:
        part = 1.0 - np.exp(-interval / np.where(goal > start, *times))
        wanted = start + part * (goal - start)
    else:
        limit = 0.8 * interval / fish.contraction_time
        wanted = start + np.clip(goal - start, -limit, limit)
    np.testing.assert_allclose(env.tank.contraction, wanted, rtol=0, atol=1e-6)  # actions are of single precision
    assert np.ptp(wanted - start) > 0.1


@pytest.mark.parametrize("count", [1, 7, 100])
@pytest.mark.parametrize("interval", [0.1, 0.04, 0.02, 0.0175, 0.01])
@pytest.mark.parametrize("ending", [".mp4", ".webp", ".gif"])
def test_videos_have_every_picture(ending, interval, count, tmp_path):
    """As many pictures are read back as were written, at any interval, whatever the rounding of its multiples."""
    ffmpeg, pictures = pytest.importorskip("imageio_ffmpeg"), pytest.importorskip("PIL.Image")
    frames = [np.full((16, 320, 3), 200, dtype=np.uint8) for _ in range(count)]
    for k, frame in enumerate(frames):  # equal pictures would be one that is shown longer
        frame[:, 3 * k : 3 * k + 20] = (20, 90, 180)
    path = tmp_path / f"video{ending}"
    write_video(frames, 1.0 / interval, path)
    if ending == ".mp4":
        assert ffmpeg.count_frames_and_secs(path)[0] == count
    else:
        with pictures.open(path) as found:
            assert found.n_frames == count


@pytest.mark.parametrize("ending", [".mp4", ".webp", ".gif"])
def test_videos(ending, tmp_path, monkeypatch):
    """A video replaces the one before only when it is complete; moving pictures are small, of half the frames' size."""
    moviepy, pictures = pytest.importorskip("moviepy"), pytest.importorskip("PIL.Image")
    frames = [np.full((240, 400, 3), 200, dtype=np.uint8) for _ in range(40)]
    for k, frame in enumerate(frames):
        frame[80:160, 8 * k : 8 * k + 80] = (20, 90, 180)
    path = tmp_path / f"video{ending}"
    path.write_bytes(b"before")
    with monkeypatch.context() as patch:
        patch.setattr(moviepy.ImageSequenceClip, "write_videofile", lambda *a, **k: 1 / 0)
        patch.setattr(pictures.Image, "save", lambda *a, **k: 1 / 0)
        with pytest.raises(ZeroDivisionError):
            write_video(frames, 25, path)
    assert path.read_bytes() == b"before"
    write_video(frames, 25, path)
    assert 500 < path.stat().st_size < 20_000 and list(tmp_path.iterdir()) == [path]
    if ending != ".mp4":
        with pictures.open(path) as found:
            assert (found.size, found.n_frames, found.info["loop"]) == ((200, 120), 40, 0)  # without end
            found.seek(3)
            found.load()
            assert found.info["duration"] == 40
            assert np.abs(np.asarray(found.convert("RGB"))[60, 20].astype(int) - (20, 90, 180)).max() < 30
