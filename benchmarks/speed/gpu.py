"""How many environment steps a second an NVIDIA GPU takes, with 256 fish and with up to 1,048,576.

    python -m benchmarks.speed.gpu

First, fish are moved on the GPU and on the processor from the same starts by the same actions, and the largest
difference of what they observe is printed. Then steps are timed, ends of episodes and new starts included. Needs an
NVIDIA GPU, and the extras [gpu] and [train]. No table has been published: there was no GPU.
"""

import argparse
import time

import numpy as np

FISH = tuple(4**k for k in range(4, 11))
CHECKED, CHECKED_STEPS = 256, 50


def largest_difference(device: str) -> float:
    """Between the observations of the same fish on the GPU and on the processor, body lengths and their like."""
    import torch

    from fish_env.envs import FishVectorEnv
    from fish_env.envs.torch_env import FishTorchEnv

    there, here = FishTorchEnv(CHECKED, device, starts=CHECKED), FishVectorEnv(CHECKED)
    rng, largest = np.random.default_rng(0), 0.0
    there.reset(seed=0)
    here.reset(seed=0)
    for _ in range(CHECKED_STEPS):
        action = rng.uniform(-1.0, 1.0, here.action_space.shape).astype(np.float32)
        wanted = here.step(action)[0]
        found = there.step(torch.from_numpy(action).to(there.device))[0]
        largest = max(largest, float(np.abs(found.cpu().numpy() - wanted).max()))
    there.close()
    here.close()
    return largest


def steps_a_second(num_envs: int, device: str, dtype: str, steps: int) -> float:
    """Environment steps of all fish in a second, with random actions."""
    import torch

    from fish_env.envs.torch_env import FishTorchEnv

    env = FishTorchEnv(num_envs, device, dtype=dtype, max_episode_steps=250)
    env.reset(seed=0)
    action = 2.0 * torch.rand(num_envs, *env.single_action_space.shape, device=env.device) - 1.0
    for _ in range(3):
        env.step(action)
    torch.cuda.synchronize(env.device)
    begun = time.perf_counter()
    for _ in range(steps):
        env.step(action)
    torch.cuda.synchronize(env.device)
    seconds = time.perf_counter() - begun
    env.close()
    return num_envs * steps / seconds


def main(arguments: list[str] | None = None) -> int:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--device", default="cuda", help="the GPU, as torch names it (cuda)")
    parser.add_argument("--steps", type=int, default=50, help="environment steps that are timed (50)")
    args = parser.parse_args(arguments)
    try:
        print(f"largest difference from the processor: {largest_difference(args.device):.3g}")
    except (ValueError, ModuleNotFoundError) as error:
        print(f"error: {error}")
        return 1
    print("fish,precision,environment steps a second")
    for dtype in ("float64", "float32"):
        for num_envs in FISH:
            try:
                print(f"{num_envs},{dtype},{steps_a_second(num_envs, args.device, dtype, args.steps):.4g}", flush=True)
            except ValueError as error:  # more than its memory holds
                print(f"{num_envs},{dtype},{error}")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
