"""The folder that a run is saved in: made and locked, before anything of the run is written."""

import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from importlib import import_module
from pathlib import Path

from fish_env.control.files import writable_folder
from fish_env.training.saved_run import versions

try:
    import fcntl
except ImportError:  # Windows
    fcntl = None


def check_installed() -> None:
    """Raise ImportError if a package that a training needs is not installed, or this one is not."""
    versions()
    for name in ("tensorboard", "matplotlib"):  # the others are imported by now
        import_module(name)


def new_folder(root: Path, task: str) -> Path:
    """An empty runs/<task>/<time>/, never one that exists; ValueError if it cannot be made."""
    stamp = time.strftime("%Y-%m-%d_%H-%M-%S")
    k = 1
    while True:
        folder = writable_folder(root / task) / (stamp if k == 1 else f"{stamp}_{k}")
        with suppress(FileExistsError):
            folder.mkdir()
            return folder
        k += 1


@contextmanager
def lock_folder(folder: Path) -> Iterator[Path]:
    """Lock the folder for this program, until the context or the program ends; it yields the folder.

    Raises:
        RuntimeError: if another program is training in it.
    """
    with (folder / "lock").open("a") as file:
        if fcntl is not None:
            try:
                fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except OSError as error:
                raise RuntimeError(f"another program is training in {folder}; wait for it, or end it first") from error
        yield folder
