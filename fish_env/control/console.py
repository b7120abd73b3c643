"""End of a command line: an exit status, at most one line with the error, and no traceback."""

import os
import sys
from collections.abc import Callable
from contextlib import suppress

import gymnasium as gym

WRONG, STOPPED, UNREAD = 2, 130, 141  # the last two as for other programs that a signal ends, 128 and its number
LINE = 2000  # characters of an error: a file may hold text of any length


def run_command(name: str, command: Callable[[], int]) -> int:
    """The exit status of a command, 2 after a line on stderr for an error that a user can correct.

    Args:
        name: of the program, before the error.
        command: gives its exit status.
    """
    try:
        try:
            return command()
        finally:
            if sys.stdout is not None:
                sys.stdout.flush()  # a full disk is found out here, not after the end
    except BrokenPipeError:  # what reads the output has read enough, as `head` does
        status = UNREAD
    except (ValueError, OSError, RuntimeError, MemoryError, gym.error.Error) as error:
        said = " ".join((str(error) or type(error).__name__).split())
        status = WRONG
        with suppress(OSError):
            print(f"{name}: {said if len(said) <= LINE else said[:LINE] + ' ...'}", file=sys.stderr)
    except KeyboardInterrupt:
        status = STOPPED
        with suppress(OSError):
            print("\nStopped.", file=sys.stderr)
    _give_up_broken()
    return status


def _give_up_broken() -> None:
    """Let what nobody can read go nowhere: Python writes it once more when it ends, and would say that this fails."""
    for stream in filter(None, (sys.stdout, sys.stderr)):  # either is None where it was closed before the start
        try:
            stream.flush()
        except OSError:
            os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())
