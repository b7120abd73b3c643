"""Exact stiffness of a body of any size, from the derivatives of a few elements at a time.

The forces' derivatives are dense matrices. Here they are computed for small bodies of some of the elements each, whose
matrices are summed to a sparse one. `_pieces` cannot split a force that a user has added to the list: its derivatives
are computed for the whole body, some columns at a time.
"""

import math

import numpy as np
from scipy.sparse import coo_array

from fish_env.physics import forces
from fish_env.physics.forces import water
from fish_env.physics.forces.evaluate import Evaluator
from fish_env.physics.linalg import rates
from fish_env.physics.records import Body, World

PIECE = 48  # elements of a kind whose derivatives are computed together
STRIP = 240  # columns of the whole body's matrix that are computed together, and dense at a time
SHARED = ("water", "springs", "tets", "green_lagrange", "pressure", "barriers", "gravity", "anchors", "contact")
"""Forces whose elements `_pieces` splits, and those without stiffness."""


def tangent(body: Body, world: World, rest_length, x):
    """Exact stiffness -df/dx (3N,3N), N/m, of all forces on a body at x (N,3) m at zero velocity.

    Dense up to `linalg.rates.DENSE` rows, then sparse (scipy, compressed rows), computed for a few elements at a time.
    Walls are excluded.
    """
    names, still = forces.present(body, world), np.zeros_like(x)
    if x.size <= rates.DENSE:
        return Evaluator(body, world, names).stiffness(rest_length, x, still)
    known, others = (tuple(name for name in names if (name in SHARED) is shared) for shared in (True, False))
    rows, columns, values = [], [], []

    def add(block, row, column):
        i, j = np.nonzero(block)
        for found, new in ((rows, row[i]), (columns, column[j]), (values, block[i, j])):
            found.append(new)

    for nodes, piece, around, rest in _pieces(body, world, rest_length):
        places = (3 * nodes[:, None] + np.arange(3)).ravel()
        add(Evaluator(piece, around, known).stiffness(rest, x[nodes], still[nodes]), places, places)
    evaluator, every = Evaluator(body, world, others), np.arange(x.size)
    for begin in range(0, x.size if others else 0, STRIP):
        some = every[begin : begin + STRIP]
        add(evaluator.stiffness(rest_length, x, still, range(begin, begin + some.size)), every, some)
    places = np.concatenate(rows), np.concatenate(columns)
    return coo_array((np.concatenate(values), places), shape=(x.size, x.size)).tocsr()


def _pieces(body: Body, world: World, rest_length):
    """Split a body into pieces: yield the nodes (K,) of a few elements, with a body of these elements only."""
    springs, faces, tets, compartments, barriers = body.springs, body.faces, body.tets, body.compartments, body.barriers
    sizes = [len(springs.nodes), len(faces.nodes), *(len(part.nodes) for part in (tets, barriers) if part is not None)]
    anchored = 0 if world.anchors is None else world.anchors.node.size
    gassed = 0 if compartments is None else compartments.gas.size
    count = -(-max(1, anchored, gassed, *sizes) // PIECE)

    def share(size, p):
        return slice(size * p // count, size * (p + 1) // count)

    def cut(part, p):
        which = share(len(part.nodes), p)
        return part._replace(**{name: value[which] for name, value in part._asdict().items() if np.ndim(value)})

    for p in range(count):
        some = [cut(part, p) for part in (springs, faces)] + [part and cut(part, p) for part in (tets, barriers)]
        gas, pull = compartments and _some_compartments(compartments, share(gassed, p)), world.anchors
        if pull is not None:
            pull = type(pull)(*(value[share(anchored, p)] for value in pull))
        named = [part.nodes for part in some if part is not None]
        named += ([] if gas is None else [gas.faces]) + ([] if pull is None else [pull.node])
        nodes = np.unique(np.concatenate([each.ravel() for each in named]))
        nodes = nodes[nodes >= 0]
        local = np.full(len(body.mass) + 1, -1)  # the last entry is for no node, -1
        local[nodes] = np.arange(nodes.size)
        parts = [part and part._replace(nodes=local[part.nodes]) for part in some]
        piece = body._replace(
            position=body.position[nodes], mass=body.mass[nodes], inverse_mass=body.inverse_mass[nodes],
            springs=parts[0], faces=parts[1], tets=parts[2], barriers=parts[3],
            compartments=gas and gas._replace(faces=local[gas.faces]), sections=None,
        )  # fmt: skip
        around = world._replace(
            anchors=pull and pull._replace(node=local[pull.node]),
            friction=world.friction * math.sqrt(water.length(piece) / water.length(body)),  # the whole body's
        )
        yield nodes, piece, around, rest_length[share(len(springs.nodes), p)]


def _some_compartments(compartments, which: slice):
    first = compartments.first[which.start : which.stop + 1]
    return compartments._replace(
        faces=compartments.faces[first[0] : first[-1]], first=first - first[0], gas=compartments.gas[which],
        ambient=compartments.ambient[which],
    )  # fmt: skip
