"""The folder that a run is saved in: made, looked at and locked, before anything of the run is written."""

import os
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from importlib import import_module
from pathlib import Path

from fish_env.control.files import writable_folder
from fish_env.training.saved_run import check_name, not_through_link, versions

try:
    import fcntl
except ImportError:  # Windows
    fcntl = None

WRITTEN = ("config.json", "curve.csv", "model.zip", "policy.npz", "results.json", "report.html", "lock")


def check_installed() -> None:
    """Raise ImportError if a package that a training needs is not installed, or this one is not."""
    versions()
    for name in ("tensorboard", "matplotlib"):  # the others are imported by now
        import_module(name)


def new_folder(root: Path, task: str) -> Path:
    """An empty runs/<task>/<time>/, never one that exists; ValueError if it cannot be made."""
    check_name(root)
    stamp = time.strftime("%Y-%m-%d_%H-%M-%S")
    k = 1
    while True:
        folder = writable_folder(root / task) / (stamp if k == 1 else f"{stamp}_{k}")
        with suppress(FileExistsError):
            folder.mkdir()
            return folder
        k += 1


def check_folder(folder: Path) -> Path:
    """Check the folder of a run, and make it if it is missing; return it.

    Raises:
        ValueError: if it cannot be written to, or if what is no file, or a link, lies where the run would write.
    """
    check_name(folder)
    for path in (folder / name for name in WRITTEN):
        if os.path.lexists(path) and not path.is_file():
            raise ValueError(f"{path} is not a file, and one would be written there; move it away")
    events = folder / "tensorboard"
    blocked = any(path.exists() and not path.is_dir() for path in (events, *events.glob("*")))
    if blocked or any(path.is_symlink() for path in (events, *events.rglob("*"))):
        raise ValueError(f"{events} is no folder of folders, or holds links, which lead elsewhere; move it away")
    return writable_folder(folder)


@contextmanager
def lock_folder(folder: Path) -> Iterator[Path]:
    """Lock the folder for this program, until the context or the program ends; it yields the folder.

    Raises:
        RuntimeError: if another program is training in it.
        ValueError: if its lock is a link, or no file that can be written to.
    """
    try:
        file = open(folder / "lock", "a", opener=not_through_link)  # noqa: SIM115 - closed below
    except OSError as error:
        raise ValueError(f"{folder / 'lock'} cannot be used ({error.strerror}); move it away") from error
    with file:
        if fcntl is not None:
            try:
                fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except OSError as error:
                raise RuntimeError(f"another program is training in {folder}; wait for it, or end it first") from error
        yield folder
