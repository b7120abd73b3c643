"""Exact stiffness of a body of any size, from the derivatives of a few elements at a time.

The forces' derivatives are dense matrices. Those of springs and tetrahedra are computed for small bodies of some of the
elements each, and summed to a sparse one; those of all other forces for the whole body, some columns at a time.
"""

from typing import Any

import numpy as np
from scipy.sparse import coo_array

from fish_env.physics import forces
from fish_env.physics.forces.evaluate import Evaluator
from fish_env.physics.linalg import rates
from fish_env.physics.records import Body, World
from fish_env.physics.world import VACUUM

PIECE = 48  # elements of a kind whose derivatives are computed together
STRIP = 240  # columns of the whole body's matrix that are computed together, and dense at a time
SPLIT = ("springs", "tets", "green_lagrange")  # forces whose elements `_pieces` splits
NO_STIFFNESS = ("gravity", "contact")  # walls are excluded


def tangent(body: Body, world: World, rest_length, x):
    """Exact stiffness -df/dx (3N,3N), N/m, of all forces on a body at x (N,3) m at zero velocity: scipy, by rows."""
    names, still, every = forces.present(body, world), np.zeros_like(x), np.arange(x.size)
    few = x.size <= rates.DENSE  # then all forces are computed for the whole body
    known = () if few else tuple(name for name in names if name in SPLIT)
    others = tuple(name for name in names if name not in (*known, *NO_STIFFNESS))
    rows, columns, values = [every[:0]], [every[:0]], [np.zeros(0)]

    def add(block, row, column):
        i, j = np.nonzero(block)
        for found, new in ((rows, row[i]), (columns, column[j]), (values, block[i, j])):
            found.append(new)

    for nodes, piece, rest in _pieces(body, rest_length) if known else ():
        places = (3 * nodes[:, None] + np.arange(3)).ravel()
        add(Evaluator(piece, VACUUM, known).stiffness(rest, x[nodes], still[nodes]), places, places)
    evaluator = Evaluator(body, world, others)
    for begin in range(0, x.size if others else 0, STRIP):
        some = every[begin : begin + STRIP]
        add(evaluator.stiffness(rest_length, x, still, range(begin, begin + some.size)), every, some)
    places = np.concatenate(rows), np.concatenate(columns)
    return coo_array((np.concatenate(values), places), shape=(x.size, x.size)).tocsr()


def _pieces(body: Body, rest_length):
    """Split a body: yield the nodes (K,) of a few springs and tetrahedra, a body of these only, and rest lengths."""
    parts: list[Any] = [body.springs._replace(rest_length=rest_length), *([body.tets] if body.tets else [])]
    count = -(-max(1, *(len(part.nodes) for part in parts)) // PIECE)

    def cut(part, begin, end):
        which = slice(len(part.nodes) * begin // count, len(part.nodes) * end // count)
        return part._replace(**{name: value[which] for name, value in part._asdict().items() if np.ndim(value)})

    for p in range(count):
        springs, *tets = (cut(part, p, p + 1) for part in parts)
        nodes = np.unique(np.concatenate([part.nodes.ravel() for part in (springs, *tets)]))
        springs, *tets = (part._replace(nodes=np.searchsorted(nodes, part.nodes)) for part in (springs, *tets))
        yield nodes, body._replace(
            position=body.position[nodes], mass=body.mass[nodes], inverse_mass=body.inverse_mass[nodes],
            springs=springs, faces=cut(body.faces, 0, 0), tets=tets[0] if tets else None, compartments=None,
            barriers=None, sections=None,
        ), springs.rest_length  # fmt: skip
