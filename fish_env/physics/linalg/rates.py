"""Highest eigenvalue of a structure's stiffness or damping over its masses."""

from typing import Any

import numpy as np

DENSE = 300  # degrees of freedom up to which a dense matrix is faster
TOLERANCE = 1e-10


def assemble(elements, size, dense=DENSE):
    """Sum of element matrices: elements [(nodes (M,k), matrices (M,3k,3k)), ...] in a matrix of that many rows."""
    # Dense up to `dense` rows, then sparse (scipy, compressed rows).
    places = [(3 * nodes[:, :, None] + np.arange(3)).reshape(len(nodes), 3 * nodes.shape[1]) for nodes, _ in elements]
    if size <= dense:
        matrix = np.zeros((size, size))
        for own, (_, blocks) in zip(places, elements, strict=True):
            np.add.at(matrix, (own[:, :, None], own[:, None, :]), blocks)
        return matrix
    from scipy.sparse import coo_array  # imported here, because it takes 0.3 s and only large bodies need it

    rows, columns, values = [np.zeros(0, int)], [np.zeros(0, int)], [np.zeros(0)]
    for own, (_, blocks) in zip(places, elements, strict=True):
        rows.append(np.repeat(own, own.shape[1], axis=1).ravel())
        columns.append(np.tile(own, (1, own.shape[1])).ravel())
        values.append(blocks.ravel())
    return coo_array(
        (np.concatenate(values), (np.concatenate(rows), np.concatenate(columns))), shape=(size, size)
    ).tocsr()


def highest(elements, root) -> float:
    """Highest eigenvalue of W K W: K the sum of the elements, W the diagonal `root` (N,3), zero where fixed."""
    matrix, weight = assemble(elements, root.size), root.ravel()
    if isinstance(matrix, np.ndarray):
        return max(0.0, float(np.linalg.eigvalsh(matrix * np.outer(weight, weight))[-1]))
    from scipy.sparse import diags_array
    from scipy.sparse.linalg import eigsh

    scaled = diags_array(weight) @ matrix @ diags_array(weight)
    if not scaled.nnz:
        return 0.0
    start = np.cos(np.arange(weight.size)) * weight  # an arbitrary, reproducible vector
    tolerance: Any = TOLERANCE  # type checkers infer int from scipy's default of 0
    return float(eigsh(scaled, k=1, which="LA", v0=start, tol=tolerance, return_eigenvectors=False)[0])
