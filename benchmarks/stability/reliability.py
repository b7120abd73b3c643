"""Trials by tests that a usual run does not have the time for: how many were made, and what came of them.

    python -m benchmarks.stability.reliability fuzz      public calls with odd arguments, twenty times the examples
    python -m benchmarks.stability.reliability bounds    the tests of the physics, with kernels that check their bounds
    python -m benchmarks.stability.reliability company   start methods, threads, caches, many processes at once
    python -m benchmarks.stability.reliability checks    checkers and wrappers of other packages over ids and options

A trial is a list of test files, each run by pytest in a process of its own under some environment variables. What has
been run is written to a table, also if the trial is interrupted; exit 1 if a test failed.
"""

import argparse
import json
import os
import subprocess
import sys
import tempfile
from collections import Counter
from dataclasses import dataclass
from pathlib import Path
from xml.etree import ElementTree

from benchmarks.common.tables import ROOT, write_csv

COMMAND = "python -m benchmarks.stability.reliability"
FUZZ = 20  # times the examples of a usual run


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
    "bounds": Trial(
        ("forces", "simd", "blocks", "ldlt", "polar", "elements", "gas_and_barriers", "surroundings", "own_force",
         "four_bodies", "lanes", "leapfrog_chebyshev", "conditions", "boundary", "statics", "prescribed", "objects",
         "counters", "integrity", "tasks", "tank", "integrators"),
        variables=(("NUMBA_BOUNDSCHECK", "1"),),
    ),
    "company": Trial(("processes", "company", "jit"), ("-m", "slow or not slow")),
    "checks": Trial(("other_checks", "envs"), ("-m", "slow or not slow")),
}  # fmt: skip


def count_tests(report: Path) -> dict[str, int | str]:
    """How many tests a report of pytest (JUnit's XML) holds, and how they ended."""
    cases = list(ElementTree.parse(report).getroot().iter("testcase"))
    skipped = sum(case.find("skipped") is not None for case in cases)
    failed = sum(case.find("failure") is not None or case.find("error") is not None for case in cases)
    return {"tests": len(cases), "passed": len(cases) - skipped - failed, "skipped": skipped, "failed": failed}


def outcome(name: str, trial: Trial, workers: int, folder: Path) -> dict[str, int | str]:
    """How many tests of a file there are, and how they ended; a file that pytest cannot run counts as failed."""
    report = folder / f"{name}.xml"
    command = [sys.executable, "-m", "pytest", "-q", "-n", str(workers), "--junitxml", str(report), *trial.arguments]
    done = subprocess.run([*command, f"tests/test_{name}.py"], cwd=ROOT, check=False,
                          env=os.environ | dict(trial.variables) | {"FISH_ENV_FUZZ_LEDGER": str(folder)})  # fmt: skip
    if done.returncode not in (0, 1) or not report.exists():
        return {"file": f"tests/test_{name}.py", "tests": 0, "passed": 0, "skipped": 0, "failed": 1}
    return {"file": f"tests/test_{name}.py"} | count_tests(report)


def calls(folder: Path) -> list[dict[str, int | str]]:
    """What the fuzz tests have called, and what became of it: accepted, or refused by an exception."""
    count: Counter = Counter()
    for path in folder.glob("*.json"):
        for entry, ending, number in json.loads(path.read_text()):
            count[entry, ending] += number
    rows = []
    for entry in sorted({entry for entry, _ in count}):
        ends = {ending: number for (name, ending), number in count.items() if name == entry}
        accepted = sum(number for ending, number in ends.items() if ending in ("accepted", "status 0"))
        rows.append({"call": entry, "calls": sum(ends.values()), "accepted": accepted,
                     "refused": sum(ends.values()) - accepted})  # fmt: skip
    return rows


def run(name: str, workers: int) -> bool:
    """Run a trial and write its tables; whether no test failed."""
    rows: list[dict[str, int | str]] = []
    with tempfile.TemporaryDirectory() as place:
        try:
            for file in TRIALS[name].files:
                rows.append(outcome(file, TRIALS[name], workers, Path(place)))
                print(", ".join(f"{key} {value}" for key, value in rows[-1].items()), flush=True)
        except KeyboardInterrupt:
            print("interrupted: what was run is in the table")
        if rows:
            write_csv(f"reliability_{name}.csv", rows, f"{COMMAND} {name}")
        made = calls(Path(place))
        if made:
            write_csv("reliability_calls.csv", made, f"{COMMAND} {name}")
    return bool(rows) and not any(row["failed"] for row in rows)


def main() -> int:
    """The command line; exit 1 if a test failed."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("trial", choices=TRIALS, help="which trial")
    parser.add_argument("--workers", type=int, default=2, help="processes of pytest (default 2)")
    chosen = parser.parse_args()
    return 0 if run(chosen.trial, chosen.workers) else 1


if __name__ == "__main__":
    sys.exit(main())
