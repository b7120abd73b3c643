"""Stub-v0: the spaces and the behaviour of Swim-v0 without physics and without compilation, for other projects' tests.

The fish glides stiffly along its nose, faster the more its muscles are contracted. Everything else, from seeding to
the end of an episode, is the code of the real environments; their kernels run as Python.
"""

from fish_env.envs.single import FishEnv
from fish_env.envs.step import contract_all, make_measure_and_observe, recall_all
from fish_env.envs.vector import FishVectorEnv
from fish_env.tasks import SwimTask


class StubVectorEnv(FishVectorEnv):
    """`FishVectorEnv` whose fish glide instead of swimming. Nothing is compiled."""

    tasks = {"swim": SwimTask}

    def _compile(self):
        super()._compile()
        self._measure_and_observe = make_measure_and_observe(self._kernels, self._sensing)
        self._step = None

    def _move(self):
        if not getattr(contract_all, "py_func", contract_all)(self._env):
            return False
        if self._memory:
            getattr(recall_all, "py_func", recall_all)(self._env)
        tank, fish, contraction = self.tank, self.tank.fish, self._contraction
        shorter = contraction - fish.lengthening * contraction[:, fish.mirrored_muscles]
        tank.rest_length[:, fish.muscles] = tank.natural - shorter * tank.span
        tank.velocity[:] = (tank.fish.length * contraction.mean(axis=1)[:, None] * self._pose.axes[:, 0])[:, None]
        tank.position[:] += tank.velocity * self.control_interval
        tank.time[:] += self.control_interval
        self._measure_and_observe(self._env, 0, self.num_envs, True)
        return True


class StubEnv(FishEnv):
    """`FishEnv` on `StubVectorEnv`."""

    vector_class = StubVectorEnv
