"""Compilation: `njit` with the flags every kernel of this package uses, stored on disk by `fish_env.kernels.cache`."""

import gc
import os
from contextlib import contextmanager
from functools import cache
from uuid import uuid4

import numba
import numpy as np
from numba import _dynfunc
from numba.core.compiler import CompilerBase, DefaultPassBuilder
from numba.core.compiler_lock import global_compiler_lock
from numba.core.compiler_machinery import PassManager, register_pass
from numba.core.dispatcher import Dispatcher
from numba.core.registry import CPUDispatcher
from numba.core.typed_passes import InlineOverloads, NativeLowering, NopythonRewrites
from numba.core.untyped_passes import InlineClosureLikes

from fish_env.kernels import cache as _cache
from fish_env.kernels.cache import SourceCache
from fish_env.kernels.fingerprint import UnknownValueError, fingerprint
from fish_env.kernels.threads import signals_held

# No fastmath at all: nothing is reordered or contracted, so that a fish has the same bits alone and in any lane, and
# the failure check sees a NaN.
OPTIONS = {"nogil": True, "error_model": "numpy", "boundscheck": False}
PART = OPTIONS | {"_nrt": False, "no_cpython_wrapper": True, "no_cfunc_wrapper": True}
"""Of a part of a kernel: it makes no arrays, so nothing counts references to them, and Python does not call it."""
INDEX = np.uint64  # kernels index with unsigned numbers: numba then has no negative ones to test for

if hasattr(os, "register_at_fork"):
    # A process that is forked while another thread compiles inherits the compiler's lock, and would wait without end.
    os.register_at_fork(
        before=global_compiler_lock.acquire,
        after_in_parent=global_compiler_lock.release,
        after_in_child=global_compiler_lock.release,
    )


@contextmanager
def compiling(function):
    """Compile a function in this block, where its name says what it is compiled from.

    The loader takes the first part of a name that is not inlined for all others of that name, and numba's numbers tell
    functions of one name apart only within a process: of two that two processes kept on disk, a third would run one for
    the other.
    """
    with global_compiler_lock:
        plain = function.__qualname__
        try:
            made_of = fingerprint(function)
        except UnknownValueError:
            made_of = uuid4().hex
        function.__qualname__ = f"{plain}_{made_of[:16]}"
        try:
            yield
        finally:
            function.__qualname__ = plain


class Kernel(CPUDispatcher):
    """A kernel that Python calls.

    While it is compiled, the garbage collector waits, which would find nothing, and so do signals: an exception would
    leave numba with half of what it needs.
    """

    def compile(self, sig):
        collecting = gc.isenabled()
        gc.disable()
        try:
            with signals_held(), compiling(self.py_func):
                return super().compile(sig)
        finally:
            if collecting:
                gc.enable()


def njit(function):
    """Compile a function that Python calls: no objects, no GIL, numpy's division rules, cached by its sources."""
    compiled = numba.njit(**OPTIONS)(function)
    if isinstance(compiled, CPUDispatcher):
        compiled.__class__ = Kernel
    if _cache._FOLDER is not None and isinstance(compiled, Dispatcher):
        compiled._cache = SourceCache(function)
    return compiled


@register_pass(mutates_CFG=True, analysis_only=False)
class PartLowering(NativeLowering):
    """Lowering of a part: to LLVM's language only. What calls it optimises it, and makes machine code of it.

    Numba optimises and assembles every function by itself as well, which for an inlined one is half of all its cost.
    Nor must a part be loaded: the loader takes the first function of a name for all others, so that what calls a part
    without inlining it would run the part as it was before it was optimised, until the next process.
    """

    _name = "part_lowering"

    def run_pass(self, state):
        context, qualname = state.targetctx, state.func_id.func_qualname
        library = context.codegen().create_library(qualname)
        library._optimize_final_module = lambda: None
        library._finalize_final_module = lambda: setattr(library, "_finalized", True)
        state.library = library
        context.get_executable = lambda library, fndesc, env: _dynfunc.make_function(
            fndesc.lookup_module(), fndesc.qualname.split(".")[-1], "part of kernels", 0, env, (library,)
        )
        try:
            return super().run_pass(state)
        finally:
            del context.get_executable  # the method of the class again


@cache
def come_first() -> None:
    """Let numba know our types first, once, when the first kernel is compiled."""
    from fish_env.kernels.simd import arithmetic

    arithmetic.come_first()


NEEDLESS = (InlineClosureLikes, InlineOverloads, NopythonRewrites)
"""Passes for what parts do not have: functions within functions, inlining on numba's level, expressions of arrays."""


class PartCompiler(CompilerBase):
    """Numba's compiler, but for how it lowers."""

    def define_pipelines(self):
        come_first()
        builder = DefaultPassBuilder
        pm = PassManager("part")
        pm.passes.extend(builder.define_untyped_pipeline(self.state).passes)
        pm.passes.extend(builder.define_typed_pipeline(self.state).passes)
        lowering = builder.define_nopython_lowering_pipeline(self.state)
        pm.passes.extend((PartLowering, text) if p is NativeLowering else (p, text) for p, text in lowering.passes)
        pm.passes = [(p, text) for p, text in pm.passes if p not in NEEDLESS]
        pm.finalize()
        return [pm]


class Part(CPUDispatcher):
    """A kernel that becomes part of every kernel that calls it. Called from Python, it runs as Python."""

    def __call__(self, *args):
        return self.py_func(*args)

    def compile(self, sig):
        with compiling(self.py_func):
            return super().compile(sig)


def part(function, **options):
    """Compile a part of kernels, without the wrappers that Python would call it by: a quarter of the time."""
    compiled = numba.njit(**PART, **options, pipeline_class=PartCompiler)(function)
    if isinstance(compiled, CPUDispatcher):
        compiled.__class__ = Part
    return compiled


def kernel(function):
    """As `part`, and made part of every kernel that calls it."""
    return part(function, forceinline=True)
