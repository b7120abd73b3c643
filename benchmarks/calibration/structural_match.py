"""Structural match of two fish: bending stiffness section by section, natural frequencies, effect of the muscles.

All by linear theory at rest, of a free fish in vacuum, on the landmarks that all bodies share.
"""

from typing import NamedTuple

import numpy as np
from scipy.sparse import csr_array

from fish_env import Tank
from fish_env.bodies import Fish
from fish_env.bodies import mass_spring as tu
from fish_env.forces import rest_matrices
from fish_env.linalg import rates
from fish_env.world import VACUUM

MODES = 4  # of lateral bending


class Measures(NamedTuple):
    """What is compared of two fish."""

    kink: np.ndarray  # (5,5) angles by which the fish kinks at layers 1 to 5 for a moment of 1 N m at each, rad
    frequency: np.ndarray  # (MODES,) of lateral bending, lowest first, Hz
    pull: np.ndarray  # (3,) angle between head and tail that a segment's left muscles make, fully contracted, rad


class Structure(NamedTuple):
    """A level fish bending sideways, linearised at rest."""

    basis: csr_array  # (3N,Q) orthonormal, of the motions it then makes
    matrix: np.ndarray  # (Q,Q) stiffness, N/m
    mass: np.ndarray  # (Q,) kg


def structure(fish: Fish) -> Structure:
    """The structure of a fish. Its basis: motions that are equal on left and right, and above and below."""
    x, n = fish.body.position, fish.body.mass.size
    group = [(np.arange(n), np.ones(3))]
    for axis, odd in ((1, (-1.0, 1.0, -1.0)), (2, (1.0, 1.0, -1.0)))[: 1 if fish.flat else 2]:
        mirror = np.where(np.arange(3) == axis, -1.0, 1.0)
        image = np.array([np.argmin(((x - point * mirror) ** 2).sum(axis=1)) for point in x])
        group += [(image[nodes], sign * odd) for nodes, sign in group]
    rows, columns, values, count = [], [], [], 0
    for i in range(n):
        if not all(i <= nodes[i] for nodes, _ in group):
            continue  # another node of the orbit stands for it
        for k in range(3):
            column: dict[int, float] = {}
            for nodes, sign in group:
                place = 3 * int(nodes[i]) + k
                column[place] = column.get(place, 0.0) + sign[k]
            size = np.linalg.norm(list(column.values()))
            if size > 0.0 and fish.body.inverse_mass[i, k] > 0.0:
                rows += column
                columns += [count] * len(column)
                values += [value / size for value in column.values()]
                count += 1
    basis = csr_array((values, (rows, columns)), shape=(3 * n, count))
    matrix = basis.T @ csr_array(rates.assemble(rest_matrices(fish.body), 3 * n)) @ basis
    return Structure(basis, matrix.toarray(), (basis.T**2) @ np.repeat(fish.body.mass, 3))


def respond(fish: Fish, frame: Structure, force) -> np.ndarray:
    """Displacement (N,3) m of the free fish under a force (N,3) N that is balanced in itself; not moved as a whole."""
    x = fish.body.position
    rigid = np.stack([np.tile([0.0, 1.0, 0.0], (len(x), 1)), np.cross([0.0, 0.0, 1.0], x - x.mean(axis=0))])
    rigid, _ = np.linalg.qr(frame.basis.T @ rigid.reshape(2, -1).T)
    fixed = frame.matrix + np.trace(frame.matrix) / len(frame.matrix) * rigid @ rigid.T
    return (frame.basis @ np.linalg.solve(fixed, frame.basis.T @ force.ravel())).reshape(x.shape)


def stations(fish: Fish) -> list[np.ndarray]:
    """Nodes of the head, of the cross-sections at layers 1 to 5, and of the tail's end: 7 arrays.

    Of the head all nodes in its foremost half, since a point gives way the more, the finer the body is divided.
    """
    x, at = fish.body.position[:, 0], fish.points(fish.body.position)[:, 0]
    places = [at[nodes].mean() for nodes in tu.LAYERS[1:]]
    head = np.flatnonzero(x > 0.5 * places[0] - 1e-6 * fish.length)
    return [head, *(np.flatnonzero(np.abs(x - place) < 1e-6 * fish.length) for place in places)]


def kinks(fish: Fish) -> np.ndarray:
    """Weights (5,N) whose sum with the nodes' y is the angle by which the line through the stations kinks at layer k.

    The same weights are forces, N, that a moment of 1 N m makes there: three-point bending.
    """
    sets = stations(fish)
    place = [fish.body.position[nodes, 0].mean() for nodes in sets]
    weights = np.zeros((5, fish.body.mass.size))
    for k in range(5):
        ahead, behind = place[k] - place[k + 1], place[k + 1] - place[k + 2]
        parts = (1.0 / ahead, -1.0 / ahead - 1.0 / behind, 1.0 / behind)
        for nodes, part in zip(sets[k : k + 3], parts, strict=True):
            weights[k, nodes] = part / len(nodes)
    return weights


def measures(fish: Fish) -> Measures:
    """Measure a fish that has the default one's landmarks."""
    frame, weights, sideways = structure(fish), kinks(fish), np.array([0.0, 1.0, 0.0])
    kink = [weights @ respond(fish, frame, row[:, None] * sideways)[:, 1] for row in weights]
    squares = np.linalg.eigvalsh(frame.matrix / np.sqrt(np.outer(frame.mass, frame.mass)))
    squares = squares[squares > 1e-7 * fish.body.max_stiffness_eigenvalue][:MODES]
    bent = weights.sum(axis=0)
    pull = [bent @ respond(fish, frame, contraction(fish, segment))[:, 1] for segment in range(3)]
    return Measures(np.array(kink), np.sqrt(squares) / (2 * np.pi), np.array(pull))


def contraction(fish: Fish, segment) -> np.ndarray:
    """Forces (N,3) N with which the left muscles of a segment, contracted fully, pull at rest."""
    body, force = fish.body, np.zeros_like(fish.body.position)
    for fibre, (upper, lower) in zip(fish.fibres, fish.drives, strict=True):
        if fish.segments[upper] != segment or fish.sides[upper] < 0:
            continue
        i, j = body.springs.nodes[fibre]
        along = body.position[j] - body.position[i]
        short = (1.0 - fish.contracted[[upper, lower]].mean()) * body.springs.rest_length[fibre]
        pull = body.springs.stiffness[fibre] * short * along / np.linalg.norm(along)
        force[i] += pull
        force[j] -= pull
    return force


def first_bending(fish: Fish) -> tuple[float, np.ndarray]:
    """Frequency, Hz, and shape (N,3), the tail tips' mean sideways displacement 1, of the lowest bending vibration."""
    frame = structure(fish)
    squares, shapes = np.linalg.eigh(frame.matrix / np.sqrt(np.outer(frame.mass, frame.mass)))
    first = np.argmax(squares > 1e-7 * fish.body.max_stiffness_eigenvalue)
    shape = (frame.basis @ (shapes[:, first] / np.sqrt(frame.mass))).reshape(fish.body.position.shape)
    return float(np.sqrt(squares[first]) / (2 * np.pi)), shape / shape[fish.tail, 1].mean()


def swing(fish: Fish, sweep: float, seconds: float = 0.6) -> float:
    """Frequency, Hz, in vacuum, of a fish released in its first bending mode, its tail displaced by `sweep` m.

    Raises:
        ValueError: if it breaks.
    """
    tank, tail = Tank(fish, 1, water=VACUUM), []
    tank.position[0] += sweep * first_bending(fish)[1]
    share, still = fish.body.mass / fish.body.mass.sum(), np.zeros((1, fish.num_muscles))
    while len(tail) * tank.dt < seconds:
        tank.drive(still, 1)
        tail.append(tank.position[0, fish.tail, 1].mean() - share @ tank.position[0, :, 1])
    if tank.failure[0]:
        raise ValueError(f"the fish breaks: {tank.failure[0]}; give a smaller sweep than {sweep} m")
    tail = np.array(tail)
    down = np.flatnonzero((tail[:-1] > 0) & (tail[1:] <= 0))
    return float(1.0 / np.diff((down + tail[down] / (tail[down] - tail[down + 1])) * tank.dt).mean())
