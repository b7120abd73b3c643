"""Smooth surfaces from coarse ones: Catmull-Clark subdivision as a matrix, so that it is worked out once a body."""

import numpy as np


def smooth(faces: np.ndarray, num_nodes: int, levels: int, pinned: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Weights (V,N) that turn node positions into points of the smooth surface, and its quadrilaterals (Q,4)."""
    # Smoothing pulls every node inwards. The nodes `pinned` are first moved out so far that the surface passes through
    # them: the nose and the tips of the tail stay where they are.
    polygons = [tuple(dict.fromkeys(face)) for face in faces.tolist()]
    weights = np.eye(num_nodes)
    for _ in range(levels):
        step, polygons = subdivide(polygons, len(weights))
        weights = step @ weights
    free = np.setdiff1d(np.arange(num_nodes), pinned)
    # Subdivision keeps the numbers of old nodes, so row i < N is where node i ends up.
    control = np.eye(num_nodes)
    wanted = np.eye(num_nodes)[pinned] - weights[np.ix_(pinned, free)] @ np.eye(num_nodes)[free]
    control[pinned] = np.linalg.solve(weights[np.ix_(pinned, pinned)], wanted)
    return weights @ control, np.array(polygons)


def subdivide(polygons: list[tuple], n: int) -> tuple[np.ndarray, list[tuple]]:
    """One Catmull-Clark step: weights (V,n), and quadrilaterals of V nodes: the n old ones, then edges, then faces."""
    # At a hole the border is kept as it is.
    touching: dict[tuple, list] = {}
    for f, polygon in enumerate(polygons):
        for a, b in zip(polygon, polygon[1:] + polygon[:1], strict=True):
            touching.setdefault((min(a, b), max(a, b)), []).append(f)
    edges = {edge: n + e for e, edge in enumerate(touching)}
    centre = np.zeros((len(polygons), n))
    for f, polygon in enumerate(polygons):
        centre[f, list(polygon)] = 1 / len(polygon)
    middle = np.zeros((len(edges), n))
    for e, (edge, around) in enumerate(touching.items()):
        middle[e, list(edge)] = 0.5
        if len(around) == 2:
            middle[e] = 0.5 * middle[e] + 0.25 * (centre[around[0]] + centre[around[1]])
    weights = np.concatenate([move_nodes(polygons, touching, centre, n), middle, centre])
    quads = []
    for f, polygon in enumerate(polygons):
        for k, node in enumerate(polygon):
            after, before = polygon[(k + 1) % len(polygon)], polygon[k - 1]
            ahead, behind = (edges[min(node, other), max(node, other)] for other in (after, before))
            quads.append((node, ahead, n + len(edges) + f, behind))
    return weights, quads


def move_nodes(polygons, touching, centre, n) -> np.ndarray:
    """Weights (n,n) by which one step moves the old nodes towards the means of their faces and neighbours."""
    weights = np.zeros((n, n))
    around: list[list[int]] = [[] for _ in range(n)]
    for f, polygon in enumerate(polygons):
        for node in polygon:
            around[node].append(f)
    border = {node for edge, faces in touching.items() if len(faces) != 2 for node in edge}
    spokes: list[list[int]] = [[] for _ in range(n)]
    for a, b in touching:
        spokes[a].append(b)
        spokes[b].append(a)
    for node in range(n):
        valence = len(spokes[node])
        if node in border or not valence:
            weights[node, node] = 1.0
            continue
        weights[node] += centre[around[node]].mean(axis=0) / valence
        weights[node, spokes[node]] += 1 / valence**2
        weights[node, node] += (valence - 2) / valence
    return weights
