"""The trials of reliability: their files exist, their ledgers add up, and the page says what the tables say."""

import json

import pytest

from benchmarks.common.tables import RESULTS, ROOT, read_table
from benchmarks.stability import reliability

PAGE = (ROOT / "docs" / "reliability.md").read_text()
PUBLISHED = [name for name in reliability.TRIALS if (RESULTS / f"reliability_{name}.csv").exists()]


def test_files_exist():
    """Every trial names test files that there are, each once."""
    for trial in reliability.TRIALS.values():
        assert len(set(trial.files)) == len(trial.files)
        assert all((ROOT / f"tests/test_{name}.py").is_file() for name in trial.files)


def test_ledgers_add_up(tmp_path):
    """Calls of several workers are added, and those that were not accepted count as refused."""
    for name, count in (("1", 2), ("2", 3)):
        rows = [["Tank", "accepted", count], ["Tank", "ValueError", 1], ["train.py", "status 2", 1]]
        (tmp_path / f"{name}.json").write_text(json.dumps(rows))
    assert reliability.calls(tmp_path) == [
        {"call": "Tank", "calls": 7, "accepted": 5, "refused": 2},
        {"call": "train.py", "calls": 2, "accepted": 0, "refused": 2},
    ]


@pytest.mark.parametrize("name", PUBLISHED)
def test_the_page_says_what_the_tables_say(name):
    """Every row of a published table stands on the page."""
    for row in read_table(f"reliability_{name}.csv"):
        cells = f"| `{row['file']}` | {row['tests']} | {row['passed']} | {row['skipped']} | {row['failed']} |"
        assert cells in PAGE


def test_the_page_counts_the_calls():
    """The page gives the calls that the ledger holds."""
    rows = read_table("reliability_calls.csv")
    made, accepted = (sum(row[key] for row in rows) for key in ("calls", "accepted"))
    assert f"are {made:,}: {accepted:,} were done and {made - accepted:,} refused" in PAGE
