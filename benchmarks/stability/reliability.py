"""Trials by tests that a usual run does not have the time for: how many were made, and what came of them.

    python -m benchmarks.stability.reliability           all of them (20 min): results/reliability.csv
    python -m benchmarks.stability.reliability fuzz      public calls and files with odd arguments, FUZZ times as many
    python -m benchmarks.stability.reliability company   start methods, threads, caches, many processes at once
    python -m benchmarks.stability.reliability checks    checkers and wrappers of other packages over ids and options

A trial is a list of test files, each run by pytest in a process of its own. The rows of other trials stay as they are;
what has been run is written to the table, also if the trial is interrupted. Exit 1 if a test failed.
"""

import argparse
import os
import subprocess
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path
from xml.etree import ElementTree

from agents.checkout import present_commit
from benchmarks.common.tables import RESULTS, ROOT, read_rows, write_csv

COMMAND = "python -m benchmarks.stability.reliability"
TABLE = "reliability.csv"
FUZZ = 5  # times the examples of a usual run


@dataclass(frozen=True)
class Trial:
    """Test files, how they are run, and what is set for them."""

    files: tuple[str, ...]
    arguments: tuple[str, ...] = ()
    variables: tuple[tuple[str, str], ...] = ()


TRIALS = {
    "fuzz": Trial(
        ("fuzz_makers", "fuzz_calls", "fuzz_files", "fuzz_sequences"), variables=(("FISH_ENV_FUZZ", str(FUZZ)),)
    ),
    "company": Trial(("processes", "company", "jit"), ("-m", "slow or not slow")),
    "checks": Trial(("other_checks", "envs"), ("-m", "slow or not slow")),
}


def count_tests(report: Path) -> dict[str, int | str]:
    """How many tests a report of pytest (JUnit's XML) holds, and how they ended."""
    cases = list(ElementTree.parse(report).getroot().iter("testcase"))
    skipped = sum(case.find("skipped") is not None for case in cases)
    failed = sum(case.find("failure") is not None or case.find("error") is not None for case in cases)
    return {"tests": len(cases), "passed": len(cases) - skipped - failed, "skipped": skipped, "failed": failed}


def outcome(name: str, trial: Trial, workers: int) -> dict[str, int | str]:
    """How many tests of a file there are, and how they ended; a file that pytest cannot run counts as failed."""
    with tempfile.TemporaryDirectory() as folder:
        report = Path(folder, "report.xml")
        command = [sys.executable, "-m", "pytest", "-q", "-n", str(workers), "--junitxml", str(report)]
        done = subprocess.run([*command, *trial.arguments, f"tests/test_{name}.py"], cwd=ROOT, check=False,
                              env=os.environ | dict(trial.variables))  # fmt: skip
        if done.returncode not in (0, 1) or not report.exists():
            return {"tests": 0, "passed": 0, "skipped": 0, "failed": 1}
        return count_tests(report)


def run(names: list[str], workers: int) -> bool:
    """Run trials and put their rows into the table; True if no test failed."""
    known: list[dict] = read_rows(RESULTS / TABLE) if (RESULTS / TABLE).exists() else []
    rows = {(row["trial"], row["file"]): row for row in known}
    commit, passed = present_commit(), True
    try:
        for name in names:
            for file in TRIALS[name].files:
                found = outcome(file, TRIALS[name], workers)
                key = (name, f"tests/test_{file}.py")
                rows[key] = {"trial": name, "file": key[1], "commit": commit} | found
                print(", ".join(f"{key} {value}" for key, value in rows[key].items()), flush=True)
                passed &= not found["failed"]
                write_csv(TABLE, list(rows.values()), COMMAND)
    except KeyboardInterrupt:
        print("interrupted: what was run is in the table")
        return False
    return passed


def main() -> int:
    """The command line; exit 1 if a test failed."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("trials", nargs="*", help=f"of {', '.join(TRIALS)} (default: all)")
    parser.add_argument("--workers", type=int, default=2, help="processes of pytest (default 2)")
    chosen = parser.parse_args()
    if unknown := set(chosen.trials) - set(TRIALS):
        parser.error(f"unknown trial {min(unknown)!r}; choose from {', '.join(TRIALS)}")
    return 0 if run(chosen.trials or list(TRIALS), chosen.workers) else 1


if __name__ == "__main__":
    sys.exit(main())
