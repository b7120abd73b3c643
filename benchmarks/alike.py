"""How alike two fish are as structures: bending stiffness section by section, natural frequencies, what muscles do.

All by linear theory at rest, of a free fish in vacuum, on the landmarks that all bodies share.
"""

from typing import NamedTuple

import numpy as np

from fish_env import forces
from fish_env.bodies import Fish
from fish_env.bodies import mass_spring as tu
from fish_env.world import VACUUM

MODES = 4  # of lateral bending


class Measures(NamedTuple):
    """What makes two fish alike."""

    bend: np.ndarray  # (4,) rotation of each section behind the head under a moment of 1 N m, rad
    tail: float  # how far the tail tip gives way to a sideways force of 1 N, against the rest, m
    frequency: np.ndarray  # (MODES,) of lateral bending, lowest first, Hz
    pull: np.ndarray  # (3,) how far a segment's left muscles, fully contracted, bend layers 1 to 5, rad


def stiffness(fish: Fish) -> np.ndarray:
    """Stiffness (3N,3N) N/m at rest."""
    body = fish.body
    matrices = np.zeros((2, 3 * body.mass.size, 3 * body.mass.size))
    forces.jacobian(body, VACUUM, body.springs.rest_length, body.position, np.zeros_like(body.position), *matrices)
    return 0.5 * (matrices[0] + matrices[0].T)


def symmetric(fish: Fish) -> np.ndarray:
    """Orthonormal basis (3N,Q) of motions in which a level fish bends sideways.

    Free, the mirror image of themselves turned round between left and right, and of themselves between up and down.
    """
    x, n = fish.body.position, fish.body.mass.size
    free = fish.body.inverse_mass.ravel() > 0.0
    basis = np.eye(3 * n)[:, free]
    for axis, sign in ((1, -1.0), (2, 1.0)):
        mirror = np.ones(3)
        mirror[axis] = -1.0
        image = np.array([np.argmin(((x - point * mirror) ** 2).sum(axis=1)) for point in x])
        if fish.flat and axis == 2:
            continue
        flip = np.zeros((n, 3, n, 3))
        for i, j in enumerate(image):
            flip[i, range(3), j, range(3)] = mirror
        half = 0.5 * (np.eye(3 * n) + sign * flip.reshape(3 * n, -1)) @ basis
        u, s, _ = np.linalg.svd(half, full_matrices=False)
        basis = u[:, s > 0.5]
    return basis


def respond(matrix, basis, fish, force) -> np.ndarray:
    """Displacement (N,3) m of the free fish under a force (N,3) N that is balanced in itself; not moved as a whole."""
    x = fish.body.position
    rigid = np.stack([np.tile([0.0, 1.0, 0.0], (len(x), 1)), np.cross([0.0, 0.0, 1.0], x - x.mean(axis=0))])
    rigid, _ = np.linalg.qr(basis.T @ rigid.reshape(2, -1).T)
    reduced = basis.T @ matrix @ basis
    scale = np.trace(reduced) / len(reduced)
    return (basis @ np.linalg.solve(reduced + scale * rigid @ rigid.T, basis.T @ force.ravel())).reshape(x.shape)


def rotation(fish: Fish, u) -> np.ndarray:
    """Rotation about z of layers 1 to 5, (5,) rad, under displacements u (N,3)."""
    moved, at = u[fish.landmarks.node], fish.points(fish.body.position)
    turned = []
    for up_left, up_right, down_right, down_left in tu.LAYERS[1:6]:
        along = moved[[up_left, down_left], 0].sum() - moved[[up_right, down_right], 0].sum()
        turned.append(-along / (at[[up_left, down_left], 1].sum() - at[[up_right, down_right], 1].sum()))
    return np.array(turned)


def couple(fish: Fish, layer) -> np.ndarray:
    """Forces (N,3) N on the corners of a layer that turn it by 1 N m about z."""
    force, at = np.zeros_like(fish.body.position), fish.points(fish.body.position)
    up_left, up_right, down_right, down_left = tu.LAYERS[layer]
    wide = at[[up_left, down_left], 1].sum() - at[[up_right, down_right], 1].sum()
    for mark, sign in ((up_left, -1), (down_left, -1), (up_right, 1), (down_right, 1)):
        force[fish.landmarks.node[mark], 0] += sign / wide
    return force


def measures(fish: Fish) -> Measures:
    """Measure a fish that has the default one's landmarks."""
    body, matrix, basis = fish.body, stiffness(fish), symmetric(fish)
    turned = rotation(fish, respond(matrix, basis, fish, couple(fish, 1) - couple(fish, 5)))
    tail = np.zeros_like(body.position)
    tips = fish.landmarks.node[list(tu.TAIL)]
    for tip in tips:
        tail[tip, 1] += 0.5
    root = np.zeros_like(tail)
    for layer, weight in ((4, -1.0), (3, -1.0)):  # what holds against it: two layers, so that nothing turns
        del layer, weight
    x5, x4, xt = (fish.points(body.position)[nodes, 0].mean() for nodes in (tu.LAYERS[5], tu.LAYERS[4], list(tu.TAIL)))
    lever = (x4 - xt) / (x4 - x5)
    for layer, part in ((tu.LAYERS[5], -lever), (tu.LAYERS[4], lever - 1.0)):
        for mark in layer:
            root[fish.landmarks.node[mark], 1] += part / 4
    given = respond(matrix, basis, fish, tail + root)
    gave = given[tips, 1].mean() - (
        lever * given[fish.landmarks.node[tu.LAYERS[5]], 1].mean()
        + (1.0 - lever) * given[fish.landmarks.node[tu.LAYERS[4]], 1].mean()
    )
    mass = np.repeat(body.mass, 3)
    reduced = basis.T @ (matrix / np.sqrt(np.outer(mass, mass))) @ basis
    squares = np.linalg.eigvalsh(reduced)
    squares = squares[squares > 1e-6 * body.elastic_rate]
    return Measures(
        turned[:-1] - turned[1:], float(gave), np.sqrt(squares[:MODES]) / (2 * np.pi), pulls(fish, matrix, basis)
    )


def pulls(fish, matrix, basis) -> np.ndarray:
    """How far each segment's left muscles bend the fish, (3,) rad."""
    body, found = fish.body, []
    for segment in range(3):
        force = np.zeros_like(body.position)
        for fibre, (upper, lower) in zip(fish.fibres, fish.drives, strict=True):
            if fish.segments[upper] != segment or fish.sides[upper] < 0:
                continue
            i, j = body.springs.nodes[fibre]
            along = body.position[j] - body.position[i]
            short = (1.0 - fish.contracted[[upper, lower]].mean()) * body.springs.rest_length[fibre]
            pull = body.springs.stiffness[fibre] * short * along / np.linalg.norm(along)
            force[i] += pull
            force[j] -= pull
        turned = rotation(fish, respond(matrix, basis, fish, force))
        found.append(turned[0] - turned[4])
    return np.array(found)
