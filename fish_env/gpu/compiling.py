"""Kernels compiled by numba-cuda (https://github.com/NVIDIA/numba-cuda), to PTX or for the GPU of this machine."""

import importlib
import importlib.util
from collections.abc import Iterator
from contextlib import contextmanager
from types import SimpleNamespace
from typing import Any

HOW = 'pip install "fish_env[gpu]"'


def load() -> Any:
    """Import `numba.cuda` of numba-cuda; ModuleNotFoundError if it is not installed."""
    if importlib.util.find_spec("numba_cuda") is None:
        raise ModuleNotFoundError(f"kernels are compiled for GPUs by numba-cuda, which is not installed: {HOW}")
    from numba import cuda

    return cuda


@contextmanager
def exactly(cc: tuple[int, int] | None = None) -> Iterator[Any]:
    """Yield `numba.cuda`, set to contract only explicit `fma`; `cc` is the compute capability if there is no GPU."""
    cuda = load()
    dispatcher: Any = importlib.import_module("numba.cuda.dispatcher")
    nvvm: Any = importlib.import_module("numba.cuda.cudadrv.nvvm")
    compile_ir, device = nvvm.compile_ir, dispatcher.get_current_device
    nvvm.compile_ir = lambda modules, **options: compile_ir(modules, **options | {"fma": False})
    if cc is not None:
        dispatcher.get_current_device = lambda: SimpleNamespace(compute_capability=cc)
    try:
        yield cuda
    finally:
        nvvm.compile_ir, dispatcher.get_current_device = compile_ir, device


def to_ptx(function, signature, cc: tuple[int, int]) -> str:
    """PTX of a plain function with the signature `types.void(...)`, which may call kernels; no GPU is needed.

    `cc` is the compute capability, such as (8, 0) for A100 and (9, 0) for H100 and H200.
    """
    with exactly(cc) as cuda:
        return cuda.compile_ptx(function, signature, cc=cc)[0]
