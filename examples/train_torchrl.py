"""Train a fish with the PPO of TorchRL: one file, to be copied and changed.

    python train_torchrl.py                                    train Swim, save, evaluate; some minutes on two cores
    python train_torchrl.py --timesteps 200000 --seed 1        any field of Args is an option

It needs fish_env and torchrl. The folder that it writes holds the network (actor.pt), the hyperparameters
(args.json) and the scores (scores.json).

`GymWrapper` takes the package's own batch of fish, which one compiled call steps: 256 fish in one environment of
TorchRL. `GymEnv("FishEnv/Swim-v0")` gives a single fish, and steps many one by one.
"""

import argparse
import json
import math
import sys
import time
from dataclasses import asdict, dataclass, fields
from pathlib import Path

import gymnasium as gym
import numpy as np
import torch
from tensordict.nn import TensorDictModule
from tensordict.nn.distributions import NormalParamExtractor
from torch import nn
from torchrl.collectors import Collector
from torchrl.envs import GymWrapper
from torchrl.modules import ProbabilisticActor, TanhNormal, ValueOperator
from torchrl.objectives import ClipPPOLoss
from torchrl.objectives.value import GAE

import fish_env  # registers the environments
from fish_env.control import evaluate, make_eval_env, means


@dataclass
class Args:
    """Hyperparameters."""

    env_id: str = "FishEnv/Swim-v0"
    """the environment"""
    muscle_groups: str = "pairs"
    """"pairs": the upper and the lower muscle of a side contract together; "muscles": one action for each muscle"""
    seed: int = 0
    """of the fish, of the network and of its noise"""
    timesteps: int = 1_000_000
    """environment steps of all fish together"""
    num_envs: int = 256
    """fish trained side by side"""
    rollout: int = 32
    """environment steps of each fish between two updates"""
    minibatches: int = 4
    """parts that a rollout is divided into"""
    epochs: int = 5
    """passes over a rollout in an update"""
    learning_rate: float = 1e-3
    """at the start; it decreases linearly to zero"""
    horizon: float = 1.0
    """s; rewards that are this far ahead count 1/e"""
    gae_lambda: float = 0.95
    """weight of longer returns in the advantage (GAE)"""
    clip: float = 0.2
    """largest relative change of an action's probability in an update"""
    max_norm: float = 0.5
    """of the gradient"""
    hidden: int = 64
    """neurons of each of the two hidden layers"""
    evaluations: int = 20
    """episodes of the evaluation"""
    folder: str = "runs/train_torchrl"
    """where the results are written"""


def parse() -> Args:
    """The hyperparameters: the defaults, changed by the command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    for field in fields(Args):
        option = "--" + field.name.replace("_", "-")
        parser.add_argument(option, type=type(field.default), default=field.default, help=f"default {field.default}")
    return Args(**vars(parser.parse_args()))


class Scaled(nn.Module):
    """Observations scaled by the fixed numbers of their layout."""

    def __init__(self, layout):
        super().__init__()
        offset, scale = layout.scaling()
        self.register_buffer("offset", torch.tensor(offset, dtype=torch.float32))
        self.register_buffer("scale", torch.tensor(scale, dtype=torch.float32))

    def forward(self, obs: torch.Tensor) -> torch.Tensor:
        """(obs - offset) / scale."""
        return (obs - self.offset) / self.scale


def make_envs(args: Args) -> tuple[GymWrapper, gym.vector.VectorEnv]:
    """The batch of fish as an environment of TorchRL, and itself."""
    fish = gym.make_vec(
        args.env_id, num_envs=args.num_envs, autoreset_mode="SameStep", muscle_groups=args.muscle_groups
    )
    envs = GymWrapper(fish)
    envs.set_seed(args.seed)
    return envs, fish


def make_networks(fish, args: Args) -> tuple[ProbabilisticActor, ValueOperator]:
    """Actor and critic."""
    inputs, outputs, wide = *fish.single_observation_space.shape, *fish.single_action_space.shape, args.hidden

    def network(size: int) -> nn.Sequential:
        return nn.Sequential(
            Scaled(fish.unwrapped.layout),
            nn.Linear(inputs, wide), nn.Tanh(), nn.Linear(wide, wide), nn.Tanh(), nn.Linear(wide, size),
        )  # fmt: skip

    mean = nn.Sequential(network(2 * outputs), NormalParamExtractor())
    actor = ProbabilisticActor(
        TensorDictModule(mean, in_keys=["observation"], out_keys=["loc", "scale"]),
        in_keys=["loc", "scale"],
        distribution_class=TanhNormal,
        return_log_prob=True,
    )
    return actor, ValueOperator(network(1), in_keys=["observation"])


def train(args: Args) -> ProbabilisticActor:
    """Train, and return the actor."""
    torch.manual_seed(args.seed)
    envs, fish = make_envs(args)
    actor, critic = make_networks(fish, args)
    gamma = math.exp(-fish.unwrapped.control_interval / args.horizon)  # type: ignore[attr-defined]
    size = args.num_envs * args.rollout
    updates = max(1, args.timesteps // size)
    collector = Collector(envs, actor, frames_per_batch=size, total_frames=updates * size,
                          auto_register_policy_transforms=True)  # fmt: skip
    advantage = GAE(gamma=gamma, lmbda=args.gae_lambda, value_network=critic)
    loss = ClipPPOLoss(actor, critic, clip_epsilon=args.clip, entropy_bonus=False, critic_coeff=0.5,
                       loss_critic_type="l2", normalize_advantage=True)  # fmt: skip
    optimiser = torch.optim.Adam(loss.parameters(), lr=args.learning_rate, eps=1e-5)
    begun, done = time.perf_counter(), 0
    for k, rollout in enumerate(collector):
        optimiser.param_groups[0]["lr"] = args.learning_rate * (1.0 - k / updates)
        with torch.no_grad():
            flat = advantage(rollout).reshape(-1)
        for _ in range(args.epochs):
            for part in torch.randperm(size).chunk(args.minibatches):
                losses = loss(flat[part])
                optimiser.zero_grad()
                (losses["loss_objective"] + losses["loss_critic"]).backward()
                nn.utils.clip_grad_norm_(loss.parameters(), args.max_norm)
                optimiser.step()
        done += size
        if (k + 1) % 10 == 0 or k + 1 == updates:
            reward = rollout["next", "reward"].mean().item()
            print(f"{done} steps, {done / (time.perf_counter() - begun):.0f} steps/s, reward {reward:.3f} a step",
                  flush=True)  # fmt: skip
    collector.shutdown()
    return actor


def scores_of(actor: ProbabilisticActor, args: Args) -> dict[str, float | None]:
    """Means over episodes on fixed seeds, without noise in the actions: the return and the metrics of the task."""
    env = make_eval_env(args.env_id, args.evaluations, {"muscle_groups": args.muscle_groups})
    mean = actor[0]

    @torch.no_grad()
    def controller(obs: np.ndarray, time: float) -> np.ndarray:
        return torch.tanh(mean(observation=torch.from_numpy(obs))[0]).numpy()

    scores = means(evaluate(env, controller))
    env.close()
    return scores


def main() -> None:
    """Train, save, evaluate."""
    args = parse()
    folder = Path(args.folder)
    if folder.exists():
        sys.exit(f"{folder} exists, and no run is overwritten; name another folder with --folder")
    folder.mkdir(parents=True)
    (folder / "args.json").write_text(json.dumps(asdict(args), indent=2))
    actor = train(args)
    torch.save(actor.state_dict(), folder / "actor.pt")
    scores = scores_of(actor, args)
    (folder / "scores.json").write_text(json.dumps(scores, indent=2))
    print(f"fish_env {fish_env.__version__}, mean of {args.evaluations} episodes: "
          + ", ".join(f"{name} {value:.2f}" for name, value in scores.items() if value is not None))  # fmt: skip


if __name__ == "__main__":
    main()
