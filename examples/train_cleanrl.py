"""Train a fish with PPO as CleanRL writes it, in one file with torch alone: to be copied and changed.

    python train_cleanrl.py                                    train Swim, save, evaluate; some minutes on two cores
    python train_cleanrl.py --timesteps 200000 --seed 1        any field of Args is an option
    python train_cleanrl.py --env-id FishEnv/Turn-v0           another task

It needs fish_env and torch. The folder that it writes holds the policy as a file that `fish_env.control`
reads (policy.npz), the hyperparameters (args.json) and the scores (scores.json).

The batch of fish is the package's own vector environment. It restarts an episode in the step in which it ends
("SameStep"), so every step is one of training. An episode that ran out of time is not over for the fish: its last
observation, `infos["final_obs"]`, says what was still to come.
"""

import argparse
import json
import math
import sys
import time
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import torch
from torch import nn
from torch.distributions import Normal

import fish_env
from fish_env.control import Policy, evaluate, make_eval_env, means


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
    entropy: float = 0.0
    """weight of the entropy of the actions"""
    value: float = 0.5
    """weight of the error of the value"""
    max_norm: float = 0.5
    """of the gradient"""
    log_std: float = -0.5
    """logarithm of the standard deviation of the actions at the start"""
    hidden: int = 64
    """neurons of each of the two hidden layers"""
    evaluations: int = 20
    """episodes of the evaluation"""
    folder: str = "runs/train_cleanrl"
    """where the results are written"""


def parse(made: type[Args] = Args, text: str | None = __doc__) -> Args:
    """The hyperparameters: the defaults, changed by the command line."""
    parser = argparse.ArgumentParser(description=text, formatter_class=argparse.RawDescriptionHelpFormatter)
    for field in fields(made):
        option = "--" + field.name.replace("_", "-")
        parser.add_argument(option, type=type(field.default), default=field.default, help=f"default {field.default}")
    return made(**vars(parser.parse_args()))


def layer(inputs: int, outputs: int, gain: float = math.sqrt(2.0)) -> nn.Linear:
    """A linear layer with orthogonal weights."""
    made = nn.Linear(inputs, outputs)
    nn.init.orthogonal_(made.weight, gain)
    nn.init.zeros_(made.bias)
    return made


class Agent(nn.Module):
    """Actor and critic; observations are scaled by the fixed numbers of the layout."""

    offset: torch.Tensor
    scale: torch.Tensor

    def __init__(self, envs: Any, args: Args):
        super().__init__()
        inputs, outputs = envs.single_observation_space.shape[0], envs.single_action_space.shape[0]
        offset, scale = envs.layout.scaling()
        self.register_buffer("offset", torch.tensor(offset, dtype=torch.float32))
        self.register_buffer("scale", torch.tensor(scale, dtype=torch.float32))
        self.actor, self.critic = (
            nn.Sequential(layer(inputs, args.hidden), nn.Tanh(), layer(args.hidden, args.hidden), nn.Tanh(), last)
            for last in (layer(args.hidden, outputs, 0.01), layer(args.hidden, 1, 1.0))
        )
        self.log_std = nn.Parameter(torch.full((outputs,), args.log_std))

    def forward(self, obs: torch.Tensor) -> tuple[Normal, torch.Tensor]:
        """The distribution of the actions (B,A) and the values (B,) of observations (B,D)."""
        scaled = (obs - self.offset) / self.scale
        return Normal(self.actor(scaled), self.log_std.exp()), self.critic(scaled).squeeze(-1)

    def policy(self, about: dict) -> Policy:
        """The mean action as a policy that numpy alone can run."""
        linear = [part for part in self.actor if isinstance(part, nn.Linear)]
        weights = [part.weight.detach().cpu().double().numpy().T.copy() for part in linear]
        biases = [part.bias.detach().cpu().double().numpy().copy() for part in linear]
        weights[0] /= self.scale.cpu().double().numpy()[:, None]  # the scaling becomes part of the first layer
        biases[0] -= self.offset.cpu().double().numpy() @ weights[0]
        return Policy(tuple(w.astype(np.float32) for w in weights), tuple(b.astype(np.float32) for b in biases), about)


def advantages(rewards, values, ends, following, args: Args, gamma: float) -> torch.Tensor:
    """Generalised advantage estimates (T,B).

    `following` (T,B) is the value of what a fish saw after each step: zero after a failure, and after an episode that
    ran out of time that of its last observation, not of the first one of the next episode. `ends` (T,B) cuts the sum.
    """
    found, later = torch.zeros_like(rewards), torch.zeros_like(rewards[0])
    for t in reversed(range(len(rewards))):
        error = rewards[t] + gamma * following[t] - values[t]
        found[t] = later = error + gamma * args.gae_lambda * (1.0 - ends[t]) * later
    return found


class Collector:
    """Steps the fish and remembers what they saw, did and were paid."""

    def __init__(self, envs: fish_env.FishVectorEnv, agent: Agent, args: Args):
        self.envs, self.agent, self.args = envs, agent, args
        obs, _ = envs.reset(seed=args.seed)
        envs.stagger()  # the first episodes do not all end in the same step
        self.obs = torch.from_numpy(obs)
        self.gamma = math.exp(-envs.control_interval / args.horizon)
        self.returns: list[float] = []

    @torch.no_grad()
    def collect(self) -> tuple[torch.Tensor, ...]:
        """A rollout: observations, actions, their log-probabilities, advantages and returns, (T*B, ...) each."""
        held: list[list[torch.Tensor]] = [[] for _ in range(7)]
        for _ in range(self.args.rollout):
            chance, value = self.agent(self.obs)
            action = chance.sample()
            obs, reward, terminated, truncated, infos = self.envs.step(action.clamp(-1.0, 1.0).numpy())
            following = self.agent(torch.from_numpy(obs))[1]
            if "final_obs" in infos:
                which = np.flatnonzero(infos["_final_obs"])
                last = torch.from_numpy(np.stack(list(infos["final_obs"][which])))
                following[which] = self.agent(last)[1] * torch.from_numpy(~terminated[which])
                terms = infos["final_info"]["terms"]
                self.returns += np.sum([terms[name][which] for name in terms if name[0] != "_"], axis=0).tolist()
            parts = (self.obs, action, chance.log_prob(action).sum(-1), value, torch.from_numpy(reward).float(),
                     torch.from_numpy(terminated | truncated).float(), following)  # fmt: skip
            for store, part in zip(held, parts, strict=True):
                store.append(part)
            self.obs = torch.from_numpy(obs)
        seen, actions, logs, values, rewards, ends, later = (torch.stack(store) for store in held)
        found = advantages(rewards, values, ends, later, self.args, self.gamma)
        return tuple(part.flatten(0, 1) for part in (seen, actions, logs, found, found + values))


def update(agent: Agent, optimiser: torch.optim.Optimizer, rollout: tuple[torch.Tensor, ...], args: Args) -> None:
    """Several epochs of the clipped objective of PPO over a rollout, in minibatches."""
    for _ in range(args.epochs):
        for part in torch.randperm(len(rollout[0])).chunk(args.minibatches):
            seen, actions, old, gain, returns = (array[part] for array in rollout)
            chance, value = agent(seen)
            ratio = (chance.log_prob(actions).sum(-1) - old).exp()
            gain = (gain - gain.mean()) / (gain.std() + 1e-8)
            loss = -torch.min(gain * ratio, gain * ratio.clamp(1.0 - args.clip, 1.0 + args.clip)).mean()
            loss = (
                loss + args.value * (value - returns).square().mean() - args.entropy * chance.entropy().sum(-1).mean()
            )
            optimiser.zero_grad()
            loss.backward()
            nn.utils.clip_grad_norm_(agent.parameters(), args.max_norm)
            optimiser.step()


def train(args: Args) -> Policy:
    """Train, and return the policy."""
    torch.manual_seed(args.seed)
    options: dict[str, Any] = {"muscle_groups": args.muscle_groups}
    envs = gym.make_vec(args.env_id, num_envs=args.num_envs, autoreset_mode="SameStep", **options)
    assert isinstance(envs, fish_env.FishVectorEnv)  # it is not wrapped
    agent = Agent(envs, args)
    optimiser = torch.optim.Adam(agent.parameters(), lr=args.learning_rate, eps=1e-5)
    collector, begun = Collector(envs, agent, args), time.perf_counter()
    size = args.num_envs * args.rollout
    updates = max(1, args.timesteps // size)
    for k in range(updates):
        optimiser.param_groups[0]["lr"] = args.learning_rate * (1.0 - k / updates)
        update(agent, optimiser, collector.collect(), args)
        if (k + 1) % 10 == 0 or k + 1 == updates:
            rate = (k + 1) * size / (time.perf_counter() - begun)
            found = f", return {np.mean(collector.returns[-args.num_envs :]):.2f}" if collector.returns else ""
            print(f"{(k + 1) * size} steps, {rate:.0f} steps/s{found}", flush=True)
    envs.close()
    return agent.policy({"env_id": args.env_id, "env_options": options, "seed": args.seed})


def begin(args: Args) -> Path:
    """Make the folder, and write the hyperparameters."""
    folder = Path(args.folder)
    if folder.exists():
        sys.exit(f"{folder} exists, and no run is overwritten; name another folder with --folder")
    folder.mkdir(parents=True)
    (folder / "args.json").write_text(json.dumps(asdict(args), indent=2))
    return folder


def end(policy: Policy, folder: Path, args: Args) -> None:
    """Write the policy and its scores, and print the scores."""
    policy.save(folder / "policy.npz")
    env = make_eval_env(args.env_id, args.evaluations, {"muscle_groups": args.muscle_groups})
    scores = means(evaluate(env, policy))
    env.close()
    (folder / "scores.json").write_text(json.dumps(scores, indent=2))
    print(f"fish_env {fish_env.__version__}, mean of {args.evaluations} episodes: "
          + ", ".join(f"{name} {value:.2f}" for name, value in scores.items() if value is not None))  # fmt: skip


def main() -> None:
    """Train, save, evaluate."""
    args = parse()
    folder = begin(args)
    end(train(args), folder, args)


if __name__ == "__main__":
    main()
