"""Kernels compiled by numba-cuda (https://github.com/NVIDIA/numba-cuda) for the GPU of this machine."""

import importlib
import importlib.util
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

HOW = 'pip install "fish_env[gpu]"'


def load() -> Any:
    """Import `numba.cuda` of numba-cuda; ModuleNotFoundError if it is not installed."""
    if importlib.util.find_spec("numba_cuda") is None:
        raise ModuleNotFoundError(f"kernels are compiled for GPUs by numba-cuda, which is not installed: {HOW}")
    from numba import cuda

    return cuda


@contextmanager
def exactly() -> Iterator[Any]:
    """Yield `numba.cuda`, set to contract only explicit `fma`."""
    cuda = load()
    nvvm: Any = importlib.import_module("numba.cuda.cudadrv.nvvm")
    compile_ir = nvvm.compile_ir
    nvvm.compile_ir = lambda modules, **options: compile_ir(modules, **options | {"fma": False})
    try:
        yield cuda
    finally:
        nvvm.compile_ir = compile_ir
