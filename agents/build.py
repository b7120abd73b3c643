"""Put environment and learner together: PPO on the native batch of fish, with fixed scaling of what the fish see."""

from pathlib import Path
from typing import Any

import numpy as np
from stable_baselines3 import PPO
from stable_baselines3.common.vec_env import VecEnv

from agents.config import TrainConfig
from agents.fast_ppo import FastPPO
from agents.layers import ScaledObservation, Tanh
from agents.mirror import MirroredPolicy, mirror_of, plain_layers
from agents.policy import Policy
from agents.synergy import Synergies, both, synergies
from fish_env.envs.sb3 import make_sb3_vec_env

POSITION_SCALE = 0.1  # body lengths: how far a node strays from its place in the body while swimming
VELOCITY_SCALE = 1.0  # body lengths per second
TILT_SCALE = 0.3  # a tilt of 0.3 rad counts as much as a node out of place


def scaling(fish) -> tuple[np.ndarray, np.ndarray]:
    """Offset and scale (D,) of the observations of a `FishVectorEnv`."""
    body, length = fish.tank.fish.body, fish.tank.fish.length
    landmarks = fish.tank.fish.points(body.position)
    rest = (landmarks - body.mass @ body.position / body.mass.sum()).ravel() / length
    muscles, directions = fish.tank.fish.num_muscles, fish.task.directions
    offset = np.concatenate([rest, np.zeros(rest.size + muscles), [0.0, 0.0, 1.0], np.zeros(3 * len(directions))])
    parts = [(rest.size, POSITION_SCALE), (rest.size, VELOCITY_SCALE), (muscles, 1.0), (3, TILT_SCALE)]
    parts += [(3, direction.typical) for direction in directions]
    return offset, np.concatenate([np.full(size, scale) for size, scale in parts])


def make_env(config: TrainConfig, num_envs: int, seed: int) -> VecEnv:
    """The batch of fish to train on, its returns logged."""
    options = config.env_options | config.training_options
    return Synergies(make_sb3_vec_env(config.env_id, num_envs, seed=seed, staggered=True, **options))


LEARNERS: dict[str, type[PPO]] = {"compiled": FastPPO, "sb3": PPO}
"""Networks and loss by compiled kernels, or all by Stable-Baselines3: both learn the same, from the same files."""


def make_model(
    config: TrainConfig, env: VecEnv, seed: int, log_folder: Path | None = None, learner: str = "compiled"
) -> PPO:
    """A fresh PPO learner; `learner` is a key of `LEARNERS`."""
    fish = env.unwrapped.fish
    offset, scale = scaling(fish)
    model = LEARNERS[learner](
        MirroredPolicy if config.symmetric else "MlpPolicy",
        env,
        n_steps=config.rollout,
        batch_size=min(config.batch_size, config.rollout * env.num_envs),
        n_epochs=config.epochs,
        learning_rate=falling(config.learning_rate),
        gamma=config.discount(fish.control_interval),
        gae_lambda=config.gae_lambda,
        clip_range=config.clip_range,
        ent_coef=config.entropy_weight,
        policy_kwargs={
            "net_arch": list(config.hidden),
            "activation_fn": Tanh,
            "optimizer_kwargs": {"fused": True},
            "log_std_init": config.initial_log_std,
            "features_extractor_class": ScaledObservation,
            "features_extractor_kwargs": {"offset": offset, "scale": scale},
            **({"mirror": mirror_of(fish)} if config.symmetric else {}),
        },
        tensorboard_log=str(log_folder) if log_folder else None,
        seed=seed,
        device="cpu",
    )
    model.threads = config.env_options.get("threads")  # as many as the fish are shared out over
    return model


class falling:  # noqa: N801 - used like a function; a class so that it can be pickled with the model
    """A learning rate that falls linearly to a tenth over the training."""

    def __init__(self, start: float):
        self.start = start

    def __call__(self, remaining: float) -> float:
        return self.start * (0.1 + 0.9 * max(remaining, 0.0))


def start_from(model: PPO, other: PPO) -> None:
    """Let a fresh learner begin with what another has learnt, on another body or with other muscle groups.

    An action that the other did not have, the difference between the muscles of a pair, begins at zero and with the
    noise of a beginner; one that this learner does not have is left out.

    Raises:
        ValueError: if their tasks show different things, or their networks differ.
    """
    mine, known = model.policy.state_dict(), other.policy.state_dict()
    fish = model.get_env().unwrapped.fish.tank.fish
    here, there = (both(fish, learner.action_space.shape[0]) for learner in (model, other))
    for name, value in mine.items():
        if name.endswith(".swap"):  # how this learner's actions are mirrored
            continue
        theirs = known.get(name)
        same = theirs is not None and value.shape == theirs.shape
        per_action = name == "log_std" or name.startswith("action_net")
        if not same and not (per_action and theirs is not None and value.shape[1:] == theirs.shape[1:]):
            found = None if theirs is None else tuple(theirs.shape)
            raise ValueError(
                f"{name} is {tuple(value.shape)} here and {found} in what was learnt before; start from a run of the "
                "same task, with the same hidden layers and the same kind of policy"
            )
        if same:
            value.copy_(theirs)
        else:
            if name != "log_std":
                value.zero_()
            value[here] = theirs[there]
    model.policy.load_state_dict(mine)


def export_policy(model: PPO, about: dict[str, Any]) -> Policy:
    """The model's mean action as a `Policy`, the scaling of observations folded into its first layer."""
    scaler = model.policy.pi_features_extractor
    weights, biases = plain_layers(model.policy)
    together = synergies(model.get_env().unwrapped.fish)
    weights[-1], biases[-1] = weights[-1] @ together.T, together @ biases[-1]
    weights[0] /= scaler.scale.double().numpy()[:, None]
    biases[0] -= scaler.offset.double().numpy() @ weights[0]
    as_float = [tuple(array.astype(np.float32) for array in arrays) for arrays in (weights, biases)]
    return Policy(*as_float, about)
