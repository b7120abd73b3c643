"""The registry of published numbers, and how it tells whether they are older than the code."""

import json
import shlex
import subprocess
import sys
from importlib import import_module

import pytest

from agents import records
from benchmarks import __main__ as entry
from benchmarks.bodies import convergence
from benchmarks.common import motion
from benchmarks.definitions import Code
from benchmarks.freshness import CURRENT, MISSING, ROOT, STALE, UNKNOWN, Repository
from benchmarks.registry import REGISTRY, RESULTS, Result

each_result = pytest.mark.parametrize("result", REGISTRY.values(), ids=REGISTRY)


@pytest.fixture(scope="module")
def repository():
    """That of this project."""
    return Repository()


# The registry


def test_every_table_has_a_command():
    """Every CSV and chart in results/ is registered once, and nothing that does not exist."""
    registered = [name for result in REGISTRY.values() for name in result.outputs]
    assert len(registered) == len(set(registered))
    assert [name for name in registered if not (ROOT / name).is_file()] == []
    published = {path.relative_to(ROOT).as_posix() for path in (ROOT / RESULTS).rglob("*.*")}
    assert published - set(registered) == set()


@each_result
def test_what_a_number_depends_on_exists(result, repository):
    """The definitions that make it, and its data files; their code reaches the package's."""
    keys = [tuple(each.split(":")) for each in result.makes]
    assert [key for key in keys if key not in repository.code.graph] == []
    assert any(module.startswith("fish_env") for module, _ in repository.code.reached(keys))
    assert [pattern for pattern in result.data if not repository.files(pattern)] == []


@each_result
def test_every_command_answers(result, monkeypatch, capsys):
    """The module of a command is imported, says how it is used, and knows the options that are registered."""
    first, *arguments = shlex.split(result.command)
    module = arguments.pop(0) if first == "-m" else first.removesuffix(".py")
    monkeypatch.setattr(sys, "argv", [module, *arguments, "--help"])
    with pytest.raises(SystemExit) as end:
        import_module(module).main()
    text = capsys.readouterr().out
    assert end.value.code == 0 and "usage: " in text
    assert [option for option in arguments if option.startswith("--") and option not in text] == []


# Digests of definitions

SOURCES = {
    "package.__init__": "from package.kernels import step\n",
    "package.kernels": '''
"""Kernels."""
import numpy as np
from package import constants
from package.constants import DEEP

def step(x, count=2):
    """Doc."""
    if count < 1:
        raise ValueError(f"count is {count}; give at least one")
    for k in range(count):  # why
        x = np.sqrt(x) + constants.SHIFT * DEEP
    return x
''',
    "package.constants": "SHIFT = 1.5\nDEEP = sum(k for k in (1, 2))\nOTHER = 7\n",
    "program": "from package import step\n\ndef measure(tank):\n    return step(tank.x, count=3)\n",
}
MOVED = {
    "package.__init__": "",
    "package.inner.__init__": '"""Moved."""\n',
    "package.inner.motion": """
import numpy
from ..numbers import OFFSET as SHIFT, INNER
def advance(value: float, times: int = 2) -> float:
    "Another text."
    print("a word")
    if times < 1:
        raise ValueError("no")
    for i in range(times):
        value = numpy.sqrt(value) + SHIFT * INNER
    return value
""",
    "package.numbers": "INNER = sum(j for j in (1, 2))\nOFFSET = 1.5\n",
    "rooms.program": "from package.inner.motion import advance\ndef find(t):\n    return advance(t.x, times=3)\n",
}


def test_digests_see_through_moves_and_new_names():
    """Moved and renamed modules, functions, constants, parameters and local variables; texts and annotations."""
    code = Code(MOVED)
    assert code.changes([("rooms.program", "find")], Code(SOURCES)) == []
    reached = {("package.inner.motion", "advance"), ("package.numbers", "OFFSET"), ("package.numbers", "INNER")}
    assert code.reached([("rooms.program", "find")]) == {("rooms.program", "find"), *reached}


@pytest.mark.parametrize(
    ("module", "old", "new", "changed"),
    [
        ("package.constants", "1.5", "1.6", "SHIFT"),
        ("package.constants", "(1, 2)", "(1, 3)", "DEEP"),
        ("package.kernels", "np.sqrt", "np.cbrt", "step"),
        ("package.kernels", "SHIFT * DEEP", "OTHER * DEEP", "step"),
        ("package.kernels", "count < 1", "count < 2", "step"),
        ("package.kernels", "ValueError", "TypeError", "step"),
        ("program", "tank.x", "tank.v", "measure"),
        ("program", "count=3", "x=3", "measure"),
    ],
)
def test_digests_see_changes(module, old, new, changed):
    """A change of a number, a function, an attribute or a keyword, however deep; it is named."""
    now = Code(SOURCES | {module: SOURCES[module].replace(old, new)})
    if changed == "step" and "OTHER" in new:
        assert ("package.kernels", "step") in now.changes([("program", "measure")], Code(SOURCES))
    else:
        assert now.changes([("program", "measure")], Code(SOURCES)) == [(module, changed)]


def test_digests_of_classes_tables_and_modules():
    """Methods and fields count; so does what is put into a table later; a module as a value counts as a whole."""
    source = {
        "a": "from m import FORCES\nclass Fish:\n    length: float = 1.0\n"
        "    def swim(self):\n        return self.length\n"
        "TABLE = {}\nTABLE['fish'] = Fish\ndef run(key):\n    return TABLE[key]().swim(), FORCES\n",
        "m": "import n\nFORCES = (n,)\n",
        "n": "def first():\n    return 1\ndef second():\n    return first()\n",
    }
    code = Code(source)
    assert {("a", "TABLE"), ("a", "Fish"), ("n", "*"), ("n", "second")} < code.reached([("a", "run")])
    for module, old, new in (("a", "= 1.0", "= 2.0"), ("a", "swim", "dive"), ("a", "'fish'", "'shark'"),
                             ("n", "first():\n    return 1", "first():\n    return 2")):  # fmt: skip
        other = Code(source | {module: source[module].replace(old, new)})
        assert other.changes([("a", "run")], code), (old, new)
    assert Code(source, ignored=("a:Fish", "m")).reached([("a", "run")]) == {("a", "run"), ("a", "TABLE")}


# Against history


def git(folder, *arguments):
    """Run git in a folder."""
    settings = ("-c", "user.name=Somebody", "-c", "user.email=some@body.org", "-c", "commit.gpgsign=false")
    done = subprocess.run(["git", *settings, *arguments], cwd=folder, check=True, capture_output=True, text=True)
    return done.stdout.strip()


@pytest.fixture
def project(tmp_path):
    """A small repository with code, a parameter file, and a table that was made at its first commit."""
    (tmp_path / "fish_env").mkdir()
    (tmp_path / "fish_env" / "__init__.py").write_text("from fish_env.kernel import step\n")
    (tmp_path / "fish_env" / "kernel.py").write_text("GAIN = 2.0\n\n\ndef step(x):\n    return GAIN * x\n")
    (tmp_path / "fish_env" / "unused.py").write_text("def other():\n    return 1\n")
    (tmp_path / "fish_env" / "body.json").write_text(json.dumps({"provenance": {"date": "then"}, "mass": 1.0}))
    (tmp_path / "benchmarks").mkdir()
    (tmp_path / "benchmarks" / "speed.py").write_text(
        "from fish_env import step\n\n\ndef measure():\n    return step(3.0)\n"
    )
    git(tmp_path, "init", "-q")
    git(tmp_path, "add", ".")
    git(tmp_path, "commit", "-q", "-m", "one")
    table(tmp_path, git(tmp_path, "rev-parse", "--short", "HEAD"))
    return tmp_path


def table(folder, commit):
    """Write the table of a commit."""
    (folder / "speed.csv").write_text(f"# command: python x\n# commit: {commit}\n# date: 2026-01-02\nx\n6.0\n")


def status(folder):
    """The status of the table."""
    return Repository(folder).status(["speed.csv"], ["benchmarks.speed:measure"], ["fish_env/*.json"])


def test_status_of_a_table(project):
    """Current; current after moves and texts, and after changes of what it does not reach; stale after the others."""
    found = status(project)
    assert (found.state, found.date, found.why) == (CURRENT, "2026-01-02", "")
    (project / "benchmarks" / "room").mkdir()
    git(project, "mv", "benchmarks/speed.py", "benchmarks/room/speed.py")
    git(project, "mv", "benchmarks/room", "benchmarks/speed")
    (project / "benchmarks" / "speed" / "__init__.py").write_text("from benchmarks.speed.speed import measure\n")
    (project / "fish_env" / "unused.py").write_text("def other():\n    return 2\n")
    (project / "fish_env" / "body.json").write_text(json.dumps({"mass": 1.0, "provenance": {"date": "now"}}, indent=2))
    moved = Repository(project)
    outputs, data = ["speed.csv"], ["fish_env/*.json"]
    assert moved.status(outputs, ["benchmarks.speed.speed:measure"], data).state == CURRENT
    (project / "fish_env" / "body.json").write_text(json.dumps({"mass": 1.1}))
    found = Repository(project).status(outputs, ["benchmarks.speed.speed:measure"], data)
    assert (found.state, found.why) == (STALE, "changed since: fish_env/body.json")
    kernel = project / "fish_env" / "kernel.py"
    kernel.write_text(kernel.read_text().replace("2.0", "2.5"))
    git(project, "add", ".")
    git(project, "commit", "-q", "-m", "two")
    found = Repository(project).status(outputs, ["benchmarks.speed.speed:measure"], data)
    assert (found.state, found.why) == (STALE, "changed since: fish_env.kernel.GAIN, fish_env/body.json")
    table(project, git(project, "rev-parse", "--short", "HEAD"))
    assert Repository(project).status(outputs, ["benchmarks.speed.speed:measure"], data).state == CURRENT


def test_status_that_cannot_be_told(project, tmp_path_factory):
    """Uncommitted changes are mentioned; an unknown commit, a table without one, and an archive are said to be so."""
    commit = git(project, "rev-parse", "--short", "HEAD")
    table(project, f"{commit}-dirty")
    found = status(project)
    assert found.state == CURRENT and "not committed" in found.why
    table(project, "unknown")
    assert status(project).state == UNKNOWN and "without git" in status(project).why
    table(project, "0123abc")
    assert status(project).state == UNKNOWN and "not in this repository" in status(project).why
    (project / "speed.csv").write_text("x\n6.0\n")
    assert status(project).state == UNKNOWN and "no commit is recorded" in status(project).why
    (project / "speed.csv").unlink()
    assert status(project)[0::3] == (MISSING, "speed.csv")
    table(project, commit)
    archive = tmp_path_factory.mktemp("archive") / "project"
    project.rename(archive)
    (archive / ".git").rename(archive / "git-was-here")
    found = status(archive)
    assert found.state == UNKNOWN and found.why.startswith("no history here")
    with pytest.raises(KeyError):
        Repository(archive).code.reached([("benchmarks.speed", "nothing")])


# The command line


def result(name, command, **options):
    """A registered command."""
    return Result(name, "a number", command, 0.1, ("speed.csv",), (), (), **options)


def test_a_failure_does_not_stop_the_others(monkeypatch, capfd):
    """All are run, in processes of their own, and the failure is reported; those to be named are left out of --all."""
    made = [result("a.good", "-c print(1)"), result("a.bad", "-c 1/0"), result("b.good", "-c print(2)"),
            result("a.search", "-c print(3)", by_name=True)]  # fmt: skip
    monkeypatch.setattr(entry, "REGISTRY", {each.name: each for each in made})
    assert entry.main(["--all"]) == 1
    out, err = capfd.readouterr()
    assert [line for line in out.splitlines() if line in ("1", "2", "3")] == ["1", "2"]
    assert "[2/3] a.bad: FAILED with exit status 1" in out and "failed: a.bad" in err
    assert entry.main(["b", "a.search"]) == 0
    out = capfd.readouterr().out
    assert [line for line in out.splitlines() if line in ("1", "2", "3")] == ["2", "3"]


def test_names_and_stale_ones(monkeypatch, capfd):
    """An unknown name is answered with what there is; --stale makes what is stale or missing."""
    assert entry.main(["nonsense"]) == 2
    assert "unknown name 'nonsense'" in capfd.readouterr().err
    with pytest.raises(SystemExit):
        entry.main(["--all", "--stale"])
    made = {name: result(f"a.{name}", f"-c print('{name}')") for name in ("current", "old", "missing", "unknown")}
    states = {"a.current": CURRENT, "a.old": STALE, "a.missing": MISSING, "a.unknown": UNKNOWN}
    monkeypatch.setattr(entry, "REGISTRY", made)
    monkeypatch.setattr(entry, "status_of", lambda each, _: entry.Status(states[each.name], "", "", ""))
    monkeypatch.setattr(Repository, "without_history", "")
    capfd.readouterr()
    assert entry.main(["--stale"]) == 0
    assert [line for line in capfd.readouterr().out.splitlines() if line in made] == ["old", "missing"]
    assert entry.main([]) == 0
    assert "1 current, 1 older than the code, 1 missing, 1 cannot be told" in capfd.readouterr().out
    monkeypatch.setattr(Repository, "without_history", "git is not installed")
    assert entry.main(["--stale"]) == 2


def test_the_list_of_this_project(capsys):
    """Every number is listed with its command."""
    assert entry.main([]) == 0
    out = capsys.readouterr().out
    assert all(each.name in out for each in REGISTRY.values())


def test_a_table_is_replaced_as_a_whole(tmp_path, monkeypatch):
    """A table that cannot be written leaves the one that was there: rows that differ, or no provenance."""
    monkeypatch.setattr(records, "RESULTS", tmp_path)
    path = records.write_csv("some.csv", [{"a": 1, "b": 2.5}], "python -m some")
    before = path.read_bytes()
    assert before.startswith(b"# command: python -m some\n") and before.endswith(b"\na,b\n1,2.5\n")
    with pytest.raises(ValueError, match="fields not in fieldnames"):
        records.write_csv("some.csv", [{"a": 1}, {"a": 1, "c": 2}], "python -m some")
    monkeypatch.setattr(records, "provenance", lambda command: 1 / 0)
    with pytest.raises(ZeroDivisionError):
        records.write_csv("some.csv", [{"a": 1}], "python -m some")
    assert path.read_bytes() == before and list(tmp_path.iterdir()) == [path]


def test_convergence_of_tetrahedra(monkeypatch):
    """Distances to the finest level, which of two is the next finer one: other motions, and no motion of its own."""
    monkeypatch.setattr(motion, "SECONDS", 1.2)
    rows = convergence.run(1, tasks=("swim",), levels=(2, 1))
    assert {(row["level"], row["against"], row["failed"]) for row in rows} == {(1, 2, 0)}
    (off,) = (float(row["error"]) for row in rows if row["quantity"] == "all")
    assert 0.05 < off < 1.0
