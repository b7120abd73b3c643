"""The force on every node: the sum over the force modules, a line each."""

from fish_env._jit import njit
from fish_env.forces import springs, water


@njit
def total(body, world, rest_length, x, v, f):
    """Sum of all forces on the nodes of one body: f (N,3) N is overwritten. rest_length (E,), x and v (N,3)."""
    f[:] = 0.0
    springs.add_force(body, rest_length, x, v, f)
    water.add_force(body, world, x, v, f)
