"""Learners of other libraries: their examples run, and what they are handed is what the fish did."""

import importlib
import json
import math
import re

import gymnasium as gym
import numpy as np
import pytest
import yaml
from pages import ROOT
from test_examples import EXAMPLES, run, run_here

from fish_env.control import load_policy

SHORT = ("--timesteps", 512, "--num-envs", 16, "--evaluations", 3, "--folder", "out")
FISH, STEPS, LIMIT = 4, 9, 7


@pytest.fixture
def cleanrl(monkeypatch):
    """The example as a module."""
    pytest.importorskip("torch")
    monkeypatch.syspath_prepend(str(EXAMPLES))
    return importlib.import_module("train_cleanrl")


@pytest.fixture
def fish():
    """A batch whose episodes end soon."""
    env = gym.make_vec("FishEnv/Swim-v0", num_envs=FISH, autoreset_mode="SameStep", max_episode_steps=LIMIT)
    yield env
    env.close()


def checked_scores(folder, said, *files):
    """The scores that an example has written, which it also prints; with the other files that it should leave."""
    assert {path.name for path in folder.iterdir()} == {"args.json", "scores.json", *files}
    assert json.loads((folder / "args.json").read_text())["num_envs"] == 16
    scores = json.loads((folder / "scores.json").read_text())
    assert f"mean of 3 episodes: return {scores['return']:.2f}" in said
    assert scores["seconds"] == 5.0 and scores["failed"] == 0.0 and math.isfinite(scores["speed"])
    return scores


def test_train_cleanrl(tmp_path):
    """It trains, saves a policy that the package plays, and evaluates."""
    pytest.importorskip("torch")
    said = run_here(tmp_path, EXAMPLES / "train_cleanrl.py", *SHORT)
    checked_scores(tmp_path / "out", said, "policy.npz")
    policy = load_policy(tmp_path / "out" / "policy.npz", "FishEnv/Swim-v0")
    assert policy.about["env_options"] == {"muscle_groups": "pairs"}


def test_cleanrl_advantages(cleanrl):
    """They are the sums of discounted errors of the value by their definition, cut where episodes end."""
    torch = pytest.importorskip("torch")
    generator = np.random.default_rng(0)
    rewards, values, following = generator.normal(size=(3, STEPS, 2)).astype(np.float32)
    ends = (generator.random((STEPS, 2)) < 0.3).astype(np.float32)
    args, gamma = cleanrl.Args(gae_lambda=0.8), 0.9
    found = cleanrl.advantages(*map(torch.tensor, (rewards, values, ends, following)), args, gamma).numpy()
    for fish in range(2):
        for t in range(STEPS):
            expected, weight = 0.0, 1.0
            for later in range(t, STEPS):
                expected += weight * (rewards + gamma * following - values)[later, fish]
                if ends[later, fish]:
                    break
                weight *= gamma * 0.8
            assert found[t, fish] == pytest.approx(expected, abs=1e-5)


def test_cleanrl_looks_beyond_the_time_limit(cleanrl, fish, monkeypatch):
    """After an episode that ran out of time comes the value of its last observation, not of the next beginning."""
    torch = pytest.importorskip("torch")
    args = cleanrl.Args(num_envs=FISH, rollout=LIMIT, seed=3)
    torch.manual_seed(0)
    agent, held = cleanrl.Agent(fish, args), {}

    def advantages(rewards, values, ends, following, *rest):
        held.update(later=following, ends=ends)
        return torch.zeros(LIMIT, FISH)

    monkeypatch.setattr(cleanrl, "advantages", advantages)
    collector = cleanrl.Collector(fish, agent, args)
    actions = collector.collect()[1].reshape(LIMIT, FISH, -1).clamp(-1.0, 1.0).numpy()
    other = gym.make_vec("FishEnv/Swim-v0", num_envs=FISH, autoreset_mode="Disabled", max_episode_steps=LIMIT)
    other.reset(seed=args.seed)
    other.unwrapped.stagger()
    for t, action in enumerate(actions):
        seen, _, terminated, truncated, _ = other.step(action)
        expected = agent(torch.from_numpy(seen))[1].detach().numpy()
        np.testing.assert_allclose(held["later"][t].numpy(), expected, rtol=1e-5)
        np.testing.assert_array_equal(held["ends"][t].numpy(), terminated | truncated)
        if (terminated | truncated).any():
            other.reset(options={"reset_mask": terminated | truncated})
    assert held["ends"].sum() >= FISH  # every fish, or nearly, has ended an episode
    other.close()


def test_cleanrl_policy(cleanrl, fish):
    """The exported policy does what the network's mean is, clipped, from the raw observation."""
    torch = pytest.importorskip("torch")
    torch.manual_seed(0)
    agent = cleanrl.Agent(fish, cleanrl.Args())
    with torch.no_grad():
        agent.actor[-1].weight.mul_(50.0)  # so that some actions are clipped
        obs = np.concatenate([fish.reset(seed=k)[0] for k in range(3)])
        obs += np.random.default_rng(0).normal(size=obs.shape).astype(np.float32)
        expected = agent(torch.from_numpy(obs))[0].mean.clamp(-1.0, 1.0).numpy()
    assert (np.abs(expected) == 1.0).any() and (np.abs(expected) < 0.9).any()
    np.testing.assert_allclose(agent.policy({"env_id": "FishEnv/Swim-v0"})(obs), expected, atol=2e-4)


@pytest.mark.slow
@pytest.mark.parametrize(("example", "package", "options", "left"), [
    ("torchrl", "torchrl", (), ["actor.pt"]),
    ("sbx", "sbx", ("--algorithm", "ppo"), ["model.zip", "scaling.pkl"]),
    ("sbx", "sbx", ("--algorithm", "crossq"), ["model.zip", "scaling.pkl"]),
])  # fmt: skip
def test_train_by_another_library(example, package, options, left, tmp_path):
    """It trains, saves what a user needs to go on, and evaluates."""
    pytest.importorskip(package, reason=f"needs {package}")
    said = run(tmp_path, EXAMPLES / f"train_{example}.py", *SHORT, *options)
    checked_scores(tmp_path / "out", said, *left)
    assert example != "torchrl" or re.search(r"512 steps, \d+ steps/s, reward -?\d", said)


@pytest.mark.slow
def test_rl_zoo3(tmp_path):
    """The zoo trains by the file of this repository, and plays what it has trained."""
    pytest.importorskip("rl_zoo3", reason="needs RL Baselines3 Zoo: pip install rl_zoo3 requests")
    names = ("--algo", "ppo", "--env", "FishEnv/Swim-v0", "--gym-packages", "fish_env", "-f", tmp_path / "zoo")
    settings = tmp_path / "rl_zoo3.yml"
    zoo = yaml.safe_load((ROOT / "agents" / "rl_zoo3.yml").read_text())
    zoo["FishEnv/Swim-v0"] |= {"n_envs": 2, "n_steps": 64, "batch_size": 128}
    settings.write_text(yaml.safe_dump(zoo))
    options = ("--conf-file", settings, "-n", 256, "--device", "cpu", "--eval-freq", -1)
    run(tmp_path, "-m", "rl_zoo3.train", *names, *options)
    assert (tmp_path / "zoo" / "ppo" / "FishEnv-Swim-v0_1" / "FishEnv-Swim-v0.zip").is_file()
    said = run(tmp_path, "-m", "rl_zoo3.enjoy", *names, "--no-render", "-n", 260)
    assert re.search(r"Episode Reward: -?\d", said)
