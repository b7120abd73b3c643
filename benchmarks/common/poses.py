"""Poses of all fish of a tank at once."""

from fish_env import Tank
from fish_env.kernels.compile import njit
from fish_env.physics.pose import Pose, make_pose, measure, packed_pose


@njit
def measure_all(tank, pose, count):
    """`measure` every fish."""
    for b in range(count):
        measure(tank, pose, b)


def pose_of(tank: Tank) -> Pose:
    """Centres of mass, their velocities and the axes of all fish, as they are now."""
    pose = make_pose(tank.num_fish)
    measure_all(tank.pack, packed_pose(pose), tank.num_fish)
    return pose
