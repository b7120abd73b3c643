"""Reading .npz files that anybody may have written: names, types and sizes are known before anything is unpacked.

What is read is what `np.savez` writes of numbers, truth values and text. It is neither unpickled nor evaluated.
"""

import json
import os
import re
import struct
import zipfile
import zlib
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

LARGEST = 32 * 2**20
"""Bytes that any file may unpack to, about 17,000 states of the default fish."""
RATIO = 4
"""Largest unpacked size of a file over its own size, if that is more."""
TEXT = 2**18  # characters of a text: the description of a file has some hundreds
DEPTH, DIGITS = 20, 100  # of the description of a file: lists in lists, and digits of a whole number
DIRECTORY = 2**16  # bytes of a zip file's list of parts, of which each takes about 60
HEAD = 2000  # bytes of the head of an array
CHUNK = 2**18  # bytes that are unpacked at once
PARTS = re.compile(
    r"\{'descr': '([<>|][biufcU]\d{1,12})', 'fortran_order': (True|False), 'shape': \(([\d, ]*)\), \} *\n"
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
    start: int
    """Bytes of its head."""
    dtype: np.dtype
    shape: tuple[int, ...]
    fortran: bool


class Npz:
    """An opened .npz file: its `parts` by name, and `read`, which unpacks one of them.

    Raises:
        ValueError: if it is truncated, damaged, pickled or encrypted, has a part twice or parts that overlap, or
            unpacks to more than `LARGEST` bytes and `RATIO` times its size.
    """

    def __init__(self, path: Path, what: str, advice: str):
        self.path, self.what, self.advice = path, what, advice
        with self._refusing():
            self._file = path.open("rb")
        try:
            with self._refusing():
                self._zip = _opened(self._file)
                self.parts = {info.filename.removesuffix(".npy"): self._part(info) for info in self._zip.infolist()}
        except BaseException:
            self._file.close()
            raise

    def __enter__(self) -> "Npz":
        return self

    def __exit__(self, *error) -> None:
        self._file.close()

    @contextmanager
    def _refusing(self) -> Iterator[None]:
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
        dtype, shape = np.dtype(found[1]), tuple(int(size) for size in re.findall(r"\d+", found[3]))
        start, size = 10 + length, dtype.itemsize
        for axis in shape:  # not `np.prod`, which overflows
            size *= axis
        if start + size != info.file_size:
            raise ValueError(f"its part {info.filename!r} has {info.file_size} bytes, and its head says {start + size}")
        return Part(info, start, dtype, shape, found[2] == "True")

    def read(self, name: str) -> np.ndarray:
        """The array of a part."""
        part = self.parts[name]
        with self._refusing():
            out, at = np.empty(part.info.file_size - part.start, dtype=np.uint8), 0
            part.info.file_size += 1  # else what goes on after its end would not be seen
            with self._zip.open(part.info) as stream:
                stream.read(part.start)
                while chunk := stream.read(CHUNK):
                    out[at : at + len(chunk)] = np.frombuffer(chunk, dtype=np.uint8)  # ValueError if it is too long
                    at += len(chunk)
            part.info.file_size -= 1
            if at != len(out) or (part.dtype == bool and out.max(initial=0) > 1):
                raise ValueError(f"its part {name!r} is not what its head says")
            array = out.view(part.dtype)
            return array.reshape(part.shape[::-1]).T if part.fortran else array.reshape(part.shape)

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
        with self._refusing():
            if part.shape or part.dtype.kind not in kinds or part.dtype.itemsize > 4 * TEXT:
                raise ValueError(f"its part {name!r} is an array {part.shape} of {part.dtype}")
        array = self.read(name)
        with self._refusing():
            return made(array[()])  # texts hold any number for a letter

    def about(self) -> dict[str, Any]:
        """The part "about", JSON."""
        text = self.text("about")
        with self._refusing():
            return read_about(text or "")


def _opened(file) -> zipfile.ZipFile:
    """A zip file, after a look at what would be unpacked."""
    size = file.seek(0, os.SEEK_END)
    file.seek(max(0, size - 42))
    tail = file.read()  # the end of the list of parts; of more than 4 GB another one before it
    if tail[-22:-18] != b"PK\5\6" or tail[-2:] != b"\0\0" or tail[:4] == b"PK\6\7":
        raise ValueError("its end is not that of a zip file")
    if int.from_bytes(tail[-10:-6], "little") > DIRECTORY:
        raise ValueError("it lists too many parts")
    found = zipfile.ZipFile(file)
    parts, end = sorted(found.infolist(), key=lambda info: info.header_offset), 0
    if len({info.filename for info in parts}) < len(parts) or not all(p.filename.endswith(".npy") for p in parts):
        raise ValueError("it holds a part twice, or one that is no array")
    for info in parts:
        if info.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):
            raise ValueError("it is compressed by another method")
        if info.header_offset < end:
            raise ValueError("its parts overlap")
        end = info.header_offset + 30 + len(info.filename) + info.compress_size
    unpacked, most = sum(info.file_size for info in parts), max(LARGEST, RATIO * size)
    if end > size or unpacked > most:
        raise ValueError(f"it has {size:,} bytes and says that it unpacks to {unpacked:,}; at most {most:,} are read")
    return found


def read_about(text: str) -> dict[str, Any]:
    """Description of a file, from its JSON text.

    Raises:
        ValueError: for other JSON than a dictionary, text of more than `TEXT` characters, lists in lists more than
            `DEPTH` deep, or whole numbers of more than `DIGITS` digits.
    """
    if len(text) > TEXT:
        raise ValueError(f"'about' has {len(text)} characters; at most {TEXT} are read")
    try:
        found = json.loads(text, parse_int=_whole)
    except RecursionError as error:
        raise ValueError(f"'about' is nested more than {DEPTH} deep") from error
    if not isinstance(found, dict):
        raise ValueError(f"'about' is a {type(found).__name__}, not a dictionary")
    _check_depth(found, DEPTH)
    return found


def write_about(about: Mapping[str, Any]) -> str:
    """JSON that `read_about` can read; ValueError for values that it cannot."""
    text = json.dumps(dict(about))
    read_about(text)
    return text


def _whole(digits: str) -> int:
    if len(digits) > DIGITS:
        raise ValueError(f"'about' has a whole number of {len(digits)} digits; at most {DIGITS} are read")
    return int(digits)


def _check_depth(value: Any, levels: int) -> None:
    if isinstance(value, dict | list):
        if not levels:
            raise ValueError(f"'about' is nested more than {DEPTH} deep")
        for part in value.values() if isinstance(value, dict) else value:
            _check_depth(part, levels - 1)
