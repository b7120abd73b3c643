"""Does an NVIDIA GPU move fish as the processor does, and how many environment steps a second does it take?

    python -m benchmarks.speed.gpu                    some minutes, most of them compilation
    python -m benchmarks.speed.gpu --cases default    agreement of the default fish only

Fish are moved for two seconds on the GPU, and on the processor in float64, from the same starts by the same actions:
how far their nodes are apart is printed, and how far they may be. Then steps are timed on both, by the clock, with ends
of episodes and new starts. Needs an NVIDIA GPU, and the extras [gpu] and [train]. Numbers: docs/other-learners.md.
"""

import time
from collections.abc import Callable
from functools import partial

import numpy as np

from benchmarks.common.tables import make_parser

FISH = tuple(4**k for k in range(4, 11))
ON_PROCESSOR = 4096  # fish
CASES: dict[str, dict[str, str]] = {
    "default": {},
    "planar": {"body": "planar"}, "two_layer": {"body": "two_layer"}, "tetrahedral": {"body": "tetrahedral"},
    "drag": {"water": "drag"}, "semi_implicit": {"integrator": "semi_implicit"}, "rk4": {"integrator": "rk4"},
    "linearly_implicit": {"integrator": "linearly_implicit"}, "rosenbrock": {"integrator": "rosenbrock"},
    "left_after_right": {"task": "left_after_right"}, "avoid": {"task": "avoid"},
}  # fmt: skip
"""Fish that are compared in float64: keywords of the environment."""
CHECKED, SECONDS = 256, 2.0  # how many fish are compared, and for how long
AGREEMENT = {"float64": 1e-10, "float32": 1e-4}
"""How far nodes may be from where the processor has them in float64, body lengths, by the precision on the GPU.

On the processor, float32 is as far as 3e-5 from float64 after two seconds of random actions.
"""


def largest_difference(device: str, dtype="float64", num_envs=CHECKED, seconds=SECONDS, **options) -> float:
    """Of the positions of all nodes of fish on the GPU from the same fish on the processor, which has float64.

    They begin alike and are given the same random actions.

    Args:
        device: the GPU, as torch names it.
        dtype: precision on the GPU.
        num_envs: how many fish.
        seconds: of the simulation, compared after every environment step.
        options: keywords of both environments.

    Returns:
        The largest distance along an axis at any time, body lengths; inf if an episode ends on one of them alone.

    Raises:
        ValueError: without a GPU, or for what it cannot hold.
        ModuleNotFoundError: without numba-cuda.
    """
    import torch

    from fish_env.envs import FishVectorEnv
    from fish_env.gpu.torch_env import FishTorchEnv

    there = FishTorchEnv(num_envs, device, starts=num_envs, dtype=dtype, **options)
    here = FishVectorEnv(num_envs, **options)
    rng, largest, going = np.random.default_rng(0), 0.0, np.ones(num_envs, dtype=bool)
    there.reset(seed=0)
    here.reset(seed=0)
    for _ in range(round(seconds / here.control_interval)):
        action = rng.uniform(-1.0, 1.0, here.action_space.shape).astype(np.float32)
        over = here.step(action)[2]
        also = there.step(torch.from_numpy(action).to(there.device))[2].cpu().numpy()
        if (over != also)[going].any():
            return np.inf
        going &= ~over  # what has ended begins again at different starts
        away = np.abs(there.position.cpu().numpy() - here.tank.position)[going]
        largest = max(largest, float(away.max(initial=0.0)) / here.tank.fish.length)
    there.close()
    here.close()
    return largest


def steps_a_second(env, action, steps: int, wait: Callable[[], None]) -> float:
    """Environment steps of all fish of an environment in a second, with an action; `wait` lets the device finish."""
    env.reset(seed=0)
    for _ in range(3):
        env.step(action)
    wait()
    begun = time.perf_counter()
    for _ in range(steps):
        env.step(action)
    wait()
    seconds = time.perf_counter() - begun
    env.close()
    return env.num_envs * steps / seconds


def rate_there(num_envs: int, device: str, dtype: str, steps: int) -> float:
    """Steps a second on the GPU."""
    import torch

    from fish_env.gpu.torch_env import FishTorchEnv

    env = FishTorchEnv(num_envs, device, dtype=dtype, max_episode_steps=250)
    action = 2.0 * torch.rand(num_envs, *env.single_action_space.shape, device=env.device) - 1.0
    return steps_a_second(env, action, steps, partial(torch.cuda.synchronize, env.device))


def rate_here(num_envs: int, dtype: str, steps: int) -> float:
    """Steps a second on all processors of this machine."""
    from fish_env.envs import FishVectorEnv

    env = FishVectorEnv(num_envs, dtype=dtype, max_episode_steps=250)
    action = np.random.default_rng(0).uniform(-1.0, 1.0, env.action_space.shape).astype(np.float32)
    return steps_a_second(env, action, steps, lambda: None)


def main(arguments: list[str] | None = None) -> int:
    """Command line."""
    parser = make_parser(__doc__)
    parser.add_argument("--device", default="cuda", help="the GPU, as torch names it (cuda)")
    parser.add_argument("--steps", type=int, default=50, help="environment steps that are timed (50)")
    parser.add_argument("--cases", nargs="+", choices=CASES, default=list(CASES), help="fish that are compared (all)")
    args = parser.parse_args(arguments)
    print("fish,precision,positions apart from the processor's in body lengths,allowed")
    try:
        for case, dtype in [(case, "float64") for case in args.cases] + [("default", "float32")]:
            found = largest_difference(args.device, dtype, **CASES[case])
            print(f"{case},{dtype},{found:.3g},{AGREEMENT[dtype]:g}", flush=True)
    except (ValueError, ModuleNotFoundError) as error:
        print(f"error: {error}")
        return 1
    print("where,fish,precision,environment steps a second")
    for dtype in AGREEMENT:
        print(f"processor,{ON_PROCESSOR},{dtype},{rate_here(ON_PROCESSOR, dtype, args.steps):.4g}", flush=True)
        for num_envs in FISH:
            try:
                rate = rate_there(num_envs, args.device, dtype, args.steps)
                print(f"{args.device},{num_envs},{dtype},{rate:.4g}", flush=True)
            except ValueError as error:  # more than its memory holds
                print(f"{args.device},{num_envs},{dtype},{error}")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
