"""Skyline L D L^T: the symmetric factorisation of the semi-implicit method, after Bathe & Wilson (Tu 1996, ch. 4).

Row i of the lower triangle is stored from its first non-zero column to the diagonal, row after row, in one array.
Fill-in stays inside that skyline, so the profile is computed once a body and never changes.

Legend: i, j, k rows and columns; a stored values, overwritten by L (below the diagonal); d the pivots D.
"""

import math
from typing import NamedTuple

import numpy as np

from fish_env._jit import INDEX, njit

ONE, TWO = INDEX(1), INDEX(2)  # an unsigned and a signed integer would add up to a float
TRUSTED_PIVOT = 1e-9  # a pivot below this fraction of its diagonal entry has lost nine digits to cancellation


class Profile(NamedTuple):
    """Shape of a skyline matrix of order N: entry (i, j) is at `start[i] + j - first[i]`."""

    first: np.ndarray  # (N,) first stored column of each row
    start: np.ndarray  # (N+1,) where each row begins; the last element is the number of stored entries
    diagonal: np.ndarray  # (N,) where each diagonal entry is


def profile(pairs: np.ndarray, order: int) -> Profile:
    """Profile of a symmetric matrix of the given order with off-diagonal entries at `pairs` (E,2)."""
    first = np.arange(order)
    for i, j in np.sort(np.asarray(pairs, dtype=np.int64).reshape(-1, 2), axis=1):
        first[j] = min(first[j], i)
    start = np.concatenate([[0], np.cumsum(np.arange(order) - first + 1)])
    return Profile(first.astype(np.int64), start.astype(np.int64), (start[1:] - 1).astype(np.int64))


def entries(shape: Profile, pairs: np.ndarray) -> np.ndarray:
    """Where the off-diagonal entries `pairs` (E,2) are stored, (E,)."""
    low, high = np.sort(np.asarray(pairs, dtype=np.int64).reshape(-1, 2), axis=1).T
    return shape.start[high] + low - shape.first[high]


@njit
def factor_solve(shape, a, b, inverse_pivot, row):
    """Factor a (S,) in place into L D L^T and solve for three right-hand sides: b (N,3) is overwritten.

    The forward reduction runs beside the factorisation, row by row: both wait on the same sums, so together they take
    three quarters of the time they take one after the other. inverse_pivot (N,) receives 1/D; row (N,) is scratch.

    Returns:
        (non-positive pivots, trusted). Trusted is False once a pivot is not finite, or smaller than `TRUSTED_PIVOT`
        times the diagonal entry it came from.
    """
    negative = 0
    trusted = True
    order = INDEX(shape.first.size)
    for i in range(order):
        first = INDEX(shape.first[i])
        row_i = INDEX(shape.start[i]) - first
        b0, b1, b2 = b[i, 0], b[i, 1], b[i, 2]
        diagonal = a[row_i + i]
        d = diagonal
        for j in range(first, i):
            first_j = INDEX(shape.first[j])
            k = max(first, first_j)
            row_j = INDEX(shape.start[j]) - first_j
            s = a[row_i + j]
            while k + ONE < j:  # two terms a turn: saves a sixth of the factorisation
                s -= row[k] * a[row_j + k] + row[k + ONE] * a[row_j + k + ONE]
                k += TWO
            if k < j:
                s -= row[k] * a[row_j + k]
            row[j] = s  # L_ij D_j
            lower = s * inverse_pivot[j]
            a[row_i + j] = lower
            d -= s * lower
            b0 -= lower * b[j, 0]  # forward reduction
            b1 -= lower * b[j, 1]
            b2 -= lower * b[j, 2]
        b[i, 0], b[i, 1], b[i, 2] = b0, b1, b2
        if not d > 0.0:
            negative += 1
        if not TRUSTED_PIVOT * abs(diagonal) < abs(d) < math.inf:
            trusted = False
        inverse_pivot[i] = 1.0 / d
    for i in range(order):  # division by D
        for k in range(3):
            b[i, k] *= inverse_pivot[i]
    for below in range(order):  # back substitution
        i = order - ONE - below
        first = INDEX(shape.first[i])
        row_i = INDEX(shape.start[i]) - first
        b0, b1, b2 = b[i, 0], b[i, 1], b[i, 2]
        for k in range(first, i):
            lower = a[row_i + k]
            b[k, 0] -= lower * b0
            b[k, 1] -= lower * b1
            b[k, 2] -= lower * b2
    return negative, trusted
