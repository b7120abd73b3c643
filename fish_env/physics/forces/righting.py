"""Righting couple: the weight of the fish acts below its buoyancy and turns it upright.

The fish has the density of water, so that the two balance. Most living fish have their centre of buoyancy below their
centre of mass, and stay upright by small motions of their fins (Webb 2002); the couple stands for these.

Legend: g force on a node at the upper edge, N.
"""

from fish_env.kernels.compile import INDEX, kernel
from fish_env.kernels.simd import vec3, zero
from fish_env.physics.records import Body, World

ANYWHERE = True


def present(body: Body, world: World) -> bool:
    """Return True if the body has sections and a couple rights them."""
    return world.righting != 0.0 and body.sections is not None


@kernel
def add_force(body, world, control, x, v, f, cache):
    """Add an upward force to every node at the upper edge, and the opposite to those at the lower one."""
    sections = body.sections
    g = control.shortness[0] * vec3(0.0, 0.0, world.righting * sections.leverage)  # (21), (75)
    for p in range(sections.upper.size):
        f[INDEX(sections.upper[p])] += g
        f[INDEX(sections.lower[p])] -= g


@kernel
def energy(body, world, control, x, v, f, cache):
    """Potential energy of the couple, J, over the factor on the mass: zero for a fish on its side."""
    sections, total = body.sections, zero(control.stiffness)
    for p in range(sections.upper.size):
        total += x[INDEX(sections.upper[p])].z - x[INDEX(sections.lower[p])].z
    return -(world.righting * sections.leverage) * (control.shortness[0] * total)
