"""Entry points of the environments. Importing this module adds the task to the table of tasks."""

from fish_env import TASKS
from fish_env.envs import FishEnv, FishVectorEnv
from swim_elsewhere.task import AnyHeadingTask

__all__ = ["FishEnv", "FishVectorEnv"]

TASKS["any_heading"] = AnyHeadingTask
