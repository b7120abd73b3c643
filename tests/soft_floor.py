"""A force that the package does not know: a floor that pushes back by how deep a node is in it. One file."""

from typing import NamedTuple

from fish_env.kernels.compile import kernel
from fish_env.kernels.simd import fma, select, vec3


class Floor(NamedTuple):
    """Parameters, in `World.extra["floor"]`."""

    height: float  # m
    stiffness: float  # N/m, of every node


def present(body, world) -> bool:
    """Whether the world has such a floor."""
    return "floor" in (world.extra or {})


@kernel
def add_force(body, world, control, x, v, f, cache):
    """Add the push of the floor on every node that is below its height."""
    for i in range(x.size):
        depth = world.floor.height - x[i].z
        push = (world.floor.stiffness * control.lightness[0]) * select(depth > 0.0, depth, 0.0)
        f[i] = fma(push, vec3(0.0, 0.0, 1.0), f[i])
