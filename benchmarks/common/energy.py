"""Stretch and energy of all fish of a tank."""

import numpy as np

from fish_env.physics.tank import Tank


def stretch_and_energy(tank: Tank) -> tuple[np.ndarray, np.ndarray]:
    """Of every fish, (B,): largest length over rest length of any spring; kinetic and elastic energy, J."""
    springs = tank.fish.body.springs
    apart = tank.position[:, springs.nodes[:, 1]] - tank.position[:, springs.nodes[:, 0]]
    length = np.sqrt(np.einsum("bek,bek->be", apart, apart))
    kinetic = np.einsum("n,bnk,bnk->b", tank.fish.body.mass, tank.velocity, tank.velocity)
    energy = 0.5 * (kinetic + (length - tank.rest_length) ** 2 @ springs.stiffness)
    return (length / springs.rest_length).max(axis=1), energy
