"""The exact stiffness of a body of any size: the elements' derivatives, worked out a few at a time.

The forces' derivatives come as dense matrices. Here they are worked out for small bodies of some of the elements each,
whose matrices add up to a sparse one; what an element's derivatives are stands in one place. It is not known how to
share out a force whose elements `_pieces` does not know, one added to the list by its user: its derivatives are worked
out for the whole body, once, some columns at a time.
"""

import numpy as np
from scipy.sparse import coo_array

from fish_env.physics import forces
from fish_env.physics.forces.evaluate import Evaluator
from fish_env.physics.linalg import rates
from fish_env.physics.records import Body, World

PIECE = 48  # elements a kind whose derivatives are worked out together
STRIP = 240  # columns of the whole body's matrix that are worked out together: what is dense at any time
SHARED = ("water", "springs", "tets", "green_lagrange", "pressure", "barriers", "gravity", "anchors", "contact")
"""The forces whose elements `_pieces` shares out, and those that have no stiffness."""


def tangent(body: Body, world: World, rest_length, x):
    """Exact stiffness -df/dx (3N,3N), N/m, of all forces on a body at x (N,3) m without motion.

    Dense up to `linalg.rates.DENSE` rows, then sparse (scipy, compressed rows), worked out for a few elements at a
    time. The walls are left out.
    """
    names = forces.present(body, world)
    if x.size <= rates.DENSE:
        return Evaluator(body, world, names).stiffness(rest_length, x, np.zeros_like(x))
    known, others = (tuple(name for name in names if (name in SHARED) is shared) for shared in (True, False))
    parts = [*_shared_out(known, body, world, rest_length, x), *_in_strips(others, body, world, rest_length, x)]
    rows, columns, values = map(np.concatenate, zip(*parts, strict=True))
    return coo_array((values, (rows, columns)), shape=(x.size, x.size)).tocsr()


def _shared_out(names, body: Body, world: World, rest_length, x):
    """Row, column and value of what these forces add between the nodes of a few elements, for all elements."""
    for nodes, piece, around, rest in _pieces(body, world, rest_length):
        block = Evaluator(piece, around, names).stiffness(rest, x[nodes], np.zeros((len(nodes), 3)))
        places = (3 * nodes[:, None] + np.arange(3)).ravel()
        i, j = np.nonzero(block)
        yield places[i], places[j], block[i, j]


def _in_strips(names, body: Body, world: World, rest_length, x):
    """Row, column and value of what these forces add in each strip of columns, if there are any of these forces."""
    evaluator, still = Evaluator(body, world, names), np.zeros_like(x)
    for begin in range(0, x.size if names else 0, STRIP):
        block = evaluator.stiffness(rest_length, x, still, range(begin, min(begin + STRIP, x.size)))
        i, j = np.nonzero(block)
        yield i, begin + j, block[i, j]


def _pieces(body: Body, world: World, rest_length):
    """Share a body's elements out: each time the nodes (K,) of a few, those elements and their surroundings alone."""
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
        local = np.full(len(body.mass) + 1, -1)  # the last stands for no node, -1
        local[nodes] = np.arange(nodes.size)
        parts = [part and part._replace(nodes=local[part.nodes]) for part in some]
        piece = body._replace(
            position=body.position[nodes], mass=body.mass[nodes], inverse_mass=body.inverse_mass[nodes],
            springs=parts[0], faces=parts[1], tets=parts[2], barriers=parts[3],
            compartments=gas and gas._replace(faces=local[gas.faces]),
        )  # fmt: skip
        around = world._replace(anchors=pull and pull._replace(node=local[pull.node]))
        yield nodes, piece, around, rest_length[share(len(springs.nodes), p)]


def _some_compartments(compartments, which: slice):
    first = compartments.first[which.start : which.stop + 1]
    return compartments._replace(
        faces=compartments.faces[first[0] : first[-1]], first=first - first[0], gas=compartments.gas[which],
        ambient=compartments.ambient[which],
    )  # fmt: skip
