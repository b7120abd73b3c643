"""The largest strain of a motion."""

from fish_env.kernels.compile import INDEX, kernel
from fish_env.kernels.simd import dot, sqrt


@kernel
def measure_strain(tank, strain, b):
    """Raise strain[b] to the largest |length / natural length - 1| of any spring of fish b."""
    x, nodes = tank.position, tank.spring_nodes
    for e in range(tank.spring_length.size):
        r = x[b, INDEX(nodes[e, 1])] - x[b, INDEX(nodes[e, 0])]
        strain[b] = max(strain[b], abs(sqrt(dot(r, r)) / tank.spring_length[e] - 1.0))
