"""Slow, obvious reference implementations of the compiled kernels, from the equations, in plain numpy and Python loops.

Nothing here calls a kernel. Every function takes one body (no batch) and returns new arrays.
"""

from naive.elements import *  # noqa: F403
from naive.forces import *  # noqa: F403
from naive.scenes import *  # noqa: F403
from naive.steps import *  # noqa: F403
from naive.sums import *  # noqa: F403
