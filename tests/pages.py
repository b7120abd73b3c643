"""The pages of the documentation and the code blocks in them."""

import re
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).parent.parent
PAGES = sorted([ROOT / "README.md", *ROOT.glob("docs/**/*.md"), *ROOT.glob("examples/**/*.md")])
FENCE = re.compile(r"^( *)```+ *(\w*)([^\n]*)\n(.*?)^\1```+ *$", re.DOTALL | re.MULTILINE)


class Block(NamedTuple):
    """A fenced block: what stands between two lines of three backticks."""

    page: str
    """Path of the page, from the root of the repository."""
    line: int
    """Number of its first line in the page, from 1."""
    language: str
    """The word after the backticks, or ""."""
    title: str
    """What the page calls the block, title="...", or ""."""
    text: str

    def __str__(self):
        return f"{self.page}:{self.line}"


def blocks(path: Path, language: str | None = None) -> list[Block]:
    """The fenced blocks of a page, those in a language or all, in their order."""
    text, found = path.read_text(), []
    for match in FENCE.finditer(text):
        indent, word, rest, body = match.groups()
        title = re.search(r'title="([^"]*)"', rest)
        line = text.count("\n", 0, match.start(4)) + 1
        body = re.sub(f"^{indent}", "", body, flags=re.MULTILINE)
        found.append(Block(path.relative_to(ROOT).as_posix(), line, word, title[1] if title else "", body))
    return [block for block in found if language in (None, block.language)]
