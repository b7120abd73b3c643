"""fish_env: a deformable, muscle-driven fish as a Gymnasium environment.

Importing this package registers its environments (`FishEnv/Swim-v0`, ...). Neither torch, Stable-Baselines3, pygame nor
matplotlib is loaded by it.
"""

from typing import TYPE_CHECKING

from gymnasium.envs.registration import register

from fish_env.bodies import BODIES, Fish, make_fish
from fish_env.integrators import INTEGRATORS
from fish_env.tank import Tank
from fish_env.tasks import TASKS
from fish_env.world import World, make_water, make_world

if TYPE_CHECKING:
    from fish_env.envs.sb3 import make_sb3_vec_env

__version__ = "0.1.0"
__all__ = [
    "BODIES",
    "INTEGRATORS",
    "TASKS",
    "Fish",
    "Tank",
    "World",
    "make_fish",
    "make_sb3_vec_env",
    "make_water",
    "make_world",
]

for _name, _task in TASKS.items():
    register(
        id=f"FishEnv/{_name.title().replace('_', '')}-v0",
        entry_point="fish_env.envs:FishEnv",
        vector_entry_point="fish_env.envs:FishVectorEnv",
        max_episode_steps=_task.episode_steps,
        kwargs={"task": _name},
    )
register(
    id="FishEnv/Stub-v0",
    entry_point="fish_env.envs:StubEnv",
    vector_entry_point="fish_env.envs:StubVectorEnv",
    max_episode_steps=TASKS["swim"].episode_steps,
    kwargs={"task": "swim"},
)


def __getattr__(name: str):
    """Load Stable-Baselines3 only where `fish_env.make_sb3_vec_env` is asked for."""
    if name == "make_sb3_vec_env":
        from fish_env.envs.sb3 import make_sb3_vec_env

        return make_sb3_vec_env
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
