"""The kernel cache: an edit anywhere opens a new folder, so that a stale kernel cannot be found."""

import errno
import os
import re
import shutil
import subprocess
import sys
import tempfile
import warnings
import zipfile
from pathlib import Path

import pytest

import fish_env
from fish_env.kernels import cache as _cache
from fish_env.kernels import progress
from fish_env.kernels.compile import njit, part

PACKAGE = Path(fish_env.__file__).parent
SCRIPT = """
import fish_env
from fish_env.physics.forces.evaluate import Evaluator, compiled
fish = fish_env.make_fish("published")
springs, x = fish.body.springs, fish.body.position
energy = Evaluator(fish.body, fish.water).energies(0.5 * springs.rest_length, x, 0.0 * x)["springs"]
expected = float((0.125 * springs.stiffness * springs.rest_length**2).sum())
hits = sum(compiled(("springs",), "energy").stats.cache_hits.values())
print(fish_env.__file__, round(energy / expected, 6), hits, sep="\\n")
"""
PATIENT = "import fish_env.kernels.progress as progress; progress.PATIENCE = 0.0"
CLOSURES = """
from fish_env.kernels.compile import kernel, njit

@kernel
def square(x):
    return x * x

@kernel
def cube(x):
    return x * x * x

def made(part, factor):
    @njit
    def scaled(x):
        return factor * part(x)
    return scaled

calls = [made(part, factor) for part in (square, cube) for factor in (1.0, 10.0)]
print([call(2.0) for call in calls], [sum(call.stats.cache_hits.values()) for call in calls])
"""
LONG = """
import math
import sys
from fish_env.kernels.compile import njit, part

def made(factor):
    @part
    def inner(x):
        total = 0.0
        for k in range(int(x)):
            total += factor
{lines}
        return total
    @njit
    def outer(x):
        return inner(x) + inner(1.01 * x) + inner(x + 1.0) + inner(x + 2.0) + inner(x + 5.0)
    return outer

print(*[made(float(factor))(1.0) for factor in sys.argv[1:]])
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
    """The hash changes with the bytes of a source file, however deep, with a new one and with a renamed one."""
    found, new = [_cache.source_hash(package)], package / "physics" / "forces" / "new.py"
    archive = shutil.make_archive(str(package.parent / "archive"), "zip", package.parent, "fish_env")
    assert _cache.source_hash(PACKAGE) == _cache.source_hash(zipfile.Path(archive, "fish_env/")) == found[0]
    for change in (lambda: new.touch(), lambda: new.write_text("\n"), lambda: new.rename(new.with_stem("newer")),
                   lambda: (package / "__init__.py").write_text("")):  # fmt: skip
        change()
        found.append(_cache.source_hash(package))
    assert len(set(found)) == len(found)
    (package / "notes.txt").write_text("not a source")
    assert _cache.source_hash(package) == found[-1]


def test_the_sources_of_the_compiler_name_the_folder(package):
    """The folder's name changes with the files of this room only."""
    first = _cache.source_hash(package, _cache.ROOMS)
    for name, same in (("control/film.py", True), ("envs/step.py", True), ("kernels/simd/types.py", False)):
        path = package / name
        path.write_text(path.read_text() + "\n")
        assert (_cache.source_hash(package, _cache.ROOMS) == first) == same


def scaled(factor):
    """A compiled function that multiplies by a factor, called once."""
    call = njit(lambda a: factor * a)
    assert call(1.0) == factor
    return call


def hits(call):
    """How often a compiled function was found on disk."""
    return sum(call.stats.cache_hits.values())


def run(script, folder, **variables):
    """What a script prints, on the standard output and error, in a fresh process in which the package of a folder is.

    Of the variables of this process for Python, numba and the package, it has none but these.
    """
    skipped = ("NUMBA_", "PYTHON", "FISH_ENV_")
    environment = {key: value for key, value in os.environ.items() if not key.startswith(skipped)}
    environment |= {"PYTHONPATH": str(folder), "PYTHONDONTWRITEBYTECODE": "1"} | variables
    words = ["-c", script] if isinstance(script, str) else list(map(str, script))
    done = subprocess.run([sys.executable, *words], env=environment, cwd=folder, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return done.stdout, done.stderr


def stored(package, cache, script=SCRIPT, **variables):
    """Energy of the springs over what it should be, by the copied package in a fresh process, and cache hits.

    Of a longer script also what it prints next, and whether it announces that it compiles.
    """
    printed, said = run(script, package.parent, XDG_CACHE_HOME=str(cache), **variables)
    file, energy, hits, *more = printed.splitlines()
    assert Path(file) == package / "__init__.py"
    message = r"fish_env compiles its kernels \(once per fish and task\): 1 of about [1-9]\d*, \d+ s \.\.\.\n"
    announced = (re.match(message, said) is not None,) if more else ()
    return float(energy), int(hits), *more, *announced


def test_no_stale_kernel(package, tmp_path):
    """A second process finds the kernels compiled, also those of closures, and by a copy that stands elsewhere.

    An edit of a kernel they call, in another file, is seen at once. A process that compiles says so, or is quiet.
    """
    cache, script = tmp_path / "cache", tmp_path / "scripts" / "script.py"
    script.parent.mkdir()
    script.write_text(PATIENT + SCRIPT + CLOSURES)
    springs, caller = package / "physics" / "forces" / "springs.py", package / "physics" / "forces" / "evaluate.py"
    stamp = caller.stat().st_mtime
    assert stored(package, cache, [script]) == (1.0, 0, "[4.0, 40.0, 8.0, 80.0] [0, 0, 0, 0]", True)
    elsewhere = shutil.copytree(package, tmp_path / "elsewhere" / "fish_env")
    assert stored(elsewhere, cache, [script]) == (1.0, 1, "[4.0, 40.0, 8.0, 80.0] [1, 1, 1, 1]", False)
    edit(springs, "total = fma(0.5 * stiffness[e]", "total = fma(1.0 * stiffness[e]")
    edit(script, "return x * x * x", "return x * x + x")
    found = stored(package, cache, [script], FISH_ENV_QUIET="1")
    assert found == (2.0, 0, "[4.0, 40.0, 6.0, 60.0] [1, 1, 0, 0]", False)
    assert caller.stat().st_mtime == stamp  # all that numba itself looks at
    assert len(list((cache / "fish_env").iterdir())) == 1


def test_a_progress_bar_stays_whole(monkeypatch, capsys):
    """Below a progress bar the message of the compiler is one line, once, and the bar is drawn again."""
    tqdm = pytest.importorskip("tqdm")
    monkeypatch.setattr(progress, "PATIENCE", -1.0)
    with tqdm.tqdm(total=2, file=sys.stderr, ncols=80, nrows=20) as bar:
        found = progress.Progress(7)
        found.on_end(None)
        found.on_end(None)
        bar.update(2)
    before, message, after = re.split(r"(?<=\r)(fish_env [^\r]*1 of about 7, 0 s \.\.\.\n)", capsys.readouterr().err)
    assert "0/2" in before and "0/2" in after and "2/2" in after and "fish_env" not in after
    assert message.count("fish_env") == 1


@pytest.fixture
def nowhere(tmp_path, monkeypatch):
    """A place below a plain file, where no folder can be made, for temporary files; returned for the cache too."""
    (tmp_path / "file").touch()
    for name in ("FISH_ENV_CACHE", *_cache.CACHE_VARIABLES):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path / "file"))
    return tmp_path / "file" / "below"


def test_warning_without_a_writable_folder(nowhere, monkeypatch):
    """Where neither the cache nor the temporary folder can be written, a warning says so and what to do about it."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(nowhere))
    with pytest.warns(RuntimeWarning, match="cannot write to .*below.* set FISH_ENV_CACHE to a writable folder"):
        assert _cache.cache_folder() is None


def test_kernels_compile_without_a_folder(monkeypatch):
    """Without a folder, functions compile all the same, uncached."""
    monkeypatch.setattr(_cache, "_FOLDER", None)
    assert njit(lambda x: 2 * x)(21) == 42


@pytest.mark.parametrize(
    ("variables", "parent"),
    [
        *(({name: "mine"}, "mine/fish_env") for name in _cache.CACHE_VARIABLES),
        ({name: name for name in ("FISH_ENV_CACHE", *_cache.CACHE_VARIABLES)}, "FISH_ENV_CACHE"),
        ({"FISH_ENV_CACHE": "", "NUMBA_CACHE_DIR": "mine", "XDG_CACHE_HOME": "other"}, "mine/fish_env"),
        ({"XDG_CACHE_HOME": "file/below"}, "cache-*/fish_env"),
        ({}, "cache-*/fish_env"),
    ],
)
def test_folder(nowhere, tmp_path, monkeypatch, variables, parent):
    """The user's variable decides where the folder is, the package's own before others; it is named after the sources.

    Where it cannot be written, and without a home as in some containers, it is among the temporary files, unsaid.
    """

    def home_missing():
        raise RuntimeError("Could not determine home directory.")

    monkeypatch.setattr(Path, "home", home_missing)
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    for name, folder in variables.items():
        monkeypatch.setenv(name, folder and str(tmp_path / folder))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        folder = Path(_cache.cache_folder())
    assert folder.is_dir() and folder.parent.relative_to(tmp_path).match(parent)
    assert folder.name.startswith(_cache.source_hash(rooms=_cache.ROOMS))


def test_own_variable_has_no_substitute(nowhere, tmp_path, monkeypatch):
    """Where FISH_ENV_CACHE cannot be written, a warning says why, and no other folder is taken."""
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path / "other"))
    monkeypatch.setenv("FISH_ENV_CACHE", str(nowhere))
    with pytest.warns(RuntimeWarning, match="below.*Not a directory.*set FISH_ENV_CACHE to a folder that can be writ"):
        assert _cache.cache_folder() is None
    assert not (tmp_path / "other").exists()


def test_a_folder_that_can_only_be_read(tmp_path, monkeypatch):
    """One that holds kernels serves, as in an image; an empty one does not. What is new stays in memory."""
    monkeypatch.setenv("FISH_ENV_CACHE", str(tmp_path))
    monkeypatch.setattr(_cache, "_FOLDER", _cache.cache_folder())
    monkeypatch.setattr(os, "access", lambda path, mode: mode != os.W_OK)
    with pytest.warns(RuntimeWarning, match="it holds no kernels, and cannot be written to"):
        assert _cache.cache_folder() is None
    assert hits(scaled(2.0)) == 0
    assert _cache.cache_folder() == _cache._FOLDER

    def refused(*arguments, **options):
        raise PermissionError(errno.EACCES, "Permission denied")

    _cache.warn_unstored.cache_clear()
    monkeypatch.setattr(os, "makedirs", refused)
    files = set(tmp_path.rglob("*.nbc"))
    assert hits(scaled(2.0)) == 1
    with pytest.warns(RuntimeWarning, match="cannot store compiled kernels in .*Permission denied.*FISH_ENV_CACHE"):
        scaled(3.0)
    assert set(tmp_path.rglob("*.nbc")) == files and files


OPEN = {
    "the folder": (".", 0o777),
    "a folder above": ("..", 0o777),
    "its group": (".", 0o770),
    "a file": ("file", 0o666),
}


@pytest.mark.skipif(not hasattr(os, "getuid"), reason="users have no numbers here")
@pytest.mark.parametrize("variable", ["FISH_ENV_CACHE", "XDG_CACHE_HOME"])
@pytest.mark.parametrize("what", OPEN)
def test_a_folder_that_others_can_write_to(nowhere, tmp_path, monkeypatch, variable, what):
    """Compiled code that somebody else may have put there is not run: it is compiled in memory, with a warning."""
    monkeypatch.setenv(variable, str(tmp_path / "mine" / "kernels"))
    monkeypatch.setattr(_cache, "_FOLDER", _cache.cache_folder())
    assert [hits(scaled(2.0)) for _ in range(2)] == [0, 1]
    place, mode = OPEN[what]
    folder = Path(_cache._FOLDER)
    path = next(folder.rglob("*.nbc")) if place == "file" else folder if place == "." else folder.parent
    path.chmod(mode)
    if mode == 0o770:
        if os.getuid() != 0:
            pytest.skip("only the administrator gives files away")
        monkeypatch.setattr(os, "getuid", lambda: 12345)
        os.chown(path, 12345, 54321)
    assert hits(scaled(2.0)) == 0
    if place != "file":
        with pytest.warns(RuntimeWarning, match="somebody else|cannot write to"):
            assert _cache.cache_folder() is None


@pytest.mark.skipif(not hasattr(os, "getuid") or os.getuid() != 0, reason="only the administrator gives files away")
def test_a_folder_of_somebody_else(tmp_path, monkeypatch):
    """So it is where somebody else owns the folder, whatever its mode."""
    monkeypatch.setenv("FISH_ENV_CACHE", str(tmp_path / "theirs"))
    folder = Path(_cache.cache_folder())
    assert _cache.others_write(folder) is None
    os.chown(folder, 12345, 12345)
    with pytest.warns(RuntimeWarning, match=f"somebody else owns {folder} or can write to it"):
        assert _cache.cache_folder() is None


def test_no_temporary_folder(nowhere, tmp_path, monkeypatch):
    """Without any folder for temporary files, the user's own is taken all the same."""

    def missing():
        raise FileNotFoundError("No usable temporary directory found")

    monkeypatch.setattr(tempfile, "gettempdir", missing)
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path))
    assert _cache.cache_folder().startswith(str(tmp_path))
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(nowhere))
    with pytest.warns(RuntimeWarning, match="cannot write to .*below"):
        assert _cache.cache_folder() is None


@pytest.mark.parametrize("damage", ["half", "a bit", "empty"])
def test_damaged_files_are_compiled_again(tmp_path, monkeypatch, damage):
    """A file of the cache that was cut short or changed counts as missing, and is replaced by a good one."""
    monkeypatch.setattr(_cache, "_FOLDER", str(tmp_path))
    assert hits(scaled(3.0)) == 0
    (path,) = tmp_path.rglob("*.nbc")
    good = path.read_bytes()
    changed = bytearray(good)
    changed[len(good) // 2] ^= 1
    path.write_bytes({"half": good[: len(good) // 2], "a bit": bytes(changed), "empty": b""}[damage])
    assert [hits(scaled(3.0)) for _ in range(2)] == [0, 1]
    assert path.stat().st_size > len(good) // 2


def test_a_file_under_another_name_is_no_kernel(tmp_path, monkeypatch):
    """Stored files that are exchanged count as missing: each knows what it is the code of."""
    monkeypatch.setattr(_cache, "_FOLDER", str(tmp_path))
    scaled(6.0), scaled(7.0)
    one, other = tmp_path.rglob("*.nbc")
    held = one.read_bytes(), other.read_bytes()
    one.write_bytes(held[1])
    other.write_bytes(held[0])
    assert [hits(scaled(factor)) for factor in (6.0, 7.0, 6.0, 7.0)] == [0, 0, 1, 1]


def test_a_full_disk_costs_time_only(tmp_path, monkeypatch):
    """Kernels that cannot be stored stay in memory, and one warning names the folder."""
    monkeypatch.setattr(_cache, "_FOLDER", str(tmp_path))
    _cache.warn_unstored.cache_clear()

    def full(source, target):
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(os, "replace", full)
    with pytest.warns(
        RuntimeWarning, match="cannot store compiled kernels in .*No space left.*another folder"
    ) as found:
        assert hits(scaled(4.0)) == hits(scaled(5.0)) == 0
    assert len(found) == 1 and not list(tmp_path.rglob("*.nbc*"))


def test_parts_are_never_loaded(tmp_path, monkeypatch):
    """What is loaded first under a name serves all callers: a part, which is not optimised by itself, must not be."""
    monkeypatch.setattr(_cache, "_FOLDER", str(tmp_path))  # or the caller would come from disk, and without its part
    seventh = part(lambda a: a / 7.0)
    call = njit(lambda a: seventh(a))
    assert call(14.0) == 2.0
    (inner,), (outer,) = seventh.overloads.values(), call.overloads.values()
    engine = outer.library.codegen._engine
    assert engine.is_symbol_defined(outer.fndesc.mangled_name)
    assert not engine.is_symbol_defined(inner.fndesc.mangled_name)


def test_processes_that_compile_at_once(tmp_path, monkeypatch):
    """Code is found by what it is for, though another process wrote at the same time and no index knows of it."""
    monkeypatch.setattr(_cache, "_FOLDER", str(tmp_path))
    calls = [scaled(factor) for factor in (2.0, 3.0)]
    files = [call._cache._cache_file for call in calls]
    keys = [call._cache._index_key(call.signatures[0], call.targetctx.codegen()) for call in calls]
    monkeypatch.setattr(type(files[0]), "_load_index", lambda self: {})
    for number, (file, key) in enumerate(zip(files, keys, strict=True)):
        file.save(key, number)
    assert [file.load(key) for file, key in zip(files, keys, strict=True)] == [0, 1]
    assert len(list(tmp_path.rglob("*.nbc"))) == 2
    for factor in (4.0, 5.0):
        scaled(factor)


def test_closures_of_several_processes(tmp_path):
    """Two processes keep a closure each; a third that loads both runs each with its own parts.

    The part is too long to be inlined: such a part is what the loader takes the first of a name of.
    """
    line = "            total += math.sin(total + k) * math.exp(-x * k) + math.tan(total * k)\n"
    path = tmp_path / "script.py"
    path.write_text(LONG.format(lines=8 * line))
    two, three, both = (
        run([path, *factors], PACKAGE.parent, FISH_ENV_CACHE=str(tmp_path), FISH_ENV_QUIET="1")[0].split()
        for factors in ("2", "3", "23")
    )
    assert two != three and both == two + three
