"""A policy of torch as the kernels take it: arrays that are torch's own parameters, images, and scratch memory."""

from functools import reduce

import numpy as np
from stable_baselines3.common.distributions import DiagGaussianDistribution
from stable_baselines3.common.policies import ActorCriticPolicy
from torch import nn

from agents import kernels
from agents.kernels import BLOCK, Images, Network, Policy, Work
from agents.layers import Tanh
from fish_env.control.equivariant import EquivariantPolicy, ScaledObservation


def unsupported(policy) -> str | None:
    """Part of a policy that `Networks` does not support, in words; None if it supports all of it."""
    if type(policy) not in (ActorCriticPolicy, EquivariantPolicy):
        return f"its policy is {type(policy).__name__}"
    if type(policy.features_extractor) is not ScaledObservation or not policy.share_features_extractor:
        return "its observations are not scaled by ScaledObservation"
    if type(policy.action_dist) is not DiagGaussianDistribution:
        return f"its actions are drawn from {type(policy.action_dist).__name__}"
    for network in (policy.mlp_extractor.policy_net, policy.mlp_extractor.value_net):
        for linear, activation in zip(network[::2], network[1::2], strict=True):
            if type(linear) is not nn.Linear or type(activation) not in (Tanh, nn.Tanh):
                return f"its layers are {type(linear).__name__} and {type(activation).__name__}"
    if policy.device.type != "cpu" or not all(p.requires_grad and p.is_contiguous() for p in policy.parameters()):
        return "its parameters are not trainable, contiguous numbers on the processor"
    return None


def linear_layers(hidden: nn.Sequential, last: nn.Module) -> list[nn.Linear]:
    """The layers with parameters of a network, in order; tanh lies between them."""
    return [layer for layer in (*hidden, last) if isinstance(layer, nn.Linear)]


class Networks:
    """The networks of a policy that is not `unsupported`. What torch changes in its parameters is changed here too.

    Attributes:
        parameters: torch's: `log_std`, then weight and bias of every layer of the actor, then of the critic.
        policy: the same as arrays.
        images: how it takes observations.
    """

    def __init__(self, policy: ActorCriticPolicy):
        extractor, scaler = policy.mlp_extractor, policy.features_extractor
        assert isinstance(scaler, ScaledObservation)  # any other is `unsupported`
        last = policy.action_net.linear if isinstance(policy, EquivariantPolicy) else policy.action_net
        chains = linear_layers(extractor.policy_net, last), linear_layers(extractor.value_net, policy.value_net)
        numbers = [p for chain in chains for layer in chain for p in (layer.weight, layer.bias)]
        self.parameters, self._depth = [policy.log_std, *numbers], len(chains[0])
        self.policy = self.named([parameter.detach().numpy() for parameter in self.parameters])
        self.dtype = self.policy.log_std.dtype
        place, swap = ([np.arange(tensor.numel())] for tensor in (scaler.scale, policy.log_std))
        sign = [np.ones(place[0].size)]
        if isinstance(policy, EquivariantPolicy):
            place.append(policy.mlp_extractor.place.numpy())
            sign.append(policy.mlp_extractor.sign.numpy())
            swap.append(policy.action_net.swap.numpy())
        place, factor = np.stack(place), np.stack(sign) / scaler.scale.numpy()[place]
        offset = scaler.offset.numpy()[place]
        self.images = Images(place, offset.astype(self.dtype), factor.astype(self.dtype), np.stack(swap))

    def named(self, arrays: list[np.ndarray]) -> Policy:
        """Arrays in the order of `parameters` by name."""
        weights, biases, depth = tuple(arrays[1::2]), tuple(arrays[2::2]), self._depth
        actor, critic = Network(weights[:depth], biases[:depth]), Network(weights[depth:], biases[depth:])
        return Policy(arrays[0], actor, critic)

    def transposed(self) -> tuple[tuple[np.ndarray, ...], ...]:
        """Weights (V,W) of actor and critic as they are now."""
        networks = self.policy.actor, self.policy.critic
        return tuple(tuple(np.ascontiguousarray(weight.T) for weight in network.weights) for network in networks)

    def work(self) -> tuple[np.ndarray, Work, Work]:
        """Scratch memory for a block: its rows, and work of actor and critic."""
        images, size = self.images.place.shape

        def of(network: Network) -> Work:
            given, slopes = ([np.empty((BLOCK * images, b.size), self.dtype) for b in network.biases] for _ in range(2))
            return Work(tuple(given), tuple(slopes), tuple(map(np.empty_like, network.weights)))

        return np.empty((BLOCK * images, size), self.dtype), of(self.policy.actor), of(self.policy.critic)

    def see(self, obs: np.ndarray) -> np.ndarray:
        """All images (n,I,D) of observations (n,D)."""
        seen = np.empty((len(obs), *self.images.place.shape), self.dtype)
        kernels.see(np.ascontiguousarray(obs), self.images, seen)
        return seen

    def act(self, obs: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Mean actions (n,A) and values (n,) for observations (n,D)."""
        seen, swap = self.see(obs).reshape(-1, obs.shape[1]), self.images.swap
        last = []
        for network, weights in zip(self.policy[1:], self.transposed(), strict=True):
            given = tuple(np.empty((len(seen), bias.size), self.dtype) for bias in network.biases)
            kernels.forward(seen, weights, network.biases, given)
            last.append(given[-1].reshape(len(obs), len(swap), -1))
        mean = reduce(np.add, (last[0][:, m, there] for m, there in enumerate(swap))) / len(swap)
        return mean, last[1][:, :, 0].mean(1)

    def zeros(self) -> tuple[np.ndarray, Policy]:
        """A flat array of zeros, and its parts by name in the shapes of the parameters."""
        ends = np.cumsum([parameter.numel() for parameter in self.parameters])
        flat = np.zeros(ends[-1], self.dtype)
        parts = np.split(flat, ends[:-1])
        return flat, self.named([part.reshape(p.shape) for part, p in zip(parts, self.parameters, strict=True)])


def arrays_of(policy: Policy) -> list[np.ndarray]:
    """Its arrays in the order of `Networks.parameters`."""
    layers = (pair for network in (policy.actor, policy.critic) for pair in zip(*network, strict=True))
    return [policy.log_std, *(array for layer in layers for array in layer)]
