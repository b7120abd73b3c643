"""Compilation: `njit` with the flags every kernel of this package uses, cached on disk under a hash of the sources.

Numba's own cache looks only at the file a kernel stands in, so a kernel that calls another file's kernel can be
served stale after an edit. Here the cache folder's name is a hash of every source file of the package: an edit
anywhere opens a new folder, and a stale kernel cannot be found.
"""

import contextlib
import hashlib
import os
import sys
import tempfile
import warnings
from pathlib import Path
from types import CodeType, FunctionType, ModuleType

import numba
import numpy as np
from numba.core.caching import FunctionCache
from numba.core.dispatcher import Dispatcher
from numba.core.registry import CPUDispatcher

# No fastmath at all: nothing is reordered or contracted, so that a fish has the same bits alone and in any lane, and the
# failure check sees a NaN.
OPTIONS = {"nogil": True, "error_model": "numpy", "boundscheck": False}
INDEX = np.uint64  # kernels index with unsigned numbers: numba then has no negative ones to test for
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
    private = Path(tempfile.gettempdir()) / f"cache-{os.getuid() if hasattr(os, 'getuid') else 'user'}"
    bases = [private]
    with contextlib.suppress(RuntimeError):  # no home folder is known
        bases.insert(0, Path(user) if user else Path.home() / ".cache")
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
        f"fish_env cannot write to {' or '.join(map(str, bases))}, so kernels are compiled anew in every process "
        "(about 15 s); set NUMBA_CACHE_DIR to a writable folder",
        RuntimeWarning,
        stacklevel=2,
    )
    return None


_FOLDER = cache_folder()


class SourceCache(FunctionCache):
    """Numba's cache of one function, for closures too: kernels that a closure holds enter the key by their code."""

    def _index_key(self, sig, codegen):
        digest = hashlib.sha256(b"".join(code_of(self._py_func, set())))
        return sig, codegen.magic_tuple(), digest.hexdigest()


def code_of(value, seen: set) -> list[bytes]:
    """What a function does, as bytes: its code, and that of the kernels and the numbers it takes from outside."""
    if isinstance(value, Dispatcher):
        value = value.py_func
    if not isinstance(value, FunctionType):
        return [repr(value).encode()]
    if value in seen:
        return []
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


def njit(function):
    """Compile a function that Python calls: no Python objects, no GIL, numpy's division rules, cached by its sources."""
    compiled = numba.njit(**OPTIONS)(function)
    if _FOLDER is not None and isinstance(compiled, Dispatcher):
        previous, numba.config.CACHE_DIR = numba.config.CACHE_DIR, _FOLDER
        try:
            compiled._cache = SourceCache(function)
        finally:
            numba.config.CACHE_DIR = previous
    return compiled


class Part(CPUDispatcher):
    """A kernel that becomes part of every kernel that calls it. Called from Python, it is compiled by itself first."""

    def __call__(self, *args):
        if "_alone" not in self.__dict__:
            self._alone = numba.njit(**OPTIONS)(self.py_func)
        return self._alone(*args)


def part(function, **options):
    """Compile a part of kernels, without the wrappers that Python would call it by: a quarter of the time."""
    compiled = numba.njit(**OPTIONS, **options, no_cpython_wrapper=True, no_cfunc_wrapper=True)(function)
    if isinstance(compiled, CPUDispatcher):
        compiled.__class__ = Part
    return compiled


def kernel(function):
    """As `part`, and made part of every kernel that calls it."""
    return part(function, forceinline=True)
