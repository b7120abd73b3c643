"""A policy for Stable-Baselines3's PPO that is equivariant under the left-right reflection.

Its action for a reflected observation is the reflected action. The fish, the water and all tasks have this symmetry: a
turn to one side is trained by turns to the other, and no bias makes the fish swim to one side.

This module loads torch and Stable-Baselines3, of the extra [train]; nothing else in the package imports it.

    model = PPO(EquivariantPolicy, env, policy_kwargs=equivariant_options(env.unwrapped.fish))
"""

from collections.abc import Mapping
from typing import Any, NamedTuple

import gymnasium as gym
import numpy as np

try:
    import torch
    from stable_baselines3.common.base_class import BaseAlgorithm
    from stable_baselines3.common.policies import ActorCriticPolicy
    from stable_baselines3.common.running_mean_std import RunningMeanStd
    from stable_baselines3.common.torch_layers import BaseFeaturesExtractor, FlattenExtractor, MlpExtractor
    from stable_baselines3.common.vec_env import VecCheckNan, VecEnvWrapper, VecMonitor, VecNormalize, VecVideoRecorder
    from torch import nn
except ImportError as error:
    raise ImportError(
        'fish_env.control.equivariant needs torch and Stable-Baselines3: pip install "fish_env[train]"'
    ) from error

from fish_env.control.policy import Policy
from fish_env.envs import FishVectorEnv

HARMLESS = (VecMonitor, VecCheckNan, VecNormalize, VecVideoRecorder)
"""Wrappers that change neither observations nor actions, `VecNormalize` where it normalises returns only."""


class Reflection(NamedTuple):
    """Exchange of left and right: observations `obs[place] * sign`, actions `action[swap]`."""

    place: np.ndarray  # (D,)
    sign: np.ndarray  # (D,)
    swap: np.ndarray  # (A,)


def reflection_of(env: FishVectorEnv) -> Reflection:
    """Exchange of left and right in an environment."""
    muscles = env.tank.fish.mirrored_muscles
    return Reflection(*env.layout.reflection(), env.groups[muscles[env.first_muscle_of_group]])


def equivariant_options(env: FishVectorEnv) -> dict[str, Any]:
    """The `policy_kwargs` of `EquivariantPolicy` for an environment: its reflection, and its observations scaled."""
    offset, scale = env.layout.scaling()
    return {
        "reflection": reflection_of(env),
        "features_extractor_class": ScaledObservation,
        "features_extractor_kwargs": {"offset": offset, "scale": scale},
    }


class ScaledObservation(BaseFeaturesExtractor):
    """(obs - offset) / scale with fixed numbers (`Layout.scaling`): there are no running statistics to save."""

    offset: torch.Tensor
    scale: torch.Tensor

    def __init__(self, observation_space, offset: np.ndarray, scale: np.ndarray):
        super().__init__(observation_space, offset.size)
        self.register_buffer("offset", torch.as_tensor(offset, dtype=torch.float32))
        self.register_buffer("scale", torch.as_tensor(scale, dtype=torch.float32))

    def forward(self, obs: torch.Tensor) -> torch.Tensor:
        """Scaled observations (B,D)."""
        return (obs - self.offset) / self.scale


class EquivariantExtractor(MlpExtractor):
    """Hidden layers applied to an observation and to its mirror image; the value is the same for both."""

    place: torch.Tensor
    sign: torch.Tensor

    def __init__(self, place, sign, **options):
        super().__init__(**options)
        self.register_buffer("place", torch.as_tensor(place))
        self.register_buffer("sign", torch.as_tensor(sign, dtype=torch.float32))
        self.latent_dim_pi *= 2

    def forward(self, features: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """Hidden features of the actor for both images side by side, (B,2H), and of the critic, their mean, (B,H)."""
        actor, critic = self._hidden(features, self.policy_net, self.value_net)
        return actor.flatten(1), critic.mean(1)

    def forward_actor(self, features: torch.Tensor) -> torch.Tensor:
        """The actor's alone."""
        return self._hidden(features, self.policy_net)[0].flatten(1)

    def forward_critic(self, features: torch.Tensor) -> torch.Tensor:
        """The critic's alone."""
        return self._hidden(features, self.value_net)[0].mean(1)

    def _hidden(self, features: torch.Tensor, *networks: nn.Sequential) -> list[torch.Tensor]:
        """Each network's output for the observations and for their mirror images, (B,2,H).

        The first layer is one product, with the weights mirrored in place of the observations: twice as fast.
        """
        return [network[1:](self._first(features, network[0]).unflatten(1, (2, -1))) for network in networks]

    def _first(self, features: torch.Tensor, layer: nn.Module) -> torch.Tensor:
        assert isinstance(layer, nn.Linear)  # so `MlpExtractor` begins every network that has layers
        weight = torch.cat([layer.weight, layer.weight[:, self.place] * self.sign])
        return nn.functional.linear(features, weight, layer.bias.repeat(2))


class EquivariantActions(nn.Module):
    """Mean of the action for the observation and of the mirrored action for its mirror image."""

    swap: torch.Tensor

    def __init__(self, size: int, swap: np.ndarray):
        super().__init__()
        self.linear = nn.Linear(size, len(swap))
        self.register_buffer("swap", torch.as_tensor(swap))

    def forward(self, latent: torch.Tensor) -> torch.Tensor:
        """Actions (B,A) from the features of both, (B,2H)."""
        plain, mirrored = latent.chunk(2, dim=1)
        return 0.5 * (self.linear(plain) + self.linear(mirrored)[:, self.swap])


class EquivariantPolicy(ActorCriticPolicy):
    """Stable-Baselines3's policy with an equivariant actor and an invariant critic.

    `reflection` is that of the environment (`reflection_of`); other arguments are those of `ActorCriticPolicy`.
    """

    mlp_extractor: EquivariantExtractor
    action_net: EquivariantActions

    def __init__(self, *arguments, reflection: Reflection, **options):
        self.reflection = Reflection(*reflection)
        super().__init__(*arguments, **options)

    def _build_mlp_extractor(self) -> None:
        place, sign, _ = self.reflection
        self.mlp_extractor = EquivariantExtractor(
            place, sign, feature_dim=self.features_dim, net_arch=self.net_arch,
            activation_fn=self.activation_fn, device=self.device,
        )  # fmt: skip

    def _build(self, lr_schedule) -> None:
        super()._build(lr_schedule)
        self.action_net = EquivariantActions(self.mlp_extractor.latent_dim_pi // 2, self.reflection.swap)
        self.init_weights(self.action_net.linear, gain=0.01)  # as Stable-Baselines3 does: small actions at first
        settings: dict[str, Any] = {"lr": lr_schedule(1), **self.optimizer_kwargs}
        self.optimizer = self.optimizer_class(self.parameters(), **settings)

    def _get_constructor_parameters(self):
        return super()._get_constructor_parameters() | {"reflection": self.reflection}


def export_policy(
    model: BaseAlgorithm | ActorCriticPolicy,
    about: Mapping[str, Any],
    combine: np.ndarray | None = None,
    raw: bool = False,
) -> Policy:
    """The mean action of a trained model as a `Policy`, which numpy alone can run.

    The scaling of observations, that of `ScaledObservation` and of `VecNormalize`, is folded into the first layer.

    Args:
        model: a PPO or A2C with the environment that it was trained in; or a policy alone, with `raw`. The policy is an
            `EquivariantPolicy` or an ordinary one, with `ScaledObservation` or without; its hidden layers have tanh.
        about: what the file says of it: env_id, env_options, and whatever else a reader should know.
        combine: matrix (A,A') from the policy's actions to those of the environment, if a wrapper combines them; None
            if they are the same.
        raw: the observations of a policy alone, which does not know its environment, are not normalised.

    Raises:
        ValueError: for another algorithm, other layers, actions that are squashed, or a wrapper that changes
            observations or actions, saying why.
    """
    if isinstance(model, BaseAlgorithm):
        policy, (offset, scale) = model.policy, _observation_scaling(model, combine is not None)
    elif raw:
        policy, offset, scale = model, 0.0, 1.0
    else:
        raise ValueError("a policy does not know whether its observations are normalised; give the model, or raw=True")
    if not isinstance(policy, ActorCriticPolicy) or type(policy) not in (ActorCriticPolicy, EquivariantPolicy):
        raise ValueError(f"a {type(policy).__name__} is not exported; train PPO or A2C with an MlpPolicy")
    _check_export(policy, combine)
    weights, biases = plain_layers(policy)
    if combine is not None:
        weights[-1], biases[-1] = weights[-1] @ combine.T, combine @ biases[-1]
    scaler = policy.pi_features_extractor
    if isinstance(scaler, ScaledObservation):
        offset = offset + scale * scaler.offset.double().numpy()
        scale = scale * scaler.scale.double().numpy()
    weights[0] = weights[0] / np.broadcast_to(scale, len(weights[0]))[:, None]
    biases[0] = biases[0] - np.broadcast_to(offset, len(weights[0])) @ weights[0]
    weights, biases = (tuple(array.astype(np.float32) for array in arrays) for arrays in (weights, biases))
    if not all(np.isfinite(array).all() for array in (*weights, *biases)):
        raise ValueError("the policy has numbers that are not finite: its training has diverged")
    return Policy(weights, biases, about)


def _observation_scaling(model: BaseAlgorithm, combined: bool) -> tuple[Any, Any]:
    """Offset and scale, (D,) or numbers, of a model's observations: (obs - offset) / scale; ValueError for others."""
    env, offset, scale = model.get_env(), np.float64(0.0), np.float64(1.0)
    if env is None:
        raise ValueError("the model has no environment, which may normalise; give it one: model.set_env(env)")
    for kind in (gym.ObservationWrapper, gym.ActionWrapper):
        if any(env.env_is_wrapped(kind)):
            raise ValueError(f"its environment has a {kind.__name__}, which a policy file does not have; leave it out")
    while isinstance(env, VecEnvWrapper):
        if isinstance(env, VecNormalize) and env.norm_obs:
            _check_clipping(model, env)
            statistics: Any = env.obs_rms
            spread = np.sqrt(statistics.var + env.epsilon)
            offset, scale = statistics.mean + spread * offset, spread * scale
        elif not isinstance(env, HARMLESS) and not combined:
            raise ValueError(f"its environment has a {type(env).__name__}, which a policy file does not have")
        env = env.venv
    assert env is not None  # under its wrappers there is one
    seen, shown = model.observation_space.shape, env.observation_space.shape
    if seen != shown:
        raise ValueError(f"the policy expects observations of shape {seen}, the environment returns {shown}")
    return offset, scale


def _check_clipping(model: BaseAlgorithm, env: VecNormalize) -> None:
    """Raise ValueError if `clip_obs`, which layers cannot do, may be below an observation."""
    space, statistics = env.observation_space, env.obs_rms
    if not isinstance(space, gym.spaces.Box) or not isinstance(statistics, RunningMeanStd):
        raise ValueError(f"observations are a {type(space).__name__}; train on a Box")
    reach = [(bound - statistics.mean) / np.sqrt(statistics.var + env.epsilon) for bound in (space.low, space.high)]
    buffer = getattr(model, "rollout_buffer", None)
    seen = buffer.observations if buffer is not None and buffer.full else np.inf
    if min(np.abs(reach).max(), np.abs(seen).max()) >= env.clip_obs:
        raise ValueError(
            f"VecNormalize clips observations at {env.clip_obs}, which layers cannot do, and none may be beyond it in "
            "the last rollout; train with clip_obs=numpy.inf, or export right after learn()"
        )


def _check_export(policy: ActorCriticPolicy, combine: np.ndarray | None) -> None:
    """Raise ValueError unless a policy is tanh layers from a vector to actions that are clipped to [-1, 1]."""
    given, actions = torch.linspace(-30.0, 30.0, 601), policy.action_space
    if not isinstance(actions, gym.spaces.Box) or not isinstance(policy.action_net, nn.Linear | EquivariantActions):
        raise ValueError(f"actions are a {type(actions).__name__}; train on a Box")
    if combine is None and not (np.all(actions.low == -1.0) and np.all(actions.high == 1.0)):
        raise ValueError("actions are not from -1 to 1, to which a policy file clips them; train without rescaling")
    if policy.squash_output:
        raise ValueError("actions are squashed by tanh, which a policy file cannot; train with squash_output=False")
    if len(policy.observation_space.shape or ()) != 1:
        raise ValueError(f"observations have shape {policy.observation_space.shape}; train on one vector, (D,)")
    if type(policy.mlp_extractor) not in (MlpExtractor, EquivariantExtractor):
        raise ValueError(f"hidden layers are a {type(policy.mlp_extractor).__name__}; train with net_arch=[...]")
    for layer in policy.mlp_extractor.policy_net:
        if not isinstance(layer, nn.Linear) and not torch.allclose(layer(given), given.tanh(), atol=1e-5):
            raise ValueError(f"a hidden layer has {type(layer).__name__}; train with activation_fn=torch.nn.Tanh")
    if type(policy.pi_features_extractor) not in (ScaledObservation, FlattenExtractor):
        name = type(policy.pi_features_extractor).__name__
        raise ValueError(f"observations pass {name}; train with equivariant_options(env), or on raw observations")


def plain_layers(policy: ActorCriticPolicy) -> tuple[list[np.ndarray], list[np.ndarray]]:
    """Weights (inputs, outputs) and biases of the actor as ordinary layers; an equivariant one's are twice as wide."""
    pairs = [weight_and_bias(layer) for layer in policy.mlp_extractor.policy_net if isinstance(layer, nn.Linear)]
    if not isinstance(policy, EquivariantPolicy):
        assert isinstance(policy.action_net, nn.Linear)  # the mean of a Gaussian
        pairs.append(weight_and_bias(policy.action_net))
        return [weight for weight, _ in pairs], [bias for _, bias in pairs]
    extractor, actions = policy.mlp_extractor, policy.action_net
    place, sign = extractor.place.numpy(), extractor.sign.double().numpy()
    first = pairs[0][0]
    mirrored = np.empty_like(first)
    mirrored[place] = first * sign[:, None]
    weights, biases = [np.hstack([first, mirrored])], [np.tile(pairs[0][1], 2)]
    for weight, bias in pairs[1:]:
        nothing = np.zeros_like(weight)
        weights.append(np.block([[weight, nothing], [nothing, weight]]))
        biases.append(np.tile(bias, 2))
    last, bias = weight_and_bias(actions.linear)
    swap = actions.swap.numpy()
    weights.append(0.5 * np.vstack([last, last[:, swap]]))
    biases.append(0.5 * (bias + bias[swap]))
    return weights, biases


def weight_and_bias(layer: nn.Linear) -> tuple[np.ndarray, np.ndarray]:
    """Weight (inputs, outputs) and bias of a layer, float64."""
    return layer.weight.detach().double().numpy().T, layer.bias.detach().double().numpy()
