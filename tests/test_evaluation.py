"""Trained policies, the gait and evaluation, without torch."""

import json
import math
import warnings
from dataclasses import replace

import gymnasium as gym
import numpy as np
import pytest
from scipy.stats import binomtest

import fish_env
from fish_env.control import (
    Policy,
    compare,
    evaluate,
    evaluation_options,
    load_policy,
    make_eval_env,
    make_policy_env,
    policy_controller,
    random_actions,
    record,
    shipped_policies,
    shipped_policy,
    statistics,
)
from fish_env.control.statistics import Interval, interval, summary, wilson

PAIRS = {"muscle_groups": "pairs"}
SHORT = {"max_episode_steps": 25}
BARS = {
    "swim": ("speed", 4.3),
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
    assert path.stat().st_size < 300_000 and set(shipped_policies()) == set(BARS)
    policy, settings = load_policy(path), json.loads(path.with_name("config.json").read_text())
    assert policy.about["task"] == settings["task"] == task
    assert policy.about["env_id"] == settings["config"]["env_id"]
    scores = evaluate(make_policy_env(policy), policy)
    metric, bar = BARS[task]
    assert not scores["failed"].any() and scores[metric].mean() >= bar


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
    assert kept[0].reward.sum() == pytest.approx(scores[0]["return"][0], abs=1e-9)
    assert watched.episode_count == 4 and watched.return_queue[0] == pytest.approx(kept[0].reward.sum())


def test_held_out_set():
    """A flat body is left out in three dimensions; noise is on every part, whatever the options of the training."""
    protocols = fish_env.protocols
    built, flat, noisy = (protocols.HELD_OUT[k] for k in (0, 1, -3))
    rows = protocols.evaluate_held_out("target_3d", 1, (built, flat, noisy))
    assert [row["condition"] for row in rows] == ["as built", "noise 0.1"]
    policy = Policy((), (), {"env_id": "FishEnv/Swim-v0"})
    noise = protocols.condition_options(policy, {"speed": 1.0}, noisy)["observation_noise"]
    assert list(noise) == ["position", "velocity", "rest length", "vertical", "commanded velocity"]


def test_an_episode_is_the_same_in_batches_of_any_size():
    """A policy acts on one fish as on many, to the bit: a long and violent episode is that of a loop by hand."""
    policy, options = load_policy("left_after_right"), {"severity": 2.0}
    obs = np.random.default_rng(0).normal(size=(100, policy.weights[0].shape[0])).astype(np.float32)
    for part in (slice(0, 1), slice(3, 8), slice(40, 100), 7):
        np.testing.assert_array_equal(policy(obs[part]), policy(obs)[part])
    env = gym.make("FishEnv/LeftAfterRight-v0", **options)
    obs, _ = env.reset(seed=5)
    way, over = [env.unwrapped.tank.position.copy()], False
    while not over:
        obs, _, terminated, truncated, _ = env.step(policy(obs))
        way.append(env.unwrapped.tank.position.copy())
        over = terminated or truncated
    kept = record(env, policy, 5)
    np.testing.assert_array_equal(kept.position, np.concatenate(way))
    totals = [evaluate(env, policy, 5, episodes=count)["return"][0] for count in (1, 2, 9)]
    assert len(set(totals)) == 1 and totals[0] == pytest.approx(kept.reward.sum(), abs=1e-9)


def test_random_actions_of_one_fish():
    """Each episode has its own, also where the controller was made for a single fish."""
    env = gym.make("FishEnv/Swim-v0", max_episode_steps=10)
    work = evaluate(env, random_actions(env.unwrapped.fish), episodes=8)["work"]
    batch = gym.make_vec("FishEnv/Swim-v0", 8, max_episode_steps=10)
    np.testing.assert_array_equal(work, evaluate(batch, random_actions(batch))["work"])
    assert work.std() > 0.01


@pytest.mark.parametrize(("inner", "outer"), [(20, 30), (30, 20)])
def test_the_shorter_of_two_time_limits(inner, outer):
    """Evaluated and recorded episodes are as long as those of the environment that is given."""
    env = gym.wrappers.TimeLimit(gym.make("FishEnv/Swim-v0", max_episode_steps=inner), outer)
    assert (evaluate(env, "swim", episodes=2)["seconds"] == 20 * 0.02).all() and record(env, "swim").steps == 20


def test_policies_are_compared():
    """Intervals hold their means; a policy equals itself, and is far from none; a list is the seeds of one training."""
    env = make_policy_env("swim", 6, **SHORT)
    still = random_actions(env)
    found = compare("swim", lambda obs, time: 0.0 * still(obs, time), env)
    for one in (*found["speed"], *found["return"]):
        assert one.low <= one.value <= one.high
    assert found["speed"].difference.low > 0.2
    share, high = (0.0, 0.0, wilson(0.0, 6)[1]), wilson(0.0, 6)[1]
    assert found["failed"] == (share, share, (0.0, pytest.approx(-high), pytest.approx(high)))
    speed = evaluate(env, "swim")["speed"]
    assert found["speed"].policy.value == pytest.approx(speed.mean())
    assert found["speed"].difference.value == found["speed"].policy.value - found["speed"].other.value
    same = compare(["swim", "swim"], load_policy("swim"), env)["speed"]
    assert same.difference == (0.0, 0.0, 0.0) and same.other.value == found["speed"].policy.value


@pytest.mark.parametrize(("count", "trials"), [(0, 100), (100, 100), (96, 100), (3, 7), (1, 1)])
def test_interval_of_a_share(count, trials):
    """One policy's is Wilson's; that of several seeds is no narrower, nor than what their spread says."""
    ends = binomtest(count, trials).proportion_ci(method="wilson")
    assert wilson(count / trials, trials) == pytest.approx((ends.low, ends.high), abs=1e-6)
    scores = {"return": np.zeros(trials + 1), "success": np.r_[np.repeat([1.0, 0.0], [count, trials - count]), np.nan]}
    one = (count / trials, *wilson(count / trials, trials))
    assert interval([scores], "success", np.random.default_rng(0)) == pytest.approx(one)  # NaN is no trial
    assert summary(scores)["intervals"] == {"success": [round(end, 3) for end in one[1:]]}
    found = interval([scores] * 5, "success", np.random.default_rng(0))
    assert found.value == pytest.approx(one[0]) and found.low <= one[1] + 1e-9 and found.high >= one[2] - 1e-9
    spread = [scores, scores | {"success": np.zeros(trials + 1)}, scores | {"success": np.ones(trials + 1)}]
    found = interval(spread, "success", np.random.default_rng(0))
    assert found.low == pytest.approx(0.0) and found.high == pytest.approx(1.0)


def test_shares_within_episodes_and_other_metrics_have_bootstrap_intervals():
    """A share of 200 targets in ten episodes is known better than one of ten episodes; a speed of 1 is no share."""
    scores = {"return": np.zeros(10), "success": np.full(10, 0.95), "speed": np.ones(10)}
    scores["success"][0] = 0.9
    found = interval([scores], "success", np.random.default_rng(0))
    assert 0.9 < found.low < found.value < found.high <= 0.95 + 1e-12
    assert f"{interval([scores], 'speed', np.random.default_rng(0))}" == "1" and f"{Interval(*(math.nan,) * 3)}" == "-"
    assert str(found) == "0.945 (0.935 to 0.95)"


def test_difference_of_shares(monkeypatch):
    """It is that of Newcombe (1998, method 10) for independent episodes, and narrower for the same ones."""
    first, second = (Interval(k / n, *wilson(k / n, n)) for k, n in ((56, 70), (48, 80)))
    found = statistics.difference(first, second, np.zeros((9, 2)), True)
    assert found == pytest.approx((0.2, 0.0524, 0.3339), abs=1e-4)
    outcomes = {"a": np.arange(100) < 60, "alike": np.arange(100) < 58, "apart": np.arange(100) >= 42}
    scores = {name: {"return": np.zeros(100), "success": values.astype(float)} for name, values in outcomes.items()}
    monkeypatch.setattr(statistics, "evaluate", lambda env, policy, *rest: scores[policy(None, 0.0)])
    alike, apart = (
        compare(lambda obs, time: "a", lambda obs, time, name=name: name, stub())["success"].difference
        for name in ("alike", "apart")
    )
    assert alike.value == apart.value == pytest.approx(0.02)
    assert alike.high - alike.low < 0.1 < 0.3 < apart.high - apart.low


def stub(**options):
    """Batch of stubs, of which each runs one episode."""
    return make_eval_env("FishEnv/Stub-v0", 2, options)


def slow_policy():
    """A policy that acts every 40 ms."""
    about = {"env_id": "FishEnv/Turn-v0", "env_options": {"control_interval": 0.04}}
    return replace(load_policy("turn"), about=about)


def short_policy():
    """A policy that was trained in episodes of 2 s, which its history keeps."""
    about = {"env_id": "FishEnv/Swim-v0", "env_options": {"history": 1, "max_episode_steps": 100}}
    return replace(load_policy("swim"), about=about)


@pytest.mark.parametrize(
    ("call", "error", "message"),
    [
        (lambda: evaluate(load_policy("swim"), stub()), ValueError, r"the policy after it: evaluate\(env, policy\)"),
        (lambda: evaluate(stub(), "swym"), FileNotFoundError, "policy file swym .did you mean 'swim'.*shipped: avoid"),
        (lambda: shipped_policy("fly"), ValueError, "no policy is shipped for 'fly'; choose from 'avoid'"),
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
        (lambda: compare("swim", short_policy()), ValueError, "the episodes last 2 s and 5 s; give max_episode_steps"),
        (lambda: compare("turn", with_options("turn", sway_weight=9)), ValueError,
         r"differ in sway_weight \(.* and 9\)"),
        (lambda: Policy((), (), {}, hidden="elu"), ValueError, "hidden is 'elu'.*; choose from 'tanh', 'relu'"),
        (lambda: policy_controller(slow_policy(), make_policy_env("turn", 1, control_interval=0.03)),
         ValueError, r"acts every 0.04 s, the environment every 0.03"),
    ],
)  # fmt: skip
def test_wrong_calls(call, error, message):
    """Each is refused with one line, which says what is right."""
    with pytest.raises(error, match=message):
        call()


def with_options(name, **options):
    """A shipped policy whose training had other options."""
    policy = load_policy(name)
    return replace(policy, about=policy.about | {"env_options": policy.about["env_options"] | options})


def test_options_that_change_no_episode_can_be_compared():
    """Defaults that were given, whole numbers, and what says how fish are drawn or computed."""
    same = with_options(
        "left_after_right", severity=1, action_noise=0, threads=1, width=640, panel=False, info_every_step=False
    )
    found = compare("left_after_right", same, episodes=2, max_episode_steps=10)
    assert found["return"].difference == (0.0, 0.0, 0.0)


def test_a_policy_of_another_task():
    """Scores of a policy on another task than its own are warned of, single and batch; on its own they are not."""
    for make in (lambda id: gym.make(f"FishEnv/{id}-v0"), lambda id: gym.make_vec(f"FishEnv/{id}-v0", 2)):
        for policy, id in (("target_3d", "Target"), ("target", "Target3D"), ("swim", "Turn")):
            with pytest.warns(UserWarning, match="the policy was trained for .*, and its scores are for"):
                evaluate(make(id), policy, episodes=2)
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            evaluate(make("Target3D"), "target_3d", episodes=2)


@pytest.mark.parametrize("lengthening", [0.0, 0.6])
def test_a_policy_of_a_longer_interval(lengthening):
    """Commanded in two intervals what it was trained to command in one, muscles end where that one would have ended."""
    weight = np.random.default_rng(0).normal(size=(156, 6)).astype(np.float32)
    policy = Policy((weight,), (np.zeros(6, np.float32),), {"env_id": "FishEnv/Swim-v0"})
    fish, interval = fish_env.make_fish(lengthening=lengthening), 0.04
    slower = replace(policy, about=policy.about | {"env_options": {"control_interval": interval} | PAIRS})
    env = make_eval_env("FishEnv/Swim-v0", 4, {"body": fish, "variation": {"strength": 0.8}} | PAIRS)
    obs, _ = env.reset(seed=0)
    control, start = policy_controller(slower, env), env.tank.contraction.copy()
    goal = 0.4 * (np.clip(policy(obs), -1.0, 1.0) + 1.0)[:, fish.grouping("pairs")]
    for k in range(2):
        obs, *_ = env.step(np.clip(control(obs, k * env.control_interval), -1.0, 1.0))
    limit = 0.8 * interval / fish.contraction_time
    wanted = start + np.clip(goal - start, -limit, limit)
    np.testing.assert_allclose(env.tank.contraction, wanted, rtol=0, atol=1e-6)  # actions are of single precision
    assert np.ptp(wanted - start) > 0.1
