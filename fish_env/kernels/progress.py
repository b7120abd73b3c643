"""Progress messages during the compilation of kernels."""

import os
import sys
import time

from numba.core import event


class Progress(event.Listener):
    """Listener that reports compilation on standard error: in a terminal a line that is updated, elsewhere one line.

    It begins after PATIENCE seconds. FISH_ENV_QUIET=1 turns it off.
    """

    def __init__(self):
        self.since, self.count, self.said = time.perf_counter(), 0, False

    def on_start(self, event):
        """Do nothing: a kernel is counted when it is done."""

    def on_end(self, event):
        """Count a kernel, and report it."""
        self.count += 1
        elapsed, terminal = time.perf_counter() - self.since, sys.stderr.isatty()
        if elapsed > PATIENCE and (terminal or not self.said):
            self.said = True
            done = f"{self.count} done, {elapsed:.0f} s"
            text = f"fish_env compiles its kernels, once for each kind of fish and task: {done}"
            sys.stderr.write(f"\r{text} " if terminal else f"{text} ...\n")
            sys.stderr.flush()


PATIENCE = 1.0  # s
_progress: list[Progress] = []


def begin_progress() -> None:
    """Listen to the compiler, unless a listener is active."""
    if not _progress and not os.environ.get("FISH_ENV_QUIET"):
        _progress.append(Progress())
        event.register("numba:compile", _progress[0])


def end_progress() -> None:
    """Stop listening, and end the line of a terminal."""
    if _progress:
        listener = _progress.pop()
        event.unregister("numba:compile", listener)
        if listener.said and sys.stderr.isatty():
            sys.stderr.write("\n")
