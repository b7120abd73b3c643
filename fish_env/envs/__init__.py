"""The environments: one implementation of an episode, and its single, vector, stub and Stable-Baselines3 faces."""

from fish_env.envs.single import FishEnv
from fish_env.envs.stub import StubEnv, StubVectorEnv
from fish_env.envs.variation import VARIATIONS
from fish_env.envs.vector import FishVectorEnv

__all__ = ["VARIATIONS", "FishEnv", "FishVectorEnv", "StubEnv", "StubVectorEnv"]
