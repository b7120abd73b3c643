"""Recovery: reflected, flattened and scrambled blocks of tetrahedra return to their shape."""

import numpy as np

from benchmarks.common.beam import elastic_energy, loose, solid
from benchmarks.common.shapes import deformation
from fish_env import Tank, make_world, statics
from fish_env.bodies.distorted import out_of_shape
from fish_env.bodies.mesh import box
from fish_env.body import Body


def damped_block(cells, edge=0.05, poisson=0.3) -> tuple[Body, float]:
    """A free block of cubes, its lowest vibration critically damped, and that vibration's angular frequency, 1/s."""
    position, nodes = box(edge * np.array(cells), cells, mirrored=True)
    lowest = 2.0 * np.pi * statics.modes(solid(position, nodes, poisson), 7)[0][6]
    return solid(position, nodes, poisson, relaxation_time=2.0 / lowest), float(lowest)


def stretch(body: Body, x) -> np.ndarray:
    """Over its rest length, (T,): how long every element is, along its longest direction, the others being 1."""
    return np.sqrt(np.maximum((deformation(body, x) ** 2).sum(axis=(1, 2)) - 2.0, 0.0))


def deformed_start(body: Body, how: str, seed: int) -> np.ndarray:
    """A start (N,3) m: the body "reflected" or "flattened" in the plane z = 0 with noise, or "scrambled" at random."""
    rng = np.random.default_rng(seed)
    x, size = body.position, np.ptp(body.position[:, 2])
    noise = 0.01 * size * rng.standard_normal(x.shape)
    if how == "scrambled":  # as far as no element is stretched to more than twice its length
        x = rng.uniform(-0.5, 0.5, x.shape) * np.ptp(x, axis=0)
        while not (stretch(body, x) <= 2.0).all():
            x *= 0.98
        return x
    return x * [1.0, 1.0, {"reflected": -1.0, "flattened": 0.0}[how]] + noise


STEPS = {"linearly_implicit": 0.05, "leapfrog_chebyshev": 0.02}


def recover(body: Body, lowest: float, start, method: str, most=400.0) -> dict:
    """Let the damped body go from a start, in thin air, until it has its shape again: how long, and how well.

    Times and steps (STEPS) are in units of 1 / lowest, the lowest vibration's angular frequency.
    """
    step = STEPS[method]
    air = make_world(viscosity=0.2 * lowest * float(body.mass.mean()))
    tank = Tank(loose(body, step / lowest), 1, method, step / lowest, air)
    tank.position[0] = start
    inverted = float((np.linalg.det(deformation(body, start)) < 0).mean())
    while tank.alive[0] and tank.time[0] * lowest < most and not out_of_shape(body, tank.position[0]) < 1e-6:
        tank.advance(round(1.0 / step))
    return {
        "inverted_at_start": inverted, "time": float(tank.time[0] * lowest),
        "out_of_shape": out_of_shape(body, tank.position[0]),
        "energy_kept": elastic_energy(body, tank.position[0]) / elastic_energy(body, start),
        "failure": tank.failure[0],
    }  # fmt: skip


def recovering() -> list[dict]:
    """Deformed blocks under two methods, five seeds each."""
    rows = []
    for cells in ((2, 2, 2), (4, 4, 4), (12, 2, 2)):
        body, lowest = damped_block(cells)
        for how in ("reflected", "flattened", "scrambled"):
            for method in ("linearly_implicit", "leapfrog_chebyshev"):
                for seed in range(5):
                    result = recover(body, lowest, deformed_start(body, how, seed), method)
                    rows.append({"cells": "x".join(map(str, cells)), "start": how, "method": method, "seed": seed}
                                | result)  # fmt: skip
                    print(rows[-1], flush=True)
    return rows
