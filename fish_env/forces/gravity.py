"""Weight, and the drag of air on every node (Song 2009, ch. 4.1; the diagonal damping of the finite-element text)."""

import math

from fish_env._jit import njit


@njit
def add_force(mass, gravity, viscosity, v, f):
    """Add m g - mu v to f (N,3) N."""
    if gravity is None:
        return
    for i in range(mass.size):
        for k in range(3):
            f[i, k] += mass[i] * gravity[k] - viscosity * v[i, k]  # (57)


@njit
def drag(gravity, viscosity):
    """Viscosity, N s/m, of the air that comes with gravity; none without."""
    if gravity is None:
        return 0.0
    return viscosity


@njit
def add_damping(gravity, viscosity, damping):
    """Add -df/dv to damping (3N,3N) N s/m."""
    for i in range(damping.shape[0]):
        damping[i, i] += drag(gravity, viscosity)


@njit
def slow(inverse_mass, gravity, viscosity, duration, v):
    """What the drag alone makes of the velocities v (N,3) m/s in a `duration` (s): they decay, exactly."""
    if gravity is None:
        return
    if viscosity == 0.0:
        return
    for i in range(v.shape[0]):
        for k in range(3):
            v[i, k] *= math.exp(-duration * viscosity * inverse_mass[i, k])


@njit
def energy(mass, gravity, x):
    """Potential energy of the weight, J, zero at the origin."""
    if gravity is None:
        return 0.0
    total = 0.0
    for i in range(mass.size):
        for k in range(3):
            total -= mass[i] * gravity[k] * x[i, k]
    return total
