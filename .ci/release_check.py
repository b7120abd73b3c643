"""What a release needs: an address, one version everywhere, and a dated section of the changelog.

python .ci/release_check.py v0.1.0                    say what is missing; the status is 0 if nothing is
python .ci/release_check.py v0.1.0 --notes notes.md   and write that section, for the page of the release
"""

import argparse
import re
import sys
from pathlib import Path

ROOT = Path(__file__).parents[1]
PLACEHOLDER = "owner".upper()  # in this form, so that a search finds the one in pyproject.toml alone
FIRST = re.compile(r"^## (?P<head>[^\n]*)\n(?P<text>.*?)(?=^## |\Z)", re.MULTILINE | re.DOTALL)


def value(root: Path, name: str, pattern: str) -> str:
    """The value in a line of a file, or "missing"."""
    found = re.search(pattern, (root / name).read_text(encoding="utf-8"), re.MULTILINE)
    return found[1] if found else "missing"


def section(root: Path) -> tuple[str, str]:
    """Heading and text of the first section of the changelog; "missing" and no text without one."""
    found = FIRST.search((root / "CHANGELOG.md").read_text(encoding="utf-8"))
    return (found["head"], found["text"].strip() + "\n") if found else ("missing", "")


def problems(tag: str, root: Path = ROOT) -> list[str]:
    """What is wrong with a release of this tag; empty if nothing is."""
    found = []
    address = value(root, "pyproject.toml", r'^repository = "(.*)"$')
    if PLACEHOLDER in address or not re.fullmatch(r"https://github\.com/[\w-]+/[\w.-]+", address):
        found.append(f"{address} in pyproject.toml is no address on GitHub: put the account there")
    version = value(root, "pyproject.toml", r'^version = "(.*)"$')
    if tag != f"v{version}":
        found.append(f"the tag is {tag}, the version in pyproject.toml {version}: tag v{version}")
    for name, pattern in (("fish_env/__init__.py", r'^__version__ = "(.*)"$'), ("CITATION.cff", r"^version: (.*)$")):
        if (other := value(root, name, pattern)) != version:
            found.append(f"the version in {name} is {other}, in pyproject.toml {version}")
    day = value(root, "CITATION.cff", r"^date-released: (.*)$")
    head, _ = section(root)
    if head != f"{version}, {day}":
        found.append(f"the first section of CHANGELOG.md is '{head}'; with CITATION.cff it would be '{version}, {day}'")
    return found


def main(words: list[str] | None = None, root: Path = ROOT) -> int:
    """The command line; its exit status."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("tag", help="v and the version")
    parser.add_argument("--notes", type=Path, help="the file for the section of the changelog")
    given = parser.parse_args(words)
    found = problems(given.tag, root)
    print("\n".join(found) or f"{given.tag} can be released")
    if not found and given.notes is not None:
        given.notes.write_text(section(root)[1], encoding="utf-8")
    return bool(found)


if __name__ == "__main__":
    sys.exit(main())
