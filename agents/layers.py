"""Layers of torch that the policies are made of: what they see, scaled by fixed numbers, and a quick tanh."""

import numpy as np
import torch
from stable_baselines3.common.torch_layers import BaseFeaturesExtractor
from torch import nn


class ScaledObservation(BaseFeaturesExtractor):
    """(obs - offset) / scale with fixed numbers from the body at rest: no running statistics to lose."""

    def __init__(self, observation_space, offset: np.ndarray, scale: np.ndarray):
        super().__init__(observation_space, offset.size)
        self.register_buffer("offset", torch.as_tensor(offset, dtype=torch.float32))
        self.register_buffer("scale", torch.as_tensor(scale, dtype=torch.float32))

    def forward(self, obs: torch.Tensor) -> torch.Tensor:
        """Scaled observations (B,D)."""
        return (obs - self.offset) / self.scale


class _Tanh(torch.autograd.Function):
    """tanh(x) = 2 / (1 + exp(-2 x)) - 1."""

    @staticmethod
    def forward(ctx, x):
        y = x.mul(2.0).sigmoid_().mul_(2.0).sub_(1.0)
        ctx.save_for_backward(y)
        return y

    @staticmethod
    def backward(ctx, gradient):
        (y,) = ctx.saved_tensors
        return torch.ops.aten.tanh_backward(gradient, y)


class Tanh(nn.Module):
    """tanh by way of torch's sigmoid: the same to rounding, and several times as fast as torch's own on a processor."""

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        """Of any shape."""
        return _Tanh.apply(x)
