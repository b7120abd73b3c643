"""Files that are written whole or not at all, in folders that are tried before anything is computed."""

import os
import secrets
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

TRIAL = 4096  # bytes


def writable_folder(folder: str | Path) -> Path:
    """`folder`, made if it is missing, after a trial that a file can be written in it.

    Raises:
        ValueError: if it cannot be made or written to, with the system's reason.
    """
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
    """`path`, whose folder is made if it is missing, after a trial that a file can be written there.

    Args:
        path: the file; one that is there already stays as it is.
        endings: how its name may end, such as `(".mp4", ".gif")`.

    Raises:
        ValueError: for another ending, for a folder, or if nothing can be written there.
    """
    path = Path(path)
    if path.suffix.lower() not in endings:
        raise ValueError(f"the file {path} ends in {path.suffix!r}; give a name that ends in {' or '.join(endings)}")
    if os.path.isdir(path):  # `Path.is_dir` raises an error for names that are too long
        raise ValueError(f"{path} is a folder; give the name of a file")
    writable_folder(path.parent)
    try:
        with suppress(FileNotFoundError):
            path.lstat()
    except OSError as error:
        raise ValueError(f"no file can be written as {path} ({error.strerror}); give another name") from error
    return path


@contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """A new file next to `path` to write to, which replaces `path` when the block ends without an error.

    An interruption leaves the old file or the new one; a kill may leave a part under another name, a random one, so
    that neither another writer of `path` nor the target of a link is written to.
    """
    partial = path.with_name(f".{path.stem[:40]}-partial-{secrets.token_hex(8)}{path.suffix}")  # of 255 bytes
    partial.touch(exist_ok=False)
    try:
        yield partial
        os.replace(partial, path)
    finally:
        partial.unlink(missing_ok=True)


def write_text(path: Path, text: str) -> None:
    """Write a text file whole or not at all."""
    with replacing(path) as partial:
        partial.write_text(text)
