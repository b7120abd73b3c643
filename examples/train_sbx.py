"""Train a fish with SBX, the algorithms of Stable-Baselines3 in JAX: one file, to be copied and changed.

    python train_sbx.py                                      PPO on Swim: train, save, evaluate; some minutes
    python train_sbx.py --algorithm crossq --timesteps 60000 --num-envs 8     a learner that reuses old steps
    python train_sbx.py --timesteps 200000 --seed 1          any field of Args is an option

It needs fish_env with the extra [train], and sbx-rl. The folder that it writes holds the model (model.zip), the scaling
of its observations (scaling.pkl), the hyperparameters (args.json) and the scores (scores.json).

SBX takes the vector environments of Stable-Baselines3, so `make_sb3_vec_env` serves it as well.
"""

import argparse
import json
import math
import sys
from dataclasses import asdict, dataclass, fields
from pathlib import Path

import numpy as np
from sbx import PPO, CrossQ
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.vec_env import VecEnv, VecNormalize

import fish_env
from fish_env.control import evaluate, make_eval_env, means


@dataclass
class Args:
    """Hyperparameters."""

    algorithm: str = "ppo"
    """ppo, or crossq: an off-policy learner, with fewer environment steps and more time for each"""
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
    """ppo: environment steps of each fish between two updates"""
    batch_size: int = 2048
    """ppo: environment steps in a minibatch"""
    epochs: int = 5
    """ppo: passes over a rollout in an update"""
    learning_rate: float = 1e-3
    """of Adam"""
    horizon: float = 1.0
    """s; rewards that are this far ahead count 1/e"""
    hidden: int = 64
    """ppo: neurons of each of the two hidden layers"""
    evaluations: int = 20
    """episodes of the evaluation"""
    folder: str = "runs/train_sbx"
    """where the results are written"""


def parse() -> Args:
    """The hyperparameters: the defaults, changed by the command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    for field in fields(Args):
        option = "--" + field.name.replace("_", "-")
        parser.add_argument(option, type=type(field.default), default=field.default, help=f"default {field.default}")
    return Args(**vars(parser.parse_args()))


def make_model(args: Args, env: VecEnv, gamma: float) -> BaseAlgorithm:
    """A learner before its first step.

    Raises:
        ValueError: for an algorithm that is neither.
    """
    common = {"learning_rate": args.learning_rate, "gamma": gamma, "seed": args.seed, "verbose": 1}
    if args.algorithm == "crossq":  # one gradient step for each environment step
        return CrossQ("MlpPolicy", env, train_freq=1, gradient_steps=args.num_envs, learning_starts=1000, **common)
    if args.algorithm != "ppo":
        raise ValueError(f"unknown algorithm {args.algorithm!r}; choose ppo or crossq")
    return PPO(
        "MlpPolicy",
        env,
        n_steps=args.rollout,
        batch_size=min(args.batch_size, args.rollout * args.num_envs),
        n_epochs=args.epochs,
        policy_kwargs={"net_arch": [args.hidden, args.hidden], "log_std_init": -0.5},
        **common,
    )


def scores_of(model: BaseAlgorithm, scaling: VecNormalize, args: Args) -> dict[str, float | None]:
    """Means over episodes on fixed seeds, without noise in the actions: the return and the metrics of the task."""
    env = make_eval_env(args.env_id, args.evaluations, {"muscle_groups": args.muscle_groups})

    def controller(obs: np.ndarray, time: float) -> np.ndarray:
        return model.predict(np.asarray(scaling.normalize_obs(obs)), deterministic=True)[0]

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
    fish = fish_env.make_sb3_vec_env(
        args.env_id, args.num_envs, seed=args.seed, staggered=True, muscle_groups=args.muscle_groups
    )
    env = VecNormalize(fish, norm_reward=False)  # observations are scaled by their running mean and deviation
    model = make_model(args, env, math.exp(-fish.get_attr("control_interval")[0] / args.horizon))
    model.learn(args.timesteps)
    model.save(folder / "model.zip")
    env.save(str(folder / "scaling.pkl"))
    scores = scores_of(model, env, args)
    (folder / "scores.json").write_text(json.dumps(scores, indent=2))
    print(f"mean of {args.evaluations} episodes: "
          + ", ".join(f"{name} {value:.2f}" for name, value in scores.items() if value is not None))  # fmt: skip
    env.close()


if __name__ == "__main__":
    main()
