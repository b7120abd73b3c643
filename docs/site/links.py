"""Hook of the documentation site: links that leave docs/ lead to copies of the files, shipped with the site.

Pages link to sources, data and charts of the repository by relative paths, as they must for a reader of the repository.
MkDocs only knows what lies in docs/. This hook adds every file of the repository that a page links to below
repository/ in the site: pictures and data as they are, source files and folders as pages, Markdown files as pages
whose own links are treated in the same way. A link to a file that does not exist is left alone, so that MkDocs reports
it.
"""

import os
import re
from pathlib import Path, PurePosixPath

from mkdocs.structure.files import File, Files, InclusionLevel

ROOT = Path(__file__).parents[2]
DOCS = ROOT / "docs"
FOLDER = "repository"
LINK = re.compile(r"(\]\()([^)#\s]+)((?:#[^)\s]*)?\))")
FENCE = re.compile(r"^(```.*?^```[ ]*$)", re.MULTILINE | re.DOTALL)
COPIED = {".csv", ".svg", ".png", ".webp", ".mp4", ".npz", ".ipynb", ".json"}
LANGUAGES = {".py": "python", ".yml": "yaml", ".toml": "toml", "": "text", ".txt": "text"}
ADDRESS = re.compile(r'^repository = "(https://github\.com/([^/]+)/(.*))"$', re.MULTILINE)
MIKE = "MIKE_DOCS_VERSION"
HEAD = "---\nsearch:\n  exclude: true\n---\n\n"


def outside(folder: Path, link: str) -> Path | None:
    """The file or folder of the repository, outside docs/, that a link in a file of `folder` leads to; else None."""
    if "://" in link or link.startswith(("mailto:", "/")):
        return None
    target = (folder / link).resolve()
    inside = target.is_relative_to(ROOT) and not target.is_relative_to(DOCS)
    return target if inside and target.exists() else None


def uri(target: Path) -> str:
    """Where a file or folder of the repository is found in the sources of the site."""
    path = PurePosixPath(FOLDER, target.relative_to(ROOT).as_posix())
    if target.is_dir():
        return str(path / "index.md")
    return str(path) if target.suffix in {*COPIED, ".md"} else f"{path}.md"


def source_of(src_uri: str) -> Path:
    """The folder from which the relative links of a page of the site count."""
    path = PurePosixPath(src_uri)
    return (ROOT / path.relative_to(FOLDER)).parent if path.parts[0] == FOLDER else (DOCS / path).parent


def text_of(target: Path) -> str:
    """The page that shows a source file, a folder or a Markdown file."""
    name = target.relative_to(ROOT).as_posix()
    if target.is_dir():
        files = sorted(path.name for path in target.iterdir() if path.is_file())
        return f"{HEAD}# `{name}/`\n\n" + "".join(f"- [`{file}`]({file})\n" for file in files)
    if target.suffix == ".md":
        return HEAD + target.read_text()
    return f"{HEAD}# `{name}`\n\n````{LANGUAGES.get(target.suffix, 'text')}\n{target.read_text()}\n````\n"


def links(text: str) -> list[str]:
    """The targets of the links of a page, outside fenced code."""
    return [match[2] for part in FENCE.split(text)[::2] for match in LINK.finditer(part)]


def on_config(config):
    """Where mike builds a version for the site on GitHub: addresses, a link to the repository, a choice of versions."""
    if MIKE in os.environ:
        address, account, name = ADDRESS.search((ROOT / "pyproject.toml").read_text("utf-8")).groups()
        config.site_url = f"https://{account}.github.io/{name}/{os.environ[MIKE]}/"
        config.extra["version"] = {"provider": "mike"}
        config.extra["social"] = [{"icon": "fontawesome/brands/github", "link": address, "name": "Repository"}]
    return config


def on_files(files: Files, config) -> Files:
    """Add what the pages link to, and what the added pages link to."""
    queue = [(source_of(file.src_uri), file.content_string) for file in files.documentation_pages()]
    known = set()
    while queue:
        folder, text = queue.pop()
        for target in {outside(folder, link) for link in links(text)} - {None} - known:
            known.add(target)
            level = InclusionLevel.NOT_IN_NAV
            if target.is_dir() or target.suffix not in COPIED:
                content = text_of(target)
                files.append(File.generated(config, uri(target), content=content, inclusion=level))
                if target.is_dir() or target.suffix == ".md":
                    queue.append((target if target.is_dir() else target.parent, content))
            else:
                files.append(File.generated(config, uri(target), abs_src_path=str(target), inclusion=level))
    return files


def on_page_markdown(markdown: str, page, config, files: Files) -> str:
    """Turn links that leave docs/ into links to the copies."""
    here = PurePosixPath(page.file.src_uri)
    folder = source_of(page.file.src_uri)
    up = "../" * (len(here.parts) - 1)

    def replaced(match: re.Match) -> str:
        target = (folder / match[2]).resolve()
        if outside(folder, match[2]) is not None:
            return f"{match[1]}{up}{uri(target)}{match[3]}"
        if here.parts[0] == FOLDER and "://" not in match[2] and target.is_relative_to(DOCS):
            return f"{match[1]}{up}{target.relative_to(DOCS).as_posix()}{match[3]}"
        return match[0]

    parts = FENCE.split(markdown)
    parts[::2] = [LINK.sub(replaced, part) for part in parts[::2]]
    return "".join(parts)
