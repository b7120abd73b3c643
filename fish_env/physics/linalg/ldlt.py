"""Skyline L D L^T: the symmetric factorisation of the implicit methods, after Bathe & Wilson (Tu 1996, ch. 4).

Row i of the lower triangle is stored from its first non-zero column to the diagonal, row after row, in one array.
Fill-in stays inside that skyline, so the profile is computed once a body and never changes. Every fish of a block has a
matrix of its own; all have the same skyline. Its rows are the nodes in their own order, or in that of reverse
Cuthill-McKee (George & Liu 1981) if that stores fewer entries. Right-hand sides are in the order of the nodes.

A pivot is untrusted if it is not finite, or smaller than TRUSTED_PIVOT times its diagonal entry, or than the rounding
error of that entry. The fish continues to the end of the call, because the lanes of a block stay together.

Legend: i, j, k rows and columns; a stored values, overwritten by L (below the diagonal); d the pivots D; s an entry of
L D; p, q columns of blocks of L D and of L.
"""

import math
from itertools import combinations

import numpy as np

from fish_env.kernels.compile import INDEX, kernel
from fish_env.kernels.simd import dot, epsilon, fma, select, vec3, zero
from fish_env.physics.records import Body, Profile, Sections, Tets

TRUSTED_PIVOT = 1e-9  # a pivot below this fraction of its diagonal entry has lost nine digits to cancellation
MOSTLY_FULL = 0.75  # part of the entries at nodes that elements join, above which another order saves little
ROUNDING = 16.0  # times the precision: rounding error of a pivot's sums


def profile(pairs: np.ndarray, order: int) -> Profile:
    """Profile of a symmetric matrix of the given order with off-diagonal entries at the nodes `pairs` (E,2)."""
    pairs = np.unique(np.sort(np.asarray(pairs, dtype=np.int64).reshape(-1, 2), axis=1), axis=0)
    own = profile_in(np.arange(order), pairs)
    if order + np.count_nonzero(pairs[:, 0] < pairs[:, 1]) >= MOSTLY_FULL * own.start[-1]:
        return own
    from scipy.sparse import coo_array  # imported here, because it takes 0.15 s and few bodies need it
    from scipy.sparse.csgraph import reverse_cuthill_mckee

    graph = coo_array((np.ones(len(pairs)), pairs.T), shape=(order, order)).tocsr()
    node = np.ascontiguousarray(reverse_cuthill_mckee(graph + graph.T, symmetric_mode=True), dtype=np.int64)
    return min(own, profile_in(node, pairs), key=lambda shape: shape.start[-1])


def profile_in(node: np.ndarray, pairs: np.ndarray) -> Profile:
    """Profile whose rows are the nodes in this order (N,)."""
    row, first = np.argsort(node), np.arange(node.size)
    low, high = np.sort(row[pairs], axis=1).T
    np.minimum.at(first, high, low)
    start = np.concatenate([[0], np.cumsum(np.arange(node.size) - first + 1)])
    return Profile(first, start, start[row + 1] - 1, row, node)


def profile_of(body: Body) -> Profile:
    """Skyline of the system matrix of a body: the nodes that springs, faces, tetrahedra or sections join."""
    return profile_of_elements(len(body.mass), body.springs.nodes, body.faces.nodes, body.tets, body.sections)


def profile_of_elements(n: int, springs, faces, tets: Tets | None, sections: Sections | None) -> Profile:
    """Skyline for n nodes of which springs (E,2), faces (F,4), tetrahedra or sections join some."""
    fours = faces if tets is None else np.concatenate([faces, tets.nodes])
    parts = [springs, *(fours[:, pair] for pair in combinations(range(4), 2))]
    if sections is not None:
        groups = np.split(sections.nodes, sections.first[1:-1])
        parts += [np.array(list(combinations(group, 2)), dtype=np.int64).reshape(-1, 2) for group in groups]
    return profile(np.concatenate(parts), n)


def entries(shape: Profile, pairs: np.ndarray) -> np.ndarray:
    """Storage indices (E,) of the off-diagonal entries of the nodes `pairs` (E,2)."""
    low, high = np.sort(shape.row[np.asarray(pairs, dtype=np.int64).reshape(-1, 2)], axis=1).T
    return shape.start[high] + low - shape.first[high]


@kernel
def check_pivot(least, diagonal, pivot, negative, untrusted):
    """Count a pivot: (non-positive pivots, untrusted ones), a number for each fish."""
    # `least` is the smallest trusted ratio of the pivot to its diagonal entry.
    size = abs(pivot)
    lost = select(size > least * abs(diagonal), untrusted, untrusted + 1.0)
    return select(pivot > 0.0, negative, negative + 1.0), select(size < math.inf, lost, untrusted + 1.0)


@kernel
def factor_solve(shape, a, b, inverse_pivot, row):
    """Factor a (S,) in place into L D L^T and solve for three right-hand sides: b (N,), vectors, is overwritten."""
    # inverse_pivot (N,) receives 1/D; row (N,) is scratch. Returns the numbers of non-positive and of untrusted pivots.
    found = factor_forward(shape, a, b, inverse_pivot, row)
    backward(shape, a, b, inverse_pivot)
    return found


@kernel
def factor_forward(shape, a, b, inverse_pivot, row):
    """First half of `factor_solve`: b becomes L^-1 b."""
    first, start, node, order = shape.first, shape.start, shape.node, shape.first.size
    negative, untrusted, least = zero(a), zero(a), max(TRUSTED_PIVOT, ROUNDING * epsilon(a))
    for i in range(order):
        least_j = first[i]
        row_i = start[i] - least_j
        y, diagonal = b[INDEX(node[i])], a[INDEX(row_i + i)]
        d = diagonal
        for j in range(least_j, i):
            least_k = first[INDEX(j)]
            row_j = start[INDEX(j)] - least_k
            s = a[INDEX(row_i + j)]
            for k in range(max(least_j, least_k), j):
                s = fma(-row[INDEX(k)], a[INDEX(row_j + k)], s)
            row[INDEX(j)] = s
            lower = s * inverse_pivot[INDEX(j)]
            a[INDEX(row_i + j)] = lower
            d = fma(-s, lower, d)
            y = fma(-lower, b[INDEX(node[INDEX(j)])], y)
        b[INDEX(node[i])] = y
        negative, untrusted = check_pivot(least, diagonal, d, negative, untrusted)
        inverse_pivot[INDEX(i)] = 1.0 / d
    return negative, untrusted


@kernel
def forward(shape, a, b, found, begin, top, i):
    """Store row i of L^-1 b in `found`, and return it, for N more vectors b that are zero above row `top`."""
    # Both are in the order of the rows, from `begin` on.
    least = shape.first[INDEX(i)]
    row_i, y = shape.start[INDEX(i)] - least, zero(found) + b[INDEX(begin + i)]
    for j in range(max(least, top), i):
        y = fma(-a[INDEX(row_i + j)], found[INDEX(begin + j)], y)
    found[INDEX(begin + i)] = y
    return y


@kernel
def backward(shape, a, b, inverse_pivot):
    """Second half of `factor_solve`: b becomes L^-T D^-1 b."""
    first, start, node, order = shape.first, shape.start, shape.node, shape.first.size
    for i in range(order):
        b[INDEX(node[i])] = inverse_pivot[i] * b[INDEX(node[i])]
    for above in range(order):
        i = INDEX(order - 1 - above)
        row_i, y = start[i] - first[i], b[INDEX(node[i])]
        for k in range(first[i], order - 1 - above):
            b[INDEX(node[INDEX(k)])] = fma(-a[INDEX(row_i + k)], y, b[INDEX(node[INDEX(k)])])


@kernel
def subtract_product(p, q, s):
    """Compute s - p q^T of blocks, each a tuple of three columns."""
    p0, p1, p2 = p
    q0, q1, q2 = q
    s0, s1, s2 = s
    s0 = fma(-q2.x, p2, fma(-q1.x, p1, fma(-q0.x, p0, s0)))
    s1 = fma(-q2.y, p2, fma(-q1.y, p1, fma(-q0.y, p0, s1)))
    s2 = fma(-q2.z, p2, fma(-q1.z, p1, fma(-q0.z, p0, s2)))
    return s0, s1, s2


@kernel
def block(a, place):
    """Three columns of the block at a place."""
    k = 3 * place
    return a[INDEX(k)], a[INDEX(k + 1)], a[INDEX(k + 2)]


@kernel
def store(a, place, s):
    """Store a block, a tuple of three columns, at a place."""
    k = 3 * place
    a[INDEX(k)], a[INDEX(k + 1)], a[INDEX(k + 2)] = s


@kernel
def factor_node(d):
    """Factors L, below the diagonal as two columns, and D of a block, from its lower triangle."""
    d0, d1, d2 = d
    first = 1.0 / d0.x
    l10, l20 = first * d0.y, first * d0.z
    pivot, below = fma(-l10, d0.y, d1.y), fma(-l10, d0.z, d1.z)
    l21 = below / pivot
    last = fma(-l21, below, fma(-l20, d0.z, d2.z))
    return vec3(0.0, l10, l20), vec3(0.0, 0.0, l21), vec3(d0.x, pivot, last)


@kernel
def factor(shape, a, row):
    """Factor a matrix of order 3N in place into L D L^T, all of its coordinates coupled."""
    # a (3S,) has three vectors, columns of a 3 x 3 block, for every entry of the N x N skyline `shape`: rows of the
    # later node, columns of the earlier one. Only the lower triangle of diagonal blocks is read. Their columns receive
    # the two columns of L below the diagonal, and 1/D. row (3N,), vectors, is scratch. Returns counts as
    # `factor_solve`.
    first, start, none = shape.first, shape.start, zero(a)
    negative, untrusted, least = none.x, none.x, max(TRUSTED_PIVOT, ROUNDING * epsilon(a))
    for i in range(first.size):
        row_i = start[i] - first[i]
        was0, was1, was2 = block(a, row_i + i)
        d = was0, was1, was2
        for j in range(first[i], i):
            row_j = start[j] - first[j]
            s = block(a, row_i + j)
            for k in range(max(first[i], first[j]), j):
                s = subtract_product(block(row, k), block(a, row_j + k), s)
            s0, s1, s2 = s
            q0, q1, inverse = block(a, row_j + j)
            s1 = fma(-q0.y, s0, s1)
            s2 = fma(-q1.z, s1, fma(-q0.z, s0, s2))
            s, lower = (s0, s1, s2), (inverse.x * s0, inverse.y * s1, inverse.z * s2)
            store(row, j, s)
            store(a, row_i + j, lower)
            d = subtract_product(s, lower, d)
        q0, q1, pivot = factor_node(d)
        negative, untrusted = check_pivot(least, was0.x, pivot.x, negative, untrusted)
        negative, untrusted = check_pivot(least, was1.y, pivot.y, negative, untrusted)
        negative, untrusted = check_pivot(least, was2.z, pivot.z, negative, untrusted)
        inverse = vec3(1.0 / pivot.x, 1.0 / pivot.y, 1.0 / pivot.z)
        store(a, row_i + i, (none + q0, none + q1, none + inverse))
    return negative, untrusted


@kernel
def solve(shape, a, b):
    """Solve for one right-hand side, vectors b (N,), which is overwritten, with the factors a of `factor`."""
    first, start, node, order, none = shape.first, shape.start, shape.node, shape.first.size, zero(b)
    for i in range(order):
        row_i, y = start[i] - first[i], b[INDEX(node[i])]
        for j in range(first[i], i):
            q0, q1, q2 = block(a, row_i + j)
            p = b[INDEX(node[j])]
            y = fma(-p.z, q2, fma(-p.y, q1, fma(-p.x, q0, y)))
        q0, q1, _ = block(a, row_i + i)
        y = fma(-y.x, q0, y)
        b[INDEX(node[i])] = fma(-y.y, q1, y)
    for i in range(order):
        _, _, inverse = block(a, start[i] + i - first[i])
        b[INDEX(node[i])] = inverse * b[INDEX(node[i])]
    for above in range(order):
        i = order - 1 - above
        row_i, y = start[i] - first[i], b[INDEX(node[i])]
        q0, q1, _ = block(a, row_i + i)
        middle = fma(-q1.z, y.z, y.y)
        y = none + vec3(fma(-q0.z, y.z, fma(-q0.y, middle, y.x)), middle, y.z)
        b[INDEX(node[i])] = y
        for j in range(first[i], i):
            q0, q1, q2 = block(a, row_i + j)
            b[INDEX(node[j])] -= vec3(dot(q0, y), dot(q1, y), dot(q2, y))
