"""Oscillating beams, distorted blocks and the deformation of elements, for tests of elements and elastic objects."""

import numpy as np

from benchmarks.common.beam import LENGTH, cantilever, loose, solid, vertical
from fish_env import Tank, make_world
from fish_env.physics.forces.evaluate import Evaluator
from fish_env.physics.records import Body
from fish_env.physics.world import VACUUM
from fish_env.soft import statics
from fish_env.soft.distorted import out_of_shape
from fish_env.soft.mesh import box

__all__ = ["STEPS", "cantilever", "damped_block", "deformation", "deformed_start", "implicit_euler", "rates_of",
           "recover", "ringing"]  # fmt: skip
STEPS = {"linearly_implicit": 0.05, "leapfrog_chebyshev": 0.02}
"""Steps of `recover` by method, over the reciprocal of the lowest angular frequency."""


def deformation(body: Body, x) -> np.ndarray:
    """Deformation gradients (T,3,3) of the elements at x (N,3)."""
    return np.einsum("tac,tad->tcd", x[body.tets.nodes], body.tets.gradient)


def ringing(body: Body, method: str, periods: float, steps_a_period: int, amplitude=1e-4):
    """Displacements along the beam's first mode, over the first one, and energies, J, at every step after release."""
    frequency, shape = vertical(body)
    scale = amplitude * LENGTH / np.abs(shape).max()
    step = 1.0 / (frequency * steps_a_period)
    tank, evaluator = Tank(loose(body, step), 1, method, step), Evaluator(body, VACUUM)
    tank.position[0] += scale * shape
    places, energies = [], []
    for _ in range(round(periods * steps_a_period) + 1):
        x, v = tank.position[0], tank.velocity[0]
        places.append(np.einsum("n,nk,nk->", body.mass, shape, x - body.position) / scale)
        energies.append(sum(evaluator.energies(body.springs.rest_length, x, v).values()))
        tank.advance(1)
    return np.array(places), np.array(energies)


def rates_of(places, steps_a_period: int) -> tuple[float, float]:
    """Angular frequency and decay rate, times a period, of a damped vibration (Prony's method).

    Samples at equal intervals obey q'' = a q' - b q, which is exact for any method that is linear: no fit of a curve.
    """
    stride = max(1, steps_a_period // 8)
    q = places[::stride]
    a, b = np.linalg.lstsq(np.stack([q[1:-1], -q[:-2]], axis=1), q[2:], rcond=None)[0]
    exponent = np.log(np.roots([1.0, -a, b]).astype(complex)[0]) * steps_a_period / stride
    return float(abs(exponent.imag)), float(-exponent.real)


def implicit_euler(relaxation: float, steps_a_period: int) -> tuple[float, float]:
    """As `rates_of`, of implicit Euler on a vibration whose relaxation time is given in periods."""
    turn = 2.0 * np.pi / steps_a_period
    damping = turn * 2.0 * np.pi * relaxation
    exponent = np.log(np.roots([1.0 + damping + turn**2, -2.0 - damping, 1.0]).astype(complex)[0]) * steps_a_period
    return float(abs(exponent.imag)), float(-exponent.real)


def damped_block(cells, edge=0.05, poisson=0.3) -> tuple[Body, float]:
    """A free block of cubes, its lowest vibration critically damped, and that vibration's angular frequency, 1/s."""
    position, nodes = box(edge * np.array(cells), cells, mirrored=True)
    lowest = 2.0 * np.pi * statics.modes(solid(position, nodes, poisson), 7)[0][6]
    return solid(position, nodes, poisson, relaxation_time=2.0 / lowest), float(lowest)


def deformed_start(body: Body, how: str, seed: int) -> np.ndarray:
    """A start (N,3) m: "reflected" or "flattened" in the plane z = 0 with noise, or "scrambled".

    A scrambled body has its nodes at random places such that no element is stretched to more than twice its length.
    """
    rng = np.random.default_rng(seed)
    x, size = body.position, np.ptp(body.position[:, 2])
    noise = 0.01 * size * rng.standard_normal(x.shape)
    if how == "scrambled":
        x = rng.uniform(-0.5, 0.5, x.shape) * np.ptp(x, axis=0)
        while not ((deformation(body, x) ** 2).sum(axis=(1, 2)) - 2.0 <= 4.0).all():
            x *= 0.98
        return x
    return x * [1.0, 1.0, {"reflected": -1.0, "flattened": 0.0}[how]] + noise


def recover(body: Body, lowest: float, start, method: str, most=400.0) -> dict:
    """Let a damped body go in thin air until it has its shape again: the inverted part at the start, and the end.

    Times are in units of 1 / lowest, the reciprocal of the lowest angular frequency.
    """
    step = STEPS[method]
    air = make_world(viscosity=0.2 * lowest * float(body.mass.mean()))
    tank = Tank(loose(body, step / lowest), 1, method, step / lowest, air)
    tank.position[0] = start
    inverted = float((np.linalg.det(deformation(body, start)) < 0).mean())
    while tank.alive[0] and tank.time[0] * lowest < most and not out_of_shape(body, tank.position[0]) < 1e-6:
        tank.advance(round(1.0 / step))
    return {"inverted_at_start": inverted, "out_of_shape": out_of_shape(body, tank.position[0]),
            "failure": tank.failure[0]}  # fmt: skip
