"""Small bodies of every kind of element, and a world with everything in it, for the tests of what they do."""

from itertools import combinations, permutations, product
from typing import NamedTuple

import naive
import numpy as np

from fish_env.physics.body import fix, make_body
from fish_env.physics.records import Body, Control, State
from fish_env.physics.world import make_water
from fish_env.soft.conditions import make_anchors
from fish_env.soft.elements import make_barriers, make_compartments, make_tets
from fish_env.soft.mesh import box
from fish_env.soft.room import make_world

CUBE = np.array(list(product((0.0, 1.0), repeat=3)))
"""Corners of the unit cube; corner 4 i + 2 j + k is at (i, j, k)."""
QUADS = np.array([[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]])
"""Its faces, outward."""
EDGES = np.array([(a, b) for a, b in combinations(range(8), 2) if np.sum(CUBE[a] != CUBE[b]) == 1])


def kuhn(corners):
    """The six tetrahedra (6,4) between the corners of a cube: along its edges in every order, all round a diagonal."""
    found = []
    for order in permutations((4, 2, 1)):
        path = [0, order[0], order[0] + order[1], 7]
        if np.linalg.det(CUBE[path[1:]] - CUBE[path[0]]) < 0:
            path[0], path[1] = path[1], path[0]
        found.append([corners[p] for p in path])
    return np.array(found)


class Task(NamedTuple):
    """A body fixed at one end, the nodes at its other end, and how far each is to move, (K,3) m."""

    body: Body
    nodes: np.ndarray
    displacement: np.ndarray


def bar_task(cells=(6, 2, 2), size=0.05):
    """A bar of cubes of five-centimetre edges, six tetrahedra each, one end fixed, the other pulled and bent."""
    position, nodes = box(size * np.array(cells), cells)
    tets = make_tets(position, nodes, 1e5, 0.3)
    body = make_body(position, np.full(len(position), 0.1), [], [], [], [], [], tets=tets)
    end = np.flatnonzero(position[:, 0] == position[:, 0].max())
    return Task(fix(body, position[:, 0] == 0.0), end, np.tile([0.01, 0.02, 0.0], (end.size, 1)))


def block(strain="corotational", young=2e4, poisson=0.3, relaxation_time=2e-3, size=0.1, cells=2):
    """A bar of cubes along x, six irregular tetrahedra each: 4 (cells + 1) nodes."""
    rng = np.random.default_rng(0)
    layers = np.array([[x, *yz] for x in range(cells + 1) for yz in product((0.0, 1.0), repeat=2)])
    position = size * (layers + 0.1 * rng.uniform(-1, 1, layers.shape))
    nodes = np.concatenate([kuhn(range(4 * c, 4 * c + 8)) for c in range(cells)])
    tets = make_tets(position, nodes, young, poisson, relaxation_time, strain)
    mass = rng.uniform(0.05, 0.1, len(position))
    return make_body(position, mass, [], [], [], [], [], tets=tets)


def subdivided(levels):
    """A sphere of radius 1: an octahedron whose triangles are halved along every edge, (N,3) and faces (F,4)."""
    points = [*np.eye(3), *-np.eye(3)]
    faces = [(0, 1, 2), (1, 3, 2), (3, 4, 2), (4, 0, 2), (1, 0, 5), (3, 1, 5), (4, 3, 5), (0, 4, 5)]
    for _ in range(levels):
        middles = {}

        def middle(a, b, middles=middles):
            key = (min(a, b), max(a, b))
            if key not in middles:
                middles[key] = len(points)
                points.append((points[a] + points[b]) / np.linalg.norm(points[a] + points[b]))
            return middles[key]

        finer = []
        for a, b, c in faces:
            ab, bc, ca = middle(a, b), middle(b, c), middle(c, a)
            finer += [(a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca)]
        faces = finer
    return np.array(points), np.array([(a, b, c, c) for a, b, c in faces])


def tetrahedral_compartment():
    """Gas inside one tetrahedron of springs."""
    position = 0.1 * np.array([[0.0, 0, 0], [1.1, 0, 0], [0.1, 0.9, 0], [0.2, 0.1, 1.2]])
    faces = [[0, 2, 1, 1], [0, 1, 3, 3], [1, 2, 3, 3], [2, 0, 3, 3]]
    gas = make_compartments(position, [faces], 400.0, 150.0)
    pairs = list(combinations(range(4), 2))
    length = np.linalg.norm(position[[b for _, b in pairs]] - position[[a for a, _ in pairs]], axis=1)
    return make_body(
        position, 0.05 * np.ones(4), pairs, 50 * np.ones(6), 0.1 * np.ones(6), length, faces, compartments=gas
    )


def two_layers():
    """A cube of springs in a cube of springs, gas inside the inner one and between the two, barriers at every face.

    On top sits a cube of tetrahedra: 20 nodes in all, with elements of every kind.
    """
    rng, size = np.random.default_rng(1), 0.1
    outer, inner, top = CUBE, 0.5 + 0.5 * (CUBE - 0.5), CUBE[CUBE[:, 2] == 1] + [0, 0, 1]
    position = size * (np.vstack([outer, inner, top]) + 0.03 * rng.uniform(-1, 1, (20, 3)))
    pairs = np.vstack([EDGES, EDGES + 8, [(i, i + 8) for i in range(8)], [(0, 7), (1, 6), (2, 5), (3, 4)]])
    length = np.linalg.norm(position[pairs[:, 1]] - position[pairs[:, 0]], axis=1)
    corners = np.array([1, 16, 3, 17, 5, 18, 7, 19])  # of the cube on top
    tets = make_tets(position, kuhn(corners), 2000.0, 0.3, 2e-3)
    between = np.vstack([QUADS, QUADS[:, ::-1] + 8])
    compartments = make_compartments(position, [QUADS + 8, between], [500.0, 450.0], 400.0)
    halves = np.vstack([QUADS[:, [0, 1, 2]], QUADS[:, [0, 2, 3]]])
    barriers = make_barriers(
        position, np.vstack([halves, halves]), np.concatenate([halves[:, 0], halves[:, 2]]) + 8, 0.02
    )
    return make_body(
        position, rng.uniform(0.05, 0.1, 20), pairs, rng.uniform(50, 100, len(pairs)),
        rng.uniform(0.1, 0.2, len(pairs)), length, QUADS, tets=tets, compartments=compartments, barriers=barriers,
    )  # fmt: skip


def rings():
    """A flat ring of springs in a ring of springs, gas in the inner one and between the two, barriers at every edge."""
    angle = 2 * np.pi * np.arange(8) / 8
    circle = np.column_stack([np.cos(angle), np.sin(angle), 0 * angle])
    position, around = 0.1 * np.vstack([circle, 0.6 * circle]), np.column_stack([np.arange(8), (np.arange(8) + 1) % 8])
    pairs = np.vstack([around, around + 8, np.column_stack([np.arange(8), np.arange(8) + 8])])
    length = np.linalg.norm(position[pairs[:, 1]] - position[pairs[:, 0]], axis=1)
    compartments = make_compartments(position, [around + 8, np.vstack([around, around[:, ::-1] + 8])], [8.0, 7.0], 6.0)
    barriers = make_barriers(
        position, np.vstack([around, around]), np.concatenate([around[:, 0], around[:, 1]]) + 8, 0.02
    )
    n = len(pairs)
    return make_body(
        position, 0.05 * np.ones(16), pairs, 60 * np.ones(n), 0.1 * np.ones(n), length, [],
        compartments=compartments, barriers=barriers,
    )  # fmt: skip


def world_with_all(body, current=(0.8, 0.6, 0.7), offset=-100.0, drag=0.2):
    """Water, gravity, air, two anchors on one node and one on another, and walls: far below, unless told otherwise."""
    water = make_water(current=current, drag_coefficient=drag, friction=20.0)
    world = make_world((0.3, -0.2, -2.0), [((0, 0, 1), offset, 0.4), ((1, 0, 2), offset, 0.7)], 0.3, water)
    node = [2, 2, min(6, len(body.mass) - 1)]
    point = body.position[node] + [[0.03, -0.05, 0.1], [-0.04, -0.02, 0.06], [0.02, 0.03, -0.01]]
    anchors = make_anchors(node, point, [30.0, 20.0, 60.0], [0.2, 0.1, 0.3], [0.05, 0.0, 0.0], [0.1, -0.2, 0.05])
    return world._replace(anchors=anchors)


def completed(body):
    """The same body with no elements of a kind, where it has None: the kernels are those of a body of every kind.

    Which kinds are None decides what numba compiles, 10 s and more for every method; so tests that need not do without
    a kind share what is compiled for `two_layers` in `world_with_all`.
    """
    x = body.position
    return body._replace(
        tets=body.tets or make_tets(x, [], 1.0, 0.3),
        compartments=body.compartments or make_compartments(x, [], 1.0),
        barriers=body.barriers or make_barriers(x, [], [], 1.0),
    )


def shaken(body, rng, displacement=0.003, speed=0.1, squeezed=True):
    """A bent, moving state (x, v), m and m/s; squeezed: with node 8 of the two layers pushed at the outer one."""
    x = body.position + displacement * rng.uniform(-1, 1, body.position.shape)
    if squeezed:
        x[8, 0] = 0.87 * x[[0, 1, 2, 3], 0].mean() + 0.13 * body.position[8, 0]
    return x, speed * rng.uniform(-1, 1, x.shape)


def start(x, v):
    """The state of one body, or of several, at time zero."""
    x, v = (np.array(a, ndmin=3) for a in (x, v))
    b = len(x)
    return State(x, v, np.zeros(b), np.zeros(b, dtype=int), np.zeros((b, 5), dtype=int), np.zeros(b))


def control(rest, rate=None, copies=1):
    """Control of one body, or of several alike."""
    rate = np.zeros_like(rest) if rate is None else rate
    return Control(np.repeat(rest[None], copies, axis=0), np.repeat(rate[None], copies, axis=0))


BODIES = {
    name: completed(body)
    for name, body in {
        "block": block(),
        "linear block": block("linear"),
        "green block": block("green_lagrange"),
        "compartment": tetrahedral_compartment(),
        "two layers": two_layers(),
        "rings": rings(),
    }.items()
}
"""Bodies of every kind of element, completed."""
ALL = BODIES["two layers"]


def bent(name, rng):
    """A turned and moved, bent and moving state of a body (of a flat one: in its plane); barriers, if any, at work."""
    body = BODIES[name]
    flat = not np.ptp(body.position[:, 2])
    x, v = shaken(body, rng, 1e-3 if flat else 3e-3, squeezed=name == "two layers")
    if flat:
        x[8, 0] += 0.032
        angle = rng.uniform(0, 2 * np.pi)
        turn = np.array([[np.cos(angle), -np.sin(angle), 0], [np.sin(angle), np.cos(angle), 0], [0, 0, 1]])
        x[:, 2], v[:, 2] = 0.0, 0.0
    else:
        turn = naive.turned(rng)
    if name == "linear block":
        turn = np.eye(3)
    return x @ turn.T + rng.uniform(-0.3, 0.3, 3) * (1, 1, not flat), v @ turn.T
