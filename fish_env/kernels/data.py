"""Data files of the package, also if it is in a zip archive."""

from importlib.resources import files
from pathlib import Path
from typing import cast


def data(package: str, *names: str) -> Path:
    """Path of a file or folder in a package of this package, or an object with the same methods in an archive."""
    place = files(package)
    for name in names:  # Python 3.10 joins one name at a time
        place = place.joinpath(name)
    return cast(Path, place)
