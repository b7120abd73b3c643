"""Fish on a GPU: the memory of its threads; and, with numba-cuda, code for GPUs, which agrees to the last bit.

That part needs no GPU: pip install -c constraints.txt -e ".[dev,gpu]"
"""

import importlib
import importlib.util
import re
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from moving import tiered
from pages import ROOT

torch = pytest.importorskip("torch")

from benchmarks.speed import gpu
from fish_env import Tank, make_fish
from fish_env.control import load_policy
from fish_env.envs import FishVectorEnv
from fish_env.envs.state import arrays_of, memory_of
from fish_env.gpu import compiling, torch_env
from fish_env.gpu.launch import threads_pack
from fish_env.gpu.memory import Upload, bytes_needed, gpu_type, is_own
from fish_env.gpu.torch_env import FishTorchEnv
from fish_env.kernels.simd import Kind
from fish_env.kernels.simd.types import THREAD, WARP
from fish_env.physics.engine import make_call

MISSING = importlib.util.find_spec("numba_cuda") is None
needs_compiler = pytest.mark.skipif(MISSING, reason='needs numba-cuda: pip install -c constraints.txt -e ".[gpu]"')
FISH, FEW = 35, 5  # more than a warp
FINE = 2e-3  # relative change of a spring's length above which steps are taken again: often
BODIES = ("mass_spring", "planar", "two_layer", "tetrahedral")
METHODS = ("semi_implicit", "rk4", "linearly_implicit", "rosenbrock")


@pytest.mark.parametrize(
    "options",
    [
        {},
        *(pytest.param({"body": body}, marks=pytest.mark.slow) for body in BODIES[1:]),
        *(pytest.param({"integrator": name}, marks=pytest.mark.slow) for name in METHODS),
    ],
)
@pytest.mark.parametrize("dtype", tiered(("float64", "float32"), ("float64",)))
def test_memory_of_a_thread(options, dtype):
    """A fish whose numbers stand between those of 31 others moves as it does alone, to the last bit."""
    body, integrator = options.get("body", BODIES[0]), options.get("integrator")
    refine = FINE if integrator is None else None
    tanks = [Tank(make_fish(body), 2, integrator, None, None, 1, dtype, 1, refine) for _ in range(2)]
    rng = np.random.default_rng(1)
    tanks[0].vary(1, stiffness=1.2, mass=0.9, current=(0.1, 0.0, 0.0))
    tanks[1].set_state(tanks[0].get_state())
    engine = tanks[1]._engine
    block, call = engine.new_block(2, Kind(THREAD, dtype)), make_call(engine.names, engine.method.make_run)
    shared = {name: value for name, value in arrays_of(block).items() if not is_own(value)}
    before = {name: memory_of(value).copy() for name, value in shared.items()}
    for _ in range(3):
        action = rng.uniform(-1.0, 1.0, (2, tanks[0].fish.num_muscles))
        tanks[0].swim(action, 0.02)
        steps = round(0.02 / tanks[1].dt)
        tanks[1].command(0.5 * (action + 1.0), 0.02)
        call(tanks[1].pack, engine.queue, block, 0, 2, steps)
    for name, wanted in tanks[0].get_state().items():
        np.testing.assert_array_equal(tanks[1].get_state()[name], wanted, err_msg=name)
    assert np.any(tanks[0].position != make_fish(body).body.position)
    assert integrator or np.any(tanks[0].counters["refinements"] > 0)
    assert not np.any(block.x.memory[..., 1:])  # nothing was written to where the other threads have theirs
    for name, value in shared.items():
        np.testing.assert_array_equal(memory_of(value), before[name], err_msg=f"threads write to {name}, shared")


def test_kind_is_for_gpus_only():
    """A tank moves its fish on the processor."""
    with pytest.raises(ValueError, match="'thread', which is for the threads of a GPU; choose from 'xyz', 1, 2"):
        Tank(make_fish("mass_spring"), lanes="thread")


def test_upload():
    """A pack arrives elsewhere with all its numbers; what shares memory still does, and every warp has its own."""
    env = FishVectorEnv(3, threads=1)
    env.reset(seed=0)
    pack, placed = threads_pack(env), []

    def place(what, dtype=None):
        placed.append(np.array(what) if dtype is None else np.zeros(what, dtype))
        return placed[-1]

    upload = Upload(pack, 5, place, lambda array: array.ctypes.data)
    arrays = arrays_of(pack)
    assert upload.of(arrays["tank.x"]) is upload.of(arrays["tank.position"])
    np.testing.assert_array_equal(upload.of(arrays["tank.x"]), env.tank.position)
    assert not np.shares_memory(upload.of(arrays["tank.x"]), env.tank.position)
    own = [array for array in placed if array.ndim > 1 and array.shape[-1] == WARP]
    assert {len(array) for array in own} == {5}
    assert len(own) == sum(map(is_own, arrays.values())) > 20
    assert sum(array.nbytes for array in placed) == bytes_needed(pack, 5)
    assert upload.type == gpu_type(pack.type) != pack.type


def test_memory_on_the_page():
    """Memory of a fish, as docs/other-learners.md states it."""
    page = (ROOT / "docs" / "other-learners.md").read_text()
    for dtype in ("float64", "float32"):
        taken = bytes_needed(threads_pack(FishVectorEnv(1024, threads=1, dtype=dtype)), 1024 // WARP) / 1024
        assert f"{taken / 1000:.1f} kB in {dtype}" in page


def test_without_the_compiler(monkeypatch):
    """Without numba-cuda, whoever asks for a GPU is told what to install."""
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    with pytest.raises(ModuleNotFoundError, match=re.escape('pip install "fish_env[gpu]"')):
        compiling.load()


def test_what_only_the_processor_runs():
    """A method without kernels is refused."""
    with pytest.raises(ValueError, match="'dop853' runs on the processor only"):
        threads_pack(FishVectorEnv(1, integrator="dop853"))


def test_import():
    """The package does not import numba-cuda, installed or not."""
    code = "import fish_env.gpu.launch, sys; sys.exit(any(name.startswith('numba_cuda') for name in sys.modules))"
    subprocess.run([sys.executable, "-c", code], check=True, cwd=ROOT)


@needs_compiler
def test_nothing_is_contracted():
    """A product and a sum stay two roundings, and `fma` is one."""
    from emulated_gpu import to_ptx
    from numba import types

    from fish_env.kernels.simd import fma

    def explicit(out, a, b, c):
        out[0] = fma(a, b, c)

    def implicit(out, a, b, c):
        out[0] = a * b + c

    signature = types.void(types.float64[::1], *[types.float64] * 3)
    found = [to_ptx(function, signature, (8, 0)).count("fma.rn.f64") for function in (explicit, implicit)]
    assert found == [1, 0]


def compared(cc=(9, 0), fish=FISH, steps=4, warps=None, **options):
    """An environment on the processor and in an emulated GPU after steps of random actions, all arrays compared."""
    from emulated_gpu import EmulatedSteps

    options = {"refine": None if "integrator" in options else FINE} | options
    env, other = (FishVectorEnv(fish, threads=1, **options) for _ in range(2))
    for each in (env, other):
        each.reset(seed=3)
    emulated, rng = EmulatedSteps(other, warps, cc), np.random.default_rng(0)
    before = env.tank.position.copy()
    for _ in range(steps):
        action = rng.uniform(-1.0, 1.0, env.action_space.shape).astype(np.float32)
        env.step(action)
        emulated.step(action)
    shared = {name: value for name, value in arrays_of(emulated.pack).items() if not is_own(value)}
    wanted = arrays_of(env._env)
    for name, value in shared.items():  # threads must not write to what they share, so that is compared too
        if name.endswith("order"):  # the processor puts fish with equal plans side by side
            continue
        expected = value if name.startswith("block.") else wanted[name]
        np.testing.assert_array_equal(emulated.upload.of(value), memory_of(expected), err_msg=name)
    assert np.any(env.tank.position != before, axis=(1, 2)).all()
    if warps is None:  # every thread has moved its own fish, and the rest none
        lanes = emulated.upload.of(emulated.pack.block.x).transpose(0, 3, 1, 2).reshape(-1, *before.shape[1:])
        np.testing.assert_array_equal(lanes[:fish], env.tank.position.astype(lanes.dtype))
        assert not np.any(lanes[fish:])
    assert "integrator" in options or np.any(env.tank.counters["refinements"] > 0)
    return emulated.ptx


def assembled(ptx, cc):
    """Assemble PTX to machine code, if the assembler of the CUDA toolkit is there, and return what it says."""
    spec = importlib.util.find_spec("nvidia")
    folders = [Path(folder) / "cuda_nvcc" / "bin" for folder in spec.submodule_search_locations] if spec else []
    found = shutil.which("ptxas", path=":".join(map(str, folders))) or shutil.which("ptxas")
    if found is None:
        pytest.skip("needs ptxas, of the CUDA toolkit")
    command = [found, f"-arch=sm_{cc[0]}{cc[1]}", "-v", "-o", "/dev/null", "-"]
    return subprocess.run(command, input=ptx, text=True, check=True, capture_output=True).stderr


@needs_compiler
@pytest.mark.parametrize("cc", tiered([(8, 0), (9, 0)], []))
def test_step_of_the_default_fish(cc):
    """A whole environment step is compiled for A100 and H100, and does to the fish what the processor does, exactly."""
    ptx = compared(cc)
    assert f".target sm_{cc[0]}{cc[1]}" in ptx
    assert ptx.count(".visible .entry") == 1
    bytewise = len(re.findall(r"\bld\S*\.u8", ptx))
    assert bytewise < 10, "numbers are loaded byte by byte"
    assert "Used 255 registers" in assembled(ptx, cc)  # all there are


@needs_compiler
@pytest.mark.slow
def test_fewer_threads_than_fish():
    """A thread that moves several fish, one after another, leaves nothing of one in the next."""
    compared(fish=70, warps=1, steps=2)


@needs_compiler
@pytest.mark.slow
@pytest.mark.parametrize(
    "options",
    [
        *({"task": task} for task in ("turn", "left_after_right", "target", "avoid", "fast_start")),
        *({"body": body} for body in BODIES[1:]),
        *({"integrator": name} for name in METHODS),
        {"dtype": "float32"},
        {
            "observation": "sensors",
            "observation_noise": {"curvature": 0.1},
            "action_noise": 0.1,
            "history": 1,
            "observation_delay": (0, 2),
            "action_delay": 1,
        },
        {"variation": {"stiffness": (0.8, 1.25), "mass": (0.9, 1.1), "drag": (0.8, 1.2), "current": (0.0, 0.3)}},
    ],
    ids=str,
)
def test_other_steps(options):
    """So do the other tasks, bodies and methods, single precision, and fish that differ."""
    compared(fish=5, **options)


# FishTorchEnv


def test_without_a_gpu(capsys):
    """It says at once that there is none, and what to use instead; a device that is no NVIDIA GPU is refused."""
    if torch.cuda.is_available():
        pytest.skip("there is a GPU")
    for device, message in (
        *(
            (name, "device is 'cuda.*there is: cpu. On the processor: gymnasium.make_vec")
            for name in ("cuda", "cuda:3")
        ),
        (torch.device("cuda"), "device is 'cuda"),
        ("cpu", "'cpu'; FishTorchEnv needs"),
        ("gpu", "'gpu'; give the name"),
    ):
        with pytest.raises(ValueError, match=message):
            FishTorchEnv(4, device)
    assert gpu.main([]) == 1
    assert "\nerror: device is 'cuda', but torch" in capsys.readouterr().out


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
    env, other = FishVectorEnv(FEW, threads=1, **options), FishTorchEnv(FEW, "cpu", **options)
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
    np.testing.assert_array_equal(info["over"], np.arange(FEW))
    np.testing.assert_array_equal(info["final_obs"], wanted)
    assert info["steps"].tolist() == [3] * FEW
    sums = np.array([env.episode_info(i)["terms"]["progress"] for i in range(FEW)])
    np.testing.assert_array_equal(info["terms"]["progress"], sums)
    for row in found.numpy():  # at one of the starts again
        assert (row == starts).all(axis=1).any()
    found, *_ = other.step(torch.zeros(FEW, env.single_action_space.shape[0]))
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
    sizes = ["--num-envs", "8", "--timesteps", "64", "--rollout", "4", "--evaluations", "2"]
    words = ["--device", "cpu", "--dtype", "float64", *sizes, "--folder", str(tmp_path / "out")]
    monkeypatch.setattr(sys, "argv", ["train_gpu.py", *words])
    example.main()
    assert "64 steps" in capsys.readouterr().out
    assert {path.name for path in (tmp_path / "out").iterdir()} == {"args.json", "scores.json", "policy.npz"}
    assert load_policy(tmp_path / "out" / "policy.npz", "FishEnv/Swim-v0").about["seed"] == 0


@needs_compiler
def test_what_is_refused(emulated, monkeypatch):
    """Steps before a reset, and actions that are not what they should be; nothing moves then."""
    env = FishTorchEnv(FEW, "cpu")
    action = torch.zeros(FEW, 12)
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
            FishTorchEnv(FEW, "cpu", **options)
    with pytest.raises(ValueError, match="starts is 0"):
        FishTorchEnv(FEW, "cpu", starts=0)
    monkeypatch.setattr(torch_env, "free_memory", lambda device: 2**21)
    with pytest.raises(ValueError, match=r"num_envs is 1000, .* GiB; cpu has .* GiB free: give at most \d+$") as error:
        FishTorchEnv(1000, "cpu", starts=2)
    most = int(str(error.value).rpartition(" ")[2])
    FishTorchEnv(most, "cpu", starts=2)
    with pytest.raises(ValueError, match="give at most"):
        FishTorchEnv(most + 1, "cpu", starts=2)


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
