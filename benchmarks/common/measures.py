"""Poses, stretch and energy of all fish of a tank at once."""

import numpy as np

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


def stretch_and_energy(tank: Tank) -> tuple[np.ndarray, np.ndarray]:
    """Of every fish, (B,): largest length over rest length of any spring; kinetic and elastic energy, J."""
    springs = tank.fish.body.springs
    apart = tank.position[:, springs.nodes[:, 1]] - tank.position[:, springs.nodes[:, 0]]
    length = np.sqrt(np.einsum("bek,bek->be", apart, apart))
    kinetic = np.einsum("n,bnk,bnk->b", tank.fish.body.mass, tank.velocity, tank.velocity)
    energy = 0.5 * (kinetic + (length - tank.rest_length) ** 2 @ springs.stiffness)
    return (length / springs.rest_length).max(axis=1), energy
