"""`make_sb3_vec_env`, which loads Stable-Baselines3 only when it is called."""

from typing import TYPE_CHECKING

from fish_env.envs.vector import make_batch

if TYPE_CHECKING:
    from fish_env.envs.sb3 import VecEnv


def make_sb3_vec_env(
    id: str, num_envs: int = 1, seed: int | None = None, monitor: bool = True, staggered: bool = False, **options
) -> "VecEnv":
    """A batch of fish for Stable-Baselines3: `make_sb3_vec_env("FishEnv/Swim-v0", num_envs=256, seed=0)`.

    Args:
        id: a registered environment of this package.
        num_envs: the number of fish.
        seed: fish i starts from seed + i.
        monitor: wrap it in `VecMonitor`, so that returns are logged.
        staggered: shorten the first episodes so that the fish do not all end theirs together (for training).
        options: keywords of `FishVectorEnv`.

    Raises:
        gymnasium.error.Error: for an id that is not registered.
        ValueError: for an option or a seed that is not allowed, or an environment that is not one of fish.
        ImportError: without Stable-Baselines3, saying how to install it.
    """
    from fish_env.envs.sb3 import FishVecEnv, VecMonitor

    if "autoreset_mode" in options:
        raise ValueError("autoreset_mode cannot be chosen: in a VecEnv, a new episode begins in the step that ends one")
    env: VecEnv = FishVecEnv(make_batch(id, num_envs, **options), staggered)
    if monitor:
        env = VecMonitor(env)
    env.seed(seed)
    return env
