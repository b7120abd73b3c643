"""Train a fish with the PPO of Stable-Baselines3: one file, to be copied and changed.

    python train_ppo.py                                   train Swim, save, evaluate; some minutes on two cores
    python train_ppo.py --timesteps 200000 --seed 1       any field of Args is an option
    python train_ppo.py --env-id FishEnv/Turn-v0 --folder runs/turn       another task, in a folder of its own

It needs fish_env with the extra [train]. The folder that it writes holds the policy (model.zip), the scaling of its
observations (scaling.pkl), the hyperparameters (args.json) and the scores (scores.json).
"""

import argparse
import json
import math
import sys
from dataclasses import asdict, dataclass, fields
from pathlib import Path

import numpy as np
from stable_baselines3 import PPO
from stable_baselines3.common.utils import LinearSchedule, set_random_seed
from stable_baselines3.common.vec_env import VecEnv, VecNormalize

import fish_env

FIRST_EVALUATION_SEED = 1_000_000  # far from the seeds of training, which count up from `seed`
COPIES = ("is_success", "TimeLimit.truncated")  # what Stable-Baselines3 reads of an episode's end


@dataclass
class Args:
    """Hyperparameters."""

    env_id: str = "FishEnv/Swim-v0"
    """the environment, of any package that has been imported"""
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
    evaluations: int = 20
    """episodes of the evaluation"""
    folder: str = "runs/train_ppo"
    """where the results are written: a new folder"""


def parse() -> Args:
    """The hyperparameters: the defaults, changed by the command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    for field in fields(Args):
        option = "--" + field.name.replace("_", "-")
        parser.add_argument(option, type=type(field.default), default=field.default, help=f"default {field.default}")
    return Args(**vars(parser.parse_args()))


def make_model(args: Args, env: VecEnv, control_interval: float) -> PPO:
    """A PPO learner before its first step."""
    return PPO(
        "MlpPolicy",
        env,
        n_steps=args.rollout,
        batch_size=min(args.batch_size, args.rollout * args.num_envs),
        n_epochs=args.epochs,
        learning_rate=LinearSchedule(args.learning_rate, 0.1 * args.learning_rate, 1.0),
        gamma=math.exp(-control_interval / args.horizon),
        gae_lambda=args.gae_lambda,
        clip_range=args.clip_range,
        policy_kwargs={"net_arch": [args.hidden, args.hidden], "log_std_init": args.log_std},
        seed=args.seed,
        device="cpu",
        verbose=1,
    )


def evaluate(args: Args, model: PPO, scaling: VecNormalize) -> dict[str, float | None]:
    """Means over episodes on fixed seeds, without noise in the actions: the return and the metrics of the task."""
    fish = fish_env.make_sb3_vec_env(
        args.env_id, args.evaluations, seed=FIRST_EVALUATION_SEED, muscle_groups=args.muscle_groups
    )
    obs, ends = fish.reset(), [{} for _ in range(args.evaluations)]
    while not all(ends):
        actions, _ = model.predict(scaling.normalize_obs(np.asarray(obs)), deterministic=True)
        obs, _, dones, infos = fish.step(actions)
        for i in np.flatnonzero(dones):
            ends[i] = ends[i] or infos[i]  # the first episode of each fish
    fish.close()
    metrics = [name for name, value in ends[0].items() if isinstance(value, int | float) and name not in COPIES]
    scores = {"return": np.array([info["episode"]["r"] for info in ends])}
    return fish_env.control.means(scores | {name: np.array([float(info[name]) for info in ends]) for name in metrics})


def main() -> None:
    """Train, save, evaluate."""
    args = parse()
    folder = Path(args.folder)
    if folder.exists():
        sys.exit(f"train_ppo.py: {folder} exists, and no run is overwritten; name another folder with --folder")
    folder.mkdir(parents=True)
    (folder / "args.json").write_text(json.dumps(asdict(args), indent=2))
    set_random_seed(args.seed)

    fish = fish_env.make_sb3_vec_env(
        args.env_id, args.num_envs, seed=args.seed, staggered=True, muscle_groups=args.muscle_groups
    )
    env = VecNormalize(fish, norm_reward=False)  # observations are scaled by their running mean and deviation
    model = make_model(args, env, fish.get_attr("control_interval")[0])
    model.learn(args.timesteps)
    model.save(folder / "model.zip")
    env.save(str(folder / "scaling.pkl"))

    scores = evaluate(args, model, env)
    (folder / "scores.json").write_text(json.dumps(scores, indent=2))
    print(f"mean of {args.evaluations} episodes: "
          + ", ".join(f"{name} {value:.2f}" for name, value in scores.items() if value is not None))  # fmt: skip
    env.close()


if __name__ == "__main__":
    main()
