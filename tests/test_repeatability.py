"""The same seed, the same bits: in other processes, folders and numbers of threads."""

import pytest

from benchmarks.common.tables import ROOT, read_table
from benchmarks.stability import repeatability
from benchmarks.stability.repeatability import CONFIGURATIONS, TRIALS, Configuration, leaves, swum

PAGE = (ROOT / "docs" / "reliability.md").read_text()


def test_threads_and_processes_change_no_bit():
    """One to three threads, and another process whose libraries have three threads of their own, see the same bits."""
    name = "swim on mass_spring"
    first = TRIALS[name](1)
    assert (
        first == TRIALS[name](2) == TRIALS[name](3) == repeatability.digests([name], Configuration("", "", 3, 3))[name]
    )


def test_digests_see_what_differs():
    """Another task option, or one step less, gives another digest; and so does a number of a trained policy."""
    found = [swum({"task": "swim"}, 1, 2), swum({"task": "swim"}, 1, 3), swum({"speed": 0.5}, 1, 2)]
    assert len(set(found)) == 3
    held = {"weight": {0: [1.0, 2.0]}, "step": 3}
    assert leaves(held) == [("/weight/0/0", b"1.0"), ("/weight/0/1", b"2.0"), ("/step", b"3")]
    assert leaves(held) != leaves(held | {"weight": {0: [1.0, 2.5]}})


@pytest.mark.slow
def test_folders_change_no_bit():
    """Two clones in two folders, which compile kernels of their own, simulate and train to the same bits."""
    pytest.importorskip("stable_baselines3")
    one, other = CONFIGURATIONS[0], next(how for how in CONFIGURATIONS if how.folder == "second")
    rows = repeatability.compare(["swim on mass_spring", "swim, trained"], (one, other))
    assert len(rows) == 4 and len({row["folder"] for row in rows}) == 2 and all(row["same"] for row in rows)


# Tables


def test_the_page_counts_the_bits_that_are_the_same():
    """All that is promised has the same bits, and the page counts them."""
    rows = [row for row in read_table("repeatability.csv") if row["configuration"] != CONFIGURATIONS[0].name]
    assert all(row["same"] for row in rows if repeatability.promised(row))
    for several in (False, True):
        found = [row["same"] for row in rows if (row["libraries"] > 1) == several]
        assert f"| {len(found)} | {sum(found)} |" in PAGE
