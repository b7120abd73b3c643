"""The beam's first vibration in time: its frequency and its decay, by two methods and many steps."""

import numpy as np

from benchmarks.common.beam import LENGTH, cantilever, elastic_energy, loose, vertical
from fish_env import Tank
from fish_env.body import Body


def ringing(body: Body, method: str, periods: float, steps_a_period: int, amplitude=1e-4):
    """Displacements along the first mode, over the first one, and energies, J, of the beam let go, at every step.

    `periods` and steps are those of the mode. Both arrays have an entry a step, and one for the start.
    """
    frequency, shape = vertical(body)
    scale = amplitude * LENGTH / np.abs(shape).max()
    step = 1.0 / (frequency * steps_a_period)
    tank = Tank(loose(body, step), 1, method, step)
    tank.position[0] += scale * shape
    places, energies = [], []
    for _ in range(round(periods * steps_a_period) + 1):
        x, v = tank.position[0], tank.velocity[0]
        places.append(np.einsum("n,nk,nk->", body.mass, shape, x - body.position) / scale)
        energies.append(0.5 * np.einsum("n,nk,nk->", body.mass, v, v) + elastic_energy(body, x))
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


def vibrating(n=2) -> list[dict]:
    """The first mode in time: its frequency and decay over what they should be, and the energy left after a period."""
    rows = []
    plain = cantilever(n)
    period = 1.0 / vertical(plain)[0]
    for relaxation in (0.0, 0.01):
        body = cantilever(n, relaxation_time=relaxation * period)
        wanted = 0.5 * relaxation * (2.0 * np.pi) ** 2  # s omega^2 / 2, a period
        for method, steps in (
            *(("linearly_implicit", steps) for steps in (10, 20, 50, 100, 200, 500, 1000, 2000)),
            *(("leapfrog_chebyshev", steps) for steps in (50, 100, 200, 500)),
        ):
            places, energies = ringing(body, method, 3.0, steps)
            frequency, rate = rates_of(places, steps)
            rows.append({
                "relaxation_time": relaxation, "method": method, "steps_a_period": steps,
                "frequency": frequency / np.sqrt((2.0 * np.pi) ** 2 - wanted**2),
                "decay": rate, "decay_wanted": wanted,
                "decay_of_implicit_euler": implicit_euler(relaxation, steps)[1],
                "energy_after_a_period": energies[steps] / energies[0],
            })  # fmt: skip
            print(rows[-1], flush=True)
    return rows
