"""The nearest rotation of a matrix."""

import naive
import numpy as np
import pytest
import small_bodies
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from kernels import read, write

from fish_env.kernels.compile import njit
from fish_env.kernels.simd import Kind, Pack
from fish_env.physics.forces.polar import make_scratch, rotation

seeds = st.integers(0, 2**32 - 1)
HARD = [
    (1, 1, 0), (1, 0.5, 0), (1, 0, 0), (0, 0, 0), (1, 1, -1), (1, 0.6, -0.2), (1, 1, -0.999999),
    (1e-200, 1e-200, 1e-200),
    (1, 1e-7, 1e-7), (1, 6e-5, 6e-5), (1, 2e-3, 2e-3), (1, 0.5, -0.496), (1, 1e-3, -1e-9),
    (2, 2, -2), (1e70, 1e69, 1e68),
]  # fmt: skip
"""Singular values, the last with the sign of the determinant."""


@njit
def turn(block):
    """The rotation of the matrix of each lane."""
    f, r = block.f, block.r
    r[0], r[1], r[2] = rotation(f[0], f[1], f[2], block.scratch)


def rotations(matrices, kind):
    """The kernel's rotations (W,3,3) of matrices (W,3,3) side by side."""
    block = Pack("block", f=kind.vectors(3), r=kind.vectors(3), scratch=make_scratch(kind))
    write(block.f, np.swapaxes(matrices, 1, 2))
    turn(block)
    return np.swapaxes(read(block.r), 1, 2)


def nearest(matrix):
    """The kernel's rotation of one matrix."""
    return rotations(matrix[None], Kind(1))[0]


def check_rotation(matrix):
    """It is a rotation, and as near as any: tr(R^T F) = s1 + s2 + s3, s3 negative where F is inverted."""
    turn = nearest(matrix)
    np.testing.assert_allclose(turn.T @ turn, np.eye(3), rtol=0, atol=2e-12)
    assert np.linalg.det(turn) > 0
    values = np.linalg.svd(matrix, compute_uv=False)
    values[2] *= 1.0 if np.linalg.det(matrix) >= 0 else -1.0
    np.testing.assert_allclose(np.sum(turn * matrix), values.sum(), rtol=0, atol=1e-12 * values[0])
    return turn, (values[1] + values[2]) / max(values[0], np.finfo(float).tiny)


@settings(max_examples=200)
@given(hnp.arrays(float, (3, 3), elements=st.floats(-10, 10, width=32)))
def test_rotation_of_any_matrix(matrix):
    """The nearest rotation of any matrix, regular, flat, inverted or null; where it is unique, the SVD's."""
    turn, gap = check_rotation(matrix)
    if gap > 1e-3:
        np.testing.assert_allclose(turn, naive.nearest_rotation(matrix), rtol=0, atol=1e-13 / gap**2)


@settings(max_examples=200)
@given(seed=seeds, exponent=st.floats(-16, -0.5))
def test_rotation_near_a_rotation(seed, exponent):
    """Of what is almost a rotation, as all elements are while strains are small, every digit is right."""
    rng = np.random.default_rng(seed)
    turn = small_bodies.turned(rng)
    matrix = turn @ (np.eye(3) + 10**exponent * rng.uniform(-1, 1, (3, 3)))
    found = nearest(matrix)
    np.testing.assert_allclose(found.T @ found, np.eye(3), rtol=0, atol=4e-15)
    np.testing.assert_allclose(found, naive.nearest_rotation(matrix), rtol=0, atol=1e-14)  # as exact as that one is


@settings(max_examples=200)
@given(seed=seeds, values=st.sampled_from(HARD))
def test_rotation_of_hard_cases(seed, values):
    """Flat, inverted, tiny and huge matrices, those without a unique nearest rotation among them."""
    rng = np.random.default_rng(seed)
    check_rotation(small_bodies.turned(rng) @ np.diag(np.array(values, float)) @ small_bodies.turned(rng))


@pytest.mark.parametrize("lanes", ["xyz", 4, 8, 16])
def test_same_bits_in_lanes(lanes):
    """Beside others, clear and unclear, a matrix has the rotation that it has alone, to the last bit."""
    rng, kind = np.random.default_rng(5), Kind(lanes)
    values = [(1 + rng.normal(0, 0.1), 1, 1 + rng.normal(0, 0.01)) for _ in range(49)] + 2 * HARD + [(np.nan, 1, 1)]
    matrices = np.array([small_bodies.turned(rng) @ np.diag(row) @ small_bodies.turned(rng) for row in values])
    rng.shuffle(matrices)
    found = np.concatenate([rotations(matrices[p : p + kind.width], kind) for p in range(0, 80, kind.width)])
    np.testing.assert_array_equal(found, [nearest(matrix) for matrix in matrices])


def test_single_precision():
    """In float32 a rotation is one to single precision, and that of the matrix, stretched or all but flat."""
    rng, kind = np.random.default_rng(6), Kind(16, "float32")
    for values in ((1.1, 1.0, 0.9), (3.0, 1.0, 0.2), (1.0, 1.0, 1e-3), (1.0, 1e-3, 1e-3), (1.0, 0.9, -0.5)):
        matrices = [small_bodies.turned(rng) @ np.diag(values) @ small_bodies.turned(rng) for _ in range(16)]
        found = rotations(np.array(matrices, dtype=np.float32), kind).astype(float)
        np.testing.assert_allclose(np.swapaxes(found, 1, 2) @ found, np.tile(np.eye(3), (16, 1, 1)), rtol=0, atol=2e-5)
        traces = np.einsum("wij,wij->w", found, matrices)
        np.testing.assert_allclose(traces, sum(values), rtol=0, atol=2e-6)
