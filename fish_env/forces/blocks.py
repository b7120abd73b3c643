"""What the exact derivatives of one fish are added up by, in matrices (3N,3N) of plain numbers."""

from fish_env._jit import kernel
from fish_env.simd import vec3


@kernel
def add_column(matrix, i, column, g):
    """Add a vector to the rows of node i, in one column."""
    matrix[3 * i, column] += g.x
    matrix[3 * i + 1, column] += g.y
    matrix[3 * i + 2, column] += g.z


@kernel
def add_outer(matrix, i, j, g, h):
    """Add g h^T to the block of nodes i and j."""
    add_column(matrix, i, 3 * j, h.x * g)
    add_column(matrix, i, 3 * j + 1, h.y * g)
    add_column(matrix, i, 3 * j + 2, h.z * g)


@kernel
def add_turning(matrix, i, j, w):
    """Add the matrix that takes u to u x w to the block of nodes i and j."""
    add_column(matrix, i, 3 * j, vec3(0.0, -w.z, w.y))
    add_column(matrix, i, 3 * j + 1, vec3(w.z, 0.0, -w.x))
    add_column(matrix, i, 3 * j + 2, vec3(-w.y, w.x, 0.0))
