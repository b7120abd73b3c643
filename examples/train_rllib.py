r"""Train a fish with the PPO of Ray RLlib, on one machine or on many: one file, to be copied and changed.

    python train_rllib.py                                      train Swim with two runners; some minutes
    python train_rllib.py --env-id FishEnv/LeftAfterRight-v0 --steps 2000000 --horizon 2 \
        --env-options '{"muscle_groups": "pairs", "control_interval": 0.04, "max_episode_steps": 125}'
    python train_rllib.py --address auto --runners 64          on a cluster that `ray start` has begun

It needs fish_env with the extra [cluster]. The folder that it writes holds RLlib's checkpoint, the policy as a
file that `fish_env.control` reads (policy.npz), the settings (args.json) and the scores (scores.json).
"""

import argparse
import gc
import json
import math
import re
import socket
import sys
import time
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np
import ray
import torch
from ray.rllib.algorithms.ppo import PPO, PPOConfig
from ray.rllib.core.columns import Columns
from ray.rllib.core.rl_module.apis import ValueFunctionAPI
from ray.rllib.core.rl_module.rl_module import RLModuleSpec
from ray.rllib.core.rl_module.torch import TorchRLModule

import fish_env
from fish_env.control import evaluate, make_eval_env, means
from fish_env.control.equivariant import EquivariantPolicy, equivariant_options, export_policy
from fish_env.control.policy import Policy


@dataclass
class Args:
    """Settings and hyperparameters."""

    env_id: str = "FishEnv/Swim-v0"
    """the environment"""
    env_options: str = '{"muscle_groups": "pairs"}'
    """its keywords, JSON; "pairs": the upper and the lower muscle of a side contract together"""
    address: str = ""
    """of a Ray cluster, such as "auto" or ray://host:10001; without it, one is started on this machine"""
    runners: int = 2
    """processes that step fish; 0: this one does"""
    fish: int = 128
    """fish of each of them"""
    rollout: int = 32
    """environment steps of each fish between two updates"""
    steps: int = 1_000_000
    """environment steps of all fish together"""
    batch_size: int = 2048
    """environment steps in a minibatch"""
    epochs: int = 5
    """passes over a rollout in an update"""
    learning_rate: float = 1e-3
    """at the start; it decreases linearly to a tenth"""
    horizon: float = 1.0
    """s; rewards that are this far ahead count 1/e"""
    gae_lambda: float = 0.95
    """weight of longer returns in the advantage (GAE)"""
    clip_range: float = 0.2
    """largest relative change of an action's probability in an update"""
    log_std: float = -0.5
    """logarithm of the standard deviation of the actions at the start"""
    hidden: int = 64
    """neurons of each of the two hidden layers"""
    seed: int = 0
    """of the fish, of the network and of its noise"""
    evaluations: int = 20
    """episodes of the evaluation"""
    folder: str = "runs/train_rllib"
    """where the results are written"""


class FishModule(TorchRLModule, ValueFunctionAPI):
    """The package's policy, equivariant under the left-right reflection, as RLlib's learner and runners want it.

    `model_config` holds `env_id`, `env_config`, `hidden` and `log_std`.
    """

    def setup(self) -> None:
        """Make the networks."""
        config = self.model_config
        env = fish_env.envs.vector.make_batch(config["env_id"], 1, **config["env_config"])
        self.policy = EquivariantPolicy(
            env.single_observation_space, env.single_action_space, lambda _: 1e-3,
            net_arch=[config["hidden"]] * 2, log_std_init=config["log_std"], **equivariant_options(env),
        )  # fmt: skip
        env.close()

    def _forward(self, batch: dict[str, Any], **kwargs) -> dict[str, Any]:
        features = self.policy.extract_features(batch[Columns.OBS], self.policy.pi_features_extractor)
        mean = self.policy.action_net(self.policy.mlp_extractor.forward_actor(features))
        return {Columns.ACTION_DIST_INPUTS: torch.cat([mean, self.policy.log_std.expand_as(mean)], dim=-1)}

    def compute_values(self, batch: dict[str, Any], embeddings=None) -> torch.Tensor:
        """Values (B,) of the observations (B,D)."""
        return self.policy.predict_values(batch[Columns.OBS]).squeeze(-1)


def parse() -> Args:
    """The settings: the defaults, changed by the command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    for field in fields(Args):
        option = "--" + field.name.replace("_", "-")
        parser.add_argument(option, type=type(field.default), default=field.default, help=f"default {field.default}")
    return Args(**vars(parser.parse_args()))


def log_fish(episode: Any, metrics_logger: Any, **kwargs) -> None:
    """Log the metrics of the task at the end of an episode, as means over a hundred episodes."""
    for name, value in episode.get_infos(-1).items():
        if isinstance(value, int | float | np.number) and np.isfinite(value):
            metrics_logger.log_value(("fish", name), float(value), window=100)


def make_config(args: Args) -> PPOConfig:
    """RLlib's configuration: every runner steps its fish as one vector environment."""
    options = json.loads(args.env_options)
    probe = fish_env.envs.vector.make_batch(args.env_id, 1, **options)
    interval = probe.control_interval
    probe.close()
    return (
        PPOConfig()
        .environment(
            args.env_id if ":" in args.env_id else f"fish_env:{args.env_id}",  # runners import what registers it
            env_config={"threads": 1, **options},  # a runner has one processor
            disable_env_checking=True,
        )
        .callbacks(on_episode_end=log_fish)
        .env_runners(
            gym_env_vectorize_mode="vector_entry_point",
            num_env_runners=args.runners,
            num_envs_per_env_runner=args.fish,
            rollout_fragment_length=args.rollout,
            batch_mode="truncate_episodes",
        )
        .fault_tolerance(restart_failed_env_runners=True)
        .training(
            gamma=math.exp(-interval / args.horizon),
            lambda_=args.gae_lambda,
            lr=[[0, args.learning_rate], [args.steps, 0.1 * args.learning_rate]],
            clip_param=args.clip_range,
            vf_clip_param=math.inf,
            vf_loss_coeff=0.5,
            use_kl_loss=False,
            grad_clip=0.5,
            grad_clip_by="global_norm",
            num_epochs=args.epochs,
            minibatch_size=args.batch_size,
            train_batch_size_per_learner=max(1, args.runners) * args.fish * args.rollout,
        )
        .rl_module(
            rl_module_spec=RLModuleSpec(
                module_class=FishModule,
                model_config={
                    "env_id": args.env_id, "env_config": options, "hidden": args.hidden, "log_std": args.log_std,
                },
            )
        )
        .debugging(seed=args.seed, log_level="ERROR")
    )  # fmt: skip


def policy_of(algorithm: PPO, args: Args) -> Policy:
    """The mean action of the trained policy, as a policy that needs numpy only."""
    about = {"env_id": args.env_id, "env_options": json.loads(args.env_options), "seed": args.seed}
    algorithm.env_runner_group.sync_weights(from_worker_or_learner_group=algorithm.learner_group, inference_only=True)
    module = algorithm.get_module()
    return export_policy(module.policy, about, raw=True)


def train(algorithm: PPO, args: Args) -> None:
    """Train until enough environment steps were sampled, and say how it goes."""
    begun = time.perf_counter()
    while True:
        result = algorithm.train()["env_runners"]
        done, fish = int(result["num_env_steps_sampled_lifetime"]), result.get("fish", {})
        scores = {"return": result.get("episode_return_mean", math.nan)}
        scores |= {name: fish[name] for name in ("success", "speed") if name in fish}
        shown = ", ".join(f"{name} {value:.2f}" for name, value in scores.items() if math.isfinite(value))
        print(f"{done} steps, {done / (time.perf_counter() - begun):.0f} steps/s, {shown}", flush=True)
        if done >= args.steps:
            return


def join(address: str) -> None:
    """Join the Ray cluster at an address, or begin one here for ""; the program ends with one line if there is none."""
    try:
        found = re.fullmatch(r"(?:ray://)?([^:/]+):(\d+)", address)
        if found:  # Ray would wait for minutes
            socket.create_connection((found[1], int(found[2])), timeout=10.0).close()
        options = {"address": address} if address else {"include_dashboard": False}
        ray.init(**options, logging_level="ERROR")
    except (OSError, OverflowError, ValueError, RuntimeError) as error:
        reason = (str(error) or type(error).__name__).splitlines()[0]
        sys.exit(
            f"train_rllib.py: there is no Ray cluster at {address!r} ({reason}); give the address that `ray start "
            "--head` printed, auto on one of its machines, or leave --address out for a cluster on this machine alone"
        )


def main() -> None:
    """Train, save, evaluate."""
    args = parse()
    join(args.address)  # before anything is written
    folder = Path(args.folder).resolve()
    if folder.exists():
        sys.exit(f"{folder} exists, and no run is overwritten; name another folder with --folder")
    folder.mkdir(parents=True)
    (folder / "args.json").write_text(json.dumps(asdict(args), indent=2))
    algorithm = make_config(args).build_algo()
    gc.freeze()  # the modules of Ray and torch stay: to look through them again and again takes as long as a rollout
    train(algorithm, args)
    algorithm.save_to_path(str(folder / "checkpoint"))
    policy = policy_of(algorithm, args)
    policy.save(folder / "policy.npz")
    algorithm.stop()
    ray.shutdown()

    env = make_eval_env(args.env_id, args.evaluations, dict(policy.about["env_options"]))
    scores = means(evaluate(env, policy))
    env.close()
    (folder / "scores.json").write_text(json.dumps(scores, indent=2))
    print(f"mean of {args.evaluations} episodes: "
          + ", ".join(f"{name} {value:.2f}" for name, value in scores.items() if value is not None))  # fmt: skip


if __name__ == "__main__":
    main()
