"""Derivatives of a control interval: the kernels of the method, called with dual numbers.

Legend: b fish; d direction of the dual numbers; c column, one of positions, velocities, start and rate of the fibres.
"""

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from fish_env.kernels.compile import INDEX, njit
from fish_env.kernels.simd import Kind, directions, floats, lane
from fish_env.physics import forces
from fish_env.physics.engine import gather, make_failure_codes
from fish_env.physics.failures import FAILURES
from fish_env.physics.forces.plan import H
from fish_env.physics.muscles import opposed_fibres

if TYPE_CHECKING:
    from fish_env.physics.tank import Tank


class Jacobians(NamedTuple):
    """Derivatives of the S = 6N + K numbers of a fish's state after an interval, a row for each.

    They are the positions (N,3) m, the velocities (N,3) m/s and the rest lengths (K,) m of the springs
    `np.unique(fish.fibres)`, flat and in this order.
    """

    state: np.ndarray
    """(B,S,S), a column for each number of the state before the interval."""
    command: np.ndarray
    """(B,S,M), a column for the commanded contraction of each muscle, or for each action of an environment."""


@forces.cached
def make_differentiated(names: tuple[str, ...], make_run):
    """Compile the interval of one fish with dual numbers, for the forces of these names."""
    run, failure_codes = make_run(names), make_failure_codes(names)

    @njit
    def call(tank, block, row, steps, first, found):
        control = block.control
        gather(tank, block, block.todo, 0, 1)
        x, v, start, rate = floats(block.x), floats(block.v), floats(control.start), floats(control.rate)
        nodes, fibres, width = 3 * block.x.size, start.shape[0], directions(block.x)
        for d in range(width):
            for c in range(2 * (nodes + fibres)):
                seed = 1.0 if c == first + d else 0.0
                if c < nodes:
                    x[c // 3, c % 3, 1 + d] = seed
                elif c < 2 * nodes:
                    v[(c - nodes) // 3, c % 3, 1 + d] = seed
                elif c < 2 * nodes + fibres:
                    start[c - 2 * nodes, 1 + d] = seed
                else:
                    rate[c - 2 * nodes - fibres, 1 + d] = seed
        control.row[0] = row
        run(block.body, block.world, control, block.x, block.v, block.work, block.cache, steps)
        for d in range(min(width, found.shape[1] - first)):
            for i in range(nodes):
                found[i, first + d] = x[i // 3, i % 3, 1 + d]
                found[nodes + i, first + d] = v[i // 3, i % 3, 1 + d]
        return lane(failure_codes(block), 0), control.plans[INDEX(row), H] * lane(control.fastest[0], 0)

    return call


def linearise(tank: "Tank", contraction: np.ndarray, steps: int) -> Jacobians:
    """Derivatives of the interval that `tank.drive(contraction, steps)` would move the fish by; they do not move."""
    engine, fish = tank._engine, tank.fish
    if engine is None or tank.conditioned:
        reason = "adapts its steps" if engine is None else "has nodes that are fixed or moved"
        raise ValueError(f"a tank that {reason} has no derivatives; take another method, or release the nodes")
    nodes, driven = tank.state.x[0].size, np.unique(fish.fibres)
    count = 2 * nodes + len(driven)
    shape = tank.num_fish, count
    found = Jacobians(np.zeros((*shape, count)), np.zeros((*shape, fish.num_muscles)))
    effort, pending, duration = tank.effort.copy(), tank.control.rate.copy(), steps * tank.dt
    tank.command(contraction, duration)
    try:
        block = engine.new_block(1, Kind("dual"))
        call = make_differentiated(engine.names, engine.method.make_run)
        for b in range(tank.num_fish):
            block.todo[0] = b
            if not tank.alive[b]:
                raise ValueError(f"fish {b} has failed ({tank.failure[b]}); reset it")
            ends = _differentiate(tank, call, block, steps)
            of_state, of_command = _rest_lengths(tank, b, contraction[b], duration)
            start, rate = ends[:, 2 * nodes : count], ends[:, count:]
            before, command = of_state - np.eye(len(driven)), of_command
            found.state[b, : 2 * nodes] = np.hstack([ends[:, : 2 * nodes], start + rate @ before / duration])
            found.state[b, 2 * nodes :, 2 * nodes :] = of_state
            found.command[b, : 2 * nodes], found.command[b, 2 * nodes :] = rate @ command / duration, command
    finally:
        tank.control.rate[:], tank.effort[:] = pending, effort
    return found


def _differentiate(tank: "Tank", call, block, steps: int) -> np.ndarray:
    """Derivatives of positions and velocities at the end, (6N, 6N + 2K), at the steps that the fish takes."""
    engine, nodes, b = tank._engine, tank.state.x[0].size, block.todo[0]
    assert engine is not None
    width = block.x.memory.shape[2] - 1
    found = np.zeros((2 * nodes, 2 * nodes + 2 * block.control.driven.size))
    for level in range(engine.levels):
        taken = tank.pack, block, engine.row[b] + level, steps << level
        code, strain = call(*taken, 0, found)
        if code == 0.0 and strain <= tank.refine:
            break
    if code != 0.0:
        raise ValueError(f"fish {b} fails in this interval ({FAILURES[int(code)]}); give smaller steps")
    for first in range(width, found.shape[1], width):
        call(*taken, first, found)
    return found


def _rest_lengths(tank: "Tank", b: int, contraction: np.ndarray, duration: float) -> tuple[np.ndarray, np.ndarray]:
    """Derivatives of the rest lengths (K,) after an interval: with respect to those before, and to the command (M,)."""
    fish, (strength, slowness) = tank.fish, tank.muscle_variation[b]
    fibres, drives, natural, span = tank._fibres
    one, limit = np.eye(len(fibres)), duration / (fish.contraction_time * slowness)
    opposed = fish.lengthening * one[opposed_fibres(fish)]
    contract = (one + opposed) / (1.0 - fish.lengthening**2) / strength  # (2)
    before = contract @ ((natural - tank.rest_length[b, fibres]) / span)
    by_command = 0.5 * np.eye(fish.num_muscles)[drives].sum(axis=1)
    free = (np.abs(by_command @ contraction - before) <= limit)[:, None]  # (1)
    shorten, order = -strength * span[:, None] * (one - opposed), np.argsort(fibres)
    after = shorten @ np.where(free, 0.0, -contract / span), shorten @ np.where(free, by_command, 0.0)
    return after[0][np.ix_(order, order)], after[1][order]
