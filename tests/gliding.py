"""Environments of every task in which nothing is compiled: their fish glide and turn as stiff bodies, without water.

For what does not depend on the physics. The kernels of tasks and observations run as Python, some milliseconds a step.
"""

import gymnasium as gym
import pytest

from fish_env import TASKS
from fish_env.envs import FishVectorEnv, StubEnv, StubVectorEnv
from fish_env.tasks.start import rotation

ID = {task: f"Gliding/{task.title().replace('_', '')}-v0" for task in TASKS}
"""Registered names, by task."""


class GlidingVectorEnv(StubVectorEnv):
    """The stub with all tasks; its fish turn towards the side whose muscles are contracted more, and spend effort."""

    tasks = TASKS

    def _move(self):
        vars(self.tank)["drive"] = self._glide
        try:
            return FishVectorEnv._move(self)
        finally:
            del vars(self.tank)["drive"]

    def _glide(self, contraction, steps):
        """In place of `Tank.drive`."""
        tank, duration = self.tank, steps * self.tank.dt
        mean, aside = contraction.mean(axis=1), (contraction * tank.fish.sides).sum(axis=1)
        for x, centre, angle in zip(tank.position, self._pose.centre, 0.02 * aside, strict=True):
            x[:] = centre + (x - centre) @ rotation(angle, 0.0, 0.0).T
        shorter = contraction - tank.fish.lengthening * contraction[:, tank.fish.mirrored_muscles]
        tank.rest_length[:, tank.fish.muscles] = tank.natural - shorter * tank.span
        tank.velocity[:] = (tank.fish.length * mean[:, None] * self._pose.axes[:, 0])[:, None]
        tank.position[:] += tank.velocity * duration
        for spent in (tank.time, tank.effort, tank.work):
            spent += duration * (1.0 if spent is tank.time else mean)


class GlidingEnv(StubEnv):
    """One fish of `GlidingVectorEnv`."""

    vector_class = GlidingVectorEnv


for task, name in ID.items():
    steps = gym.spec(f"FishEnv/{name.partition('/')[2]}").max_episode_steps
    gym.register(
        name, "gliding:GlidingEnv", vector_entry_point="gliding:GlidingVectorEnv", max_episode_steps=steps,
        kwargs={"task": task},
    )  # fmt: skip

each_task = pytest.mark.parametrize("task", TASKS)
each_way = pytest.mark.parametrize(
    ("task", "make"),
    [
        *(pytest.param(task, GlidingVectorEnv, id=f"{task}, gliding") for task in TASKS),
        *(pytest.param(task, FishVectorEnv, id=task, marks=[pytest.mark.slow] * (task != "swim")) for task in TASKS),
    ],
)
"""Every task without physics, and with: kernels of one task are compiled in every run, those of others are slow."""
