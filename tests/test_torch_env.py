"""FishTorchEnv: a batch of fish on a GPU. Here without one: what it says then, and its steps with the GPU emulated."""

import importlib
import re
import sys

import numpy as np
import pytest
from moving import tiered
from pages import ROOT
from test_gpu import needs_compiler

torch = pytest.importorskip("torch")

from benchmarks.speed import gpu
from fish_env.control import load_policy
from fish_env.envs import FishVectorEnv
from fish_env.gpu import torch_env
from fish_env.gpu.torch_env import FishTorchEnv

FISH = 5
needs_no_gpu = pytest.mark.skipif(torch.cuda.is_available(), reason="there is a GPU")


@needs_no_gpu
@pytest.mark.parametrize(
    ("device", "message"),
    [
        *(
            (name, "device is 'cuda.*there is: cpu. On the processor: gymnasium.make_vec")
            for name in ("cuda", "cuda:3")
        ),
        (torch.device("cuda"), "device is 'cuda"),
        ("cpu", "'cpu'; FishTorchEnv needs"),
        ("gpu", "'gpu'; give the name"),
    ],
)
def test_without_a_gpu(device, message):
    """It says at once that there is none, and what to use instead; a device that is no NVIDIA GPU is refused."""
    with pytest.raises(ValueError, match=message):
        FishTorchEnv(4, device)


def test_missing_gpu(monkeypatch):
    """One that is not there is refused, and those that are named."""
    monkeypatch.setattr(torch.cuda, "device_count", lambda: 1)
    monkeypatch.setattr(torch.cuda, "get_device_name", lambda index: "H200")
    monkeypatch.setattr(torch.version, "cuda", "12.9")
    with pytest.raises(ValueError, match=re.escape("device is 'cuda:2'; there is: cuda:0 (H200)")):
        FishTorchEnv(4, "cuda:2")
    assert torch_env.checked_device("cuda:0") == torch.device("cuda", 0)


@pytest.fixture
def emulated(monkeypatch):
    """Memory of the processor in place of a GPU's, and launches that are emulated."""
    monkeypatch.setattr(torch_env, "checked_device", torch.device)
    monkeypatch.setattr(torch_env, "free_memory", lambda device: 2**30)
    monkeypatch.setattr(torch_env, "launch_blocks", lambda num_fish, device: 1)
    from emulated_gpu import emulated_launcher

    monkeypatch.setattr(torch_env, "launcher", emulated_launcher)


@needs_compiler
def test_episodes(emulated):
    """Steps are those of the processor; an episode that ends begins again at a start, and says what it came to."""
    options = {"task": "swim", "max_episode_steps": 3, "variation": {"stiffness": (0.5, 2.0)}}
    env, other = FishVectorEnv(FISH, threads=1, **options), FishTorchEnv(FISH, "cpu", **options)
    found, info = other.reset(seed=7)
    starts = found.numpy()
    np.testing.assert_array_equal(env.reset(seed=7)[0], starts)
    assert info == {}
    np.testing.assert_array_equal(other.position, env.tank.position)
    rng = np.random.default_rng(0)
    for step in range(1, 4):
        action = rng.uniform(-1.0, 1.0, env.action_space.shape).astype(np.float32)
        wanted, reward, terminated, truncated, _ = env.step(action)
        found, other_reward, *ends, info = other.step(torch.from_numpy(action))
        np.testing.assert_array_equal(other_reward.numpy(), reward.astype(np.float32))
        np.testing.assert_array_equal(torch.stack(ends).numpy(), [terminated, truncated])
        assert truncated.all() == (step == 3)
        if step < 3:
            np.testing.assert_array_equal(found.numpy(), wanted)
            assert info == {}
    np.testing.assert_array_equal(info["over"], np.arange(FISH))
    np.testing.assert_array_equal(info["final_obs"], wanted)
    assert info["steps"].tolist() == [3] * FISH
    sums = np.array([env.episode_info(i)["terms"]["progress"] for i in range(FISH)])
    np.testing.assert_array_equal(info["terms"]["progress"], sums)
    for row in found.numpy():  # at one of the starts again
        assert (row == starts).all(axis=1).any()
    found, *_ = other.step(torch.zeros(FISH, env.single_action_space.shape[0]))
    assert not other._arrays["truncated"].any()
    assert np.abs(found.numpy() - starts).max() > 0.0
    other.close()
    with pytest.raises(RuntimeError, match="is closed and its memory is freed"):
        _ = other.position


@needs_compiler
def test_more_fish_than_starts(emulated):
    """Fish that begin at the same start swim alike, and at another one otherwise."""
    env = FishTorchEnv(70, "cpu", starts=2)
    first, _ = env.reset(seed=1)
    torch.testing.assert_close(first[2:], first[:-2], rtol=0.0, atol=0.0)
    found, reward, *_ = env.step(torch.linspace(-1.0, 1.0, 12).repeat(70, 1))
    torch.testing.assert_close(found[2:], found[:-2], rtol=0.0, atol=0.0)
    assert reward[0] == reward[68] != reward[69]


@needs_compiler
def test_training_on_the_gpu_alone(emulated, monkeypatch, tmp_path, capsys):
    """The example collects what its model for the processor does, as long as no episode has begun again; it trains."""
    monkeypatch.syspath_prepend(str(ROOT / "examples"))
    example, model = importlib.import_module("train_gpu"), importlib.import_module("train_cleanrl")
    count, steps, limit = 12, 6, 12
    args = example.GpuArgs(device="cpu", dtype="float64", num_envs=count, rollout=steps, seed=2, evaluations=2)
    found = []
    options = {"muscle_groups": "pairs", "max_episode_steps": limit}
    processor = FishVectorEnv(count, threads=1, autoreset_mode="SameStep", **options)
    for kind, env in ((model, processor), (example, FishTorchEnv(count, "cpu", **options))):
        torch.manual_seed(3)
        agent = model.Agent(env, args)
        collector = kind.Collector(env, agent, args)
        rollout = [part.reshape(steps, count, -1) for part in collector.collect()]
        returns = [np.atleast_1d(each) for each in collector.returns]
        found.append((rollout, np.sort(np.concatenate(returns))))
        env.close()
    first = np.arange(steps)[:, None] <= np.arange(count)  # fish b's episode ends with step b
    for one, two in zip(found[0][0], found[1][0], strict=True):
        np.testing.assert_allclose(two.numpy()[first], one.numpy()[first], rtol=1e-5, atol=1e-6)
    assert len(found[0][1]) == len(found[1][1]) == steps
    np.testing.assert_allclose(found[1][1], found[0][1], rtol=1e-5, atol=1e-6)
    words = ["--device", "cpu", "--num-envs", "8", "--timesteps", "64", "--rollout", "4", "--evaluations", "2"]
    monkeypatch.setattr(sys, "argv", ["train_gpu.py", *words, "--folder", str(tmp_path / "out")])
    example.main()
    assert "64 steps" in capsys.readouterr().out
    assert {path.name for path in (tmp_path / "out").iterdir()} == {"args.json", "scores.json", "policy.npz"}
    assert load_policy(tmp_path / "out" / "policy.npz", "FishEnv/Swim-v0").about["seed"] == 0


@needs_compiler
def test_what_is_refused(emulated, monkeypatch):
    """Steps before a reset, and actions that are not what they should be; nothing moves then."""
    env = FishTorchEnv(FISH, "cpu")
    action = torch.zeros(FISH, 12)
    with pytest.raises(RuntimeError, match="before reset"):
        env.step(action)
    before, _ = env.reset(seed=0)
    for bad, message in (
        (action[:, :5], re.escape("actions are (5, 5); give a tensor (5, 12) on cpu")),
        (action.numpy(), "actions are ndarray"),
        (action.to("meta"), "actions are on meta"),
        (action + np.nan, "not finite"),
        (action.clone().requires_grad_(), "require a gradient"),
        (action.to(torch.complex64), "are complex"),
    ):
        with pytest.raises(ValueError, match=message):
            env.step(bad)
    np.testing.assert_array_equal(env._arrays["observation"], before)
    env.step(action.to(torch.bfloat16))
    env.max_episode_steps = 1
    env.reset(seed=0)
    assert env.step(action)[3].all()
    for bad in (0, -5, 1.5):
        with pytest.raises(ValueError, match="max_episode_steps is"):
            env.max_episode_steps = bad
    for bad in (-1, 1.5, "3"):
        with pytest.raises(ValueError, match=r"seed is .*; give a whole number, zero or more"):
            env.reset(seed=bad)
    for options, message in (({"lanes": 8}, "lanes is for the processor"), ({"integrator": "radau"}, "processor only")):
        with pytest.raises(ValueError, match=message):
            FishTorchEnv(FISH, "cpu", **options)
    with pytest.raises(ValueError, match="starts is 0"):
        FishTorchEnv(FISH, "cpu", starts=0)
    monkeypatch.setattr(torch_env, "free_memory", lambda device: 2**21)
    with pytest.raises(ValueError, match=r"num_envs is 1000, .* GiB; cpu has .* GiB free: give at most \d+$") as error:
        FishTorchEnv(1000, "cpu", starts=2)
    most = int(str(error.value).rpartition(" ")[2])
    FishTorchEnv(most, "cpu", starts=2)
    with pytest.raises(ValueError, match="give at most"):
        FishTorchEnv(most + 1, "cpu", starts=2)


def test_benchmark_without_a_gpu(capsys):
    """The measurement says what is missing."""
    if torch.cuda.is_available():
        pytest.skip("there is a GPU")
    assert gpu.main([]) == 1
    assert "\nerror: device is 'cuda', but torch" in capsys.readouterr().out


@needs_compiler
@pytest.mark.parametrize("dtype", tiered(gpu.AGREEMENT, ("float64",)))
def test_agreement_of_an_emulated_gpu(emulated, dtype):
    """What `test_on_a_gpu` asks of a GPU, asked of the emulated one: float64 has the processor's bits."""
    found = gpu.largest_difference("cpu", dtype, num_envs=3, seconds=0.2)
    assert found == 0.0 if dtype == "float64" else 0.0 < found < gpu.AGREEMENT[dtype]


@needs_compiler
def test_disagreement_is_seen(emulated, monkeypatch):
    """A node that is a little elsewhere, far less than observations show, and an end of one episode are seen."""
    step = FishTorchEnv.step

    def a_little_off(env, actions):
        found = step(env, actions)
        env.position[1, 5, 2] += 1e-9 * 0.2
        return found

    def ended(env, actions):
        obs, reward, terminated, *rest = step(env, actions)
        return obs, reward, terminated | torch.tensor([False, True]), *rest

    monkeypatch.setattr(FishTorchEnv, "step", a_little_off)
    assert gpu.AGREEMENT["float64"] < gpu.largest_difference("cpu", num_envs=2, seconds=0.02) < 1e-7
    monkeypatch.setattr(FishTorchEnv, "step", ended)
    assert gpu.largest_difference("cpu", num_envs=2, seconds=0.02) == np.inf


@needs_compiler
@pytest.mark.skipif(not torch.cuda.is_available(), reason="needs an NVIDIA GPU")
@pytest.mark.parametrize("dtype", gpu.AGREEMENT)
def test_on_a_gpu(dtype):
    """Fish on the GPU are where they are on the processor, for two seconds."""
    assert gpu.largest_difference("cuda", dtype) < gpu.AGREEMENT[dtype]
