"""What the entry points name. Importing it enters the task in the table that the environments look it up in."""

from fish_env import TASKS
from fish_env.envs import FishEnv, FishVectorEnv
from swim_elsewhere.task import AnyHeadingTask

__all__ = ["FishEnv", "FishVectorEnv"]

TASKS["any_heading"] = AnyHeadingTask
