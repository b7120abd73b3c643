"""The force on every node and its derivatives: sums over the force modules, a line each."""

from fish_env._jit import INDEX, njit, njit_inline
from fish_env.forces import anchors, contact, gravity, guards, pressure, springs, tets, water


@njit
def total(body, world, rest_length, x, v, f):
    """Sum of all forces on the nodes of one body: f (N,3) N is overwritten. rest_length (E,), x and v (N,3)."""
    f[:] = 0.0
    water.add_force(body, world, x, v, f)
    springs.add_force(body, rest_length, x, v, f)
    add_others(body, world, x, v, f)
    anchors.add_force(world.anchors, x, v, f)
    contact.add_reaction(world.planes, x, v, f)


@njit
def add_others(body, world, x, v, f):
    """Add to f all but the water, the springs, the anchors and the walls."""
    tets.add_force(body.tets, x, v, f)
    pressure.add_force(body.chambers, x, f)
    guards.add_force(body.guards, x, f)
    gravity.add_force(body.mass, world.gravity, world.viscosity, v, f)


@njit
def external(body, world, x, v, f):
    """Sum of the forces that Tu's method takes explicitly, all but the springs and anchors: f is overwritten."""
    f[:] = 0.0
    water.add_force(body, world, x, v, f)
    add_others(body, world, x, v, f)


@njit_inline
def add_total_kept(body, world, rest_length, x, v, f, kept):
    """Add the sum of all forces but the drag of the air to f (N,3) N; keep what `add_tangent` and `add_change` need.

    kept: of the water (F,5), the springs (7,E), the tetrahedra (T,9) and the gas (C,N,3).
    """
    wet, tangent, turned, compressed = kept
    water.add_force_kept(body, world, x, v, f, wet)
    springs.add_force_tangent(body, rest_length, x, v, f, tangent)
    tets.add_force_kept(body.tets, x, v, f, turned)
    pressure.add_force_kept(body.chambers, x, f, compressed)
    guards.add_force(body.guards, x, f)
    gravity.add_force(body.mass, world.gravity, 0.0, v, f)
    anchors.add_force(world.anchors, x, v, f)
    contact.add_reaction(world.planes, x, v, f)


@njit_inline
def add_tangent(body, world, weights, kept, x, y, f):
    """Add to f (N,3) the pull of all elements, weighted, if every node moved by y (N,3) from x (N,3).

    weights: of the springs, elastic and along them (E,), of the tetrahedra (T,), of the anchors (A,2), of the gas.
    """
    _, tangent, turned, compressed = kept
    elastic, along, solid, pulling, gas = weights
    springs.add_tangent(body, elastic, along, tangent, y, f)
    tets.add_tangent(body.tets, solid, turned, y, f)
    pressure.add_tangent(gas, compressed, y, f)
    anchors.add_tangent(world.anchors, pulling, x, y, f)


@njit_inline
def add_change(body, world, kept, mobility, v, f):
    """Add to f (N,3) what the forces from outside change by when the velocities become v; x is that of `kept`."""
    water.add_change(body, world, kept[0], mobility, v, f)


@njit
def jacobian(body, world, rest_length, x, v, stiffness, damping):
    """Exact derivatives of `total`: stiffness -df/dx (3N,3N) N/m and damping -df/dv (3N,3N) N s/m are overwritten.

    The walls, whose force jumps, are left out.
    """
    stiffness[:] = 0.0
    damping[:] = 0.0
    water.add_jacobian(body, world, x, v, stiffness, damping)
    springs.add_jacobian(body, rest_length, x, v, stiffness, damping)
    tets.add_jacobian(body.tets, x, v, stiffness, damping)
    pressure.add_jacobian(body.chambers, x, stiffness)
    guards.add_jacobian(body.guards, x, stiffness)
    anchors.add_jacobian(world.anchors, x, v, stiffness, damping)
    gravity.add_damping(world.gravity, world.viscosity, damping)


@njit
def system(body, world, rest_length, x, v, h, lowest, wet, a):
    """Matrix M + h D + h^2 K of a linearly implicit method: a (S,3,3) kg is overwritten.

    Symmetric, a 3 x 3 block for each entry of the nodes' skyline. K and D are the elements' (`springs.add_system`, for
    `lowest` too; `tets.add_system`) and the anchors'; where `wet` is true, D is the water's as well. Gas and guards,
    whose matrices are full or indefinite, stay explicit.
    """
    a[:] = 0.0
    for i in range(body.mass.size):
        for k in range(3):
            a[INDEX(body.profile.diagonal[i]), k, k] = body.mass[i] + h * gravity.drag(world.gravity, world.viscosity)
    if wet:
        water.add_system(body, world, x, v, h, a)
    springs.add_system(body, rest_length, x, v, h, lowest, a)
    tets.add_system(body.tets, body.profile, x, h, a)
    anchors.add_system(world.anchors, body.profile.diagonal, x, h, a)


@njit
def add_stiffness_force(body, world, rest_length, x, v, y, h, lowest, f):
    """Add -h K y to f (N,3), with y (N,3) and the K of `system`."""
    springs.add_stiffness_force(body, rest_length, x, v, y, h, lowest, f)
    tets.add_stiffness_force(body.tets, x, y, h, f)
    anchors.add_stiffness_force(world.anchors, x, y, h, f)


def energies(body, world, rest_length, x, v) -> dict[str, float]:
    """Energy of each kind, J, of one body at positions x and velocities v (N,3): kinetic, and what the forces store."""
    return {
        "kinetic": 0.5 * float(body.mass @ (v**2).sum(axis=1)),
        "springs": springs.energy(body, rest_length, x),
        "tets": tets.energy(body.tets, x),
        "gas": pressure.energy(body.chambers, x),
        "guards": guards.energy(body.guards, x),
        "weight": gravity.energy(body.mass, world.gravity, x),
        "anchors": anchors.energy(world.anchors, x),
    }
