"""Compilation: `njit` with the flags of this package's kernels, which `fish_env.kernels.cache` stores on disk."""

import functools
import gc
import os
from contextlib import contextmanager
from uuid import uuid4

import numba
import numpy as np
from numba import _dynfunc
from numba.core.compiler import CompilerBase, DefaultPassBuilder
from numba.core.compiler_lock import global_compiler_lock
from numba.core.compiler_machinery import PassManager, register_pass
from numba.core.registry import CPUDispatcher
from numba.core.typed_passes import InlineOverloads, NativeLowering, NopythonRewrites
from numba.core.untyped_passes import InlineClosureLikes

from fish_env.kernels import cache
from fish_env.kernels.cache import SourceCache
from fish_env.kernels.fingerprint import UnknownValueError, fingerprint
from fish_env.kernels.threads import defer_signals

# No fastmath: nothing is reordered or contracted. A single fish and a fish in any lane then have the same bits, and the
# failure check detects a NaN.
OPTIONS = {"nopython": True, "nogil": True, "error_model": "numpy", "boundscheck": False}
PART = OPTIONS | {"_nrt": False, "no_cpython_wrapper": True, "no_cfunc_wrapper": True}
"""Options of a part of a kernel: without reference counts, because it makes no arrays, and without Python wrappers."""
INDEX = np.uint64  # kernels use unsigned indices, so that numba need not test for negative ones

if hasattr(os, "register_at_fork"):
    # A process that is forked while another thread compiles inherits the compiler's lock, and would deadlock.
    os.register_at_fork(
        before=global_compiler_lock.acquire,
        after_in_parent=global_compiler_lock.release,
        after_in_child=global_compiler_lock.release,
    )


@contextmanager
def name_by_content(function):
    """Compile a function in this block, in which its name contains a hash of its content."""
    # The loader resolves all calls of one name to the first part of that name that is not inlined. Numba distinguishes
    # such names only within a process, so a third process could confuse functions that two others have stored.
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
    """A kernel that Python calls."""

    # Signals during its compilation are deferred: an exception would leave numba in an inconsistent state.

    def compile(self, sig):
        collecting = gc.isenabled()
        gc.disable()
        try:
            with defer_signals(), name_by_content(self.py_func):
                return super().compile(sig)
        finally:
            if collecting:
                gc.enable()


def njit(function):
    """Compile a function that Python calls: no objects, no GIL, numpy's division rules, cached by its sources."""
    if numba.config.DISABLE_JIT:
        return function
    compiled = Kernel(function, targetoptions=OPTIONS)
    if cache._FOLDER is not None:
        compiled._cache = SourceCache(function)
    return compiled


@register_pass(mutates_CFG=True, analysis_only=False)
class PartLowering(NativeLowering):
    """Lowering of a part to LLVM's language only, which halves its cost; its callers optimise and assemble it."""

    # It must not be loaded either: callers that do not inline the part would find this unoptimised version first.

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
            del context.get_executable  # restores the method of the class


@functools.cache
def prefer_own_types() -> None:
    """Register the types of this package before numba's, once, when the first kernel is compiled."""
    from fish_env.kernels.simd import arithmetic

    arithmetic.prefer_own_types()


NEEDLESS = (InlineClosureLikes, InlineOverloads, NopythonRewrites)
"""Passes that parts do not need: functions within functions, inlining on numba's level, expressions of arrays."""


class PartCompiler(CompilerBase):
    """Numba's compiler with the lowering of parts."""

    def define_pipelines(self):
        prefer_own_types()
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
    """A kernel that is compiled into every kernel that calls it. Called from Python, it runs as Python."""

    def __call__(self, *args):
        return self.py_func(*args)

    def compile(self, sig):
        with name_by_content(self.py_func):
            return super().compile(sig)


def part(function, **options):
    """Compile a part of kernels without wrappers for Python, in a quarter of the time."""
    if numba.config.DISABLE_JIT:
        return function
    return Part(function, targetoptions=PART | options, pipeline_class=PartCompiler)


def kernel(function):
    """Compile a part that is inlined into every kernel that calls it."""
    return part(function, forceinline=True)
