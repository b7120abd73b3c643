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


@njit
def factor(shape, a, inverse_pivot, row):
    """Factor a matrix of order 3N in place into L D L^T, all of its coordinates coupled.

    a (S,3,3) holds a 3 x 3 block for every entry of the N x N skyline `shape`: rows of the later node, columns of the
    earlier one. Of the diagonal blocks only the lower triangle is read. Three rows are worked on together, so that
    every number of L that is fetched is used three times. inverse_pivot (N,3) receives 1/D; row (N,3,3) is scratch.

    Returns:
        (non-positive pivots, trusted), as `factor_solve`.
    """
    negative = 0
    trusted = True
    for i in range(INDEX(shape.first.size)):
        first = INDEX(shape.first[i])
        row_i = INDEX(shape.start[i]) - first
        d = a[row_i + i]
        d00, d10, d11, d20, d21, d22 = d[0, 0], d[1, 0], d[1, 1], d[2, 0], d[2, 1], d[2, 2]
        was0, was1, was2 = d00, d11, d22
        for j in range(first, i):
            first_j = INDEX(shape.first[j])
            row_j = INDEX(shape.start[j]) - first_j
            s = a[row_i + j]
            s00, s01, s02 = s[0, 0], s[0, 1], s[0, 2]
            s10, s11, s12 = s[1, 0], s[1, 1], s[1, 2]
            s20, s21, s22 = s[2, 0], s[2, 1], s[2, 2]
            for k in range(max(first, first_j), j):
                p, q = row[k], a[row_j + k]
                s00 -= p[0, 0] * q[0, 0] + p[0, 1] * q[0, 1] + p[0, 2] * q[0, 2]
                s01 -= p[0, 0] * q[1, 0] + p[0, 1] * q[1, 1] + p[0, 2] * q[1, 2]
                s02 -= p[0, 0] * q[2, 0] + p[0, 1] * q[2, 1] + p[0, 2] * q[2, 2]
                s10 -= p[1, 0] * q[0, 0] + p[1, 1] * q[0, 1] + p[1, 2] * q[0, 2]
                s11 -= p[1, 0] * q[1, 0] + p[1, 1] * q[1, 1] + p[1, 2] * q[1, 2]
                s12 -= p[1, 0] * q[2, 0] + p[1, 1] * q[2, 1] + p[1, 2] * q[2, 2]
                s20 -= p[2, 0] * q[0, 0] + p[2, 1] * q[0, 1] + p[2, 2] * q[0, 2]
                s21 -= p[2, 0] * q[1, 0] + p[2, 1] * q[1, 1] + p[2, 2] * q[1, 2]
                s22 -= p[2, 0] * q[2, 0] + p[2, 1] * q[2, 1] + p[2, 2] * q[2, 2]
            q, p, e = a[row_j + j], row[j], inverse_pivot[j]  # q: L within node j
            s01 -= s00 * q[1, 0]
            s11 -= s10 * q[1, 0]
            s21 -= s20 * q[1, 0]
            s02 -= s00 * q[2, 0] + s01 * q[2, 1]
            s12 -= s10 * q[2, 0] + s11 * q[2, 1]
            s22 -= s20 * q[2, 0] + s21 * q[2, 1]
            p[0, 0], p[0, 1], p[0, 2] = s00, s01, s02  # L D
            p[1, 0], p[1, 1], p[1, 2] = s10, s11, s12
            p[2, 0], p[2, 1], p[2, 2] = s20, s21, s22
            s[0, 0], s[0, 1], s[0, 2] = s00 * e[0], s01 * e[1], s02 * e[2]  # L
            s[1, 0], s[1, 1], s[1, 2] = s10 * e[0], s11 * e[1], s12 * e[2]
            s[2, 0], s[2, 1], s[2, 2] = s20 * e[0], s21 * e[1], s22 * e[2]
            d00 -= s00 * s[0, 0] + s01 * s[0, 1] + s02 * s[0, 2]
            d10 -= s10 * s[0, 0] + s11 * s[0, 1] + s12 * s[0, 2]
            d11 -= s10 * s[1, 0] + s11 * s[1, 1] + s12 * s[1, 2]
            d20 -= s20 * s[0, 0] + s21 * s[0, 1] + s22 * s[0, 2]
            d21 -= s20 * s[1, 0] + s21 * s[1, 1] + s22 * s[1, 2]
            d22 -= s20 * s[2, 0] + s21 * s[2, 1] + s22 * s[2, 2]
        d[1, 0], d[2, 0] = d10 / d00, d20 / d00
        d11 -= d10 * d[1, 0]
        d21 -= d20 * d[1, 0]
        d[2, 1] = d21 / d11
        d22 -= d20 * d[2, 0] + d21 * d[2, 1]
        for k, was, pivot in ((0, was0, d00), (1, was1, d11), (2, was2, d22)):
            if not pivot > 0.0:
                negative += 1
            if not TRUSTED_PIVOT * abs(was) < abs(pivot) < math.inf:
                trusted = False
            inverse_pivot[i, k] = 1.0 / pivot
    return negative, trusted


@njit
def solve(shape, a, inverse_pivot, b):
    """Solve for one right-hand side b (N,3), which is overwritten, with what `factor` made."""
    order = INDEX(shape.first.size)
    for i in range(order):
        first = INDEX(shape.first[i])
        row_i = INDEX(shape.start[i]) - first
        b0, b1, b2 = b[i, 0], b[i, 1], b[i, 2]
        for j in range(first, i):
            q, c0, c1, c2 = a[row_i + j], b[j, 0], b[j, 1], b[j, 2]
            b0 -= q[0, 0] * c0 + q[0, 1] * c1 + q[0, 2] * c2
            b1 -= q[1, 0] * c0 + q[1, 1] * c1 + q[1, 2] * c2
            b2 -= q[2, 0] * c0 + q[2, 1] * c1 + q[2, 2] * c2
        q = a[row_i + i]
        b1 -= q[1, 0] * b0
        b2 -= q[2, 0] * b0 + q[2, 1] * b1
        b[i, 0], b[i, 1], b[i, 2] = b0, b1, b2
    for i in range(order):  # division by D
        for k in range(3):
            b[i, k] *= inverse_pivot[i, k]
    for below in range(order):  # back substitution
        i = order - ONE - below
        first = INDEX(shape.first[i])
        row_i = INDEX(shape.start[i]) - first
        q, b0, b1, b2 = a[row_i + i], b[i, 0], b[i, 1], b[i, 2]
        b1 -= q[2, 1] * b2
        b0 -= q[1, 0] * b1 + q[2, 0] * b2
        b[i, 0], b[i, 1] = b0, b1
        for j in range(first, i):
            q = a[row_i + j]
            b[j, 0] -= q[0, 0] * b0 + q[1, 0] * b1 + q[2, 0] * b2
            b[j, 1] -= q[0, 1] * b0 + q[1, 1] * b1 + q[2, 1] * b2
            b[j, 2] -= q[0, 2] * b0 + q[1, 2] * b1 + q[2, 2] * b2
