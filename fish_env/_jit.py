"""Compilation: `njit` with the flags every kernel of this package uses, cached on disk under a hash of the sources.

Numba's own cache looks only at the file a kernel stands in, so a kernel that calls another file's kernel can be
served stale after an edit. Here the cache folder's name is a hash of every source file of the package: an edit
anywhere opens a new folder, and a stale kernel cannot be found.
"""

import contextlib
import gc
import hashlib
import os
import pickle
import sys
import tempfile
import warnings
from functools import cache
from pathlib import Path
from types import CodeType, FunctionType, ModuleType

import numba
import numpy as np
from numba import _dynfunc
from numba.core.caching import FunctionCache, IndexDataCacheFile
from numba.core.compiler import CompilerBase, DefaultPassBuilder
from numba.core.compiler_machinery import PassManager, register_pass
from numba.core.dispatcher import Dispatcher
from numba.core.registry import CPUDispatcher
from numba.core.typed_passes import InlineOverloads, NativeLowering, NopythonRewrites
from numba.core.untyped_passes import InlineClosureLikes

from fish_env._progress import begin_progress, end_progress

# No fastmath at all: nothing is reordered or contracted, so that a fish has the same bits alone and in any lane, and
# the failure check sees a NaN.
OPTIONS = {"nogil": True, "error_model": "numpy", "boundscheck": False}
PART = OPTIONS | {"_nrt": False, "no_cpython_wrapper": True, "no_cfunc_wrapper": True}
"""Of a part of a kernel: it makes no arrays, so nothing counts references to them, and Python does not call it."""
INDEX = np.uint64  # kernels index with unsigned numbers: numba then has no negative ones to test for
CHECKSUM = 32  # bytes
CACHE_VARIABLES = ("NUMBA_CACHE_DIR", "XDG_CACHE_HOME", "LOCALAPPDATA")


def source_hash(package: Path = Path(__file__).parent) -> str:
    """Hash of every Python source file under `package` (names and bytes), 16 hexadecimal digits."""
    digest = hashlib.sha256()
    for path in sorted(package.rglob("*.py")):
        digest.update(path.relative_to(package).as_posix().encode())
        digest.update(path.read_bytes())
    return digest.hexdigest()[:16]


def cache_folder() -> str | None:
    """The folder compiled kernels are kept in, created if need be; None (with a warning) if none can be written.

    Compiled kernels are pickles, so the folder is the user's own: under NUMBA_CACHE_DIR, XDG_CACHE_HOME, LOCALAPPDATA
    or ~/.cache, else a private one among the temporary files.
    """
    user = next((os.environ[name] for name in CACHE_VARIABLES if os.environ.get(name)), None)
    bases, private = [], None
    with contextlib.suppress(RuntimeError):  # there is no home folder
        bases.append(Path(user) if user else Path.home() / ".cache")
    with contextlib.suppress(FileNotFoundError):  # nor one for temporary files
        private = Path(tempfile.gettempdir()) / f"cache-{os.getuid() if hasattr(os, 'getuid') else 'user'}"
        bases.append(private)
    for base in bases:
        folder = base / "fish_env" / f"{source_hash()}-py{sys.version_info.major}{sys.version_info.minor}"
        try:
            if base is private:
                base.mkdir(mode=0o700, exist_ok=True)
                if hasattr(os, "getuid") and base.stat().st_uid != os.getuid():
                    continue  # somebody else made it
            folder.mkdir(parents=True, exist_ok=True)
            if os.access(folder, os.W_OK):
                return str(folder)
        except OSError:
            continue
    warnings.warn(
        f"fish_env cannot write to {' or '.join(map(str, bases)) or 'any folder'}, so kernels are compiled again in "
        "every process (about 15 s); set NUMBA_CACHE_DIR to a writable folder",
        RuntimeWarning,
        stacklevel=2,
    )
    return None


_FOLDER = cache_folder()


class KeyedFiles(IndexDataCacheFile):
    """Files of compiled code named by what they are for, so that processes that compile at once keep theirs apart.

    Numba numbers them by an index that it reads and writes without a lock: of two processes that compile two closures
    of one function, one may then be given the other's code.

    A file begins with a checksum; one that is damaged or cannot be read counts as missing.
    """

    def save(self, key, data):
        """Store compiled code."""
        self._save_data(self._name(key), data)

    def load(self, key):
        """What was stored, or None."""
        with contextlib.suppress(OSError):
            return self._load_data(self._name(key))
        return None

    def _dump(self, obj):
        data = super()._dump(obj)
        return hashlib.sha256(data).digest() + data

    def _load_data(self, name):
        content = Path(self._data_path(name)).read_bytes()
        digest, data = content[:CHECKSUM], content[CHECKSUM:]
        return pickle.loads(data) if hashlib.sha256(data).digest() == digest else None

    def _name(self, key) -> str:
        text = "\n".join(map(str, (numba.__version__, *key)))
        return self._index_name.removesuffix("nbi") + hashlib.sha256(text.encode()).hexdigest()[:32] + ".nbc"


class SourceCache(FunctionCache):
    """Numba's cache of one function, for closures too: kernels that a closure holds enter the key by their code."""

    def __init__(self, function):
        super().__init__(function)
        base = self._impl.filename_base
        self._cache_file = KeyedFiles(self._cache_path, base, self._impl.locator.get_source_stamp())

    def load_overload(self, sig, target_context):
        """What was compiled before, or None: then it is compiled now, and said so."""
        found = super().load_overload(sig, target_context)
        if found is None:
            begin_progress()
        return found

    def save_overload(self, sig, data):
        """Store what was compiled."""
        end_progress()
        try:
            super().save_overload(sig, data)
        except OSError as error:
            unstored(self._cache_file._cache_path, error.strerror or str(error))

    def _index_key(self, sig, codegen):
        digest = hashlib.sha256(b"".join(code_of(self._py_func, set())))
        return sig, codegen.magic_tuple(), numba.config.BOUNDSCHECK, digest.hexdigest()


@cache
def unstored(folder: str, reason: str) -> None:
    """Say, once a process, that a compiled kernel stays in memory only."""
    warnings.warn(
        f"fish_env cannot store compiled kernels in {folder} ({reason}): they are compiled again in every process; "
        "make room there, or set NUMBA_CACHE_DIR to another folder",
        RuntimeWarning,
        stacklevel=2,
    )


def code_of(value, seen: set) -> list[bytes]:
    """What a function does, as bytes: its code, and that of the kernels and the numbers it takes from outside."""
    if isinstance(value, Dispatcher):
        value = value.py_func
    if not isinstance(value, FunctionType):
        return [str(getattr(value, "cache_key", repr(value))).encode()]
    if value in seen:
        return [value.__qualname__.encode()]
    seen.add(value)
    code = value.__code__
    constants = [const for const in code.co_consts if not isinstance(const, CodeType)]
    found = [value.__module__.encode(), value.__qualname__.encode(), code.co_code, repr(constants).encode()]
    for cell in value.__closure__ or ():
        found += code_of(cell.cell_contents, seen)
    for name in code.co_names:
        outside = value.__globals__.get(name)
        if isinstance(outside, Dispatcher | FunctionType | int | float | tuple):
            found += code_of(outside, seen)
        elif isinstance(outside, ModuleType) and outside.__name__.split(".")[0] != "fish_env":
            path = getattr(outside, "__file__", None)
            found.append(Path(path).read_bytes() if path and path.endswith(".py") else name.encode())
    return found


def named(function):
    """Name a closure after what it does, besides where it stands.

    The loader takes the first part of a name that is not inlined for all others of that name, and numba's numbers tell
    closures apart only within a process: of two that two processes kept on disk, a third would run one for the other.
    """
    home = getattr(sys.modules.get(function.__module__), "__dict__", None)
    if function.__closure__ or function.__globals__ is not home:
        function.__qualname__ += "_" + hashlib.sha256(b"".join(code_of(function, set()))).hexdigest()[:16]
    return function


class Kernel(CPUDispatcher):
    """A kernel that Python calls. The garbage collector, which would find nothing, waits while it is compiled."""

    def compile(self, sig):
        collecting = gc.isenabled()
        gc.disable()
        try:
            return super().compile(sig)
        finally:
            if collecting:
                gc.enable()


def njit(function):
    """Compile a function that Python calls: no objects, no GIL, numpy's division rules, cached by its sources."""
    compiled = numba.njit(**OPTIONS)(named(function))
    if isinstance(compiled, CPUDispatcher):
        compiled.__class__ = Kernel
    if _FOLDER is not None and isinstance(compiled, Dispatcher):
        previous, numba.config.CACHE_DIR = numba.config.CACHE_DIR, _FOLDER
        try:
            compiled._cache = SourceCache(function)
        finally:
            numba.config.CACHE_DIR = previous
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
    from fish_env.simd import arithmetic

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


def part(function, **options):
    """Compile a part of kernels, without the wrappers that Python would call it by: a quarter of the time."""
    compiled = numba.njit(**PART, **options, pipeline_class=PartCompiler)(named(function))
    if isinstance(compiled, CPUDispatcher):
        compiled.__class__ = Part
    return compiled


def kernel(function):
    """As `part`, and made part of every kernel that calls it."""
    return part(function, forceinline=True)
