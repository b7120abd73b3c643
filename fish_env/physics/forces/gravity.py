"""Weight, and the drag of air on every node (Song 2009, ch. 4.1; the diagonal damping of the finite-element text)."""

from fish_env.kernels.compile import INDEX, kernel
from fish_env.kernels.simd import dot, exp, fma, select, vec3, zero
from fish_env.physics.forces.plan import INNER, H
from fish_env.physics.records import Body, World

ANYWHERE = True


def present(body: Body, world: World) -> bool:
    """Return True if the world has gravity, even if it is zero; air drag belongs to it."""
    return world.gravity is not None


def constant(body: Body, world: World) -> bool:
    """Return True: the drag of the air is linear in the velocities, so its matrix is constant."""
    return True


@kernel
def add_force(body, world, control, x, v, f, cache):
    """Add the weight and the drag of the air on every node."""
    air = -world.viscosity * control.lightness[0]
    for i in range(x.size):
        f[i] += fma(air, v[i], body.mass[i] * world.gravity[0])  # (82)


@kernel
def add_force_cached(body, world, control, x, v, f, cache):
    """Add the weight only, because `decay` applies the air drag."""
    for i in range(x.size):
        f[i] = fma(body.mass[i], world.gravity[0], f[i])


@kernel
def decay(body, world, control, x, v, f, cache):
    """Apply the exact decay of the velocities by air drag in half a step."""
    if world.viscosity == 0.0:
        return
    rate = (-0.5 * control.plans[control.row[0], H] * world.viscosity) * control.lightness[0]
    for i in range(v.size):
        left, free = exp(rate * (1.0 / body.mass[i])), body.inverse_mass[i]
        v[i] *= vec3(select(free.x > 0.0, left, 1.0), select(free.y > 0.0, left, 1.0), select(free.z > 0.0, left, 1.0))


@kernel
def add_system(body, world, control, x, v, a, cache):
    """Add h D of the air to the matrix a, as `springs.add_system`."""
    drag = (control.plans[control.row[0], INNER] * world.viscosity) * control.lightness[0]
    for i in range(body.mass.size):
        place = 3 * body.profile.diagonal[i]
        a[INDEX(place)] += drag * vec3(1.0, 0.0, 0.0)
        a[INDEX(place + 1)] += drag * vec3(0.0, 1.0, 0.0)
        a[INDEX(place + 2)] += drag * vec3(0.0, 0.0, 1.0)


@kernel
def energy(body, world, control, x, v, f, cache):
    """Potential energy of gravity, J, zero at the origin."""
    total = zero(control.stiffness)
    for i in range(x.size):
        total = fma(-body.mass[i], dot(world.gravity[0], x[i]), total)
    return total
