"""The checkout that a training or a measurement runs in, if there is one: its folder and its commit."""

import subprocess
from contextlib import suppress
from pathlib import Path

ROOT = Path(__file__).parents[2]
CODE = ("fish_env", "agents", "benchmarks", "train.py", "constraints.txt", "pyproject.toml")
"""Paths that results depend on: a commit is called dirty if a change in them is not committed."""
WRITTEN = (":!benchmarks/results", ":!*/pretrained/*", ":!fish_env/control/*.json", ":!fish_env/bodies/*.json")
"""Files that commands write; changes in them do not make a commit dirty."""


def present_commit() -> str:
    """The commit, with "-dirty" at its end if code that results depend on is not committed.

    It is "unknown" without git, and for a package that is installed without its checkout.
    """
    if not (ROOT / ".git").exists():  # git would look for one in the folders above
        return "unknown"

    def git(*arguments):
        with suppress(OSError):  # there is no git
            done = subprocess.run(["git", *arguments], cwd=ROOT, capture_output=True, text=True, check=False)
            return done.stdout.strip()
        return ""

    commit = git("describe", "--always")
    changed = commit and git("status", "--porcelain", "--", *CODE, *WRITTEN)
    return f"{commit}-dirty" if changed else commit or "unknown"
