"""The numbers that count what kernels do with them."""

import numpy as np

from benchmarks.speed import limits
from fish_env.simd import Kind, cross, dot, fma, plain, select, sqrt


def test_operations_are_counted():
    """A kernel that runs as Python leaves the same numbers as ever, and what it did."""
    arrays = [Kind(1).vectors(1) for _ in range(3)]
    arrays[0].memory[:], arrays[1].memory[:] = (1.0, 2.0, 3.0), (2.0, -1.0, 0.5)
    with limits.counting() as found:
        a, b = arrays[0][0], arrays[1][0]
        q = dot(a, b) / sqrt(dot(b, b))
        arrays[2][0] = select(q > 0.0, fma(q, a, cross(a, b)), a - 2.0 * b)
    assert found == {"load": 6, "multiply": 2 + 3 + 3, "fma": 4 + 3 + 3, "square root": 1, "divide": 1, "compare": 1,
                     "add": 3, "select": 3, "store": 3}  # fmt: skip
    x, y = arrays[0].memory[0], arrays[1].memory[0]
    q = x @ y / np.sqrt(y @ y)
    np.testing.assert_allclose(arrays[2].memory[0], q * x + np.cross(x, y), rtol=1e-15)
    assert not isinstance(plain.read(np.ones(1), 1), limits.Counted)


def test_a_step_is_counted():
    """The springs' and faces' square roots: one a spring and two a face for the forces, one a face for the change."""
    fish = limits.make_fish()
    found = limits.operations(3)
    assert found["square root"] == len(fish.body.springs.nodes) + 3 * len(fish.body.faces.nodes)
