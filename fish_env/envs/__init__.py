"""The environments: one implementation of an episode, and its single, vector, stub and Stable-Baselines3 faces."""

from fish_env.envs.single import FishEnv
from fish_env.envs.stub import StubEnv, StubVectorEnv
from fish_env.envs.vector import FishVectorEnv

__all__ = ["FishEnv", "FishVectorEnv", "StubEnv", "StubVectorEnv"]
