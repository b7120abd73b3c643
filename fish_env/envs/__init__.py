"""The environments: one implementation of an episode, and its single, vector, stub and Stable-Baselines3 interfaces."""

import importlib

from fish_env.envs.layout import LAYOUT_VERSION, Layout, Part, observation_layout
from fish_env.envs.make_sb3 import make_sb3_vec_env
from fish_env.envs.single import FishEnv
from fish_env.envs.state import FishState
from fish_env.envs.stub import StubEnv, StubVectorEnv
from fish_env.envs.variation import VARIATIONS
from fish_env.envs.vector import FishVectorEnv

__all__ = [
    "LAYOUT_VERSION",
    "VARIATIONS",
    "FishEnv",
    "FishState",
    "FishVectorEnv",
    "Layout",
    "Part",
    "StubEnv",
    "StubVectorEnv",
    "make_sb3_vec_env",
    "observation_layout",
]


def __getattr__(name: str):
    """`fish_env.envs.sb3`, which needs Stable-Baselines3, is loaded when it is first used."""
    if name == "sb3":
        return importlib.import_module("fish_env.envs.sb3")
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
