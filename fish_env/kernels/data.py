"""Files that come with the package, also where it lies in a zip archive."""

from importlib.resources import files
from pathlib import Path
from typing import cast


def data(package: str, *names: str) -> Path:
    """A file or folder in a package of this package: a Path, or in an archive what is read in the same way."""
    place = files(package)
    for name in names:  # Python 3.10 joins one name at a time
        place = place.joinpath(name)
    return cast(Path, place)
