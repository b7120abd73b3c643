"""A policy that cannot tell left from right: what it does when mirrored is the mirror image of what it does.

The fish and the water are symmetric, and so are all tasks; a network that is symmetric by construction learns a turn to
one side from turns to the other, and has no bias that makes it swim askew.
"""

import numpy as np
import torch
from stable_baselines3.common.policies import ActorCriticPolicy
from stable_baselines3.common.torch_layers import MlpExtractor
from torch import nn


def mirror_of(env) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """How left and right are exchanged in a `FishVectorEnv`.

    The mirrored observation is `obs[place] * sign`, both (D,), the mirrored action `action[swap]`, (A,).
    """
    fish = env.tank.fish
    nodes = (3 * fish.landmarks.mirror[:, None] + np.arange(3)).ravel()
    muscles = fish.mirrored_muscles
    directions = np.arange(3 + 3 * len(env.task.directions))  # the vertical, and what the task shows
    parts = (nodes, nodes, muscles, directions)
    starts = np.cumsum([0, *map(len, parts)])
    place = np.concatenate([start + part for start, part in zip(starts, parts, strict=False)])
    flip = [1.0, -1.0, 1.0]  # forward and up stay, left becomes right
    sign = np.concatenate(
        [np.tile(flip, 2 * len(fish.landmarks.mirror)), np.ones(len(muscles)), np.tile(flip, len(directions) // 3)]
    )
    return place, sign, env.groups[muscles[env.leaders]]


class MirroredExtractor(MlpExtractor):
    """Hidden layers that see an observation and its mirror image; the value does not depend on which is which."""

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

    def _first(self, features: torch.Tensor, layer: nn.Linear) -> torch.Tensor:
        weight = torch.cat([layer.weight, layer.weight[:, self.place] * self.sign])
        return nn.functional.linear(features, weight, layer.bias.repeat(2))


class MirroredActions(nn.Module):
    """Mean of the action for the observation and of the mirrored action for its mirror image."""

    def __init__(self, size: int, swap: np.ndarray):
        super().__init__()
        self.linear = nn.Linear(size, len(swap))
        self.register_buffer("swap", torch.as_tensor(swap))

    def forward(self, latent: torch.Tensor) -> torch.Tensor:
        """Actions (B,A) from the features of both, (B,2H)."""
        plain, mirrored = latent.chunk(2, dim=1)
        return 0.5 * (self.linear(plain) + self.linear(mirrored)[:, self.swap])


class MirroredPolicy(ActorCriticPolicy):
    """SB3's policy with both networks symmetric. Takes `mirror`, what `mirror_of` returns."""

    def __init__(self, *arguments, mirror, **options):
        self.mirror = mirror
        super().__init__(*arguments, **options)

    def _build_mlp_extractor(self) -> None:
        place, sign, _ = self.mirror
        self.mlp_extractor = MirroredExtractor(
            place, sign, feature_dim=self.features_dim, net_arch=self.net_arch,
            activation_fn=self.activation_fn, device=self.device,
        )  # fmt: skip

    def _build(self, lr_schedule) -> None:
        super()._build(lr_schedule)
        self.action_net = MirroredActions(self.mlp_extractor.latent_dim_pi // 2, self.mirror[2])
        self.init_weights(self.action_net.linear, gain=0.01)  # as SB3 does: small actions at first
        self.optimizer = self.optimizer_class(self.parameters(), lr=lr_schedule(1), **self.optimizer_kwargs)

    def _get_constructor_parameters(self):
        return super()._get_constructor_parameters() | {"mirror": self.mirror}


def plain_layers(policy: ActorCriticPolicy) -> tuple[list[np.ndarray], list[np.ndarray]]:
    """Weights (inputs, outputs) and biases of the actor as ordinary layers; a symmetric one's are twice as wide."""
    extractor, actions = policy.mlp_extractor, policy.action_net
    pairs = [numbers(layer) for layer in extractor.policy_net if isinstance(layer, nn.Linear)]
    if not isinstance(policy, MirroredPolicy):
        return tuple(map(list, zip(*pairs, numbers(actions), strict=True)))
    place, sign = extractor.place.numpy(), extractor.sign.double().numpy()
    first = pairs[0][0]
    mirrored = np.empty_like(first)
    mirrored[place] = first * sign[:, None]
    weights, biases = [np.hstack([first, mirrored])], [np.tile(pairs[0][1], 2)]
    for weight, bias in pairs[1:]:
        nothing = np.zeros_like(weight)
        weights.append(np.block([[weight, nothing], [nothing, weight]]))
        biases.append(np.tile(bias, 2))
    last, bias = numbers(actions.linear)
    swap = actions.swap.numpy()
    weights.append(0.5 * np.vstack([last, last[:, swap]]))
    biases.append(0.5 * (bias + bias[swap]))
    return weights, biases


def numbers(layer: nn.Linear) -> tuple[np.ndarray, np.ndarray]:
    """Weight (inputs, outputs) and bias of a layer, float64."""
    return layer.weight.detach().double().numpy().T, layer.bias.detach().double().numpy()
