"""Ray RLlib with the native batch of fish: runners hand over what the fish did, and are replaced when they die."""

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
from agents import ray_jobs
from agents.train_all import Job
from fish_env.envs.vector import make_batch
from fish_env.training.config import CONFIGS

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(sys.platform == "win32", reason="kills processes by POSIX signals"),
]
ray = pytest.importorskip("ray", reason='needs Ray: pip install -c constraints.txt -e ".[cluster]"')
pytest.importorskip("ray.rllib.algorithms.ppo", reason='needs RLlib: pip install -c constraints.txt -e ".[cluster]"')

FISH, STEPS = 6, 20


@pytest.fixture(scope="module")
def example():
    """The example as a module; Ray's processes find it as well."""
    sys.path.insert(0, str(ROOT / "examples"))
    import train_rllib

    places = os.pathsep.join([str(ROOT), str(ROOT / "examples")])
    ray.init(
        num_cpus=3, include_dashboard=False, logging_level="ERROR", runtime_env={"env_vars": {"PYTHONPATH": places}}
    )
    yield train_rllib
    ray.shutdown()
    sys.path.remove(str(ROOT / "examples"))


@pytest.fixture
def args(example):
    """Small settings."""
    return replace(example.Args(), runners=0, fish=FISH, rollout=STEPS, batch_size=60, epochs=1, hidden=8)


def make_runner(example, args, **options):
    """A runner in this process."""
    config = example.make_config(args).environment(env_config={"muscle_groups": "pairs"} | options)
    return config.build_algo().env_runner


def test_episodes_are_what_the_fish_did(example, args):
    """Observations, rewards and ends of two rollouts are those of the same batch under the same actions."""
    runner = make_runner(example, args, max_episode_steps=15, staggered=True)
    parts = [runner.sample(), runner.sample()]
    env = make_batch(args.env_id, FISH, muscle_groups="pairs", max_episode_steps=15)
    env.reset(seed=runner._seed)
    env.stagger()
    actions = np.zeros((2 * STEPS, FISH, env.single_action_space.shape[0]), dtype=np.float32)
    place, order, names = np.zeros(FISH, dtype=int), [], {}
    for rollout, episodes in enumerate(parts):
        fish = 0
        for episode in episodes:
            episode.validate()
            first, end = place[fish], place[fish] + len(episode)
            assert names.setdefault(episode.id_, fish) == fish
            actions[first:end, fish] = episode.get_actions()
            order.append((fish, first, episode))
            place[fish] = end
            if end == (rollout + 1) * STEPS:
                fish += 1
        assert fish == FISH
    assert (np.abs(actions) > 1.0).any(), "some actions are to be clipped"
    obs, reward = np.zeros((2 * STEPS + 1, FISH, env.single_observation_space.shape[0])), np.zeros((2 * STEPS, FISH))
    final, over = {}, np.zeros((2 * STEPS, FISH), dtype=bool)
    obs[0] = env.observe()
    for t in range(2 * STEPS):
        reward[t], terminated, truncated = env.advance(np.clip(actions[t], -1.0, 1.0))
        over[t] = terminated | truncated
        seen = env.observe()
        final |= {(t, i): seen[i] for i in np.flatnonzero(over[t]).tolist()}
        if over[t].any():
            env.restart(over[t])
        obs[t + 1] = env.observe()
    assert len(final) > FISH
    for fish, first, episode in order:
        last = first + len(episode) - 1
        np.testing.assert_array_equal(episode.get_observations()[:-1], obs[first : last + 1, fish])
        np.testing.assert_array_equal(episode.get_observations(-1), final.get((last, fish), obs[last + 1, fish]))
        np.testing.assert_array_equal(episode.get_rewards(), reward[first : last + 1, fish].astype(np.float32))
        assert episode.is_truncated == over[last, fish] and not episode.is_terminated
        assert not over[first:last, fish].any()


def test_likelihood_of_the_actions(example, args):
    """The logarithm of the probability density that comes with an action is that of the module's Gaussian."""
    runner = make_runner(example, args)
    episode = runner.sample()[0]
    mean, log_std = np.split(episode.get_extra_model_outputs("action_dist_inputs"), 2, axis=1)
    away = (episode.get_actions() - mean) / np.exp(log_std)
    wanted = (-0.5 * away**2 - log_std - 0.5 * np.log(2 * np.pi)).sum(axis=1)
    np.testing.assert_allclose(episode.get_extra_model_outputs("action_logp"), wanted, rtol=1e-4, atol=1e-4)


def test_whole_episodes(example, args):
    """Asked for episodes, a runner returns whole ones from their beginning."""
    runner = make_runner(example, args, max_episode_steps=8)
    found = runner.sample(num_episodes=9, explore=False)
    assert len(found) == 9 and len({episode.id_ for episode in found}) == 9
    assert all(episode.is_done and len(episode) == 8 for episode in found)


def test_exported_policy_acts_as_the_module(example, args):
    """The policy file computes the actions that the module computes."""
    algorithm = example.make_config(args).build_algo()
    example.train(algorithm, replace(args, steps=1))
    policy, runner = example.policy_of(algorithm, args), algorithm.env_runner
    obs = runner.env.observe()
    np.testing.assert_allclose(policy(obs), np.clip(runner._act(obs, False, False)["actions"], -1, 1), atol=2e-6)


def test_refused(example):
    """An environment that is not one of fish is refused by name."""
    config = example.PPOConfig().env_runners(env_runner_cls=example.FishEnvRunner, num_env_runners=0)
    with pytest.raises(ValueError, match="give an environment of fish"):
        config.environment("CartPole-v1").build_algo()


def test_a_killed_runner_is_replaced(example, args):
    """Two runners on a local cluster; one is killed in mid-training, another takes its place, and training goes on."""
    args = replace(args, runners=2)
    algorithm = example.make_config(args).build_algo()
    assert sampled(algorithm) == 2 * FISH * STEPS
    runners = algorithm.env_runner_group
    pids = runners.foreach_env_runner(lambda runner: os.getpid(), local_env_runner=False)
    os.kill(pids[0], signal.SIGKILL)
    seen, after = sampled(algorithm), []
    assert seen > 2 * FISH * STEPS, "training goes on with one runner"
    begun = time.monotonic()
    while len(after) < 2 and time.monotonic() - begun < 120.0:
        time.sleep(0.2)
        seen = sampled(algorithm)
        after = runners.foreach_env_runner(lambda runner: os.getpid(), local_env_runner=False)
    assert len(after) == 2 and pids[0] not in after and pids[1] in after
    assert sampled(algorithm) - seen == 2 * FISH * STEPS
    sums = runners.foreach_env_runner(
        lambda runner: float(sum(value.double().sum() for value in runner.module.state_dict().values())),
        local_env_runner=False,
    )
    assert sums[0] == sums[1], "the new runner has the weights of the learner"
    algorithm.stop()


def sampled(algorithm):
    """Environment steps of all runners since the beginning, after another iteration."""
    return algorithm.train()["env_runners"]["num_env_steps_sampled_lifetime"]


def test_learns(example, args, tmp_path):
    """A tenth of the usual training: the fish of the exported policy swims."""
    args = replace(example.Args(), steps=100_000, fish=64)
    algorithm = example.make_config(args).build_algo()
    example.train(algorithm, args)
    example.policy_of(algorithm, args).save(tmp_path / "policy.npz")
    algorithm.stop()
    policy = fish_env.control.load_policy(tmp_path / "policy.npz")
    env = fish_env.control.make_eval_env(args.env_id, 5, dict(policy.about["env_options"]))
    scores = fish_env.control.evaluate(env, policy)
    assert np.mean(scores["speed"]) > 1.0


class ShortJob(Job):
    """A run of few steps."""

    def command(self):
        """That of a run, with fewer steps."""
        words = super().command()
        return [*words[:-2], "--timesteps", "2048", "--num-envs", "16", *words[-2:]]


def test_runs_of_all_tasks_on_a_cluster(tmp_path):
    """Runs go to the processors of a cluster, and their files come back; one that fails is named with its log."""
    ray.shutdown()
    config = replace(CONFIGS["swim"], timesteps=2048)
    jobs = [ShortJob("swim", seed, tmp_path / f"seed_{seed}", config) for seed in range(2)]
    bad = Job("no_such_task", 0, tmp_path / "bad", config)
    assert ray_jobs.run_on_ray([*jobs, bad], [*jobs, bad], "local") == [bad]
    assert all(job.finished and (job.folder / "policy.npz").exists() and job.steps == 2048 for job in jobs)
    assert "no_such_task" in (bad.folder / "log.txt").read_text()
    assert not ray.is_initialized()


def test_no_cluster():
    """An address without a cluster is refused, with what may be given."""
    ray.shutdown()
    with pytest.raises(ValueError, match="there is no Ray cluster"):
        ray_jobs.join_cluster("127.0.0.1:1")


@pytest.mark.parametrize("address", ["127.0.0.1:1", "auto", "nowhere"])
def test_the_example_without_a_cluster(tmp_path, address):
    """The example says in one line that there is no cluster and what may be given, before it writes anything."""
    done = subprocess.run(
        [sys.executable, str(ROOT / "examples" / "train_rllib.py"), "--address", address, "--folder", "out"],
        env={**os.environ, "PYTHONPATH": os.pathsep.join(sys.path), "RAY_ADDRESS": ""}, cwd=tmp_path,
        capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.returncode == 1 and not (tmp_path / "out").exists()
    last = done.stderr.splitlines()[-1]
    assert (
        last.startswith(f"train_rllib.py: there is no Ray cluster at {address!r} (") and "leave --address out" in last
    )
    assert "Traceback" not in done.stderr
