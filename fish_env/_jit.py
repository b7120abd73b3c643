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

import numba
import numpy as np

# Contraction (fused multiply-add), reciprocals and sign of zero may be traded for speed. `nnan` and `ninf` may not:
# the failure check must see a NaN. `reassoc` may not: the loops are short, and vectorised sums make them slower.
FASTMATH = {"contract", "arcp", "nsz"}
INDEX = (
    np.uint64
)  # kernels index with unsigned numbers: numba then has no negative ones to test for, a quarter less time
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


def njit(function, forceinline=False):
    """Compile `function` with numba: no Python objects, no GIL, numpy's division rules, cached by source hash."""
    previous = numba.config.CACHE_DIR
    numba.config.CACHE_DIR = _FOLDER or ""
    try:
        return numba.njit(
            cache=_FOLDER is not None, nogil=True, fastmath=FASTMATH, error_model="numpy", boundscheck=False,
            forceinline=forceinline,
        )(function)  # fmt: skip
    finally:
        numba.config.CACHE_DIR = previous


def njit_inline(function):
    """As `njit`, and made part of every kernel that calls it: a call copies each array of a tuple it is handed."""
    return njit(function, forceinline=True)
