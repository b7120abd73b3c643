"""The environments: one implementation of an episode, and its single, vector, stub and Stable-Baselines3 interfaces."""

from fish_env.envs.layout import LAYOUT_VERSION, Layout, Part, observation_layout
from fish_env.envs.make_sb3 import make_sb3_vec_env
from fish_env.envs.single import FishEnv
from fish_env.envs.state import FishState
from fish_env.envs.stub import StubEnv, StubVectorEnv
from fish_env.envs.variation import VARIATIONS
from fish_env.envs.vector import FishVectorEnv
from fish_env.physics.lazy import lazy_names

__all__ = [
    "LAYOUT_VERSION", "VARIATIONS", "FishEnv", "FishState", "FishVectorEnv", "Layout", "Part", "StubEnv",
    "StubVectorEnv", "make_sb3_vec_env", "observation_layout",
]  # fmt: skip

__getattr__ = lazy_names(__name__, {"sb3": "fish_env.envs.sb3"})  # it needs Stable-Baselines3
