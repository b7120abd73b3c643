"""Righting couple: the weight of every section acts below its buoyancy and turns the fish upright.

The fish has the density of water, so that the two balance. Most living fish have their centre of buoyancy below their
centre of mass, and stay upright by small motions of their fins (Webb 2002); the couple stands for these.

Legend: k section; g its force on an upper end, N.
"""

from fish_env.kernels.compile import INDEX, kernel
from fish_env.kernels.simd import fma, vec3, zero
from fish_env.physics.records import Body, World

ANYWHERE = True


def present(body: Body, world: World) -> bool:
    """Return True if the body has sections and a couple rights them."""
    return world.righting != 0.0 and body.sections is not None


@kernel
def add_force(body, world, control, x, v, f, cache):
    """Add an upward force to the upper ends of every section, and the opposite to the lower ones."""
    ends, leverage = body.sections.ends, body.sections.leverage
    for k in range(leverage.size):
        g = vec3(0.0, 0.0, world.righting * leverage[k])  # (79)
        f[INDEX(ends[k, 0])] += g
        f[INDEX(ends[k, 1])] += g
        f[INDEX(ends[k, 2])] -= g
        f[INDEX(ends[k, 3])] -= g


@kernel
def energy(body, world, control, x, v, f, cache):
    """Potential energy of the couples, J, over the factor on the mass: zero if all ends are level."""
    ends, leverage, total = body.sections.ends, body.sections.leverage, zero(control.stiffness)
    for k in range(leverage.size):
        upper = x[INDEX(ends[k, 0])] + x[INDEX(ends[k, 1])]
        rise = upper - x[INDEX(ends[k, 2])] - x[INDEX(ends[k, 3])]
        total = fma(-world.righting * leverage[k], rise.z, total)
    return total
