"""Pieces of rewards that more than one task is made of."""

import numpy as np

from fish_env._jit import njit


@njit
def progress(centre, before, heading, length):
    """Distance covered along `heading` (B,3) from `before` to `centre` (B,3) m, (B,) body lengths."""
    out = np.empty(centre.shape[0])
    for b in range(out.size):
        along = 0.0
        for k in range(3):
            along += (centre[b, k] - before[b, k]) * heading[b, k]
        out[b] = along / length
    return out
