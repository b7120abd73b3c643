"""How far a body of tetrahedra is from its shape."""

import numpy as np

from fish_env.body import Body


def deformation(body: Body, x) -> np.ndarray:
    """Deformation gradients (T,3,3) of the elements at x (N,3)."""
    return np.einsum("tac,tad->tcd", x[body.tets.nodes], body.tets.gradient)


def out_of_shape(body: Body, x) -> float:
    """Largest distance of a node from where it is at rest, over the body's size, once x is turned to fit best."""
    here, there = (a - np.average(a, axis=0, weights=body.mass) for a in (x, body.position))
    u, _, vt = np.linalg.svd((here * body.mass[:, None]).T @ there)
    turn = u @ np.diag([1.0, 1.0, np.linalg.det(u @ vt)]) @ vt
    return float(np.linalg.norm(here @ turn - there, axis=1).max() / np.ptp(body.position, axis=0).max())
