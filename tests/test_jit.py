"""The kernel cache: an edit anywhere opens a new folder, so that a stale kernel cannot be found."""

import os
import shutil
import subprocess
import sys
import tempfile
import warnings
from pathlib import Path

import pytest

import fish_env
from fish_env import _jit
from fish_env.body import TORN

PACKAGE = Path(fish_env.__file__).parent
SCRIPT = """
import fish_env, numpy as np
from fish_env.integrators._common import check
body = fish_env.make_fish("published").body
failure = check(body, 2.0 * body.position, np.zeros_like(body.position))
print(fish_env.__file__, failure, sum(check.stats.cache_hits.values()), sep="\\n")
"""


@pytest.fixture
def package(tmp_path):
    """A copy of the package's sources."""
    return shutil.copytree(PACKAGE, tmp_path / "fish_env", ignore=shutil.ignore_patterns("__pycache__"))


def edit(path, before, after):
    """Replace one piece of a source file."""
    text = path.read_text()
    assert text.count(before) == 1, f"{path.name} no longer holds {before!r} once"
    path.write_text(text.replace(before, after))


def test_hash_sees_every_source_file(package):
    """The hash changes with the bytes of any source file, however deep, with a new one and with a renamed one."""
    first = _jit.source_hash(package)
    assert first == _jit.source_hash(package) == _jit.source_hash(PACKAGE)
    seen = {first}
    for path in sorted(package.rglob("*.py")):
        text = path.read_bytes()
        path.write_bytes(text + b"\n")
        seen.add(_jit.source_hash(package))
        path.write_bytes(text)
    assert len(seen) == 1 + len(list(package.rglob("*.py")))
    (package / "forces" / "new.py").touch()
    seen.add(_jit.source_hash(package))
    (package / "forces" / "new.py").rename(package / "forces" / "newer.py")
    seen.add(_jit.source_hash(package))
    assert len(seen) == 3 + len(list(package.rglob("*.py"))) - 1
    (package / "forces" / "newer.py").unlink()
    (package / "notes.txt").write_text("not a source")
    assert _jit.source_hash(package) == first


def stretch(package, cache):
    """Stretch a fish to twice its size by the copied package in a fresh process: what failed, and cache hits."""
    environment = {key: value for key, value in os.environ.items() if not key.startswith(("NUMBA_", "PYTHON"))}
    environment |= {"PYTHONPATH": str(package.parent), "XDG_CACHE_HOME": str(cache), "PYTHONDONTWRITEBYTECODE": "1"}
    command = [sys.executable, "-c", SCRIPT]
    done = subprocess.run(command, env=environment, cwd=package.parent, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    file, failure, hits = done.stdout.split("\n")[:3]
    assert Path(file) == package / "__init__.py"
    return int(failure), int(hits)


def test_no_stale_kernel(package, tmp_path):
    """A second process finds the kernels compiled; an edit of a kernel they call, in another file, is seen at once."""
    cache = tmp_path / "cache"
    springs, caller = package / "forces" / "springs.py", package / "integrators" / "_common.py"
    stamp = caller.stat().st_mtime
    assert stretch(package, cache) == (0, 0)
    assert stretch(package, cache) == (0, 1)
    original = springs.read_text()
    edit(springs, "allowed = limit * ", "allowed = 0.5 * limit * ")
    assert stretch(package, cache) == (TORN, 0)
    assert caller.stat().st_mtime == stamp  # all that numba itself looks at
    springs.write_text(original)
    assert stretch(package, cache) == (0, 1)
    assert len(list((cache / "fish_env").iterdir())) == 2


@pytest.fixture
def nowhere(tmp_path, monkeypatch):
    """A place below a plain file, where no folder can be made, for temporary files; returned for the cache too."""
    (tmp_path / "file").touch()
    monkeypatch.delenv("NUMBA_CACHE_DIR", raising=False)
    monkeypatch.delenv("XDG_CACHE_HOME", raising=False)
    monkeypatch.delenv("LOCALAPPDATA", raising=False)
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path / "file"))
    return tmp_path / "file" / "below"


def test_warning_without_a_writable_folder(nowhere, monkeypatch):
    """Where neither the cache nor the temporary folder can be written, a warning says so and what to do about it."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(nowhere))
    with pytest.warns(RuntimeWarning, match="cannot write to .*below.* set NUMBA_CACHE_DIR to a writable folder"):
        assert _jit.cache_folder() is None


def test_kernels_compile_without_a_folder(monkeypatch):
    """Without a folder, functions compile all the same, uncached."""
    monkeypatch.setattr(_jit, "_FOLDER", None)

    @_jit.njit
    def twice(x):
        return 2 * x

    assert twice(21) == 42


@pytest.mark.parametrize("variable", ["NUMBA_CACHE_DIR", "XDG_CACHE_HOME", "LOCALAPPDATA"])
def test_folder_is_where_the_user_says(nowhere, tmp_path, monkeypatch, variable):
    """The user's variable decides where the folder is; it is named after the sources and made."""
    monkeypatch.setenv(variable, str(tmp_path / "mine"))
    folder = Path(_jit.cache_folder())
    assert folder.is_dir() and folder.parent == tmp_path / "mine" / "fish_env"
    assert folder.name.startswith(_jit.source_hash())


def test_falls_back_to_the_temporary_folder(nowhere, tmp_path, monkeypatch):
    """Where the user's folder cannot be written, the temporary one is taken, without a warning."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(nowhere))
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert _jit.cache_folder().startswith(str(tmp_path / "cache-"))


def test_no_home(nowhere, tmp_path, monkeypatch):
    """A user without a home directory, as in some containers, gets the temporary folder."""
    monkeypatch.setattr(Path, "home", home_missing)
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    assert _jit.cache_folder().startswith(str(tmp_path / "cache-"))


def home_missing():
    """What pathlib does where no home directory is known."""
    raise RuntimeError("Could not determine home directory.")
