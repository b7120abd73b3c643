"""What a user sees while kernels are compiled."""

import os
import sys
import time

from numba.core import event


class Progress(event.Listener):
    """Says on the standard error that kernels are compiled, and how far that is: a first use should not look dead.

    In a terminal a line that is kept up to date; elsewhere one line, once it has taken PATIENCE seconds.
    FISH_ENV_QUIET=1 turns it off.
    """

    def __init__(self):
        self.since, self.count, self.said = time.perf_counter(), 0, False

    def on_start(self, event):
        """Nothing: a kernel is counted when it is done."""

    def on_end(self, event):
        """Count a kernel, and say so."""
        self.count += 1
        elapsed, terminal = time.perf_counter() - self.since, sys.stderr.isatty()
        if elapsed > PATIENCE and (terminal or not self.said):
            self.said = True
            done = f"{self.count} done, {elapsed:.0f} s"
            text = f"fish_env compiles its kernels, once for each kind of fish and task: {done}"
            sys.stderr.write(f"\r{text} " if terminal else f"{text} ...\n")
            sys.stderr.flush()

    def close(self):
        """End the line of a terminal."""
        if self.said and sys.stderr.isatty():
            sys.stderr.write("\n")


PATIENCE = 1.0  # s
_progress: list[Progress] = []


def begin_progress() -> None:
    """Listen to the compiler, unless that is done already."""
    if not _progress and not os.environ.get("FISH_ENV_QUIET"):
        _progress.append(Progress())
        event.register("numba:compile", _progress[0])


def end_progress() -> None:
    """Stop listening."""
    if _progress:
        listener = _progress.pop()
        event.unregister("numba:compile", listener)
        listener.close()
