"""The force on every node: the sum over the force modules, a line each."""

from fish_env._jit import njit
from fish_env.forces import springs, water


@njit
def total(body, world, rest_length, x, v, f):
    """Sum of all forces on the nodes of one body: f (N,3) N is overwritten. rest_length (E,), x and v (N,3)."""
    external(body, world, x, v, f)
    springs.add_force(body, rest_length, x, v, f)


@njit
def external(body, world, x, v, f):
    """Sum of the forces from outside the body, which a semi-implicit method takes explicitly: f is overwritten."""
    f[:] = 0.0
    water.add_force(body, world, x, v, f)
