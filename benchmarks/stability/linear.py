"""Step-size limits by linear theory: the body's vibrations at rest, each moved by the method's own kernel."""

import numpy as np

from fish_env import Tank
from fish_env.physics.body import make_body
from fish_env.physics.fish import ElasticObject
from fish_env.physics.forces.evaluate import Evaluator
from fish_env.physics.records import Body
from fish_env.physics.world import VACUUM


def modes(body: Body) -> tuple[np.ndarray, np.ndarray]:
    """Squared frequencies (K,) 1/s2 and damping rates (K,) 1/s of the body's vibrations at rest, rigid motion left out.

    The damping of a mode is its part of the springs' damping: exact where all springs have the same relaxation time,
    an estimate for the default fish, whose damping differs along the body.
    """
    still = np.zeros_like(body.position)
    matrices = Evaluator(body, VACUUM).jacobian(body.springs.rest_length, body.position, still)
    root = np.repeat(body.mass, 3) ** -0.5
    stiffness, damping = np.array(matrices) * np.outer(root, root)
    squares, shapes = np.linalg.eigh(stiffness)
    real = squares > 1e-9 * squares[-1]
    return squares[real], np.einsum("ik,ij,jk->k", shapes, damping, shapes)[real]


def oscillators(body: Body) -> Body:
    """A body with two nodes and one spring for each vibration of the given one: same frequency, same damping."""
    squares, damping = modes(body)
    pairs = np.arange(2 * squares.size).reshape(-1, 2)
    position = np.zeros((2 * squares.size, 3))
    position[1::2, 0] = 1.0
    position[:, 1] = 10.0 * np.repeat(np.arange(squares.size), 2)
    made = make_body(position, np.full(2 * squares.size, 2.0), pairs, squares, damping, np.ones(squares.size), [])
    return made._replace(
        max_stiffness_eigenvalue=body.max_stiffness_eigenvalue, max_damping_eigenvalue=body.max_damping_eigenvalue
    )


def growth(tank: Tank, h: float) -> float:
    """Largest factor by which one step of h s makes a small vibration of the oscillators in a tank of four grow."""
    tank.reset()
    tank._set_read_only(dt=h)
    engine = tank._engine
    engine._rows.clear()  # no plans for steps of another length: a new tank for each step would take far longer
    engine._plans.clear()
    for i in range(4):
        engine.choose_step(i)
    state, small, omega = tank.state, 1e-5, np.sqrt(tank.fish.body.springs.stiffness)
    for row, side in ((0, 0.5), (1, -0.5)):  # each spring longer and shorter, then faster and slower
        state.x[row, 1::2, 0] += side * small
        state.x[row, ::2, 0] -= side * small
        state.v[2 + row, 1::2, 0] = side * small * omega
        state.v[2 + row, ::2, 0] = -side * small * omega
    tank.advance(1)
    if state.failure.any():
        return np.inf
    apart = state.x[:, 1::2, 0] - state.x[:, ::2, 0]
    speed = (state.v[:, 1::2, 0] - state.v[:, ::2, 0]) / omega
    columns = [(side[::2] - side[1::2]) / (2 * small) for side in (apart, speed)]  # of what was longer, what was faster
    return float(np.abs(np.linalg.eigvals(np.moveaxis(np.array(columns), 2, 0))).max())


def linear_limit(name: str, body: Body, longest: float) -> float:
    """First step, s, at which a method lets a small vibration of the body in vacuum grow; inf if none up to `longest`.

    Each mode is an oscillator of two nodes, moved by the method's own kernel, so a filter that looks at the whole
    body's highest frequency does so here. Unstable: grows by more than 1e-9 a step.
    """
    pairs = oscillators(body)
    thing = ElasticObject(name="oscillators", body=pairs, length=1.0, time_step=longest, control_interval=longest)
    tank = Tank(thing, 4, name, longest, threads=1)
    squares, damping = pairs.springs.stiffness, pairs.springs.damping
    omega = np.sqrt(squares.max())
    relaxation = (damping / squares)[damping > 0].min(initial=1.0 / omega)
    first = 0.02 * min(1.0 / omega, relaxation, 1.0 / max(omega, damping.max()))
    below = 0.0
    for h in np.append(np.geomspace(first, longest, 1 + int(np.log(longest / first) / np.log(1.03))), longest):
        if growth(tank, h) > 1.0 + 1e-9:
            break
        below = h
    else:
        return np.inf
    while h - below > 1e-6 * h:
        middle = 0.5 * (below + h)
        below, h = (below, middle) if growth(tank, middle) > 1.0 + 1e-9 else (middle, h)
    return float(h)
