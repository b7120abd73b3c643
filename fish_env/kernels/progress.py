"""Progress messages during the compilation of kernels."""

import os
import sys
import time

from numba.core import event


class Progress(event.Listener):
    """Listener that reports compilation on standard error: in a terminal a line that is updated, elsewhere one line."""

    # It begins after PATIENCE seconds. Above a progress bar of tqdm it is one line, too. FISH_ENV_QUIET=1 turns it off.

    def __init__(self):
        self.since, self.count = time.perf_counter(), 0
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
            text = f"fish_env compiles its kernels (once per fish and task): {self.count}, {elapsed:.0f} s"
            if bar:
                sys.modules["tqdm"].tqdm.write(f"{text} ...", file=sys.stderr)
            else:
                sys.stderr.write(f"\r{text} " if updating else f"{text} ...\n")
            sys.stderr.flush()


PATIENCE = 1.0  # s
_progress: list[Progress] = []


def compiled() -> int:
    """Number of kernels compiled so far; 0 while nothing is compiled."""
    return sum(listener.count for listener in _progress)


def has_bar() -> bool:
    """Return True while a progress bar of tqdm is shown, which is that of Stable-Baselines3, too."""
    return "tqdm" in sys.modules and len(getattr(sys.modules["tqdm"].tqdm, "_instances", ())) > 0


def start_progress() -> None:
    """Listen to the compiler, unless a listener is active."""
    if not _progress and not os.environ.get("FISH_ENV_QUIET"):
        _progress.append(Progress())
        event.register("numba:compile", _progress[0])


def end_progress() -> None:
    """Stop listening, and end the line of a terminal."""
    if _progress:
        listener = _progress.pop()
        event.unregister("numba:compile", listener)
        if listener.updating:
            sys.stderr.write("\n")
