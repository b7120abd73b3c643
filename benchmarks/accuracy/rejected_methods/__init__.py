"""Methods that were rejected in favour of `leapfrog_chebyshev`, as kernels of one fish, and their comparison."""

from benchmarks.accuracy.rejected_methods.common import RejectedMethod
from benchmarks.accuracy.rejected_methods.constant import CONSTANT_MATRIX
from benchmarks.accuracy.rejected_methods.explicit import TOLERANCE, WITHOUT_MATRIX
from benchmarks.accuracy.rejected_methods.matrices import MATRIX_EVERY_STEP

ALL = (*MATRIX_EVERY_STEP, *CONSTANT_MATRIX, *WITHOUT_MATRIX)
REJECTED_METHODS: dict[str, RejectedMethod] = {method.name: method for method in ALL}

__all__ = ["MATRIX_EVERY_STEP", "REJECTED_METHODS", "TOLERANCE", "RejectedMethod"]
