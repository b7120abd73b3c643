"""The nearest rotation of a matrix."""

import naive
import numpy as np
import small_bodies
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from fish_env.forces.polar import rotation

seeds = st.integers(0, 2**32 - 1)


def nearest(matrix):
    """The kernel's rotation as a matrix."""
    return np.array(rotation(*map(float, matrix.ravel()))).reshape(3, 3)


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
@given(seed=seeds, values=st.sampled_from([
    (1, 1, 0), (1, 0.5, 0), (1, 0, 0), (0, 0, 0), (1, 1, -1), (1, 0.6, -0.2), (1, 1, -0.999999),
    (1e-200, 1e-200, 1e-200),
    (1, 1e-7, 1e-7), (1, 6e-5, 6e-5), (1, 2e-3, 2e-3), (1, 0.5, -0.496), (1, 1e-3, -1e-9),
    (2, 2, -2), (1e70, 1e69, 1e68),
]))  # fmt: skip
def test_rotation_of_hard_cases(seed, values):
    """Flat, inverted, tiny and huge matrices, those without a unique nearest rotation among them."""
    rng = np.random.default_rng(seed)
    check_rotation(small_bodies.turned(rng) @ np.diag(np.array(values, float)) @ small_bodies.turned(rng))
