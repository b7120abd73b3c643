"""Kernels on a GPU: the memory of its threads; and, with numba-cuda, code for GPUs, which agrees to the last bit.

The last part needs no GPU: pip install -c constraints.txt -e ".[dev,gpu]"
"""

import importlib.util
import re
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from moving import tiered

from fish_env import Tank, make_fish
from fish_env.envs import FishVectorEnv
from fish_env.envs.state import arrays_of, memory_of
from fish_env.gpu import compiling
from fish_env.gpu.launch import threads_pack
from fish_env.gpu.memory import Upload, bytes_needed, gpu_type, is_own
from fish_env.kernels.simd import Kind
from fish_env.kernels.simd.types import THREAD, WARP
from fish_env.physics.engine import make_call

MISSING = importlib.util.find_spec("numba_cuda") is None
needs_compiler = pytest.mark.skipif(MISSING, reason='needs numba-cuda: pip install -c constraints.txt -e ".[gpu]"')
FISH = 35  # more than a warp
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
    """What docs/gpu.md says that a fish takes."""
    page = (Path(__file__).parent.parent / "docs" / "gpu.md").read_text()
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
    subprocess.run([sys.executable, "-c", code], check=True, cwd=Path(__file__).parent.parent)


@needs_compiler
def test_nothing_is_contracted():
    """A product and a sum stay two roundings, and `fma` is one."""
    from numba import types

    from fish_env.kernels.simd import fma

    def explicit(out, a, b, c):
        out[0] = fma(a, b, c)

    def implicit(out, a, b, c):
        out[0] = a * b + c

    signature = types.void(types.float64[::1], *[types.float64] * 3)
    found = [compiling.to_ptx(function, signature, (8, 0)).count("fma.rn.f64") for function in (explicit, implicit)]
    assert found == [1, 0]


def compared(cc=(8, 0), fish=FISH, steps=4, warps=None, **options):
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
@pytest.mark.parametrize("cc", tiered([(8, 0), (9, 0)], [(9, 0)]))
def test_step_of_the_default_fish(cc):
    """A whole environment step is compiled for A100 and H100, and does to the fish what the processor does, exactly."""
    ptx = compared(cc)
    assert f".target sm_{cc[0]}{cc[1]}" in ptx
    assert ptx.count(".visible .entry") == 1
    bytewise = len(re.findall(r"\bld\S*\.u8", ptx))
    assert bytewise < 10, "numbers are loaded byte by byte"
    assert "Used 255 registers" in assembled(ptx, cc)  # all there are


@needs_compiler
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
