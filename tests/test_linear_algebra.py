"""Skyline L D L^T against scipy and numpy, for every kind of block, and its signs against the eigenvalues."""

from functools import cache

import numpy as np
import pytest
import scipy.linalg
from hypothesis import given
from hypothesis import strategies as st
from moving import ONE, read, tiered, write

from fish_env import make_fish
from fish_env.kernels.compile import njit
from fish_env.kernels.simd import Kind, Pack, packed
from fish_env.physics.body import fix
from fish_env.physics.integrators.common import eliminate
from fish_env.physics.linalg import ldlt

EPSILON = np.finfo(float).eps


@cache
def solvers():
    """The solvers, compiled for a pack of what they work on."""

    @njit
    def scalars(block):
        b = block
        b.pivots[0], b.pivots[1] = ldlt.factor_solve(b.shape, b.a, b.b, b.inverse_pivot, b.row)

    @njit
    def factor(block):
        b = block
        b.pivots[0], b.pivots[1] = ldlt.factor(b.shape, b.a, b.row)

    @njit
    def solve(block):
        ldlt.solve(block.shape, block.a, block.b)

    return scalars, factor, solve


def solve_lanes(kind, shape, matrices, b):
    """Solutions (w,N,3), L (w,N,N), 1/D (w,N) and pivots (w,2) of w matrices (w,N,N) with b (w,N,3), all by rows."""
    order = b.shape[1]
    block = Pack("scalars", shape=packed(shape, kind), a=kind.numbers(int(shape.start[-1])), b=kind.vectors(order),
                 inverse_pivot=kind.numbers(order), row=kind.numbers(order), pivots=kind.numbers(2))  # fmt: skip
    write(block.a, [skyline(shape, matrix) for matrix in matrices])
    write(block.b, b[:, shape.row])
    solvers()[0](block)
    lower = np.tile(np.eye(order), (len(b), 1, 1))
    for i, first in enumerate(shape.first):
        lower[:, i, first:i] = read(block.a)[:, shape.start[i] : shape.start[i + 1] - 1]
    return read(block.b)[:, shape.node], lower, read(block.inverse_pivot), read(block.pivots)


def solve_blocks(kind, shape, matrices, b):
    """The same of matrices (w,3N,3N) of 3 x 3 blocks with b (w,N,3), solved for b and 2 b with the same factors."""
    order = len(shape.first)
    block = Pack("blocks", shape=packed(shape, kind), a=kind.vectors(3 * int(shape.start[-1])), b=kind.vectors(order),
                 row=kind.vectors(3 * order), pivots=kind.numbers(2))  # fmt: skip
    places = [(i, j) for i, first in enumerate(shape.first) for j in range(first, i + 1)]
    stored = np.array([matrices[:, 3 * i : 3 * i + 3, 3 * j : 3 * j + 3] for i, j in places]).swapaxes(0, 1)
    stored[:, shape.start[1:] - 1] += np.triu(np.full((3, 3), np.nan), 1)  # which must not be read
    write(block.a, stored.swapaxes(2, 3).reshape(len(b), -1, 3))
    solvers()[1](block)
    found = []
    for right in (b, 2.0 * b):
        write(block.b, right[:, shape.row])
        solvers()[2](block)
        found.append(read(block.b)[:, shape.node])
    np.testing.assert_array_equal(found[1], 2.0 * found[0])
    a = read(block.a).reshape(len(b), -1, 3, 3).swapaxes(2, 3)
    lower = np.tile(np.eye(3 * order), (len(b), 1, 1))
    for (i, j), entries in zip(places, a.swapaxes(0, 1), strict=True):
        lower[:, 3 * i : 3 * i + 3, 3 * j : 3 * j + 3] = entries if i > j else np.tril(entries, -1) + np.eye(3)
    return found[0], lower, a[..., 2][:, shape.start[1:] - 1].reshape(len(b), -1), read(block.pivots)


each_solver = pytest.mark.parametrize("solver", [solve_lanes, solve_blocks])


def solve(solver, shape, matrix, b):
    """Solution, L, D, non-positive pivots and trust of one matrix."""
    (x,), (lower,), (inverse_pivot,), ((negative, untrusted),) = solver(ONE, shape, matrix[None], b[None])
    with np.errstate(divide="ignore"):
        return x, lower, 1.0 / inverse_pivot, negative, untrusted == 0


def skyline(shape, matrix):
    """The stored entries of a dense matrix."""
    return np.concatenate([row[first : i + 1] for i, (row, first) in enumerate(zip(matrix, shape.first, strict=True))])


def scalar_rows(solver, shape):
    """The first stored column of every row of a matrix whose nodes have this profile."""
    return [3 * first for first in shape.first for _ in range(3)] if solver is solve_blocks else shape.first


def symmetric(first, rng, signs):
    """A matrix L D L^T with these first columns; its pivots lie in 0.5 to 2, so none is lost to cancellation."""
    lower = np.eye(len(first))
    for i, start in enumerate(first):
        lower[i, start:i] = rng.uniform(-1, 1, i - start)
    return lower @ np.diag(rng.uniform(0.5, 2.0, len(first)) * rng.choice(signs, len(first))) @ lower.T


@each_solver
@pytest.mark.parametrize("definite", [True, False])
@given(data=st.data())
def test_factors_and_solution(solver, definite, data):
    """L D L^T is the matrix and the solution solves it, to the rounding that the factors' sizes allow; scipy agrees."""
    nodes = data.draw(st.integers(1, 8 if solver is solve_blocks else 16))
    shape = ldlt.profile([(i, data.draw(st.integers(0, i))) for i in range(nodes)], nodes)
    rng = np.random.default_rng(data.draw(st.integers(0, 2**32 - 1)))
    matrix = symmetric(scalar_rows(solver, shape), rng, [1.0] if definite else [1.0, -1.0])
    order, b = len(matrix), rng.normal(size=(nodes, 3))
    x, lower, pivots, negative, trusted = solve(solver, shape, matrix, b)
    if solver is solve_blocks:
        x, b = x.reshape(-1, 1), b.reshape(-1, 1)
    size = np.abs(lower) @ np.diag(np.abs(pivots)) @ np.abs(lower).T
    assert trusted
    assert np.all(np.abs(lower @ np.diag(pivots) @ lower.T - matrix) <= 4 * (order + 3) * EPSILON * size)
    assert np.all(np.abs(matrix @ x - b) <= 8 * (order + 3) * EPSILON * (size @ np.abs(x) + np.abs(b)))
    reference = scipy.linalg.solve(matrix, b)
    allowed = 20 * order * EPSILON * np.abs(np.linalg.inv(matrix)) @ (size @ np.abs(reference) + np.abs(b))
    assert np.all(np.abs(x - reference) <= allowed)
    assert negative == np.count_nonzero(scipy.linalg.eigvalsh(matrix) < 0)  # Sylvester's law of inertia


@given(st.data())
def test_storage(data):
    """Each row is stored from its first entry to the diagonal; `entries` finds an entry, whichever node comes first."""
    order = data.draw(st.integers(1, 12))
    node = st.integers(0, order - 1)
    pairs = np.array(data.draw(st.lists(st.tuples(node, node), max_size=15)), dtype=int).reshape(-1, 2)
    shape, own = ldlt.profile(pairs, order), ldlt.profile_in(np.arange(order), pairs)
    assert shape.start[-1] <= own.start[-1]
    assert shape.node[shape.row].tolist() == list(range(order))
    if shape.start[-1] == own.start[-1]:
        assert shape.row.tolist() == list(range(order))
    pairs = shape.row[pairs]
    for i in range(order):
        partners = [min(pair) for pair in pairs.tolist() if max(pair) == i]
        assert shape.first[i] == min([i, *partners])
    numbers = np.arange(float(order * order)).reshape(order, order)
    stored = skyline(shape, numbers)
    assert len(stored) == shape.start[-1]
    low, high = np.sort(pairs, axis=1).T
    for wanted in (pairs, pairs[:, ::-1]):
        np.testing.assert_array_equal(stored[ldlt.entries(shape, shape.node[wanted])], numbers[high, low])
    np.testing.assert_array_equal(stored[shape.diagonal[shape.node]], numbers.diagonal())


@pytest.mark.parametrize("place", range(6))
@pytest.mark.parametrize("value", [0.0, float("nan"), float("inf"), "lost"])
def test_untrusted_blocks(place, value):
    """A pivot that vanishes, is not finite or has lost twelve digits is found in every row of a node."""
    shape, matrix, b = ldlt.profile([(1, 0)], 2), np.diag(np.arange(1.0, 7.0)), np.ones((2, 3))
    assert solve(solve_blocks, shape, matrix, b)[-1]
    if value == "lost":  # to the next row; after the last comes the first
        low, high = sorted((place, (place + 1) % 6))
        matrix[low, low] = matrix[low, high] = matrix[high, low] = 1.0
        matrix[high, high] = 1.0 + 1e-12
    else:
        matrix[place, place] = value
    assert not solve(solve_blocks, shape, matrix, b)[-1]


@pytest.mark.parametrize(
    "matrix",
    [
        [[0.0]],
        [[float("nan")]],
        [[float("inf")]],
        [[1.0, 1.0], [1.0, 1.0]],
        [[1.0, 1.0], [1.0, 1.0 + 1e-12]],
        [[1.0, float("nan")], [float("nan"), 1.0]],
        [[1.0, 1e200], [1e200, 1.0]],
        [[2.0, -1.0, -1.0], [-1.0, 2.0, -1.0], [-1.0, -1.0, 2.0]],
    ],
    ids=["zero", "nan", "infinite", "singular", "nearly singular", "nan inside", "overflow", "free springs"],
)
def test_untrusted(matrix):
    """A singular, nearly singular, overflowing or non-finite matrix is reported: its solution is not to be trusted."""
    order = len(matrix)
    shape = ldlt.profile([(i, 0) for i in range(order)], order)
    assert not solve(solve_lanes, shape, np.array(matrix), np.ones((order, 3)))[-1]


@pytest.mark.parametrize("scale", [1e-12, 1e12])
def test_trust_does_not_depend_on_units(scale):
    """Scaling all entries changes neither trust nor the count of pivots, nor, for a power of two, one bit of L."""
    shape = ldlt.profile([(1, 0), (2, 1)], 3)
    matrix = np.array([[2.0, -1.0, 0.0], [-1.0, -3.0, 0.5], [0.0, 0.5, 1.0]])
    _, lower, _, *found = solve(solve_lanes, shape, matrix, np.ones((3, 3)))
    _, scaled, _, *again = solve(solve_lanes, shape, 2.0 ** round(np.log2(scale)) * matrix, np.ones((3, 3)))
    assert found == again == [1, True]
    np.testing.assert_array_equal(lower, scaled)


# Every kind of block


def several(solver, nodes, count=16):
    """A profile, `count` matrices of its skyline of blocks, some indefinite, and right-hand sides."""
    rng = np.random.default_rng(nodes)
    shape = ldlt.profile([(i, max(0, i - int(rng.integers(1, 4)))) for i in range(nodes)], nodes)
    matrices = [symmetric(scalar_rows(solver, shape), rng, [1.0, 1.0, -1.0]) for _ in range(count)]
    return shape, np.array(matrices), rng.normal(size=(count, nodes, 3))


def by_numpy(matrix, b):
    """The solution of three right-hand sides, or of one (N,3), and the error that rounding allows, in precisions."""
    wanted = np.linalg.solve(matrix, b if len(b) == len(matrix) else b.ravel()).reshape(b.shape)
    return wanted, 20 * len(matrix) * np.linalg.cond(matrix) * np.abs(wanted).max()


@each_solver
@pytest.mark.parametrize("lanes", tiered(("xyz", 1, 4, 8, 16), ("xyz", 8)))
def test_every_kind_equals_numpy_and_the_others(solver, lanes):
    """The solutions in lanes are numpy's to rounding, and bit for bit those of each matrix alone, as are the pivots."""
    kind = Kind(lanes)
    shape, matrices, b = several(solver, 7)
    for first in range(0, 16, kind.width):
        part = slice(first, first + kind.width)
        found = solver(kind, shape, matrices[part], b[part])
        for lane, (matrix, right) in enumerate(zip(matrices[part], b[part], strict=True)):
            alone, (wanted, close) = solver(ONE, shape, matrix[None], right[None]), by_numpy(matrix, right)
            for together, single in zip(found, alone, strict=True):
                np.testing.assert_array_equal(together[lane], single[0])
            assert np.abs(found[0][lane] - wanted).max() <= EPSILON * close
            assert found[-1][lane].tolist() == [np.count_nonzero(np.linalg.eigvalsh(matrix) < 0), 0]


@each_solver
def test_a_singular_matrix_leaves_its_neighbours_alone(solver):
    """Of eight matrices in lanes one is singular and one is no matrix of numbers: only these are not trusted."""
    shape, matrices, b = several(solver, 6, 8)
    matrices[1, 5, :] = matrices[1, :, 5] = 0.0
    matrices[2, 3, 3] = np.nan
    with np.errstate(invalid="ignore"):
        solution, *_, pivots = solver(Kind(8), shape, matrices, b)
    assert (pivots[:, 1] > 0).tolist() == [k in (1, 2) for k in range(8)]
    for lane in (0, 3):
        alone, *_ = solver(ONE, shape, matrices[lane][None], b[lane][None])
        np.testing.assert_array_equal(solution[lane], alone[0])


@each_solver
@pytest.mark.parametrize("lanes", tiered(("xyz", 1, 16), (1,)))
def test_single_precision(solver, lanes):
    """In float32 the solutions are numpy's to that precision, for one matrix and in lanes."""
    kind, (shape, matrices, b) = Kind(lanes, "float32"), several(solver, 5)
    part = slice(0, kind.width)
    found = solver(kind, shape, matrices[part], b[part])
    for x, matrix, right in zip(found[0], matrices[part], b[part], strict=True):
        wanted, close = by_numpy(matrix, right)
        assert np.abs(x - wanted).max() <= np.finfo("float32").eps * close


def test_trust_in_single_precision():
    """A pivot of a millionth of its diagonal entry is sound in float64; in float32 all its digits are rounding."""
    shape = ldlt.profile([(1, 0)], 2)
    matrix = np.array([[[1.0, 1.0], [1.0, 1.0 + 1e-6]]])
    for dtype, lost in (("float64", 0), ("float32", 1)):
        assert solve_lanes(Kind(1, dtype), shape, matrix, np.ones((1, 2, 3)))[-1][0, 1] == lost


def test_two_chains_are_eliminated_side_by_side():
    """Two chains of n nodes joined by rungs, numbered one after the other, need n (n + 3) - 1 entries, or 3 a node."""
    n, chain = 20, [(i, i + 1) for i in range(19)]
    pairs = np.array([*chain, *((i + n, j + n) for i, j in chain), *((i, i + n) for i in range(n))])
    assert ldlt.profile_in(np.arange(2 * n), pairs).start[-1] == n * (n + 3) - 1
    assert ldlt.profile(pairs, 2 * n).start[-1] <= 6 * n


@pytest.mark.parametrize("reordered", [False, True])
def test_fixed_degrees_of_freedom_are_eliminated(reordered):
    """Their rows and columns are those of the identity, and all others stay as they are."""
    body = fix(fix(make_fish("two_layer" if reordered else "mass_spring").body, [3, 11]), [4, 22], "xz")
    assert reordered == (body.profile.row.tolist() != list(range(len(body.mass))))
    first, start, node = body.profile.first, body.profile.start, body.profile.node
    columns = np.random.default_rng(0).normal(size=(int(start[-1]), 3, 3))  # of each block: column, row

    @njit
    def run(block):
        eliminate(block.body, block.a)

    block = Pack("fixed", body=packed(body, ONE), a=ONE.vectors(3 * len(columns)))
    write(block.a, columns.reshape(1, -1, 3))
    run(block)
    found, fixed = read(block.a)[0].reshape(-1, 3, 3), set(map(tuple, body.fixed.tolist()))
    for i in range(len(body.mass)):
        for j in range(first[i], i + 1):
            entry = start[i] + j - first[i]
            for r, c in np.ndindex(3, 3):
                held = (node[i], r) in fixed or (node[j], c) in fixed
                expected = float((i, r) == (j, c)) if held else columns[entry, c, r]
                assert found[entry, c, r] == expected, (i, r, j, c)
