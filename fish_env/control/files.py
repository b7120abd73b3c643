"""Files that are written whole or not at all, and .npz files that anybody may have written."""

import csv
import json
import os
import secrets
import tempfile
import zipfile
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

TRIAL = 4096  # bytes
LARGEST = 32 * 2**20  # bytes that any file may unpack to, about 17,000 states of the default fish
RATIO = 4  # largest unpacked size of a file over its own size, if that is more


@contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """A new file next to `path` to write to, which replaces `path` when the block ends without an error."""
    # An interruption leaves the old file or the new one; a kill may leave a part under another name, a random one.
    partial = path.with_name(f".{path.stem[:40]}-partial-{secrets.token_hex(8)}{path.suffix}")  # of 255 bytes
    partial.touch(exist_ok=False)
    try:
        yield partial
        with partial.open("rb+") as file:
            os.fsync(file.fileno())  # or a power failure may leave a new name for an empty file
        os.replace(partial, path)
    finally:
        partial.unlink(missing_ok=True)


def write_text(path: Path, text: str) -> None:
    """Write a text file whole or not at all."""
    with replacing(path) as partial:
        partial.write_text(text, encoding="utf-8", newline="\n")


def write_csv(path: Path, rows: Iterable[Iterable[Any]]) -> None:
    """Write a table, its head first, whole or not at all."""
    with replacing(path) as partial, partial.open("w", newline="", encoding="utf-8") as file:
        csv.writer(file, lineterminator="\n").writerows(rows)


def writable_folder(folder: str | Path) -> Path:
    """`folder`, made if it is missing; ValueError, with the system's reason, if no file can be written in it."""
    folder = Path(folder)
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder) as file:
            file.write(bytes(TRIAL))  # a full disk still takes an empty file
    except OSError as error:
        raise ValueError(
            f"no file can be written in the folder {folder} ({error.strerror}); give a folder that can be written to"
        ) from error
    return folder


def writable_file(path: str | Path, endings: tuple[str, ...]) -> Path:
    """`path`, whose folder is made if missing; ValueError for another ending, a folder, or if it cannot be written."""
    path = Path(path)
    if path.suffix.lower() not in endings:
        raise ValueError(f"the file {path} ends in {path.suffix!r}; give a name that ends in {' or '.join(endings)}")
    if os.path.isdir(path):  # `Path.is_dir` raises an error for names that are too long
        raise ValueError(f"{path} is a folder; give the name of a file")
    writable_folder(path.parent)
    try:
        path.lstat()
    except FileNotFoundError:
        pass
    except OSError as error:
        raise ValueError(f"no file can be written as {path} ({error.strerror}); give another name") from error
    return path


def read_npz(path: Path, what: str, advice: str) -> dict[str, Any]:
    """The arrays of a file by name, single numbers and texts as Python's; ValueError if damaged or too large."""
    try:
        with path.open("rb") as file:
            unpacked = sum(part.file_size for part in zipfile.ZipFile(file).infolist())
            if unpacked > max(LARGEST, RATIO * file.seek(0, os.SEEK_END)):
                raise ValueError(f"it unpacks to {unpacked:,} bytes")
            file.seek(0)
            with np.load(file, allow_pickle=False) as archive:
                parts = {name: np.asarray(archive[name]) for name in archive.files}
        return {name: part if part.ndim else part.item() for name, part in parts.items()}
    except Exception as error:  # what is damaged may raise anything
        raise ValueError(f"{path} is not a {what}, or is damaged or pickled ({error}); {advice}") from error


def read_about(text: Any) -> dict[str, Any]:
    """The part "about" of a file, JSON; ValueError if it is no dictionary."""
    try:
        found = json.loads(str(text))
    except RecursionError as error:
        raise ValueError("its part 'about' is nested too deeply") from error
    if not isinstance(found, dict):
        raise ValueError(f"its part 'about' is a {type(found).__name__}, not a dictionary")
    return found


def check_arrays(parts: Mapping[str, Any], shapes: Mapping[str, tuple], types: Mapping[str, Any]) -> None:
    """ValueError unless the arrays have these names and shapes, are finite, and of these types, by default floats."""
    # In a shape, a text is a number that all its axes agree in.
    if parts.keys() != shapes.keys():
        raise ValueError(f"it has missing or extra parts {sorted(parts.keys() ^ shapes.keys())}")
    sizes: dict[Any, int] = {}
    for name, shape in shapes.items():
        array, kind = np.asarray(parts[name]), types.get(name, np.floating)
        fits = np.issubdtype(array.dtype, kind) and array.ndim == len(shape)
        if not fits or any(size != sizes.setdefault(axis, size if isinstance(axis, str) else axis)
                           for axis, size in zip(shape, array.shape, strict=True)):  # fmt: skip
            raise ValueError(f"its part {name} is {array.shape} of {array.dtype}; it should be {kind.__name__} of "
                             f"shape {shape}, where {sizes}")  # fmt: skip
        if not np.isfinite(array).all():
            raise ValueError(f"its part {name} holds numbers that are not finite")
