"""The trials of reliability: their files exist, their rows are kept apart, and the page says what the table says."""

import pytest

from benchmarks.common.tables import ROOT, read_rows, read_table
from benchmarks.stability import reliability

PAGE = (ROOT / "docs" / "reliability.md").read_text()


def test_files_exist():
    """Every trial names test files that there are, each once; the table is that of all trials."""
    files = [(name, f"tests/test_{file}.py") for name, trial in reliability.TRIALS.items() for file in trial.files]
    assert len(set(files)) == len(files) and all((ROOT / file).is_file() for _, file in files)
    assert [(row["trial"], row["file"]) for row in read_table(reliability.TABLE)] == files


def test_a_trial_replaces_its_own_rows(tmp_path, monkeypatch):
    """Rows of other trials stay as they are; a failed test is reported."""
    monkeypatch.setattr(reliability, "RESULTS", tmp_path)
    monkeypatch.setattr("benchmarks.common.tables.RESULTS", tmp_path)
    for failed, names in ((0, ["company", "checks"]), (1, ["checks"])):
        counts = {"tests": 3, "passed": 3 - failed, "skipped": 0, "failed": failed}
        monkeypatch.setattr(reliability, "outcome", lambda *_, counts=counts: counts)
        assert reliability.run(names, 1) == (not failed)
    rows = read_rows(tmp_path / reliability.TABLE)
    assert [(row["trial"], row["failed"]) for row in rows] == [("company", "0")] * 3 + [("checks", "1")] * 2


@pytest.mark.parametrize("row", read_table(reliability.TABLE), ids=lambda row: row["file"])
def test_the_page_says_what_the_table_says(row):
    """Every row of the table stands on the page."""
    assert f"| `{row['file']}` | {row['tests']} | {row['passed']} | {row['skipped']} | {row['failed']} |" in PAGE
