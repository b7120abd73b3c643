"""Progress messages during the compilation of kernels."""

import os
import sys
import time
from types import FunctionType

from numba.core import event

from fish_env.kernels.fingerprint import UnknownValueError, count_parts


class Progress(event.Listener):
    """Listener that reports compilation on standard error: in a terminal a line that is updated, elsewhere one line.

    It begins after PATIENCE seconds. Above a progress bar of tqdm it is one line, too. FISH_ENV_QUIET=1 turns it off.

    Args:
        total: how many parts are to be compiled, about: some are compiled for several types. None if unknown.
    """

    def __init__(self, total: int | None):
        self.since, self.count, self.total = time.perf_counter(), 0, total
        self.said = self.updating = False

    def on_start(self, event):
        """Do nothing: a kernel is counted when it is done."""

    def on_end(self, event):
        """Count a kernel, and report it."""
        self.count += 1
        elapsed, bar = time.perf_counter() - self.since, has_bar()
        updating = sys.stderr.isatty() and not bar
        if elapsed > PATIENCE and (updating or not self.said):
            self.said, self.updating = True, updating
            of = "" if self.total is None else f" of about {max(self.total, self.count)}"
            done = f"{self.count}{of}, {elapsed:.0f} s"
            text = f"fish_env compiles its kernels (once per fish and task): {done}"
            if bar:
                sys.modules["tqdm"].tqdm.write(f"{text} ...", file=sys.stderr)
            else:
                sys.stderr.write(f"\r{text} " if updating else f"{text} ...\n")
            sys.stderr.flush()


PATIENCE = 1.0  # s
_progress: list[Progress] = []


def compiled() -> tuple[int, int | None] | None:
    """Number of kernels compiled, and about how many there are; None while nothing is compiled."""
    for listener in _progress:
        return listener.count, listener.total
    return None


def has_bar() -> bool:
    """Return True while a progress bar of tqdm is shown, which is that of Stable-Baselines3, too."""
    return "tqdm" in sys.modules and len(getattr(sys.modules["tqdm"].tqdm, "_instances", ())) > 0


def begin_progress(function: FunctionType) -> None:
    """Listen to the compiler, which begins with this function, unless a listener is active."""
    if not _progress and not os.environ.get("FISH_ENV_QUIET"):
        try:
            total = count_parts(function)
        except UnknownValueError:
            total = None
        _progress.append(Progress(total))
        event.register("numba:compile", _progress[0])


def end_progress() -> None:
    """Stop listening, and end the line of a terminal."""
    if _progress:
        listener = _progress.pop()
        event.unregister("numba:compile", listener)
        if listener.updating:
            sys.stderr.write("\n")
