"""Stub-v0: the spaces and the behaviour of Swim-v0 without physics and without compilation, for other projects' tests.

The fish glides stiffly along its nose, faster the more its muscles are contracted. Everything else, from seeding to
the end of an episode, is the code of the real environments.
"""

import numpy as np

from fish_env.envs.single import FishEnv
from fish_env.envs.vector import FishVectorEnv
from fish_env.tasks import SwimTask


class StubTask(SwimTask):
    """`SwimTask` without its kernel."""

    def progress(self, tank, pose):
        return ((pose.centre - self._before) * self._heading).sum(axis=1) / tank.fish.length


class StubVectorEnv(FishVectorEnv):
    """`FishVectorEnv` whose fish glide instead of swimming. Plain numpy: nothing is compiled."""

    tasks = {"swim": StubTask}

    def _contract(self, action):
        self._contraction[:] = 0.5 * (np.clip(action, -1.0, 1.0)[:, self.groups] + 1.0)
        return np.isfinite(action).all()

    def _swim(self):
        tank, contraction = self.tank, self._contraction
        tank.rest_length[:, tank.fish.muscles] = tank.natural - contraction * tank.span
        velocity = tank.fish.length * contraction.mean(axis=1)[:, None] * self._pose.axes[:, 0]
        tank.velocity[:] = velocity[:, None]
        tank.position[:] += tank.velocity * self.control_interval
        tank.time[:] += self.control_interval

    def _measure(self):
        fish, pose = self.tank.fish, self._pose
        mass = fish.body.mass / fish.body.mass.sum()
        pose.centre[:], pose.velocity[:] = mass @ self.tank.position, mass @ self.tank.velocity
        x = self.tank.position
        forward = fish.line @ x
        forward /= np.linalg.norm(forward, axis=1, keepdims=True)
        left = (x[:, fish.left] - x[:, fish.right]).sum(axis=1)
        left -= (left * forward).sum(axis=1, keepdims=True) * forward
        left /= np.linalg.norm(left, axis=1, keepdims=True)
        pose.axes[:] = np.stack([forward, left, np.cross(forward, left)], axis=1)

    def observe(self):
        tank, axes = self.tank, self._pose.axes
        rotate = axes.transpose(0, 2, 1)
        parts = [
            (tank.fish.points(tank.position) - self._pose.centre[:, None]) @ rotate / tank.fish.length,
            tank.velocity[:, tank.fish.landmarks.node] @ rotate / tank.fish.length,
            2.0 * tank.contraction - 1.0,
            axes[:, :, 2],
            self.task.vectors(tank, self._pose) @ rotate,
        ]
        obs = np.concatenate([part.reshape(self.num_envs, -1) for part in parts], axis=1)
        space = self.observation_space
        return np.clip(obs.astype(np.float32), space.low, space.high)


class StubEnv(FishEnv):
    """`FishEnv` on `StubVectorEnv`."""

    vector_class = StubVectorEnv
