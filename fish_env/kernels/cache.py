"""Disk cache of compiled kernels: its folder, the names of its files, and their look-up.

Numba's own cache checks only the file of a kernel, not those of the kernels that it calls. Here the folder's name is a
hash of the sources of `fish_env.kernels`, and a file's name is one of all that the kernel is made of. So a stale kernel
cannot be found after an edit, and an edit elsewhere costs nothing.
"""

import contextlib
import hashlib
import os
import pickle
import sys
import tempfile
import warnings
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import numba
from numba.core.caching import CompileResultCacheImpl, FunctionCache, IndexDataCacheFile

from fish_env.kernels.data import data
from fish_env.kernels.fingerprint import UnknownValueError, fingerprint
from fish_env.kernels.progress import end_progress, start_progress

CHECKSUM = 32  # bytes
ROOMS = ("kernels",)
"""Folders of the package whose functions `fingerprint` knows by their names; it has all others by value."""
CACHE_VARIABLES = ("NUMBA_CACHE_DIR", "XDG_CACHE_HOME", "LOCALAPPDATA")


def source_hash(package: Path | None = None, rooms: tuple[str, ...] = ("",)) -> str:
    """Hash of the Python source files of a package or some of its folders (names and bytes), 16 hexadecimal digits."""
    digest, package = hashlib.sha256(), data("fish_env") if package is None else package
    for room in rooms:
        for name, content in _sources(package.joinpath(room) if room else package, room):
            digest.update(name.encode())
            digest.update(content)
    return digest.hexdigest()[:16]


def _sources(folder: Path, above: str = "") -> Iterator[tuple[str, bytes]]:
    """Yield names and bytes of the source files below a folder, which may be in an archive."""
    for each in sorted(folder.iterdir(), key=lambda each: each.name):
        if each.is_dir():
            yield from _sources(each, f"{above}{each.name}/")
        elif each.name.endswith(".py"):
            yield above + each.name, each.read_bytes()


def cache_folder() -> str | None:
    """Folder of compiled kernels, created if necessary; None (with a warning) if none can be written."""
    # It is FISH_ENV_CACHE, or in NUMBA_CACHE_DIR, XDG_CACHE_HOME, LOCALAPPDATA or ~/.cache, or else a private one among
    # the temporary files. Compiled kernels are pickles, so only the user may write to it.
    name = f"{source_hash(rooms=ROOMS)}-py{sys.version_info.major}{sys.version_info.minor}"
    if os.environ.get("FISH_ENV_CACHE"):
        return chosen_folder(Path(os.environ["FISH_ENV_CACHE"]).expanduser() / name)
    user = next((os.environ[name] for name in CACHE_VARIABLES if os.environ.get(name)), None)
    bases, private = [], None
    with contextlib.suppress(RuntimeError):  # there is no home folder
        bases.append(Path(user) if user else Path.home() / ".cache")
    with contextlib.suppress(FileNotFoundError):  # there is no folder for temporary files
        private = Path(tempfile.gettempdir()) / f"cache-{os.getuid() if hasattr(os, 'getuid') else 'user'}"
        bases.append(private)
    for base in bases:
        folder = base / "fish_env" / name
        with contextlib.suppress(OSError):
            if base is private:
                base.mkdir(mode=0o700, exist_ok=True)
            folder.mkdir(parents=True, exist_ok=True)
            if os.access(folder, os.W_OK) and not others_write(folder):
                return str(folder)
    warnings.warn(
        f"fish_env cannot write to {' or '.join(map(str, bases)) or 'any folder'}, so kernels are compiled again in "
        "every process (about 15 s); set FISH_ENV_CACHE to a writable folder",
        RuntimeWarning,
        stacklevel=2,
    )
    return None


def others_write(path: Path) -> Path | None:
    """First of a path and its parent folders whose content another user can change, or None."""
    # The administrator is trusted, and a group with the number of its user. Sticky folders, such as that of temporary
    # files, protect files of others.
    if not hasattr(os, "getuid"):
        return None
    for each in (path, *path.resolve().parents):
        status = each.stat()
        shared = 0o002 if status.st_gid in (0, os.getuid()) else 0o022
        if each is not path and status.st_mode & 0o1000:
            shared = 0
        if status.st_uid not in (0, os.getuid()) or status.st_mode & shared:
            return each
    return None


def chosen_folder(folder: Path) -> str | None:
    """Folder below FISH_ENV_CACHE, or None with a warning; a read-only one is valid if it contains kernels."""
    reason = "it holds no kernels, and cannot be written to"
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        reason = error.strerror or str(error)
    if folder.is_dir() and (os.access(folder, os.W_OK) or any(folder.rglob("*.nbc"))):
        path = others_write(folder)
        if path is None:
            return str(folder)
        reason = f"somebody else owns {path} or can write to it, and compiled kernels are run unseen"
    warnings.warn(
        f"fish_env cannot store compiled kernels in {folder} ({reason}), so they are compiled again in every process "
        "(about 15 s); set FISH_ENV_CACHE to a folder that can be written to, or fill it by python -m fish_env compile",
        RuntimeWarning,
        stacklevel=2,
    )
    return None


_FOLDER = cache_folder()


class Place:
    """Cache locator of a function, for numba: a subfolder with the name of the function's package."""

    # Numba's own are named after the path of the sources, which differs between machines, and reject read-only folders.

    def __init__(self, function, file):
        package, _, _ = function.__module__.rpartition(".")
        outside = hashlib.sha256(os.path.dirname(os.path.abspath(file)).encode()).hexdigest()[:16]
        self._path = os.path.join(str(_FOLDER), package if package.split(".")[0] == "fish_env" else outside)
        self._py_file = file  # which numba names where it warns that a kernel cannot be stored

    @classmethod
    def from_function(cls, function, file):
        return cls(function, file)

    def get_cache_path(self) -> str:
        """Folder of its files."""
        return self._path

    def ensure_cache_path(self) -> None:
        """Create that folder; OSError if that is impossible."""
        os.makedirs(self._path, exist_ok=True)

    def get_source_stamp(self) -> str:
        """Return "": folder names depend on the sources, and file names on the functions' content."""
        return ""

    def get_disambiguator(self) -> str:
        """Return "": the fingerprint in a file's name distinguishes functions of one name."""
        return ""


class Stored(CompileResultCacheImpl):
    """Numba's serialisation of a kernel, with the locator of this package."""

    _locator_classes = [Place]


class KeyedFiles(IndexDataCacheFile):
    """Files of compiled code, named by a hash of their key; a damaged one, by its checksum, counts as missing."""

    # Numba numbers files by an index without a lock: of two processes that compile two closures of one function, one
    # may then load the code of the other.

    def save(self, key, data):
        """Store compiled code."""
        name = self._name(key)
        content = self._dump(data)
        with self._open_for_write(self._data_path(name)) as file:
            file.write(checksum(name, content) + content)

    def load(self, key):
        """Load compiled code; None if there is none, or if it is of a module that cannot be imported."""
        name = self._name(key)
        path = Path(self._data_path(name))
        with contextlib.suppress(OSError):
            if not others_write(path):
                digest, data = (content := path.read_bytes())[:CHECKSUM], content[CHECKSUM:]
                try:
                    return pickle.loads(data) if checksum(name, data) == digest else None
                except ImportError as error:
                    warn_unstored(f"kernels so that they are found again ({error}); every process compiles them again")
        return None

    def _name(self, key) -> str:
        text = "\n".join(map(str, (numba.__version__, *key)))
        return self._index_name.removesuffix("nbi") + hashlib.sha256(text.encode()).hexdigest()[:32] + ".nbc"


def checksum(name: str, data: bytes) -> bytes:
    """Digest of a stored kernel and of its name: a file with the name of another one is none."""
    return hashlib.sha256(name.encode() + data).digest()


class SourceCache(FunctionCache):
    """Numba's cache of one function, also for closures: its key contains all that the function is compiled from."""

    _impl_class = Stored

    def __init__(self, function):
        super().__init__(function)
        self._cache_file = KeyedFiles(self._cache_path, self._impl.filename_base, self._impl.locator.get_source_stamp())

    def load_overload(self, sig, target_context):
        """Load compiled code, or return None and announce the compilation."""
        found = None
        with contextlib.suppress(UnknownValueError):
            found = super().load_overload(sig, target_context)
        if found is None:
            start_progress()
        return found

    def save_overload(self, sig, data):
        """Store compiled code."""
        end_progress()
        try:
            super().save_overload(sig, data)
        except OSError as error:
            warn_unstored(
                f"compiled kernels in {_FOLDER} ({error.strerror or error}): they are compiled again in every process; "
                "make room there, or set FISH_ENV_CACHE to another folder"
            )
        except UnknownValueError as error:
            warn_unstored(f"the compiled {self._py_func.__name__}, which every process compiles again: {error}")

    def _index_key(self, sig, codegen):
        return sig, codegen.magic_tuple(), numba.config.BOUNDSCHECK, fingerprint(self._py_func)


@cache
def warn_unstored(what: str) -> None:
    """Warn, once per process, that a compiled kernel is in memory only."""
    warnings.warn(f"fish_env cannot store {what}", RuntimeWarning, stacklevel=2)
