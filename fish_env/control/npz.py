"""Reading .npz files that anybody may have written: names, types and sizes are known before anything is unpacked.

What is read is what `np.savez` writes of numbers, truth values and text. It is neither unpickled nor evaluated.
"""

import json
import math
import os
import re
import struct
import zipfile
import zlib
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any, BinaryIO, NamedTuple

import numpy as np

LARGEST = 32 * 2**20
"""Bytes that any file may unpack to, about 17,000 states of the default fish."""
RATIO = 4
"""Largest unpacked size of a file over its own size, if that is more."""
TEXT = 2**18  # characters of a text: the description of a file has some hundreds
DEPTH = 20  # of the description of a file: lists in lists
HEAD = 2000  # bytes of the head of an array
DIRECTORY = 2**16  # bytes of a zip file's list of parts, of which each takes about 60
PARTS = re.compile(
    r"\{'descr': '([<>|][biufcU]\d{1,12})', 'fortran_order': (?:True|False), 'shape': \(([\d, ]*)\), \} *\n"
)
"""The head of an array, as numpy writes it."""

DAMAGED = (
    ValueError, TypeError, LookupError, ArithmeticError, OSError, EOFError, RuntimeError, MemoryError, struct.error,
    zipfile.BadZipFile, zlib.error,
)  # fmt: skip
"""Exceptions that Python raises for files that are truncated, encrypted, changed or something else."""


class Part(NamedTuple):
    """An array in a file, before it is read."""

    info: zipfile.ZipInfo
    dtype: np.dtype
    shape: tuple[int, ...]


class Npz:
    """An opened .npz file: its `parts` by name, and `read`, which unpacks one of them.

    Raises:
        ValueError: if it is truncated, damaged, pickled or encrypted, has a part twice, or unpacks to more than
            `LARGEST` bytes and `RATIO` times its size.
    """

    def __init__(self, path: Path, what: str, advice: str):
        self.path, self.what, self.advice = path, what, advice
        with self._rejecting_damage():
            self._file = path.open("rb")
        try:
            with self._rejecting_damage():
                self._zip = _open_archive(self._file)
                self.parts = {info.filename.removesuffix(".npy"): self._part(info) for info in self._zip.infolist()}
        except BaseException:
            self._file.close()
            raise

    def __enter__(self) -> "Npz":
        return self

    def __exit__(self, *error) -> None:
        self._file.close()

    @contextmanager
    def _rejecting_damage(self) -> Iterator[None]:
        """One exception for all that is wrong with a file."""
        try:
            yield
        except DAMAGED as error:
            raise ValueError(
                f"{self.path} is not a {self.what}, or is damaged or pickled ({error}); {self.advice}"
            ) from error

    def _part(self, info: zipfile.ZipInfo) -> Part:
        """The head of an array, whose size must be that of the part."""
        with self._zip.open(info) as stream:
            magic, length = struct.unpack("<8sH", stream.read(10))
            found = PARTS.fullmatch(stream.read(min(length, HEAD)).decode("latin1"))
        if magic != b"\x93NUMPY\x01\x00" or not found:
            raise ValueError(f"its part {info.filename!r} is not an array of numbers or a text")
        dtype, shape = np.dtype(found[1]), tuple(int(size) for size in re.findall(r"\d+", found[2]))
        size = 10 + length + dtype.itemsize * math.prod(shape)
        if size != info.file_size:
            raise ValueError(f"its part {info.filename!r} has {info.file_size} bytes, and its head says {size}")
        return Part(info, dtype, shape)

    def read(self, name: str) -> np.ndarray:
        """The array of a part."""
        with self._rejecting_damage(), self._zip.open(self.parts[name].info) as stream:
            return np.lib.format.read_array(stream, allow_pickle=False)

    def whole(self, name: str) -> int | None:
        """A whole number; None if the file has none of that name."""
        return self._single(name, "iu", int)

    def text(self, name: str) -> str | None:
        """A text; None if the file has none of that name."""
        return self._single(name, "U", str)

    def _single(self, name: str, kinds: str, made: Any) -> Any:
        part = self.parts.get(name)
        if part is None:
            return None
        with self._rejecting_damage():
            if part.shape or part.dtype.kind not in kinds or part.dtype.itemsize > 4 * TEXT:
                raise ValueError(f"its part {name!r} is an array {part.shape} of {part.dtype}")
            return made(self.read(name)[()])  # texts hold any number for a letter

    def about(self) -> dict[str, Any]:
        """The part "about", JSON."""
        text = self.text("about")
        with self._rejecting_damage():
            return read_about(text or "")


def _open_archive(file: BinaryIO) -> zipfile.ZipFile:
    """A zip file that holds arrays, each once, and does not unpack to very much."""
    size = file.seek(0, os.SEEK_END)
    file.seek(max(0, size - 42))
    end = file.read()  # of the list of parts; of more than 4 GB another one before it
    if end[-22:-18] != b"PK\5\6" or end[:4] == b"PK\6\7" or int.from_bytes(end[-10:-6], "little") > DIRECTORY:
        raise ValueError("its end is not that of a zip file of a few parts")
    found = zipfile.ZipFile(file)
    names = found.namelist()
    if len(set(names)) < len(names) or not all(name.endswith(".npy") for name in names):
        raise ValueError("it holds a part twice, or one that is no array")
    unpacked, most = sum(info.file_size for info in found.infolist()), max(LARGEST, RATIO * size)
    if unpacked > most:
        raise ValueError(f"it has {size:,} bytes and says that it unpacks to {unpacked:,}; at most {most:,} are read")
    return found


def read_about(text: str) -> dict[str, Any]:
    """Description of a file, from its JSON text.

    Raises:
        ValueError: for other JSON than a dictionary, text of more than `TEXT` characters, or lists in lists more than
            `DEPTH` deep.
    """
    if len(text) > TEXT:
        raise ValueError(f"'about' has {len(text)} characters; at most {TEXT} are read")
    try:
        found = json.loads(text)  # ValueError for a number of thousands of digits
    except RecursionError as error:
        raise ValueError(f"'about' is nested more than {DEPTH} deep") from error
    if not isinstance(found, dict):
        raise ValueError(f"'about' is a {type(found).__name__}, not a dictionary")
    _check_depth(found, DEPTH)
    return found


def write_about(about: Mapping[str, Any]) -> str:
    """JSON that `read_about` can read, or ValueError."""
    text = json.dumps(dict(about))
    read_about(text)
    return text


def _check_depth(value: Any, levels: int) -> None:
    if isinstance(value, dict | list):
        if not levels:
            raise ValueError(f"'about' is nested more than {DEPTH} deep")
        for part in value.values() if isinstance(value, dict) else value:
            _check_depth(part, levels - 1)
