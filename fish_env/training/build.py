"""Put environment and learner together: PPO on the native batch of fish, with observations scaled by fixed numbers."""

from pathlib import Path
from typing import Any

from gymnasium.spaces import Dict, flatdim
from stable_baselines3 import PPO
from stable_baselines3.common.vec_env import VecEnv
from torch import nn

from fish_env.control.equivariant import EquivariantPolicy, equivariant_options
from fish_env.control.equivariant import export_policy as export_policy  # the name that it had here
from fish_env.envs import make_sb3_vec_env
from fish_env.training.config import TrainConfig
from fish_env.training.synergy import SynergyWrapper, batch_of, common_actions, mirrored_actions


def make_env(config: TrainConfig, num_envs: int, seed: int) -> VecEnv:
    """The batch of fish to train on, its returns logged; ValueError for goals, no fish, or no time limit."""
    options = config.env_options | config.training_options
    env = make_sb3_vec_env(config.env_id, num_envs, seed=seed, staggered=True, **options)
    if isinstance(env.observation_space, Dict):
        env.close()
        raise ValueError("the environment observes goals, which are for HER and not for PPO; leave goal_env out")
    if batch_of(env).max_episode_steps is None:
        env.close()
        raise ValueError(f"{config.env_id} has no time limit, and its episodes might not end; give max_episode_steps")
    return SynergyWrapper(env, config.twist)


def make_model(config: TrainConfig, env: VecEnv, seed: int, folder: Path | None = None) -> PPO:
    """A fresh PPO learner for a run, whose folder gets TensorBoard's events."""
    batch = batch_of(env)
    options = equivariant_options(batch)
    if not config.symmetric:
        del options["reflection"]
    elif flatdim(env.action_space) < flatdim(batch.single_action_space):
        options["reflection"] = options["reflection"]._replace(swap=mirrored_actions(batch.tank.fish))
    return PPO(
        EquivariantPolicy if config.symmetric else "MlpPolicy",
        env,
        policy_kwargs={
            "net_arch": list(config.hidden),
            "activation_fn": nn.Tanh,
            "optimizer_kwargs": {"fused": True},
            "log_std_init": config.initial_log_std,
            **options,
        },
        seed=seed,
        device="cpu",
        **_hyperparameters(config, env, folder),
    )


def load_model(folder: Path, config: TrainConfig | None = None, env: VecEnv | None = None) -> PPO:
    """The learner that a run has saved, to continue in an environment with these settings, or to start another from.

    `PPO.load` executes what is in the file: resume no run of somebody whom you do not trust.
    ValueError if it cannot be read, or is of another policy than the settings ask for.
    """
    settings = {} if config is None or env is None else _hyperparameters(config, env, folder)
    try:
        model = PPO.load(folder / "model.zip", env, device="cpu", **settings)
    except Exception as error:  # what was damaged may raise anything
        why = f"{type(error).__name__}: {error!s:.300}"
        raise ValueError(f"{folder / 'model.zip'} cannot be read ({why}); restore the file, or train again") from error
    saved = tuple(model.policy_kwargs["net_arch"]), isinstance(model.policy, EquivariantPolicy)
    if config is not None and saved != (config.hidden, config.symmetric):
        raise ValueError(
            f"{folder / 'model.zip'} has hidden={saved[0]} and symmetric={saved[1]}, the settings {config.hidden} and "
            f"{config.symmetric}; leave them as they were"
        )
    return model


def _hyperparameters(config: TrainConfig, env: VecEnv, folder: Path | None) -> dict[str, Any]:
    """Keywords of PPO that do not depend on its policy."""
    return {
        "n_steps": config.rollout,
        "batch_size": min(config.batch_size, config.rollout * env.num_envs),
        "n_epochs": config.epochs,
        "learning_rate": falling(config.learning_rate),
        "gamma": config.discount(batch_of(env).control_interval),
        "gae_lambda": config.gae_lambda,
        "clip_range": config.clip_range,
        "ent_coef": config.entropy_weight,
        "tensorboard_log": str(folder / "tensorboard") if folder else None,
    }


class falling:  # noqa: N801 - used like a function; a class so that it can be pickled with the model
    """A learning rate that falls linearly to a tenth over the training."""

    def __init__(self, start: float):
        self.start = start

    def __call__(self, remaining: float) -> float:
        return self.start * (0.1 + 0.9 * max(remaining, 0.0))


def start_from(model: PPO, other: PPO) -> None:
    """Let a fresh learner start from the parameters of a trained one, on another body or with other muscle groups.

    An action that the other did not have, the difference between the muscles of a pair, starts at zero and with the
    noise of a fresh learner; one that this learner does not have is left out.
    ValueError if the observations of their tasks differ, or their networks do.
    """
    mine, given = model.policy.state_dict(), other.policy.state_dict()
    fish = batch_of(model.get_env()).tank.fish
    here, there = (common_actions(fish, flatdim(learner.action_space)) for learner in (model, other))
    for name, value in mine.items():
        if name.endswith(".swap"):  # how this learner's actions are mirrored
            continue
        theirs = given.get(name)
        first = 1 if name == "log_std" or name.startswith("action_net") else 0  # of these, a row for each action
        if theirs is None or value.shape[first:] != theirs.shape[first:]:
            found = None if theirs is None else tuple(theirs.shape)
            raise ValueError(
                f"{name} is {tuple(value.shape)} here and {found} in the run to start from; start from a run of the "
                "same task, with the same hidden layers and the same kind of policy"
            )
        if value.shape == theirs.shape:
            value.copy_(theirs)
        else:
            if name != "log_std":
                value.zero_()
            value[here] = theirs[there]
    model.policy.load_state_dict(mine)
