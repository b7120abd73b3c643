"""PPO by compiled kernels computes what Stable-Baselines3's does, for the policy of every task."""

import copy
from dataclasses import replace

import numpy as np
import pytest

torch = pytest.importorskip("torch")
pytest.importorskip("stable_baselines3")

from stable_baselines3 import PPO
from stable_baselines3.common.logger import Logger
from torch import nn

from agents.build import export_policy, make_env, make_model
from agents.config import CONFIGS
from agents.fast_ppo import Acting, FastPPO
from agents.kernels import _tanh32, tanh
from agents.networks import Networks
from agents.train import how_it_learns
from fish_env.kernels.compile import njit

pytestmark = pytest.mark.filterwarnings("ignore:You have specified a mini-batch size")  # one is cut off

TOLERANCE = {torch.float64: 1e-6, torch.float32: 5e-5}  # Adam magnifies what processors round differently: 3.6e-5 seen
"""Relative to the largest number of an array."""
FIELDS = ("values", "log_probs", "advantages", "returns", "rewards")
POLICIES = [*((task, True) for task in CONFIGS), ("swim", False)]


@pytest.fixture(autouse=True)
def one_thread():
    """Torch on one thread, as the scripts have it."""
    torch.set_num_threads(1)


def pair(task, symmetric=True, dtype=torch.float32, **settings):
    """The same learner twice, by Stable-Baselines3's code and by the kernels, its numbers far from those of a start."""
    config = replace(CONFIGS[task], symmetric=symmetric, rollout=16, num_envs=6, **settings)
    learners = []
    for learner in ("sb3", "compiled"):
        model = make_model(config, make_env(config, config.num_envs, seed=0), 0, learner=learner)
        generator = torch.Generator().manual_seed(1)
        with torch.no_grad():
            for parameter in model.policy.parameters():
                parameter.add_(0.2 * torch.randn(parameter.shape, generator=generator))
        model.policy.to(dtype)
        model.set_logger(Logger(None, []))
        learners.append(model)
    return learners


def fill(model, seed=0):
    """Fill a learner's rollout buffer with numbers of which many are clipped, in the precision of its policy."""
    rng, buffer, policy = np.random.default_rng(seed), model.rollout_buffer, model.policy
    scaler, dtype = policy.features_extractor, policy.log_std.detach().numpy().dtype
    buffer.reset()
    noise = rng.normal(size=buffer.observations.shape)
    buffer.observations[:] = scaler.offset.numpy() + scaler.scale.numpy() * noise
    flat = torch.as_tensor(buffer.observations.reshape(-1, noise.shape[-1]))
    with torch.no_grad():
        mean = policy.get_distribution(flat).distribution.mean.numpy().reshape(buffer.actions.shape)
        buffer.actions[:] = mean + rng.normal(size=mean.shape) * policy.log_std.exp().numpy()
        actions = torch.as_tensor(buffer.actions.reshape(len(flat), -1))
        values, log_probs, _ = policy.evaluate_actions(flat, actions)
    for name in FIELDS:
        setattr(buffer, name, rng.normal(size=buffer.values.shape).astype(dtype))
    buffer.log_probs += log_probs.numpy().reshape(buffer.log_probs.shape) - 0.7 * buffer.log_probs
    buffer.values += values.numpy().reshape(buffer.values.shape) - 0.7 * buffer.values
    buffer.pos, buffer.full = buffer.buffer_size, True
    return buffer


def numbers(model):
    """What a learner has learnt and keeps, by name."""
    found = {}
    for name, parameter in model.policy.named_parameters():
        found[name] = parameter.detach().numpy().copy()
        state = model.policy.optimizer.state[parameter]
        found |= {f"{name}, {key}": value.numpy().copy() for key, value in state.items()}
        found[f"{name}, grad"] = parameter.grad.numpy().copy()
    return found


def assert_alike(one, other, tolerance):
    """Arrays by name are the same, to a part of the largest number of each."""
    assert one.keys() == other.keys()
    for name, value in one.items():
        scale = max(np.abs(value).max(), 1e-3)
        np.testing.assert_allclose(other[name], value, rtol=0, atol=tolerance * scale, err_msg=name)


def logged(model):
    """What the update logged, but the rate."""
    return {name: np.array(value) for name, value in model.logger.name_to_value.items()}


@pytest.mark.parametrize("dtype", TOLERANCE)
@pytest.mark.parametrize(("task", "symmetric"), POLICIES)
def test_acting_is_the_same(task, symmetric, dtype):
    """Actions for the same noise, their means, values and log-probabilities are those of torch."""
    _, fast = pair(task, symmetric, dtype)
    obs = torch.as_tensor(fill(fast).observations.reshape(-1, fast.observation_space.shape[0])[:70])
    found = []
    for policy in (Acting(Networks(fast.policy)), fast.policy):
        torch.manual_seed(3)
        with torch.no_grad():
            actions, values, log_probs = policy.forward(obs)
            found.append({"actions": actions, "values": values, "log_probs": log_probs})
            mean, _, likeliest = policy.forward(obs, deterministic=True)
            found[-1] |= {"mean": mean, "log_probs of the mean": likeliest}
            found[-1] |= {"alone": policy.predict_values(obs), "noise": torch.rand(3)}  # as many numbers were drawn
    ours, theirs = ({name: value.numpy() for name, value in each.items()} for each in found)
    assert ours["actions"].dtype == theirs["actions"].dtype and np.ptp(ours["values"]) > 0.1
    assert_alike(theirs, ours, TOLERANCE[dtype])


@pytest.mark.parametrize("dtype", TOLERANCE)
@pytest.mark.parametrize(("task", "symmetric"), POLICIES)
def test_an_update_is_the_same(task, symmetric, dtype):
    """One minibatch gives the losses, gradients and parameters of Stable-Baselines3's, all its terms at work."""
    learners = pair(task, symmetric, dtype)
    for model in learners:
        model.n_epochs, model.batch_size, model.ent_coef, model.clip_range_vf = 1, 96, 0.01, lambda _: 0.1
        fill(model)
        before = copy.deepcopy(numbers_of_parameters(model))
        model.train()
        changed = [np.abs(value - before[name]).max() for name, value in numbers_of_parameters(model).items()]
        assert min(changed) > 1e-5
    slow, fast = learners
    assert 0.1 < logged(slow)["train/clip_fraction"] < 0.9
    assert_alike(logged(slow), logged(fast), TOLERANCE[dtype])
    assert_alike(numbers(slow), numbers(fast), TOLERANCE[dtype])


def numbers_of_parameters(model):
    """The parameters by name."""
    return {name: parameter.detach().numpy() for name, parameter in model.policy.named_parameters()}


@pytest.mark.parametrize("settings", [{}, {"normalize_advantage": False}, {"target_kl": 0.2}, {"batch_size": 95}])
def test_many_updates_are_the_same(settings):
    """Epochs of minibatches, one of them cut off, and one that stops since the policy changed too much."""
    learners = pair("swim", dtype=torch.float64)
    for model in learners:
        model.n_epochs, model.batch_size = 4, 40
        vars(model).update(settings)
        for update in range(2):
            np.random.seed(update)  # noqa: NPY002 - what SB3 draws minibatches with
            fill(model, update).log_probs[:] += 0.2 * np.random.default_rng(update).normal()
            model.train()
    slow, fast = learners
    assert slow._n_updates == fast._n_updates
    assert ("target_kl" in settings) == (slow._n_updates < 8)
    assert_alike(logged(slow), logged(fast), 1e-6)
    learnt = [{name: value for name, value in numbers(model).items() if "grad" not in name} for model in learners]
    assert_alike(*learnt, 1e-6)


def start(learner, task="swim", threads=1, **settings):
    """A learner with episodes that end by their time limit, some in every rollout of 256 samples."""
    options = {"max_episode_steps": 12, "threads": threads}
    config = replace(CONFIGS[task], num_envs=32, rollout=8, batch_size=100, training_options=options, **settings)
    model = make_model(config, make_env(config, config.num_envs, seed=0), 0, learner=learner)
    if isinstance(model, FastPPO):
        model.threads = threads
    return model


def run(learner, *arguments, updates=3, **options):
    """A short training run."""
    return start(learner, *arguments, **options).learn(updates * 256)


@pytest.mark.parametrize("task", ["swim", "avoid"])
def test_a_training_run_is_the_same(task):
    """From the same seed both learn the same: rollouts, time limits, returns, updates, what is logged of episodes."""
    slow, fast = run("sb3", task), run("compiled", task)
    assert fast.why_slow is None and slow.num_timesteps == fast.num_timesteps == 768
    assert_alike(numbers_of_parameters(slow), numbers_of_parameters(fast), 2e-5)
    for name in ("observations", "actions", "rewards", "episode_starts", *FIELDS):
        one, other = getattr(slow.rollout_buffer, name), getattr(fast.rollout_buffer, name)
        if slow.rollout_buffer.generator_ready:
            other = slow.rollout_buffer.swap_and_flatten(other) if one.shape != other.shape else other
        np.testing.assert_allclose(np.squeeze(other), np.squeeze(one), atol=2e-4, err_msg=name)
    assert len(slow.ep_info_buffer) == len(fast.ep_info_buffer) > 0
    for one, other in zip(slow.ep_info_buffer, fast.ep_info_buffer, strict=True):
        assert one["l"] == other["l"] and one["r"] == pytest.approx(other["r"], abs=1e-4)


def test_threads_change_no_bit():
    """One, two and three threads learn the same, bit for bit."""
    one, *others = (numbers(run("compiled", threads=threads)) for threads in (1, 2, 3))
    for other in others:
        for name, value in one.items():
            np.testing.assert_array_equal(other[name], value, err_msg=name)


def test_what_the_kernels_do_not_know_is_learnt_all_the_same(monkeypatch):
    """With another activation a reason is given, and Stable-Baselines3's own code learns."""
    monkeypatch.setattr("agents.build.Tanh", nn.ReLU)
    slow, fast = start("sb3").learn(256), start("compiled")
    assert "its layers are Linear and ReLU" in fast.why_slow and fast.why_slow in how_it_learns(fast)
    for one, other in zip(slow.policy.parameters(), fast.learn(256).policy.parameters(), strict=True):
        assert torch.equal(one, other)


def test_what_learns_is_said():
    """The log of a run says which code learns."""
    assert start("compiled").why_slow is None
    assert how_it_learns(start("compiled")).startswith("Learning with compiled kernels")
    assert how_it_learns(start("sb3")) == "Learning with Stable-Baselines3's own code."


@pytest.mark.parametrize("hidden", [pytest.param((16,), marks=pytest.mark.slow), (16, 24, 8)])
def test_other_layers(hidden):
    """One hidden layer, and three of different widths, learn the same too."""
    slow, fast = run("sb3", hidden=hidden, updates=1), run("compiled", hidden=hidden, updates=1)
    assert fast.why_slow is None
    assert_alike(numbers_of_parameters(slow), numbers_of_parameters(fast), 2e-5)


def test_either_goes_on_from_what_the_other_saved(tmp_path):
    """A saved learner is loaded by both, with its optimizer's numbers, and learns on alike."""
    run("compiled").save(tmp_path / "model.zip")
    env = make_env(replace(CONFIGS["swim"], num_envs=32), 32, seed=1)
    learners = [kind.load(tmp_path / "model.zip", env, device="cpu") for kind in (PPO, FastPPO)]
    for model in learners:
        model.set_logger(Logger(None, []))
        np.random.seed(0)  # noqa: NPY002 - what SB3 draws minibatches with
        fill(model)
        model.train()
    assert_alike(numbers(learners[0]), numbers(learners[1]), 2e-5)
    obs = learners[0].rollout_buffer.observations[:3]
    exported = [export_policy(model, {})(obs) for model in learners]
    np.testing.assert_allclose(*exported, atol=1e-4)
    learners[1].save(tmp_path / "again.zip")
    again = FastPPO.load(tmp_path / "again.zip", env, device="cpu")
    for one, other in zip(learners[1].policy.parameters(), again.policy.parameters(), strict=True):
        assert torch.equal(one, other)


def test_numbers_that_are_not_finite_are_refused():
    """A network that gives no numbers ends the training with a reason."""
    model = run("compiled", updates=1)
    with torch.no_grad():
        model.policy.action_net.linear.bias.fill_(np.nan)
    with pytest.raises(ValueError, match="actions are not finite"):
        model.learn(256)


def test_tanh_of_the_kernels():
    """The rational function is tanh to 3e-7 and keeps a NaN; in double precision it is tanh."""
    call = njit(lambda x: tanh(x))
    x = np.concatenate([np.linspace(-12, 12, 20_001), [-np.inf, np.inf, 0.0]])
    found = np.array([call(np.float32(value)) for value in x])
    assert np.abs(found - np.tanh(x.astype(np.float32).astype(float))).max() < 3e-7
    assert np.isnan(call(np.float32(np.nan))) and np.isnan(_tanh32(np.float32(np.nan)))
    np.testing.assert_allclose([call(value) for value in x], np.tanh(x), rtol=1e-15)
