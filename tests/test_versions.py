"""The trial of other versions: which versions pip is told to take, and that the page says what the table says."""

import re

import pytest

from benchmarks.common.tables import RESULTS, ROOT, read_rows
from benchmarks.stability import versions

PROJECT = (ROOT / "pyproject.toml").read_text()
PAGE = (ROOT / "docs" / "reliability.md").read_text()


def as_numbers(text):
    """A version as numbers that can be compared; a part such as "post1" counts as none."""
    return tuple(int(part) for part in text.split(".") if part.isdigit())


def test_every_requirement_has_a_lower_bound():
    """Each package that is required has one bound, so "lowest" leaves nothing to pip but what others require."""
    lists = re.findall(r"^([\w-]+) = \[(.*)\]$", PROJECT.split("[tool.", 1)[0], re.MULTILINE)
    required = [each for name, text in lists if name not in ("keywords", "license-files") for each in
                re.findall(r'"([^"]+)"', text)]  # fmt: skip
    names = {re.match(r"[\w-]+", each)[0] for each in required} - {"fish_env"}
    assert {"numpy", "torch", "viser", "ruff", "setuptools", "cma"} <= names
    assert names == set(versions.bounds(PROJECT))
    free = {each for each in required if ">=" not in each and not each.startswith("fish_env[")}
    assert free == {"gymnasium[mujoco]"}  # whose bound is that of gymnasium


def test_two_bounds_are_refused():
    """A package with two lower bounds has no lowest version."""
    assert versions.bounds('["numpy>=2.0", "numba-cuda[cu12]>=0.30", "mujoco>=3.17,<4"]') == {
        "numpy": "2.0", "numba-cuda": "0.30", "mujoco": "3.17"}  # fmt: skip
    with pytest.raises(ValueError, match=r"pip has the lower bounds 1.0 and 2.0"):
        versions.bounds('["pip>=1.0"]\n["pip>=2.0"]')


def test_what_pip_is_told():
    """The lowest are the bounds, the newest fixes torch alone, the pinned are constraints.txt and allowed."""
    lowest, newest, pinned = (versions.constraints(name, ROOT) for name in versions.RESOLUTIONS)
    assert "numpy==" in lowest and ">" not in lowest
    assert newest.startswith("torch==") and len(newest.splitlines()) == 1
    bounds = versions.bounds(PROJECT)
    for name, version in re.findall(r"^([\w-]+)==([\w.]+)", pinned, re.MULTILINE):
        assert as_numbers(version) >= as_numbers(bounds.get(name, "0")), name


def test_a_table_of_trials(tmp_path, monkeypatch):
    """A row replaces that of the same minor version and resolution; rows are in the order of the versions."""
    monkeypatch.setattr(versions, "RESULTS", tmp_path)
    monkeypatch.setattr("agents.records.RESULTS", tmp_path)
    for python, resolution, tests in (("3.10.1", "lowest", 1), ("3.9.5", "pinned", 2), ("3.10.2", "lowest", 3)):
        versions.keep({"python": python, "resolution": resolution, "tests": tests})
    rows = read_rows(tmp_path / versions.TABLE)
    assert [tuple(row.values()) for row in rows] == [("3.9.5", "pinned", "2"), ("3.10.2", "lowest", "3")]


def test_the_page_says_what_the_table_says():
    """Every row of the table stands on the page, and no other one."""
    rows = read_rows(RESULTS / versions.TABLE)
    for row in rows:
        counts = " | ".join(row[name] for name in ("tests", "passed", "skipped", "failed"))
        assert f"| {row['python']} | {row['resolution']} | {counts} |" in PAGE
    assert len(re.findall(r"^\| 3\.\d+\.\d+ \| ", PAGE, re.MULTILINE)) == len(rows)
