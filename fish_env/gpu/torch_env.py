"""FishTorchEnv: a batch of fish on an NVIDIA GPU, torch tensors in and out, which never leave it.

In the manner of Isaac Lab's and Brax's environments for torch: all fish are stepped by one launch, episodes that end
begin again within the step, and a step returns tensors on the device.
"""

import warnings
from collections.abc import Callable
from functools import cache
from typing import Any

import numpy as np
import torch

from fish_env.envs.episode import Episodes
from fish_env.envs.options import checked_seed
from fish_env.envs.state import arrays_of, fish_axes, memory_of
from fish_env.gpu.compiling import exactly
from fish_env.gpu.launch import SIGNATURE, launch_for, threads_pack
from fish_env.gpu.memory import Upload, bytes_needed
from fish_env.kernels.simd.types import WARP
from fish_env.physics.tank_options import checked_count

BLOCK = 2  # warps that start together
RESIDENT = 8  # warps on a multiprocessor at a time: so many have registers


class FishTorchEnv:
    """A batch of fish on a GPU: `fish_env.envs.FishVectorEnv`, with torch tensors on the GPU in and out.

    Every episode begins at one of `starts` states that are drawn at a reset, on the processor as in `FishVectorEnv`;
    an episode that ends starts again within the same step. What was drawn for a start belongs to it: its variation, its
    delays and its noise, which are the same in all episodes from there until the next reset.

    Args:
        num_envs: B, the number of fish.
        device: the GPU, as torch names it.
        starts: how many starts are drawn at a reset; None for as many as fish, at most 1024.
        options: keywords of `FishVectorEnv` that belong to fish and task, but `threads` and `lanes`.

    Raises:
        ValueError: for a device that is not an NVIDIA GPU or is not there, saying what is; for more fish than its free
            memory holds; for a method or task that runs on the processor only; and as `FishVectorEnv`.
        ModuleNotFoundError: without numba-cuda.
    """

    def __init__(self, num_envs: int = 256, device: str | torch.device = "cuda", starts: int | None = None, **options):
        self.device = checked_device(device)
        self.num_envs = checked_count(num_envs, "num_envs")
        starts = min(self.num_envs, 1024) if starts is None else checked_count(starts, "starts")
        refused = sorted({"threads", "lanes", "privileged", "goal_env"} & set(options))
        if refused:
            raise ValueError(f"{refused[0]} is for the processor; leave it out on a GPU")
        self._episodes = Episodes(starts, threads=1, **options)
        self._axes = fish_axes(*(threads_pack(Episodes(count, threads=1, **options)) for count in (1, 2)))
        self.single_observation_space = self._episodes.single_observation_space
        self.single_action_space = self._episodes.single_action_space
        self.control_interval, self.layout = self._episodes.control_interval, self._episodes.layout
        self.term_names = self._episodes._names
        self._blocks = launch_blocks(self.num_envs, self.device)
        self._generator = torch.Generator(self.device)
        self._upload_all()

    def _upload_all(self) -> None:
        """Lay out the memory of all fish, once it is known to fit."""
        self._free()
        episodes, warps = self._episodes, self._blocks * BLOCK
        self._pack = threads_pack(episodes)  # a reference: it owns what is uploaded by its address
        fixed = bytes_needed(self._pack, warps, self._axes, 0)
        each = bytes_needed(self._pack, warps, self._axes, 1) - fixed
        needed, free = fixed + each * (self.num_envs + episodes.num_envs), free_memory(self.device)
        if needed > free:
            raise ValueError(
                f"num_envs is {self.num_envs}, which takes {needed / 2**30:.3g} GiB; {self.device} has "
                f"{free / 2**30:.3g} GiB free: give at most {max(0, self.num_envs - -(-(needed - free) // each))}"
            )
        memory = Upload(self._pack, warps, self._place, torch.Tensor.data_ptr, self._axes, self.num_envs)
        self._memory, self._address, self._plans = memory, memory.address, plans_of(episodes)
        self._arrays = {name: memory.of(value) for name, value in episodes._arrays.items()}
        order, named = memory.of(episodes._env.order), arrays_of(self._pack)
        order.copy_(torch.arange(self.num_envs, device=self.device))
        axes = {id(memory.of(named[name])): (named[name], axis) for name, axis in self._axes.items()}
        del axes[id(order)]
        self._fish = [(memory_of(value), memory.of(value), axis) for value, axis in axes.values()]
        self._launch = launcher(episodes, memory.type, self._blocks, self.device)

    def _place(self, what, dtype=None) -> torch.Tensor:
        if dtype is None:
            return torch.tensor(what, device=self.device)
        return torch.zeros(tuple(what), dtype=torch.from_numpy(np.zeros(1, dtype)).dtype, device=self.device)

    @property
    def max_episode_steps(self) -> int | None:
        """Environment steps after which an episode is truncated; another number counts from the next `reset` on."""
        return self._episodes.max_episode_steps

    @max_episode_steps.setter
    def max_episode_steps(self, steps: int | None) -> None:
        self._episodes.max_episode_steps = steps

    @property
    def position(self) -> torch.Tensor:
        """Node positions, (B,N,3) m in float64, on the GPU: live; RuntimeError after `close`."""
        if self._memory is None:
            raise RuntimeError("the environment is closed and its memory is freed; create a new one")
        return self._memory.of(self._episodes.tank.state.x)

    def reset(self, *, seed: int | None = None) -> tuple[torch.Tensor, dict[str, Any]]:
        """Draw starts, and begin an episode of every fish: observations (B,D) float32, and {}.

        Start i of seed s is that of `FishVectorEnv` seeded s + i; fish b begins at start b, and at start b modulo their
        number if they are fewer.
        """
        episodes, seed = self._episodes, checked_seed(seed)
        seeds = None if seed is None else [seed + i for i in range(episodes.num_envs)]
        episodes.restart(np.ones(episodes.num_envs, dtype=bool), seeds)
        if seed is not None:
            self._generator.manual_seed(seed % 2**63)
        if plans_of(episodes) != self._plans:
            self._upload_all()
        self._starts = [torch.tensor(memory, device=self.device) for memory, _, _ in self._fish]
        everyone = torch.arange(self.num_envs, device=self.device)
        self._begin(everyone, everyone % episodes.num_envs)
        self._begun = True
        return self._arrays["observation"].clone(), {}

    def stagger(self) -> None:
        """Shorten the episodes just begun, so that they end one by one, as `FishVectorEnv.stagger`."""
        if self.max_episode_steps is not None:
            everyone = torch.arange(self.num_envs, device=self.device)
            self._arrays["limit"].copy_(1 + everyone * self.max_episode_steps // self.num_envs)

    def _begin(self, which: torch.Tensor, start: torch.Tensor) -> None:
        """Put the fish of these numbers (K,) at these starts (K,)."""
        for (_, tensor, axis), starts in zip(self._fish, self._starts, strict=True):
            tensor.index_copy_(axis, which, starts.index_select(axis, start))

    def step(self, actions: torch.Tensor):
        """One control interval for every fish, whose episode begins again if it has ended.

        Args:
            actions: (B,A) on the device, in [-1, 1] (what lies outside is clipped).

        Returns:
            Observations (B,D) float32; rewards (B,) float32; terminated (B,) and truncated (B,) bool; and a dict, empty
            but where episodes have ended: "over", their numbers (K,), "final_obs" (K,D), "terms", the sums (K,) of the
            terms of the reward by name, and "steps" (K,).

        Raises:
            ValueError: for actions of another shape, elsewhere, not finite, complex, or that require a gradient, which
                does not pass through; nothing has moved then.
            RuntimeError: before the first reset.
        """
        if not self._begun:
            raise RuntimeError("step was called before reset; call env.reset() first")
        arrays, episodes = self._arrays, self._episodes
        action = arrays["action"]
        if not isinstance(actions, torch.Tensor) or actions.shape != action.shape:
            found = tuple(actions.shape) if isinstance(actions, torch.Tensor) else type(actions).__name__
            raise ValueError(f"actions are {found}; give a tensor {tuple(action.shape)} on {action.device}")
        if actions.requires_grad or actions.is_complex():
            raise ValueError("actions require a gradient, or are complex; give actions.detach(), of real numbers")
        if actions.device != action.device:
            raise ValueError(f"actions are on {actions.device}; give a tensor on {action.device}")
        if not torch.isfinite(actions).all():
            raise ValueError("actions are not finite; give numbers in [-1, 1]")
        action.copy_(actions)
        self._launch(self._address, self.num_envs, episodes._substeps, episodes.control_interval)
        reward, terminated, truncated = (arrays[name].clone() for name in ("reward", "terminated", "truncated"))
        over, info = torch.nonzero(terminated | truncated).flatten(), {}
        if len(over):
            info = {
                "over": over,
                "final_obs": arrays["observation"][over],
                "terms": dict(zip(self.term_names, arrays["totals"][:, over], strict=True)),
                "steps": arrays["elapsed"][over],
            }
            among = episodes.num_envs
            self._begin(over, torch.randint(among, (len(over),), generator=self._generator, device=self.device))
        return arrays["observation"].clone(), reward.float(), terminated, truncated, info

    def close(self) -> None:
        """Give the memory back."""
        self._episodes.tank.close()
        self._free()

    def _free(self) -> None:
        self._begun, self._memory, self._arrays, self._fish, self._starts = False, None, {}, [], []


def plans_of(episodes: Episodes) -> int:
    """Number of distinct plans that the fish need, by their stiffness."""
    return len(threads_pack(episodes).block.control.plans)


def checked_device(device: str | torch.device) -> torch.device:
    """The GPU of that name, or ValueError, saying what there is."""
    try:
        found = torch.device(device)
    except (RuntimeError, TypeError) as error:
        raise ValueError(f"device is {device!r}; give the name of an NVIDIA GPU, such as 'cuda'") from error
    if found.type != "cuda":
        raise ValueError(
            f"device is {str(found)!r}; FishTorchEnv needs an NVIDIA GPU, such as 'cuda'. On the processor: "
            "gymnasium.make_vec('FishEnv/Swim-v0', num_envs)"
        )
    there = [f"cuda:{i} ({torch.cuda.get_device_name(i)})" for i in range(torch.cuda.device_count())]
    if torch.version.cuda is None or not there:
        reason = "was built without CUDA" if torch.version.cuda is None else "finds no NVIDIA GPU"
        raise ValueError(
            f"device is {str(found)!r}, but torch {torch.__version__} {reason}; there is: cpu. On the processor: "
            "gymnasium.make_vec('FishEnv/Swim-v0', num_envs)"
        )
    index = torch.cuda.current_device() if found.index is None else found.index
    if index >= len(there):
        raise ValueError(f"device is {str(found)!r}; there is: {', '.join(there)}")
    return torch.device("cuda", index)


def free_memory(device: torch.device) -> int:
    """Bytes that are free on a GPU, those that torch holds and does not use included."""
    idle = torch.cuda.memory_reserved(device) - torch.cuda.memory_allocated(device)
    return torch.cuda.mem_get_info(device)[0] + idle


def launch_blocks(num_fish: int, device: torch.device) -> int:
    """Number of blocks of BLOCK warps to launch: a thread for each fish, but no more than can run at a time."""
    most = torch.cuda.get_device_properties(device).multi_processor_count * RESIDENT // BLOCK
    return min(-(-num_fish // (BLOCK * WARP)), most)


def launcher(episodes: Episodes, env_type, blocks: int, device: torch.device):
    """The compiled kernel `launch(address, count, n, duration)` on a GPU, in the stream that torch works in."""
    cuda, compiled = compile_for(launch_for(episodes, env_type), device.index)

    def launch(*arguments):
        stream = cuda.external_stream(torch.cuda.current_stream(device).cuda_stream)
        compiled[blocks, BLOCK * WARP, stream](*arguments)

    return launch


@cache
def compile_for(launch: Callable, index: int) -> tuple[Any, Any]:
    """`numba.cuda`, and a kernel of `launch_for` compiled for the GPU of that number: once, it takes seconds."""
    warnings.filterwarnings("ignore", "Grid size .* under-utilization")  # few fish are allowed
    with exactly() as cuda:
        cuda.select_device(index)
        return cuda, cuda.jit(SIGNATURE)(launch)
