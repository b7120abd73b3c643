"""Is a published number older than the code it depends on? By git: the commit in its table against the files here.

A number depends on the definitions that `benchmarks/registry.py` names, on what they refer to, and on the data files
that it names, JSON without its provenance. `benchmarks/definitions.py` says what is seen of a definition, and what is
not. The number is older than the code if one of these, as it is in the working tree, did not exist at the commit. That
a file was moved, or a function renamed, makes nothing stale; nor does a change of a chart or of a command line. A
commit that ends in "-dirty" is taken for the commit, since nothing else is known of it, and said to be dirty.
"""

import hashlib
import json
import subprocess
from collections.abc import Iterable
from functools import cache, cached_property
from pathlib import Path
from typing import NamedTuple

from agents.records import ROOT
from benchmarks.definitions import Code

FOLDERS = ("fish_env", "agents", "benchmarks", "examples", "train.py")
IGNORED = (
    "agents.records", "agents.results:read_rows", "benchmarks.provenance", "benchmarks.common.tables",
    "fish_env._jit:Progress", "fish_env._progress", "fish_env._cache", "fish_env._jit:cache_folder",
    "fish_env._jit:source_hash", "fish_env._jit:_FOLDER", "fish_env._jit:KeyedFiles", "fish_env._jit:SourceCache",
    "fish_env._jit:unstored", "fish_env._jit:CHECKSUM", "fish_env._jit:CACHE_VARIABLES",
)  # fmt: skip
"""What writes numbers and kernels down and tells the user what is going on; names of former layouts stay here."""
CURRENT, STALE, UNKNOWN, MISSING = "current", "older than the code", "cannot be told", "missing"


class Status(NamedTuple):
    """What is known of a published table."""

    state: str
    commit: str
    date: str
    why: str


def module_name(path: str) -> str:
    """The dotted name of a Python file, "package.__init__" for a package."""
    return path.removesuffix(".py").replace("/", ".")


def content(name: str, data: bytes) -> str:
    """A digest of a data file; of JSON, without its provenance and its layout."""
    if name.endswith(".json"):
        record = json.loads(data)
        if isinstance(record, dict):
            record.pop("provenance", None)
        data = json.dumps(record, sort_keys=True).encode()
    return hashlib.sha256(data).hexdigest()


def header_of(path: Path) -> dict[str, str]:
    """The provenance of a table (its comment lines) or of a JSON file; empty for any other file."""
    if path.suffix == ".json":
        return json.loads(path.read_text()).get("provenance", {})
    if path.suffix != ".csv":
        return {}
    lines = (line[2:] for line in path.read_text().splitlines() if line.startswith("# "))
    return dict(line.split(": ", 1) for line in lines if ": " in line)


class Repository:
    """A working tree with its history.

    Args:
        root: where the files are.
    """

    def __init__(self, root: Path = ROOT):
        self.root = root
        self._blobs: dict[str, bytes] = {}

    def git(self, *arguments: str, stdin: bytes | None = None) -> bytes:
        """What a git command prints.

        Raises:
            RuntimeError: if git is missing, or the command fails.
        """
        try:
            done = subprocess.run(["git", *arguments], cwd=self.root, capture_output=True, input=stdin, check=False)
        except FileNotFoundError as error:
            raise RuntimeError("git is not installed") from error
        if done.returncode:
            raise RuntimeError(done.stderr.decode().strip())
        return done.stdout

    @cached_property
    def without_history(self) -> str:
        """Why there is no history, or ""."""
        try:
            top = self.git("rev-parse", "--show-toplevel").decode().strip()
        except RuntimeError as error:
            return str(error).splitlines()[0]
        return "" if Path(top).resolve() == self.root.resolve() else "the files are not those of a git repository"

    @cached_property
    def code(self) -> Code:
        """The code of the working tree."""
        files = [path for folder in FOLDERS for path in self.files(folder) if path.suffix == ".py"]
        return Code({module_name(path.relative_to(self.root).as_posix()): path.read_text() for path in files}, IGNORED)

    def files(self, pattern: str) -> list[Path]:
        """Files of the working tree: one, those below a folder, or those of a pattern."""
        place = self.root / pattern
        if place.is_dir():
            return sorted(path for path in place.rglob("*") if path.is_file())
        return sorted(self.root.glob(pattern))

    @cache  # noqa: B019 - as long-lived as the process
    def tree(self, commit: str) -> dict[str, str]:
        """Names of the files of a commit and of their contents.

        Raises:
            RuntimeError: if the commit is not in this repository.
        """
        lines = self.git("ls-tree", "-r", "-z", f"{commit}^{{commit}}").decode().split("\0")
        return {line.split("\t")[1]: line.split()[2] for line in lines if line}

    def read(self, blobs: Iterable[str]) -> list[bytes]:
        """Contents by their names, each read from git once."""
        blobs = list(blobs)
        todo = [blob for blob in dict.fromkeys(blobs) if blob not in self._blobs]
        if todo:
            out, place = self.git("cat-file", "--batch", stdin="\n".join(todo).encode() + b"\n"), 0
            for blob in todo:
                end = out.index(b"\n", place)
                size = int(out[place:end].split()[2])
                self._blobs[blob] = out[end + 1 : end + 1 + size]
                place = end + size + 2
        return [self._blobs[blob] for blob in blobs]

    @cache  # noqa: B019
    def code_at(self, commit: str) -> Code:
        """The code of a commit."""
        names = {path: blob for path, blob in self.tree(commit).items() if path.endswith(".py")}
        names = {path: blob for path, blob in names.items() if path.split("/")[0] in FOLDERS}
        sources = self.read(names.values())
        return Code({module_name(path): text.decode() for path, text in zip(names, sources, strict=True)}, IGNORED)

    @cache  # noqa: B019
    def data_at(self, commit: str, suffix: str) -> set[str]:
        """Digests of all data files of a commit with this suffix."""
        names = {path: blob for path, blob in self.tree(commit).items() if path.endswith(suffix)}
        return {content(path, data) for path, data in zip(names, self.read(names.values()), strict=True)}

    def changes(self, commit: str, definitions: Iterable[str], data: Iterable[str] = ()) -> list[str]:
        """What a number depends on and did not exist at a commit.

        Args:
            commit: its name, or a tag.
            definitions: "module:name" of those that make the number.
            data: files, folders and patterns of files that it is made with.

        Raises:
            KeyError: if a definition does not exist in the working tree.
            RuntimeError: if the commit is not in this repository.
        """
        keys = [tuple(each.split(":")) for each in definitions]
        found = [f"{module}.{name}" for module, name in self.code.changes(keys, self.code_at(commit))]
        for path in (path for pattern in data for path in self.files(pattern)):
            if content(path.name, path.read_bytes()) not in self.data_at(commit, path.suffix):
                found.append(path.relative_to(self.root).as_posix())
        return found

    def status(self, outputs: Iterable[str], definitions: Iterable[str], data: Iterable[str] = ()) -> Status:
        """Of a number's files: whether they are there and current; the oldest commit counts if there are several."""
        paths = [self.root / name for name in outputs]
        missing = [path.name for path in paths if not path.exists()]
        if missing:
            return Status(MISSING, "", "", ", ".join(missing))
        records = {(header["commit"], header.get("date", "")) for header in map(header_of, paths) if "commit" in header}
        if not records:
            return Status(UNKNOWN, "", "", "no commit is recorded in these files")
        found = [
            self._of_commit(commit, date, definitions, data) for commit, date in sorted(records, key=lambda r: r[1])
        ]
        return min(found, key=lambda each: (STALE, UNKNOWN, CURRENT).index(each.state))

    def _of_commit(self, recorded: str, date: str, definitions, data) -> Status:
        """The status of a table that was made at a commit."""
        commit = recorded.removesuffix("-dirty")
        note = "made with changes that were not committed" if recorded != commit else ""
        if commit == "unknown":
            return Status(UNKNOWN, recorded, date, "it was made without git")
        if self.without_history:
            return Status(UNKNOWN, recorded, date, f"no history here: {self.without_history}")
        try:
            self.tree(commit)
        except RuntimeError:
            return Status(UNKNOWN, recorded, date, "this commit is not in this repository")
        changed = self.changes(commit, definitions, data)
        if changed:
            more = f" and {len(changed) - 3} more" if len(changed) > 3 else ""
            return Status(STALE, recorded, date, f"changed since: {', '.join(changed[:3])}{more}")
        return Status(CURRENT, recorded, date, note)
