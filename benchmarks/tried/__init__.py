"""Methods that were tried and lost to `leapfrog_chebyshev`, as kernels of one fish: see `benchmarks/ideas.py`."""

from benchmarks.tried.common import Idea
from benchmarks.tried.constant import FOR_GOOD
from benchmarks.tried.explicit import TOLERANCE, WITHOUT
from benchmarks.tried.matrices import EVERY_STEP

IDEAS: dict[str, Idea] = {idea.name: idea for idea in (*EVERY_STEP, *FOR_GOOD, *WITHOUT)}

__all__ = ["EVERY_STEP", "IDEAS", "TOLERANCE", "Idea"]
