"""Kernels compiled ahead of their first use, for images of containers and for folders that machines share."""

from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from fish_env.bodies import BODIES
from fish_env.checks import check_names
from fish_env.envs.vector import FishVectorEnv
from fish_env.kernels import cache as _cache
from fish_env.tasks import TASKS

COUNTS = (1, 64)  # numbers of fish: one, and enough to share a kernel and two threads


def stored_kernels() -> tuple[Path, set[Path]]:
    """The folder of the compiled kernels, and the files in it; ValueError if there is no such folder."""
    if _cache._FOLDER is None:
        raise ValueError("there is no folder for compiled kernels; set FISH_ENV_CACHE to one that can be written to")
    folder = Path(_cache._FOLDER)
    return folder, set(folder.rglob("*.nbc"))


def compile_ahead(
    tasks: Sequence[str] = tuple(TASKS),
    bodies: Sequence[str] = ("mass_spring",),
    dtypes: Sequence[str] = ("float64",),
    integrator: str | None = None,
) -> Iterator[tuple[str, int, int]]:
    """Compile what these tasks on these bodies need, one fish and many, with and without an environment."""
    # It yields what was compiled, how many kernels were stored for it, and how many there are in all.
    check_names("unknown body", BODIES, *bodies)
    before = len(stored_kernels()[1])
    for body in bodies:
        for task in tasks:
            for dtype in dtypes:
                for count in COUNTS:
                    use_kernels(count, task, body, dtype, integrator)
            now = len(stored_kernels()[1])
            yield f"{task} on {body}", now - before, now
            before = now


def use_kernels(count: int, task: str, body: str, dtype: str, integrator: str | None) -> None:
    """Use everything once: begin episodes, of all fish and of one, step, and drive a tank."""
    env = FishVectorEnv(count, task=task, body=body, dtype=dtype, integrator=integrator, threads=2)
    env.reset(seed=0)
    env.step(np.zeros((count, *env.single_action_space.shape), dtype=np.float32))
    env.reset(options={"reset_mask": np.arange(count) == 0})
    env.tank.swim(np.zeros((count, env.tank.fish.num_muscles)), env.tank.dt)
    env.close()
