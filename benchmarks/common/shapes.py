"""How the elements of a body of tetrahedra are deformed."""

import numpy as np

from fish_env.body import Body


def deformation(body: Body, x) -> np.ndarray:
    """Deformation gradients (T,3,3) of the elements at x (N,3)."""
    return np.einsum("tac,tad->tcd", x[body.tets.nodes], body.tets.gradient)
