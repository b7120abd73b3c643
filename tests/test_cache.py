"""The kernel cache: compiled code is never older than its source, is found by its content, and can be filled ahead."""

import errno
import importlib.util
import os
import re
import shutil
import subprocess
import sys
import tempfile
import warnings
import zipfile
from itertools import product
from pathlib import Path

import numba
import numpy as np
import pytest
from fuzzing import examples
from hypothesis import assume, given
from hypothesis import strategies as st
from numba import njit as plain_njit

import fish_env
from fish_env import __main__ as command_line
from fish_env.envs import ahead
from fish_env.kernels import cache as _cache
from fish_env.kernels import progress
from fish_env.kernels.compile import INDEX, kernel, njit, part
from fish_env.kernels.fingerprint import UnknownValueError, fingerprint
from fish_env.kernels.simd import Kind, Pack

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
    message = r"fish_env compiles its kernels \(once per fish and task\): 1, \d+ s \.\.\.\n"
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
        found = progress.Progress()
        found.on_end(None)
        found.on_end(None)
        bar.update(2)
    before, message, after = re.split(r"(?<=\r)(fish_env [^\r]*1, 0 s \.\.\.\n)", capsys.readouterr().err)
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
    "its owner": (".", 0o700),
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
    if mode in (0o770, 0o700):
        if os.getuid() != 0:
            pytest.skip("only the administrator gives files away")
        owner = 12345 if mode == 0o700 else 0
        monkeypatch.setattr(os, "getuid", lambda: 12345 - owner)
        os.chown(path, 12345, 54321)
    assert hits(scaled(2.0)) == 0
    if place != "file":
        with pytest.warns(RuntimeWarning, match="somebody else|cannot write to"):
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


def test_a_kernel_of_a_missing_module_is_compiled_again(tmp_path, monkeypatch):
    """A stored kernel that names a module which cannot be imported here counts as missing, and a warning says why."""
    monkeypatch.setattr(_cache, "_FOLDER", str(tmp_path))
    _cache.warn_unstored.cache_clear()
    assert hits(scaled(9.0)) == 0
    (path,) = tmp_path.rglob("*.nbc")
    content = b"cno_such_module\nkernel\n."  # a pickle of an object of this module
    path.write_bytes(_cache.checksum(path.name, content) + content)
    with pytest.warns(RuntimeWarning, match="No module named 'no_such_module'.*compiles them again"):
        assert hits(scaled(9.0)) == 0


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


def test_checks_of_bounds_have_a_cache_of_their_own(tmp_path, monkeypatch):
    """Kernels that check their bounds (NUMBA_BOUNDSCHECK=1) are never mistaken for those that do not."""
    monkeypatch.setattr(_cache, "_FOLDER", str(tmp_path))
    pack = Pack("numbers", a=np.arange(9.0)[:3], v=Kind().vectors(3))

    def made():
        @kernel
        def inner(pack, i):
            return pack.a[i] + pack.v[i].x

        @njit
        def read(pack, i):
            return inner(pack, INDEX(i))

        return read

    for checked in (None, 1, None, 1):
        monkeypatch.setattr(numba.config, "BOUNDSCHECK", checked)
        read = made()
        assert read(pack, 2) == 2.0
        if checked:
            with pytest.raises(IndexError, match="out of bounds"):
                read(pack, 3)
    assert len(list(tmp_path.rglob("*.nbc"))) == 2 and sum(read.stats.cache_hits.values()) == 1


# What compiled code is found by

NUMBERS = st.sampled_from([0.0, -0.0, 1.0, 2.0, 30.0, 60.0, 1e-300, 1.0 + 2**-52, float("inf"), float("nan")])
WHOLE = st.integers(-3, 3)


@st.composite
def arrays(draw):
    """An expression for an array: small or large, of some type and order, one number of it drawn."""
    size, dtype = draw(st.sampled_from([1, 4, 6000])), draw(st.sampled_from(["float64", "float32", "int64", "uint8"]))
    place, value = draw(st.integers(0, size - 1)), draw(WHOLE.map(abs))
    shape, order = draw(st.sampled_from([(size,), (1, size), (size, 1)])), draw(st.sampled_from("CF"))
    digits = draw(st.sampled_from([0.0, 1e-12])) if dtype == "float64" else 0
    return (f"np.where(np.arange({size}) == {place}, {value} + {digits}, 7).astype('{dtype}')"
            f".reshape({shape}, order='{order}')")  # fmt: skip


SCALARS = st.one_of(
    NUMBERS.map(lambda x: f"float('{x}')"),
    WHOLE.map(str),
    st.booleans().map(str),
    st.tuples(WHOLE, WHOLE).map(lambda z: f"complex{z}"),
    st.tuples(st.sampled_from(["float64", "float32", "int8", "uint16", "complex64"]), st.integers(0, 3)).map(
        lambda pair: f"np.{pair[0]}({pair[1]})"
    ),
)
"""Expressions for numbers that kernels take."""
VALUES = st.one_of(
    arrays().map(lambda text: (text, "np.sum(K) + 100.0 * K.argmin() + K.ndim + 0.1 * K.itemsize")),
    SCALARS.map(lambda text: (text, "K * 2.0")),
    SCALARS.map(lambda text: (f"(1.0, ({text}, 2))", "K[1][0] * 2.0 + K[0]")),
    st.tuples(SCALARS, SCALARS).map(lambda pair: (f"Pair({pair[0]}, {pair[1]})", "K.a * 2.0 + K.b")),
    st.sampled_from(["low", "high", "höher", ""]).map(
        lambda text: (repr(text), "1.0 if K == 'high' else len(K) + 2.0")
    ),
    st.integers(0, 2).map(lambda number: (f"Gear({number})", "K.value * 2.0")),
    st.integers(0, 2).map(lambda number: (f"Level({number})", "K.value * 3.0")),
)
"""Pairs: an expression for a value K of a kernel, and one for a number that follows from it."""

HEAD = """
import enum
from collections import namedtuple
import numpy as np
from fish_env.kernels.compile import kernel, njit
class Gear(enum.Enum):
    FIRST, SECOND, THIRD = 0, 1, 2
class Level(enum.IntEnum):
    LOW, MIDDLE, HIGH = 0, 1, 2
Pair = namedtuple("Pair", "a b")
"""
INNER = "\ndef inner(x):\n    return x * ({use})\n"
CALLED = "@njit\ndef call(x):\n    return inner(x)\n"
WAYS = {
    "global": "K = {value}\n@njit" + INNER.replace("inner", "call"),
    "global of a called kernel": "K = {value}\n@kernel" + INNER + CALLED,
    "global of another library's kernel": "import numba\nK = {value}\n@numba.njit" + INNER + CALLED,
    "closure": "def make(K):\n    @njit\n    def call(x):\n        return x * ({use})\n    return call\n"
    "call = make({value})\n",
    "closure of a called kernel": "def make(K):\n    @kernel\n    def inner(x):\n        return x * ({use})\n"
    "    return inner\ninner = make({value})\n" + CALLED,
    "inner function": "K = {value}\n@njit\ndef call(x):\n    def inner(y):\n        return y * ({use})\n"
    "    return inner(x)\n",
    "lambda": "K = {value}\n@njit\ndef call(x):\n    f = lambda y: y * ({use})\n    return f(x)\n",
    "comprehension": "K = {value}\n@njit\ndef call(x):\n    return [x * ({use}) for _ in range(2)][1]\n",
    "module": "import types\nm = types.ModuleType('m')\nm.K = {value}\n@njit\ndef call(x):\n    K = m.K\n"
    "    return x * ({use})\n",
}
"""Ways in which a kernel comes by a value."""
NUMBERED = {
    "default": "@njit\ndef call(x, k={value}):\n    return x * k\n",
    "default of a called kernel": "@kernel\ndef inner(x, k={value}):\n    return x * k\n" + CALLED,
    "constant of an inner function": "@njit\ndef call(x):\n    def inner(y):\n        return y * {value}\n"
    "    return inner(x)\n",
    "constant of a lambda": "@njit\ndef call(x):\n    return (lambda y: y * {value})(x)\n",
    "constant of a comprehension": "@njit\ndef call(x):\n    return [x * {value} for _ in range(2)][1]\n",
    "member of an enumeration": "class Gear(enum.Enum):\n    FIRST = {value}\n@njit\ndef call(x):\n"
    "    return x * Gear.FIRST.value\n",
    "default of a named tuple": "from typing import NamedTuple\nclass P(NamedTuple):\n    k: float = {value}\n"
    "P0 = P()\n@njit\ndef call(x):\n    return x * P0.k\n",
}
"""The same for plain numbers."""


@pytest.fixture(scope="module", autouse=True)
def own_folder(tmp_path_factory):
    """A folder of compiled code of this module's own."""
    before, _cache._FOLDER = _cache._FOLDER, str(tmp_path_factory.mktemp("kernels"))
    yield
    _cache._FOLDER = before


def loaded(path, text):
    """The module of a file as another process would have it, its kernels not compiled yet."""
    path.write_text(text)
    name = "edited"
    spec = importlib.util.spec_from_file_location(name, path)
    sys.modules[name] = module = importlib.util.module_from_spec(spec)
    exec(compile(text, str(path), "exec"), module.__dict__)
    return module


def python_of(text, x):
    """What the text means without a compiler."""
    plain = text.replace("from fish_env.kernels.compile import kernel, njit", "kernel = njit = lambda f: f")
    plain = plain.replace("@numba.njit", "@njit")
    space = {"__name__": "plain"}
    with np.errstate(all="ignore"), warnings.catch_warnings():
        warnings.simplefilter("ignore")
        exec(plain, space)
        return space["call"](x)


def is_right(path, text, x=3.0):
    """Check what the compiled text makes of a number, and return the module."""
    module = loaded(path, text)
    wanted, found = python_of(text, x), module.call(x)
    np.testing.assert_allclose(found, wanted, rtol=1e-14)
    if wanted == 0.0 and not isinstance(wanted, complex | np.complexfloating):
        assert np.signbit(found) == np.signbit(wanted)
    return module


@given(way=st.sampled_from([*WAYS, *NUMBERED]), data=st.data())
@examples(30)
def test_values_are_seen(tmp_path_factory, way, data):
    """Whatever value a kernel comes by in whatever way, compiled code is of the value that it has now."""
    path = tmp_path_factory.mktemp("edited") / "edited.py"
    kinds = VALUES if way in WAYS else st.sampled_from(["1.0", "2.0", "3", "-0.0", "True"]).map(lambda text: (text, ""))
    values = data.draw(st.lists(kinds, min_size=2, max_size=3))
    assume(way != "module" or not any("arange" in value for value, _ in values))  # numba takes no arrays of modules
    for value, use in (*values, values[0]):
        is_right(path, HEAD + (WAYS | NUMBERED)[way].format(value=value, use=use))


TEXTS = {
    "function of numpy": ("np.sin(x)", "np.cos(x)"),
    "operator": ("x + 2.0", "x - 2.0"),
    "attribute": ("np.float64(x).real", "np.float64(x).imag"),
    "order of arguments": ("np.arctan2(x, 2.0)", "np.arctan2(2.0, x)"),
    "set": ("1.0 if int(x) in (1, 2, 3) else 0.0", "1.0 if int(x) in (1, 2, 4) else 0.0"),
    "type": ("np.float32(x / 7.0)", "np.float64(x / 7.0)"),
}


@pytest.mark.parametrize("name", TEXTS)
def test_code_is_seen(tmp_path, name):
    """A change of the code itself is seen where the bytecode stays the same; what has not changed is found."""
    one, other = (HEAD + f"@njit\ndef call(x):\n    return {text}\n" for text in TEXTS[name])
    unrelated = one + "other = 3\n\n\ndef unrelated():\n    return other\n"
    assert [loads(tmp_path, text) for text in (one, one, other, other, one, unrelated)] == [0, 1, 0, 1, 1, 1]


def loads(folder, text):
    """How often what a text compiles was found on disk; the compiled text is right."""
    return hits(is_right(folder / "edited.py", text).call)


OUTER = "def outer(x):\n    return x * {value}\n"
CALLS_OUTER = CALLED.replace("inner", "outer")
ELSEWHERE = {
    "overload": "from numba.extending import overload\n" + OUTER + "@overload(outer)\ndef _(x):\n"
    "    return lambda x: x * {value}\n" + CALLS_OUTER,
    "function of an overload": "from numba.extending import overload\ndef outer(x):\n    raise NotImplementedError\n"
    + OUTER.replace("outer", "inner") + "@overload(outer)\ndef _(x):\n    return inner\n" + CALLS_OUTER,
    "jitable": "from numba.extending import register_jitable\n@register_jitable\n" + OUTER + CALLS_OUTER,
}  # fmt: skip


@pytest.mark.parametrize("name", ELSEWHERE)
def test_overloads_are_seen(tmp_path, name):
    """What numba compiles in place of a function is part of what calls it, and found again."""
    for value, wanted in (("2.0", 0), ("2.0", 1), ("5.0", 0)):
        module = loaded(tmp_path / "edited.py", HEAD + ELSEWHERE[name].format(value=value))
        assert module.call(3.0) == 3.0 * float(value)
        assert hits(module.call) == wanted


UFUNC = "import numba\n@numba.vectorize\n" + OUTER + CALLS_OUTER


def test_what_is_unknown_is_not_stored(tmp_path):
    """A kernel that calls what cannot be told by value is compiled in every process, and one warning says so."""
    for value in ("2.0", "5.0"):
        _cache.warn_unstored.cache_clear()
        with pytest.warns(RuntimeWarning, match="cannot store the compiled call, .*outer"):
            module = loaded(tmp_path / "edited.py", HEAD + UFUNC.format(value=value))
            assert module.call(3.0) == 3.0 * float(value)
        with pytest.raises(UnknownValueError, match="outer"):
            fingerprint(module.call.py_func)


def test_a_large_table_is_not_stored(tmp_path):
    """A kernel of a table above a megabyte, which compiled code only points to, works; numba says it is not stored."""
    text = HEAD + "K = np.arange(2e5)\n@njit\ndef call(x):\n    return x * K[int(x)]\n"
    for _ in range(2):
        with pytest.warns(numba.NumbaWarning, match="Cannot cache .*call.* as it uses dynamic globals"):
            assert loads(tmp_path, text) == 0


def test_closures_of_one_process():
    """Kernels that close over arrays which differ in one of 6,000 numbers are told apart, inlined or not."""

    def made(array, how):
        inner = how(lambda i: array[i])
        return njit(lambda i: inner(i))

    first, second = np.zeros(6000), np.zeros(6000)
    second[3000] = 1.0
    for how in (kernel, njit, plain_njit):
        assert [made(array, how)(3000) for array in (first, second)] == [0.0, 1.0]


def test_keyword_defaults():
    """A default that only a keyword replaces, which numba takes in no call yet, is seen as well."""

    def made(k):
        def call(x, *, k=k):
            return x * k

        return call

    assert fingerprint(made(1.0)) == fingerprint(made(1.0)) != fingerprint(made(2.0))


def test_recursion_and_twins():
    """Functions that call themselves have a fingerprint, and one called twice is not taken for another of its name."""

    def made(k):
        @kernel
        def inner(x):
            return k * x

        return inner

    one, other = made(1.0), made(2.0)

    def pair(f, g, h):
        def call(x):
            return f(x) + g(x) + h(x)

        return call

    assert fingerprint(pair(one, other, one)) != fingerprint(pair(one, other, other))

    @plain_njit
    def factorial(n):
        return 1 if n < 2 else n * factorial(n - 1)

    assert len(fingerprint(factorial.py_func)) == 64


# Ahead of its use

USE = """
import warnings
import gymnasium as gym, numpy as np, fish_env
warnings.simplefilter("error")
for env in (gym.make("FishEnv/Swim-v0"), gym.make_vec("FishEnv/Swim-v0", num_envs=256, variation={"mass": (0.9, 1.1)})):
    obs, _ = env.reset(seed=0)
    for _ in range(3):
        env.step(np.zeros(env.action_space.shape, np.float32))
fish = fish_env.make_fish()
fish_env.Tank(fish, 1, water=fish.water).swim([1.0] * 12, fish.control_interval)
"""


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """An empty folder of kernels."""
    monkeypatch.setattr(_cache, "_FOLDER", str(tmp_path))
    return tmp_path


def test_it_says_what_was_stored(folder, monkeypatch, capsys):
    """For each task and body, how many kernels are new, and how many there are."""
    tried = []

    def run(count, *words):
        tried.append((count, *words))
        if count == 1 and words[2] == "float64":
            factor = len(tried)
            njit(lambda a: factor * a)(1.0)

    monkeypatch.setattr(ahead, "use_kernels", run)
    words = ["compile", "swim", "turn", "--body", "planar", "--dtype", "float64", "float32", "--integrator", "rk4"]
    assert command_line.main(words) == 0
    assert capsys.readouterr().out.splitlines() == [
        "swim on planar: 1 new kernels, 1 in all", "turn on planar: 1 new kernels, 2 in all", f"0 MB in {folder}",
    ]  # fmt: skip
    each = product(("swim", "turn"), ("float64", "float32"), ahead.COUNTS)
    assert tried == [(count, task, "planar", dtype, "rk4") for task, dtype, count in each]


def test_mistakes_are_answered(folder, monkeypatch, capsys):
    """An unknown task or body, and a missing folder, are refused in one line."""
    for words, said in (
        (["swimm"], "unknown task 'swimm'"),
        (["swim", "--body", "eel"], "unknown body 'eel'; choose from 'mass_spring'"),
        (["swim", "--dtype", "half"], "half"),
    ):
        assert command_line.main(["compile", *words]) == 2
        assert said in capsys.readouterr().err
    monkeypatch.setattr(_cache, "_FOLDER", None)
    assert command_line.main(["compile", "swim"]) == 2
    assert "set FISH_ENV_CACHE to one that can be written to" in capsys.readouterr().err


@pytest.mark.slow
def test_nothing_is_left_to_compile(tmp_path):
    """After the command, environments of one fish and of many, and a tank, find every kernel; nothing is stored."""

    def run_here(script):
        output = run(script, PACKAGE.parent, FISH_ENV_CACHE=str(tmp_path))
        return *output, {path: path.stat().st_mtime_ns for path in Path(tmp_path).rglob("*.nbc")}

    said, _, before = run_here(["-m", "fish_env", "compile", "swim"])
    assert f"{len(before)} in all" in said and len(before) > 2
    _, errors, after = run_here(USE)
    assert after == before and "compiles" not in errors
