"""fish_env: a deformable, muscle-driven fish as a Gymnasium environment.

Importing this package registers its environments (`FishEnv/Swim-v0`, ...). Neither torch, Stable-Baselines3, pygame nor
matplotlib is loaded by it.
"""

from gymnasium.envs.registration import register

from fish_env.bodies import BODIES, Fish, make_fish
from fish_env.integrators import INTEGRATORS
from fish_env.tank import Tank
from fish_env.tasks import TASKS
from fish_env.world import World, make_water, make_world

__version__ = "0.1.0"
__all__ = ["BODIES", "INTEGRATORS", "TASKS", "Fish", "Tank", "World", "make_fish", "make_water", "make_world"]

EPISODE_STEPS = {"swim": 250, "turn": 250, "left_after_right": 250, "target": 500, "avoid": 300}
"""Decisions in an episode of each task."""

for _task, _steps in EPISODE_STEPS.items():
    register(
        id=f"FishEnv/{_task.title().replace('_', '')}-v0",
        entry_point="fish_env.envs:FishEnv",
        vector_entry_point="fish_env.envs:FishVectorEnv",
        max_episode_steps=_steps,
        kwargs={"task": _task},
    )
register(
    id="FishEnv/Stub-v0",
    entry_point="fish_env.envs:StubEnv",
    vector_entry_point="fish_env.envs:StubVectorEnv",
    max_episode_steps=EPISODE_STEPS["swim"],
    kwargs={"task": "swim"},
)
