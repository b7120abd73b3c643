"""What the methods share: moving rest lengths, and taking fixed degrees of freedom out of a matrix."""

from fish_env._jit import INDEX, kernel
from fish_env.simd import fma


@kernel
def move_rest_lengths(control, elapsed):
    """Set the rest lengths of the driven springs to where they are `elapsed` seconds into the call."""
    rest, start, rate, driven = control.rest_length, control.start, control.rate, control.driven
    for d in range(driven.size):
        rest[INDEX(driven[d])] = fma(elapsed, rate[d], start[d])  # (14)
