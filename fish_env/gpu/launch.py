"""An environment step on a GPU as one launch: the kernel of `fish_env.envs.step`, one fish a thread."""

from numba import types

from fish_env.envs.step import make_step
from fish_env.gpu.compiling import load
from fish_env.kernels.simd import Kind, Pack
from fish_env.kernels.simd.types import THREAD
from fish_env.physics.forces import cached

SIGNATURE = types.void(types.int64, types.int64, types.int64, types.float64)
"""Signature of the kernel that `make_launch` makes."""


def threads_pack(episodes) -> Pack:
    """The pack of an environment for threads, each with a fish; ValueError for a task or a method without kernels."""
    engine = episodes.tank._engine
    if engine is None:
        raise ValueError(f"integrator {episodes.tank.integrator.name!r} runs on the processor only; choose another one")
    if episodes._kernels is None:
        raise ValueError(f"the task {type(episodes.task).__name__} is written in Python; give one made of kernels")
    block = engine.new_block(1, Kind(THREAD, episodes.tank.kind.dtype))
    return Pack("env", **(episodes._env._kept | {"block": block}))


@cached
def make_launch(names, make_run, kernels, senses, env_type):
    """The kernel `launch(address, count, n, duration)`: a step of each fish order[:count] of the pack at an address."""
    # Its threads take the fish in turn, so there may be fewer of them than fish; `step` says what n and duration are. A
    # fish whose action is not finite stays as it is.
    cuda, step = load(), make_step(names, make_run, kernels, senses, env_type)

    def launch(address, count, n, duration):
        for p in range(cuda.grid(1), count, cuda.gridsize(1)):
            step(address, p, p + 1, n, duration)

    return launch


def launch_for(episodes, env_type):
    """`make_launch` for an environment, whose pack is of that type on the GPU."""
    engine = episodes.tank._engine
    return make_launch(engine.names, engine.method.make_run, episodes._kernels, episodes._sensing, env_type)
