"""Train a fish with PPO on an NVIDIA GPU: fish, network and rollouts stay in its memory.

    python train_gpu.py                                            train Swim, save, evaluate
    python train_gpu.py --num-envs 65536 --timesteps 40000000      any field of Args is an option

It needs fish_env with the extra [gpu], torch, an NVIDIA GPU, and train_cleanrl.py beside it, which has the network, the
advantages and the update. Here is what differs: the environment, and a rollout that is made of the GPU's tensors. The
folder that it writes is that of train_cleanrl.py.
"""

import math
import sys
import time
from dataclasses import dataclass
from typing import Any

import gymnasium as gym
import torch
from train_cleanrl import Agent, Args, advantages, begin, end, parse, update

from fish_env.control import Policy
from fish_env.gpu.torch_env import FishTorchEnv


@dataclass
class GpuArgs(Args):
    """Hyperparameters: those of train_cleanrl.py for more fish, which are not tuned."""

    device: str = "cuda"
    """the GPU, as torch names it"""
    dtype: str = "float32"
    """precision of the fish"""
    timesteps: int = 10_000_000
    """environment steps of all fish together"""
    num_envs: int = 16_384
    """fish trained side by side"""
    rollout: int = 16
    """environment steps of each fish between two updates"""
    minibatches: int = 8
    """parts that a rollout is divided into"""
    folder: str = "runs/train_gpu"
    """where the results are written"""


class Collector:
    """Steps the fish and remembers what they saw, did and were paid, all on the GPU."""

    def __init__(self, env: FishTorchEnv, agent: Agent, args: GpuArgs):
        self.env, self.agent, self.args = env, agent, args
        self.obs, _ = env.reset(seed=args.seed)
        env.stagger()  # the first episodes do not all end in the same step
        self.gamma = math.exp(-env.control_interval / args.horizon)
        self.returns: list[torch.Tensor] = []

    @torch.no_grad()
    def collect(self) -> tuple[torch.Tensor, ...]:
        """A rollout: observations, actions, their log-probabilities, advantages and returns, (T*B, ...) each."""
        held: list[list[torch.Tensor]] = [[] for _ in range(7)]
        self.returns.clear()
        for _ in range(self.args.rollout):
            chance, value = self.agent(self.obs)
            action = chance.sample()
            obs, reward, terminated, truncated, info = self.env.step(action)
            following = self.agent(obs)[1]
            if info:  # an episode that ran out of time is not over for the fish
                over, terms = info["over"], info["terms"]
                following[over] = self.agent(info["final_obs"])[1] * ~terminated[over]
                self.returns.append(torch.stack([terms[name] for name in terms if name[0] != "_"]).sum(0))
            parts = (self.obs, action, chance.log_prob(action).sum(-1), value, reward,
                     (terminated | truncated).float(), following)  # fmt: skip
            for store, part in zip(held, parts, strict=True):
                store.append(part)
            self.obs = obs
        seen, actions, logs, values, rewards, ends, later = (torch.stack(store) for store in held)
        found = advantages(rewards, values, ends, later, self.args, self.gamma)
        return tuple(part.flatten(0, 1) for part in (seen, actions, logs, found, found + values))


def make_env(args: GpuArgs) -> FishTorchEnv:
    """The fish on the GPU; the program ends with one line if there is no GPU, or if it cannot hold them."""
    spec = gym.spec(args.env_id)
    fish: dict[str, Any] = {**spec.kwargs, "muscle_groups": args.muscle_groups, "dtype": args.dtype}
    try:
        return FishTorchEnv(args.num_envs, args.device, max_episode_steps=spec.max_episode_steps, **fish)
    except (ValueError, ModuleNotFoundError) as error:
        sys.exit(f"train_gpu.py: {error}")


def train(env: FishTorchEnv, args: GpuArgs) -> Policy:
    """Train, and return the policy."""
    torch.manual_seed(args.seed)
    agent = Agent(env, args).to(env.device)
    optimiser = torch.optim.Adam(agent.parameters(), lr=args.learning_rate, eps=1e-5)
    collector, begun = Collector(env, agent, args), time.perf_counter()
    size = args.num_envs * args.rollout
    updates = max(1, args.timesteps // size)
    for k in range(updates):
        optimiser.param_groups[0]["lr"] = args.learning_rate * (1.0 - k / updates)
        update(agent, optimiser, collector.collect(), args)
        found = f", return {torch.cat(collector.returns).mean():.2f}" if collector.returns else ""
        seconds = time.perf_counter() - begun
        print(f"{(k + 1) * size} steps, {seconds:.1f} s{found}", flush=True)
    env.close()
    options = {"muscle_groups": args.muscle_groups}
    return agent.policy({"env_id": args.env_id, "env_options": options, "seed": args.seed})


def main() -> None:
    """Train, save, evaluate."""
    args = parse(GpuArgs, __doc__)
    assert isinstance(args, GpuArgs)
    env = make_env(args)  # before anything is written
    folder = begin(args)
    end(train(env, args), folder, args)


if __name__ == "__main__":
    main()
