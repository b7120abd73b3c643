"""The force on every node and its derivatives: sums over the force modules, a line each."""

from fish_env._jit import INDEX, njit, njit_inline
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


@njit_inline
def add_total_kept(body, world, rest_length, x, v, f, tangent, kept):
    """Add the sum of all forces to f (N,3) N, and keep what `springs.add_tangent` and `add_change` need of it."""
    water.add_force_kept(body, world, x, v, f, kept)
    springs.add_force_tangent(body, rest_length, x, v, f, tangent)


@njit_inline
def add_change(body, world, kept, mobility, v, f):
    """Add to f (N,3) what the forces from outside change by when the velocities become v; x is that of `kept`."""
    water.add_change(body, world, kept, mobility, v, f)


@njit
def jacobian(body, world, rest_length, x, v, stiffness, damping):
    """Exact derivatives of `total`: stiffness -df/dx (3N,3N) N/m and damping -df/dv (3N,3N) N s/m are overwritten."""
    stiffness[:] = 0.0
    damping[:] = 0.0
    water.add_jacobian(body, world, x, v, stiffness, damping)
    springs.add_jacobian(body, rest_length, x, v, stiffness, damping)


@njit
def system(body, world, rest_length, x, v, h, lowest, wet, a):
    """Matrix M + h D + h^2 K of a linearly implicit method: a (S,3,3) kg is overwritten.

    Symmetric, a 3 x 3 block for each entry of the nodes' skyline. K and D are the units' (`springs.add_system`, for
    `lowest` too); where `wet` is true, D is the water's as well (`water.add_system`).
    """
    a[:] = 0.0
    for i in range(body.mass.size):
        for k in range(3):
            a[INDEX(body.profile.diagonal[i]), k, k] = body.mass[i]
    if wet:
        water.add_system(body, world, x, v, h, a)
    springs.add_system(body, rest_length, x, v, h, lowest, a)
