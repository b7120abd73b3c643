"""A policy for Stable-Baselines3's PPO that is equivariant under the left-right reflection.

Its action for a reflected observation is the reflected action. The fish, the water and all tasks have this symmetry: a
turn to one side is trained by turns to the other, and no bias makes the fish swim to one side. It needs observations as
they are: the running means of `VecNormalize` are no mirror images.

This module loads torch and Stable-Baselines3, of the extra [train]; nothing else in the package imports it.

    model = PPO(EquivariantPolicy, env, policy_kwargs=equivariant_options(env.unwrapped.fish))
"""

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

try:
    import torch
    from stable_baselines3.common.base_class import BaseAlgorithm
    from stable_baselines3.common.policies import ActorCriticPolicy, BasePolicy
    from stable_baselines3.common.torch_layers import BaseFeaturesExtractor, FlattenExtractor, MlpExtractor
    from torch import nn
except ImportError as error:
    raise ImportError(
        'fish_env.control.equivariant needs torch and Stable-Baselines3: pip install "fish_env[train]"'
    ) from error

from fish_env.control.models import check_spaces, normalisation_of, trained_with
from fish_env.control.policy import Policy
from fish_env.envs import FishVectorEnv

POLICIES = (
    "stable_baselines3.common.policies.ActorCriticPolicy",
    "stable_baselines3.sac.policies.SACPolicy",
    "stable_baselines3.td3.policies.TD3Policy",
    "sb3_contrib.tqc.policies.TQCPolicy",
    f"{__name__}.EquivariantPolicy",
)
"""Those that are exported, by name: sb3-contrib may not be installed."""
ACTIVATIONS = {nn.Tanh: "tanh", nn.ReLU: "relu"}
"""Those of hidden layers that a `Policy` has."""


class Reflection(NamedTuple):
    """Exchange of left and right: observations `obs[place] * sign`, actions `action[swap]`."""

    place: np.ndarray  # (D,)
    sign: np.ndarray  # (D,)
    swap: np.ndarray  # (A,)


def reflection_of(env: FishVectorEnv) -> Reflection:
    """Exchange of left and right in an environment."""
    return Reflection(*env.layout.reflection(), env.groups[env.tank.fish.mirrored_muscles[env.first_muscle_of_group]])


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
        """Each network's output for the observations and for their mirror images, (B,2,H)."""
        # The first layer is one product, with the weights mirrored in place of the observations: twice as fast.
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
    model: BaseAlgorithm | BasePolicy, about: Mapping[str, Any], combine: np.ndarray | None = None, raw: bool = False
) -> Policy:
    """The deterministic action of a trained model as a `Policy`, which numpy alone can run.

    The policy normalises observations as `VecNormalize` does; `ScaledObservation` is folded into the first layer.

    Args:
        model: a PPO, A2C, SAC, TD3, DDPG, or a TQC of sb3-contrib, with the environment that it was trained in; or a
            policy alone, with `raw`. The policy is an `EquivariantPolicy` or an `MlpPolicy`, with `ScaledObservation`
            or without; its hidden layers have tanh or ReLU.
        about: what the file says of it: env_id, env_options, and whatever else a reader should know. The `interface`
            of the model's environment is added as "trained".
        combine: matrix (A,A') from the policy's actions to those of the environment, if a wrapper combines them; None
            for that of the package's own trainings, or if they are the same.
        raw: the observations of a policy alone, which does not know its environment, are not normalised.

    Raises:
        ValueError: for other policies, layers or spaces, or a wrapper that changes observations or actions, saying why.
    """
    policy, normalisation = model.policy if isinstance(model, BaseAlgorithm) else model, None
    if combine is None and isinstance(model, BaseAlgorithm):
        combine = getattr(model.get_env(), "synergy_matrix", None)
    check_spaces(policy.observation_space, policy.action_space, combine is not None)
    if isinstance(model, BaseAlgorithm):
        normalisation = normalisation_of(model, combine is not None)
        about = {**about, **trained_with(model)}
    elif not raw:
        raise ValueError("a policy does not know whether its observations are normalised; give the model, or raw=True")
    scaler, modules = actor_modules(policy)
    hidden, output = _activation(modules), "tanh" if policy.squash_output else "clip"
    weights, biases = plain_layers(policy, modules)
    if combine is not None:
        if output != "clip":
            raise ValueError("actions are squashed by tanh, and a wrapper combines them; train without one of the two")
        weights[-1], biases[-1] = weights[-1] @ combine.T, combine @ biases[-1]
    if isinstance(scaler, ScaledObservation):
        weights[0] = weights[0] / scaler.scale.double().cpu().numpy()[:, None]
        biases[0] = biases[0] - scaler.offset.double().cpu().numpy() @ weights[0]
    weights, biases = (tuple(array.astype(np.float32) for array in arrays) for arrays in (weights, biases))
    numbers = (*weights, *biases, *([] if normalisation is None else normalisation[:2]))
    if not all(np.isfinite(array).all() for array in numbers):
        raise ValueError("the policy has numbers that are not finite: its training has diverged")
    return Policy(weights, biases, about, hidden=hidden, output=output, normalisation=normalisation)


def actor_modules(policy: Any) -> tuple[nn.Module, list[nn.Module]]:
    """The features extractor of an actor, and the modules from features to actions of any size; else ValueError."""
    kind = type(policy)
    if f"{kind.__module__}.{kind.__qualname__}" not in POLICIES:
        raise ValueError(f"a {kind.__name__} is not exported; train PPO, A2C, SAC, TD3, DDPG or TQC with an MlpPolicy")
    if isinstance(policy, ActorCriticPolicy):
        if type(policy.mlp_extractor) not in (MlpExtractor, EquivariantExtractor):
            raise ValueError(f"hidden layers are a {type(policy.mlp_extractor).__name__}; train with net_arch=[...]")
        scaler, parts = policy.pi_features_extractor, [*policy.mlp_extractor.policy_net, policy.action_net]
    else:
        actor = policy.actor
        scaler = actor.features_extractor
        parts = [*actor.latent_pi, actor.mu] if hasattr(actor, "latent_pi") else [*actor.mu][:-1]  # TD3's tanh
    if type(scaler) not in (ScaledObservation, FlattenExtractor):
        name = type(scaler).__name__
        raise ValueError(f"observations pass {name}; train with equivariant_options(env), or on raw observations")
    return scaler, [module for part in parts for module in (part if isinstance(part, nn.Sequential) else [part])]


def _activation(modules: list[nn.Module]) -> str:
    """The activation between the layers; ValueError for another than tanh and ReLU, or for both."""
    found = set()
    for module in modules:
        if isinstance(module, nn.Linear | EquivariantActions):
            continue
        if type(module) not in ACTIVATIONS:
            raise ValueError(
                f"a layer has {type(module).__name__}; train with activation_fn=torch.nn.Tanh or torch.nn.ReLU, and "
                "with clip_mean=0.0 where use_sde is"
            )
        found.add(ACTIVATIONS[type(module)])
    if len(found) > 1:
        raise ValueError("hidden layers have tanh and ReLU; train with one of them")
    return found.pop() if found else "tanh"


def plain_layers(policy: Any, modules: list[nn.Module]) -> tuple[list[np.ndarray], list[np.ndarray]]:
    """Weights (inputs, outputs) and biases of the actor as ordinary layers; an equivariant one's are twice as wide."""
    pairs = [weight_and_bias(module) for module in modules if isinstance(module, nn.Linear)]
    if not isinstance(policy, EquivariantPolicy):
        return [weight for weight, _ in pairs], [bias for _, bias in pairs]
    extractor, actions = policy.mlp_extractor, policy.action_net
    place, sign = extractor.place.cpu().numpy(), extractor.sign.double().cpu().numpy()
    first = pairs[0][0]
    mirrored = np.empty_like(first)
    mirrored[place] = first * sign[:, None]
    weights, biases = [np.hstack([first, mirrored])], [np.tile(pairs[0][1], 2)]
    for weight, bias in pairs[1:]:
        nothing = np.zeros_like(weight)
        weights.append(np.block([[weight, nothing], [nothing, weight]]))
        biases.append(np.tile(bias, 2))
    last, bias = weight_and_bias(actions.linear)
    swap = actions.swap.cpu().numpy()
    weights.append(0.5 * np.vstack([last, last[:, swap]]))
    biases.append(0.5 * (bias + bias[swap]))
    return weights, biases


def weight_and_bias(layer: nn.Linear) -> tuple[np.ndarray, np.ndarray]:
    """Weight (inputs, outputs) and bias of a layer, float64."""
    return layer.weight.detach().double().cpu().numpy().T, layer.bias.detach().double().cpu().numpy()
