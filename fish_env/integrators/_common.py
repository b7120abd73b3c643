"""What the methods share: rows of their plan, scratch memory, and rest lengths that move during a call."""

import numpy as np

from fish_env._jit import INDEX, kernel
from fish_env.forces.plan import INNER, LOWEST, POLYNOMIAL, H
from fish_env.simd import Kind, Pack, fma


def plan_of_step(elastic: float, viscous: float, h: float) -> np.ndarray:
    """The row of `control.plans` of a method that needs to know nothing but its step of h s."""
    row = np.zeros(POLYNOMIAL)
    row[[H, INNER, LOWEST]] = h, h, -np.inf
    return row


def scratch(body, kind: Kind, *names: str) -> Pack:
    """Vectors (N,) of these names for a block of fish."""
    return Pack("work", **{name: kind.vectors(len(body.mass)) for name in names})


@kernel
def move_rest_lengths(control, elapsed):
    """Set the rest lengths of the driven springs to where they are `elapsed` seconds into the call."""
    rest, start, rate, driven = control.rest_length, control.start, control.rate, control.driven
    for d in range(driven.size):
        rest[INDEX(driven[d])] = fma(elapsed, rate[d], start[d])  # (14)
