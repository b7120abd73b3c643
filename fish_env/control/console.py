"""A command: its options, an exit status, one line with an error, no traceback, and saved work after a signal."""

import argparse
import os
import signal
import sys
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from importlib import import_module
from types import ModuleType
from typing import Any

import gymnasium as gym

from fish_env.checks import similar

ERROR, STOPPED, BROKEN_PIPE = 2, 130, 141  # the last two as for other programs that a signal ends, 128 and its number
LINE = 2000  # characters of an error: a file may hold text of any length
INSTALL = 'pip install "fish_env[train]"'


def import_from_here(name: str) -> ModuleType:
    """Import a module of a user, from the present folder too; ValueError if it cannot be."""
    sys.path.insert(0, os.getcwd())  # where `python -m fish_env` looks, and the installed program does not
    try:
        return import_module(name)
    except (ImportError, SyntaxError, TypeError, ValueError) as error:  # the last two for names that no module has
        raise ValueError(f"the module {name!r} cannot be imported: {error}") from error


class Parser(argparse.ArgumentParser):
    """A parser that says which name an unknown one resembles; each of its commands shows its own usage."""

    def parse_known_args(self, args: Any = None, namespace: Any = None) -> tuple[Any, list[str]]:
        """Parse, and end the program for options that the command does not have."""
        found, others = super().parse_known_args(args, namespace)
        if others:
            near = similar(others[0].partition("=")[0], self._option_string_actions)
            self.error(f"unrecognized arguments: {' '.join(others)}{near}")
        return found, others

    def _check_value(self, action: argparse.Action, value: Any) -> None:
        try:
            super()._check_value(action, value)
        except argparse.ArgumentError as error:
            error.message += similar(value, action.choices or ())
            raise


def run_command(name: str, command: Callable[[], int], install: str = INSTALL) -> int:
    """The exit status of a command, 2 after a line on stderr for an error that a user can correct."""
    try:
        try:
            with warnings.catch_warnings():
                warnings.showwarning = lambda message, *_: print(f"{name}: {message}", file=sys.stderr)
                return command()
        finally:
            if sys.stdout is not None:
                sys.stdout.flush()  # a full disk is found out here, not after the end
    except BrokenPipeError:  # what reads the output has read enough, as `head` does
        status = BROKEN_PIPE
    except (ValueError, OSError, RuntimeError, MemoryError, ImportError, gym.error.Error) as error:
        said = " ".join((str(error) or type(error).__name__).split())
        if isinstance(error, ImportError) and "pip install" not in said:
            said += f"; install what it needs: {install}"
        status = ERROR
        with suppress(OSError):
            print(f"{name}: {said if len(said) <= LINE else said[:LINE] + ' ...'}", file=sys.stderr)
    except KeyboardInterrupt as stop:
        status = STOPPED
        with suppress(OSError):
            if type(stop) is KeyboardInterrupt:  # else what was saved is printed already
                print("\nStopped.", file=sys.stderr)
    _discard_broken_output()
    return status


def _discard_broken_output() -> None:
    """Let what nobody can read go nowhere: Python writes it once more when it ends, and would say that this fails."""
    for stream in filter(None, (sys.stdout, sys.stderr)):  # either is None where it was closed before the start
        try:
            stream.flush()
        except OSError:
            os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())


@contextmanager
def interrupt_once(signals: list[int]) -> Iterator[None]:
    """A context in which SIGTERM and SIGHUP do what Ctrl-C does; after the first of them, no other interrupts."""
    # A second one would end the saving. Those that come are added to the list. `nohup` works as usual.

    def stop(number, frame):
        signals.append(number)
        if len(signals) == 1:
            raise KeyboardInterrupt

    numbers, hangup = [signal.SIGINT, signal.SIGTERM], getattr(signal, "SIGHUP", None)  # Windows has none
    if hangup is not None and signal.getsignal(hangup) is not signal.SIG_IGN:
        numbers.append(hangup)
    before = {number: signal.signal(number, stop) for number in numbers}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler or signal.SIG_DFL)
