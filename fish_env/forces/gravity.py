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
def weight(gravity, viscosity, factor, h, least):
    """What `add_tangent` multiplies each displacement by, kg: of the air's drag; as `tets.weights`."""
    if gravity is None:
        return 0.0
    return max(2.0 * factor, least) * h * viscosity


@njit
def add_tangent(gravity, air, y, f):
    """Add to f (N,3) what the air holds back, by its weight, if every node moved by y (N,3)."""
    if gravity is None:
        return
    for i in range(y.shape[0]):
        for k in range(3):
            f[i, k] -= air * y[i, k]


@njit
def rate(gravity, viscosity, inverse_mass):
    """Viscosity over the lightest node's mass, 1/s."""
    if gravity is None:
        return 0.0
    return viscosity * inverse_mass.max()


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
