"""Ray: RLlib steps the batch of fish by itself, replaces runners that die, and many trainings share a cluster."""

import os
import signal
import subprocess
import sys
import time
from dataclasses import replace

import numpy as np
import pytest
from pages import ROOT

import fish_env
from fish_env.envs.vector import make_batch

pytestmark = pytest.mark.slow
FISH, STEPS = 6, 20


def test_the_runner_of_before():
    """Its import names what replaces it."""
    with pytest.raises(ImportError, match=r'gym_env_vectorize_mode="vector_entry_point"'):
        import fish_env.envs.rllib  # noqa: F401


@pytest.fixture(scope="module")
def example():
    """The example as a module; Ray's processes find it as well."""
    ray = pytest.importorskip("ray", reason='needs Ray: pip install -c constraints.txt -e ".[cluster]"')
    pytest.importorskip("ray.rllib.algorithms.ppo", reason="needs RLlib, of the extra [cluster]")
    sys.path.insert(0, str(ROOT / "examples"))
    import train_rllib

    places = {"PYTHONPATH": os.pathsep.join([str(ROOT), str(ROOT / "examples"), os.environ.get("PYTHONPATH", "")])}
    ray.init(num_cpus=3, include_dashboard=False, logging_level="ERROR", runtime_env={"env_vars": places})
    yield train_rllib
    ray.shutdown()
    sys.path.remove(str(ROOT / "examples"))


@pytest.fixture
def args(example):
    """Small settings."""
    return replace(example.Args(), runners=0, fish=FISH, rollout=STEPS, batch_size=60, epochs=1, hidden=8)


def test_episodes_are_what_the_fish_did(example, args):
    """Observations, rewards and ends of a rollout are those of the same batch under the same actions."""
    config = example.make_config(args)
    runner = config.environment(env_config={"muscle_groups": "pairs", "max_episode_steps": 15}).build_algo().env_runner
    found = runner.sample()
    env = make_batch(args.env_id, FISH, muscle_groups="pairs", max_episode_steps=15, autoreset_mode="Disabled")
    first, rest = found[:FISH], found[FISH:]
    assert all(len(episode) == 15 and episode.is_truncated for episode in first)
    assert sum(map(len, found)) >= FISH * STEPS and not any(episode.is_done for episode in rest)
    actions = np.array([episode.get_actions() for episode in first])
    assert (np.abs(actions) > 1.0).any(), "some actions are to be clipped"
    seen, _ = env.reset(seed=runner._seed)
    for t in range(15):
        np.testing.assert_allclose(np.array([episode.get_observations(t) for episode in first]), seen, atol=1e-5)
        seen, reward, *_ = env.step(np.clip(actions[:, t], -1.0, 1.0))
        np.testing.assert_allclose([episode.get_rewards(t) for episode in first], reward, atol=1e-4)


def test_exported_policy_acts_as_the_module(example, args):
    """The policy file computes the actions that the module computes."""
    import torch

    algorithm = example.make_config(args).build_algo()
    example.train(algorithm, replace(args, steps=1))
    obs = np.random.default_rng(0).normal(size=(5, 156)).astype(np.float32)
    with torch.inference_mode():
        inputs = algorithm.get_module().forward_inference({"obs": torch.from_numpy(obs)})["action_dist_inputs"]
    wanted = np.clip(inputs.numpy()[:, :6], -1.0, 1.0)
    np.testing.assert_allclose(example.policy_of(algorithm, args)(obs), wanted, atol=2e-6)


def sampled(algorithm):
    """Environment steps of all runners since the beginning, after another iteration."""
    return algorithm.train()["env_runners"]["num_env_steps_sampled_lifetime"]


def test_a_killed_runner_is_replaced(example, args):
    """Two runners on a local cluster; one is killed in mid-training, another takes its place, and training goes on."""
    algorithm = example.make_config(replace(args, runners=2)).build_algo()
    assert sampled(algorithm) >= 2 * FISH * STEPS
    runners = algorithm.env_runner_group
    pids = runners.foreach_env_runner(lambda runner: os.getpid(), local_env_runner=False)
    os.kill(pids[0], signal.SIGKILL)
    after, begun = [], time.monotonic()
    while len(after) < 2 and time.monotonic() - begun < 120.0:
        seen = sampled(algorithm)
        after = runners.foreach_env_runner(lambda runner: os.getpid(), local_env_runner=False)
    assert len(after) == 2 and pids[0] not in after and pids[1] in after
    assert sampled(algorithm) > seen
    algorithm.stop()


def test_learns(example, args, tmp_path):
    """A tenth of the usual training: the fish of the exported policy swims."""
    args = replace(example.Args(), steps=100_000, fish=64)
    algorithm = example.make_config(args).build_algo()
    example.train(algorithm, args)
    example.policy_of(algorithm, args).save(tmp_path / "policy.npz")
    algorithm.stop()
    policy = fish_env.control.load_policy(tmp_path / "policy.npz")
    env = fish_env.control.make_eval_env(args.env_id, 5, dict(policy.about["env_options"]))
    assert np.mean(fish_env.control.evaluate(env, policy)["speed"]) > 1.0


@pytest.mark.parametrize("address", ["127.0.0.1:1", "auto", "nowhere"])
def test_the_example_without_a_cluster(tmp_path, address):
    """The example says in one line that there is no cluster and what may be given, before it writes anything."""
    pytest.importorskip("ray")
    done = subprocess.run(
        [sys.executable, str(ROOT / "examples" / "train_rllib.py"), "--address", address, "--folder", "out"],
        env={**os.environ, "PYTHONPATH": os.pathsep.join(sys.path), "RAY_ADDRESS": ""}, cwd=tmp_path,
        capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.returncode == 1 and not (tmp_path / "out").exists()
    last = done.stderr.splitlines()[-1]
    assert last.startswith(f"train_rllib.py: there is no Ray cluster at {address!r} (")
    assert "leave --address out" in last and "Traceback" not in done.stderr
