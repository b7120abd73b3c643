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
    """Each package that the tests need has one bound, so "lowest" leaves nothing to pip but what others require."""
    found = versions.bounds(PROJECT)
    assert {"numpy", "numba", "torch", "pillow", "viser", "ruff", "setuptools", "cma"} <= set(found)
    assert not {"ray", "mujoco", "numba-cuda", "playwright", "mkdocs-material"} & set(found)


@pytest.mark.parametrize("given", ['"numpy>=2.1"', '"scipy"'])
def test_two_bounds_or_none_are_refused(given):
    """A package with two lower bounds, or without any, has no lowest version."""
    text = 'dependencies = ["numpy>=2.0"]\nmore = [%s]\ndev = ["fish_env[more]", "mujoco[all]>=3.17,<4"]\n'
    assert versions.bounds(text % '"numpy>=2.0"') == {"numpy": "2.0", "mujoco": "3.17"}
    with pytest.raises(ValueError, match="has the lower bounds"):
        versions.bounds(text % given)


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
    monkeypatch.setattr("benchmarks.common.tables.RESULTS", tmp_path)
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
    assert len(re.findall(r"^\| 3\.\d+\.\d+ \| ", PAGE, re.MULTILINE)) == len(rows) > 0
