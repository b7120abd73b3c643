"""Actions for pairs of muscles: the mean of the upper and the lower muscle of a side, and their difference.

Independent noise on every muscle mostly twists the fish; noise on pairs bends it, by which it finds out how to swim.
The difference allows what pairs alone cannot do, roll and pitch.
"""

import gymnasium as gym
import numpy as np
from stable_baselines3.common.vec_env import VecEnv, VecEnvWrapper
from stable_baselines3.common.vec_env.base_vec_env import VecEnvObs

from fish_env.bodies import Fish
from fish_env.envs import FishVectorEnv
from fish_env.envs.sb3 import FishVecEnv

DIFFERENCE_WEIGHT = 0.4  # weight of the difference, relative to the common part
ACTION_LIMIT = 3.0  # a learner's actions are not clipped to [-1, 1]: those of the muscles are, after they are combined


def batch_of(env: VecEnv | None) -> FishVectorEnv:
    """The batch of fish under the wrappers of a `VecEnv`; ValueError if there is no environment, or none of fish."""
    bare = None if env is None else env.unwrapped
    if not isinstance(bare, FishVecEnv):
        raise ValueError(f"the environment is {bare!r}; give one that make_sb3_vec_env returned")
    return bare.fish


def synergies(env: FishVectorEnv, size: int | None = None) -> np.ndarray:
    """The matrix (A,A') from a learner's actions, `size` of them or as many as the environment has, to the latter's.

    The action at the place of the upper muscle of a pair moves both, that of the lower one sets their difference. A
    learner with one action for each pair moves both muscles alike. In an environment with an action for each pair, the
    actions are the same.
    """
    fish, own = env.tank.fish, int(env.groups.max()) + 1
    matrix = np.eye(own)
    if own <= fish.grouping("pairs").max() + 1:
        return matrix
    if size is not None and size < own:
        return matrix[:, :size][fish.grouping("pairs")]
    for upper, lower in pairs(fish):
        matrix[upper, lower], matrix[lower, upper], matrix[lower, lower] = DIFFERENCE_WEIGHT, 1.0, -DIFFERENCE_WEIGHT
    return matrix


def pairs(fish: Fish) -> np.ndarray:
    """The upper and the lower muscle of each pair, (P,2), in the order of the environment's pairs."""
    group = fish.grouping("pairs")
    found = (np.flatnonzero(group == pair) for pair in range(group.max() + 1))
    return np.array([muscles[np.argsort(-fish.heights[muscles])] for muscles in found])


def common_actions(fish: Fish, size: int) -> np.ndarray:
    """Which of a learner's actions, `size` of them, moves both muscles of each pair, (P,)."""
    upper = pairs(fish)[:, 0]
    return np.arange(size) if size == upper.size else upper


def mirrored_actions(fish: Fish) -> np.ndarray:
    """The action for a pair that each becomes when left and right are exchanged, (P,)."""
    return fish.grouping("pairs")[fish.mirrored_muscles[pairs(fish)[:, 0]]]


class SynergyWrapper(VecEnvWrapper):
    """Turns a learner's actions into those of the muscles of the environment; `twist` is False for one a pair."""

    def __init__(self, venv: VecEnv, twist: bool = True):
        env = batch_of(venv)
        self.synergy_matrix = synergies(env, None if twist else len(pairs(env.tank.fish)))
        """(A,A') from the learner's actions to those of the environment: `export_policy` looks for it by this name."""
        self.matrix = self.synergy_matrix.T.astype(np.float32)
        size = len(self.matrix)
        super().__init__(venv, action_space=gym.spaces.Box(-ACTION_LIMIT, ACTION_LIMIT, (size,), dtype=np.float32))

    def step_async(self, actions: np.ndarray) -> None:
        """Combine the actions and hand them to the environment."""
        self.venv.step_async(actions @ self.matrix)

    def step_wait(self):
        """Return the results of the environment's step."""
        return self.venv.step_wait()

    def reset(self) -> VecEnvObs:
        """Begin new episodes."""
        return self.venv.reset()
