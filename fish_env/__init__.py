"""fish_env: a deformable, muscle-driven fish as a Gymnasium environment.

Importing this package registers its environments (`FishEnv/Swim-v0`, ...). Neither torch, Stable-Baselines3, pygame nor
matplotlib is loaded by it.

- Environments, which Gymnasium makes by their ids: `FishEnv`, `FishVectorEnv`; `make_sb3_vec_env` makes one for
  Stable-Baselines3, `observation_layout` says what an observation holds.
- Tasks: `TASKS`, the protocol `Task`, and `Option`, a number that a keyword or a reset sets.
- Bodies: `BODIES`, `make_fish`, `Fish`; `make_body` for one of your own.
- Simulation: `Tank`, `World`, `make_water`, `make_world`, `INTEGRATORS`, `Integrator`; `prescribe` swims a body by a
  given midline.

Controllers and trained policies are in `fish_env.control`, the conditions on which they are compared in
`fish_env.protocols`; `fish_env list` lists what there is.
"""

from typing import TYPE_CHECKING

from gymnasium.envs.registration import register

from fish_env.bodies import BODIES, Fish, make_fish
from fish_env.envs import FishEnv, FishVectorEnv, make_sb3_vec_env, observation_layout
from fish_env.physics.body import make_body
from fish_env.physics.integrators import INTEGRATORS, Integrator
from fish_env.physics.lazy import lazy_names
from fish_env.physics.records import World
from fish_env.physics.tank import Tank
from fish_env.physics.world import make_water
from fish_env.tasks import TASKS, Option, Task

__version__ = "0.1.0"
__all__ = [
    "BODIES", "INTEGRATORS", "TASKS", "Fish", "FishEnv", "FishVectorEnv", "Integrator", "Option", "Tank", "Task",
    "World", "make_body", "make_fish", "make_sb3_vec_env", "make_water", "make_world", "observation_layout",
    "prescribe",
]  # fmt: skip

if TYPE_CHECKING:
    from fish_env.soft.midline import prescribe
    from fish_env.soft.room import make_world

WHEN_USED = {
    "protocols": "fish_env.control.protocols",
    "make_world": "fish_env.soft.room:make_world",
    "prescribe": "fish_env.soft.midline:prescribe",
}
__getattr__ = lazy_names(__name__, WHEN_USED)

SOLVED = {"swim": 10, "turn": 16, "left_after_right": 15, "target": 60, "target_3_d": 10, "avoid": 27, "fast_start": 4}
"""Mean return that counts as solved: about halfway between the motor controllers and the shipped policy."""

for _name, _task, _options in (*((name, name, {}) for name in TASKS), ("target_3_d", "target", {"dimensions": 3})):
    register(
        id=f"FishEnv/{_name.title().replace('_', '')}-v0",
        entry_point="fish_env.envs:FishEnv",
        vector_entry_point="fish_env.envs:FishVectorEnv",
        reward_threshold=SOLVED.get(_name),
        max_episode_steps=TASKS[_task].episode_steps,
        kwargs={"task": _task, **_options},
    )
register(
    id="FishEnv/Stub-v0",
    entry_point="fish_env.envs:StubEnv",
    vector_entry_point="fish_env.envs:StubVectorEnv",
    max_episode_steps=TASKS["swim"].episode_steps,
    kwargs={"task": "swim"},
)
