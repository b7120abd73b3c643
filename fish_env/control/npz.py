"""Reading .npz files that anybody may have written: nothing is unpickled, and their sizes are known beforehand."""

import json
import zipfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

LARGEST = 32 * 2**20
"""Bytes that any file may unpack to, about 17,000 states of the default fish."""
RATIO = 4
"""Largest unpacked size of a file over its own size, if that is more."""


def read_npz(path: Path, what: str, advice: str) -> dict[str, Any]:
    """The arrays of a file by name; single numbers and texts as those of Python.

    Raises:
        ValueError: if it is truncated, damaged or pickled, or unpacks to more than `LARGEST` bytes and `RATIO` times
            its size.
    """
    try:
        with path.open("rb") as file:
            _check_sizes(zipfile.ZipFile(file).infolist(), file.seek(0, 2))
            file.seek(0)
            with np.load(file, allow_pickle=False) as archive:
                parts = {name: np.asarray(archive[name]) for name in archive.files}
        return {name: part if part.ndim else part.item() for name, part in parts.items()}
    except Exception as error:  # what is damaged may raise anything
        raise ValueError(f"{path} is not a {what}, or is damaged or pickled ({error}); {advice}") from error


def _check_sizes(parts: list[zipfile.ZipInfo], size: int) -> None:
    """ValueError unless a file of so many bytes unpacks to few, by its directory: reading stops at what that says."""
    unpacked, most = sum(part.file_size for part in parts), max(LARGEST, RATIO * size)
    if unpacked > most:
        raise ValueError(f"it has {size:,} bytes and says that it unpacks to {unpacked:,}; at most {most:,} are read")
    if any(part.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED) for part in parts):
        raise ValueError("it is compressed otherwise than numpy does")  # one step of such a method unpacks any size


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
    """Check the arrays of a file.

    Args:
        parts: the arrays by name.
        shapes: of every array; a text is a number that all its axes agree in, and "T+1" is one more than "T".
        types: of numpy, by name; those that are not there are floating-point numbers.

    Raises:
        ValueError: if one is missing or extra, of another type or shape, or not finite.
    """
    if parts.keys() != shapes.keys():
        raise ValueError(f"it has missing or extra parts {sorted(parts.keys() ^ shapes.keys())}")
    sizes: dict[str, int] = {}
    for name, shape in shapes.items():
        array, kind = parts[name], types.get(name, np.floating)
        if not isinstance(array, np.ndarray) or not np.issubdtype(array.dtype, kind) or array.ndim != len(shape):
            given = f"{array.shape} of {array.dtype}" if isinstance(array, np.ndarray) else repr(array)
            raise ValueError(f"its part {name} is {given:.100}; it should be {kind.__name__} of shape {shape}")
        for axis, size in zip(shape, array.shape, strict=True):
            late = axis == "T+1"
            wanted = axis if isinstance(axis, int) else sizes.setdefault("T" if late else axis, size - late) + late
            if size != wanted:
                raise ValueError(f"its part {name} has shape {array.shape}, which does not fit the other arrays")
        if not np.isfinite(array).all():
            raise ValueError(f"its part {name} holds numbers that are not finite")
