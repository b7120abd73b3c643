"""Weight, and the drag of air on every node (Song 2009, ch. 4.1; the diagonal damping of the finite-element text)."""

from fish_env._jit import njit


@njit
def add_force(mass, gravity, viscosity, v, f):
    """Add m g - mu v to f (N,3) N."""
    if gravity is None:
        return
    for i in range(mass.size):
        for k in range(3):
            f[i, k] += mass[i] * gravity[k] - viscosity * v[i, k]  # (56)


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
