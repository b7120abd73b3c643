"""The registry of published numbers, and how it tells whether they are stale."""

import shlex
import sys
from dataclasses import replace
from fnmatch import fnmatch
from importlib import import_module

import pytest

from benchmarks import __main__ as entry
from benchmarks.common import reference, tables
from benchmarks.common.reference import TRAJECTORIES
from benchmarks.common.tables import TRAJECTORIES as TRAJECTORIES_KEY
from benchmarks.freshness import CURRENT, MISSING, NO_TABLE, ROOT, STALE, UNKNOWN, Status, status_of
from benchmarks.registry import REGISTRY, RESULTS, Result
from fish_env import make_fish
from fish_env.physics.body import scale_body
from fish_env.training.checkout import present_commit

each_result = pytest.mark.parametrize("result", REGISTRY.values(), ids=REGISTRY)


# The registry


def test_every_table_has_a_command():
    """Every CSV and chart in results/ is registered once, and nothing that does not exist."""
    registered = [name for result in REGISTRY.values() for name in result.outputs]
    assert len(registered) == len(set(registered))
    assert [name for name in registered if not (ROOT / name).is_file()] == []
    published = {path.relative_to(ROOT).as_posix() for path in (ROOT / RESULTS).rglob("*.*")}
    assert published - set(registered) == set()


@each_result
def test_what_a_number_follows_exists(result):
    """Every pattern names a reference trajectory."""
    assert result.follows
    for pattern in result.follows:
        assert any(fnmatch(name, pattern) for name in TRAJECTORIES), pattern


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


# Reference trajectories


@pytest.fixture
def project(tmp_path, monkeypatch):
    """A folder with a table, and the numbers of two trajectories, which may be changed."""
    now = {"body fast": 1.0, "body slow": -2000.0, "task swim": 0.0}
    monkeypatch.setattr(reference, "trajectories", lambda: now)

    def table(numbers):
        head = f"# commit: abc\n# date: 2026-01-02\n# {TRAJECTORIES_KEY}: {reference.as_text(numbers)}\n"
        (tmp_path / "speed.csv").write_text(head + "x\n6.0\n")

    table(now)
    return tmp_path, now, table


def test_status_of_a_table(project):
    """Stale where a trajectory that it follows has changed beyond the tolerance, or is new; current otherwise."""
    folder, now, table = project
    outputs = ["speed.csv", "speed.csv"]
    assert status_of(outputs, ["body *"], folder) == (CURRENT, "abc", "2026-01-02", "")
    now["body slow"] *= 1 + 1e-8  # another processor
    assert status_of(outputs, ["body *"], folder).state == CURRENT
    now["body slow"] *= 1 + 1e-4
    assert status_of(outputs, ["body *"], folder)[0::3] == (STALE, "other now: body slow")
    assert status_of(outputs, ["body fast", "task *"], folder).state == CURRENT
    now["body new"] = 1.0
    assert status_of(outputs, ["body new"], folder).state == STALE
    table(now)
    assert status_of(outputs, ["*"], folder).state == CURRENT
    now["task swim"] = float("nan")
    assert status_of(outputs, ["*"], folder).state == STALE


def test_status_that_cannot_be_told(project):
    """A table without trajectories, and files that are no tables, are said to be so; a missing file comes first."""
    folder, _, _ = project
    (folder / "speed.csv").write_text("# commit: abc\nx\n6.0\n")
    assert status_of(["speed.csv"], ["*"], folder).state == UNKNOWN
    (folder / "chart.svg").touch()
    assert status_of(["chart.svg"], ["*"], folder) == (NO_TABLE, "", "", "")
    (folder / "gait.json").write_text('{"provenance": {"commit": "abc", "date": "2026-01-02"}}')
    assert status_of(["gait.json"], ["*"], folder) == (NO_TABLE, "abc", "2026-01-02", "")
    assert status_of(["chart.svg", "gone.csv"], ["*"], folder)[0::3] == (MISSING, "gone.csv")


def test_trajectories_see_the_physics():
    """A body that is a millionth stiffer, or a reward that weighs more, gives other numbers; the same code the same."""
    fish = make_fish("mass_spring")
    first, task = reference.swim(fish), reference.perform("swim")
    assert (reference.swim(fish), reference.perform("swim")) == (first, task)
    stiffer = replace(fish, body=scale_body(fish.body, stiffness=1.0 + 1e-6))
    assert abs(reference.swim(stiffer) / first - 1.0) > 1e-8
    numbers = {"body a": 1.25e-7, "task b c": -3.0}
    assert reference.from_text(reference.as_text(numbers)) == numbers


# The command line


def result(name, command, **options):
    """A registered command."""
    return Result(name, "a number", command, 0.1, ("speed.csv",), **options)


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
    """An unknown name is answered with what there is; --stale makes what is stale or missing, --all what is older."""
    assert entry.main(["nonsense"]) == 2
    assert "unknown name 'nonsense'" in capfd.readouterr().err
    with pytest.raises(SystemExit):
        entry.main(["--all", "--stale"])
    made = {
        state: Result(f"a.{state}", "", f"-c print('{state}')", 0.1, (state,)) for state in (CURRENT, STALE, MISSING)
    }
    commit = present_commit()
    monkeypatch.setattr(entry, "REGISTRY", made)
    monkeypatch.setattr(entry, "status_of", lambda outputs, follows: Status(outputs[0], commit, "", ""))
    for option in ("--stale", "--all"):
        capfd.readouterr()
        assert entry.main([option]) == 0
        assert [line for line in capfd.readouterr().out.splitlines() if line in made] == [STALE, MISSING]
    assert entry.main([]) == 0
    assert "1 current, 1 stale, 1 missing" in capfd.readouterr().out


def test_the_list_of_this_project(capsys):
    """Every number is listed with its command."""
    assert entry.main([]) == 0
    out = capsys.readouterr().out
    assert all(each.name in out for each in REGISTRY.values())


def test_a_table_is_replaced_as_a_whole(tmp_path, monkeypatch):
    """A table that cannot be written leaves the one that was there: rows that differ, or no provenance."""
    monkeypatch.setattr(tables, "RESULTS", tmp_path)
    monkeypatch.setattr(tables, "trajectories", lambda: {"body fast": 1.0})
    path = tables.write_csv("some.csv", [{"a": 1, "b": 2.5}], "python -m some")
    before = path.read_bytes()
    assert before.startswith(b"# command: python -m some\n") and before.endswith(b"\na,b\n1,2.5\n")
    with pytest.raises(ValueError, match="fields not in fieldnames"):
        tables.write_csv("some.csv", [{"a": 1}, {"a": 1, "c": 2}], "python -m some")
    monkeypatch.setattr(tables, "provenance", lambda command: 1 / 0)
    with pytest.raises(ZeroDivisionError):
        tables.write_csv("some.csv", [{"a": 1}], "python -m some")
    assert path.read_bytes() == before and list(tmp_path.iterdir()) == [path]
