"""What a motion costs the body: the largest strain of its units, and the work its muscles do."""

from typing import NamedTuple

import numpy as np

from fish_env._jit import njit


class Load(NamedTuple):
    """Strain and work of B fish since their start, and what the next decision needs of the last."""

    strain: np.ndarray  # (B,) the largest |length / natural length - 1| of any unit at a decision
    work: np.ndarray  # (B,) J, put in by shortening the muscles' rest lengths under tension
    tension: np.ndarray  # (B,K) N, of each fibre at the last decision
    rest: np.ndarray  # (B,K) m, its rest length then


def make_load(tank) -> Load:
    """Nothing yet, for relaxed fish of a tank."""
    b, k = tank.num_fish, tank.fish.fibres.size
    return Load(np.zeros(b), np.zeros(b), np.zeros((b, k)), np.tile(tank.fibre_length, (b, 1)))


def measure_load(tank, load: Load) -> None:
    """Take the state of every fish into account, once a decision."""
    springs = tank.fish.body.springs
    add_load(
        springs.nodes, springs.rest_length, springs.stiffness, tank.variation[:, 0], tank.fish.fibres,
        tank.position, tank.rest_length, *load,
    )  # fmt: skip


@njit
def add_load(nodes, natural, stiffness, factor, fibres, x, rest_length, strain, work, tension, rest):
    """Update the four arrays of a `Load` for units of the given stiffness (E,) times each fish's factor (B,).

    A fibre whose rest length l0 moves under the elastic tension T takes in the work -T dl0, by the trapezoidal rule
    over the interval (docs/physics.md, eq. 41).
    """
    for b in range(x.shape[0]):
        for e in range(natural.size):
            strain[b] = max(strain[b], abs(distance(x[b], nodes[e]) / natural[e] - 1.0))
        for m in range(fibres.size):
            e = fibres[m]
            now = rest_length[b, e]
            pull = factor[b] * stiffness[e] * (distance(x[b], nodes[e]) - now)
            work[b] -= 0.5 * (pull + tension[b, m]) * (now - rest[b, m])  # (41)
            tension[b, m], rest[b, m] = pull, now


@njit
def distance(x, pair):
    """Distance, m, between two nodes of x (N,3)."""
    i, j = pair
    return np.sqrt((x[i, 0] - x[j, 0]) ** 2 + (x[i, 1] - x[j, 1]) ** 2 + (x[i, 2] - x[j, 2]) ** 2)
