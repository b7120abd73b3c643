"""Threads that work on shares of the fish, and signals that wait until what must not be interrupted is done."""

import os
import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from itertools import count
from queue import SimpleQueue


@contextmanager
def signals_held() -> Iterator[None]:
    """Handle signals that come in this block, such as Ctrl-C, at its end. Only the main thread ever handles any."""
    came: list[int] = []
    handlers = {}
    if threading.current_thread() is threading.main_thread():
        found = {number: signal.getsignal(number) for number in signal.valid_signals()}
        handlers = {number: handler for number, handler in found.items() if callable(handler)}
    try:
        for number in handlers:
            signal.signal(number, lambda number, frame: came.append(number))
        yield
    finally:
        for number, handler in handlers.items():
            signal.signal(number, handler)
        for number in came:
            signal.raise_signal(number)


class Jobs:
    """Calls of a function that threads share out among them: each takes the next, until none is left."""

    def __init__(self, work: Callable, jobs: list[tuple]):
        self.work, self.left, self.total = work, list(jobs), len(jobs)
        self.errors: list[BaseException] = []
        self.over, self._ended, self._count = False, threading.Lock(), count(1)
        self._ended.acquire()

    def help(self) -> None:
        """Do those that are left, in a thread of a pool."""
        while self.left:
            try:
                job = self.left.pop()
            except IndexError:  # another thread was faster
                return
            try:
                self.work(*job)
            except BaseException as error:
                self.errors.append(error)
            if next(self._count) == self.total:
                self.over = True
                self._ended.release()

    def wait(self) -> None:
        """Wait until all have ended."""
        if not self.over:
            self._ended.acquire()


class Threads:
    """A number of threads, started when they are first needed, and again after `close` or in a forked process.

    A forked process has none of the threads of its parent; it would wait for them without end. A pickle holds none.
    """

    def __init__(self, count: int):
        self.count = count
        self._queue, self._process = None, 0

    def run(self, work: Callable, jobs: list[tuple]) -> None:
        """Call `work(*job)` for every job, side by side, and raise an error of one when all have ended.

        What interrupts the wait for them, such as Ctrl-C, is raised then too: nothing works on in the background. So
        all that is done here may be done twice, and locks are those that Python acquires and releases in one piece.
        """
        if not jobs:
            return
        queue, shared, interruption = self._started(), Jobs(work, jobs), None
        while not shared.over:
            try:
                for _ in jobs:  # a thread for each; one that finds nothing left goes on waiting
                    queue.put(shared)
                shared.wait()
            except BaseException as error:
                interruption = interruption or error
        for error in (interruption, *shared.errors):
            if error is not None:
                raise error

    def _started(self) -> SimpleQueue:
        if self._queue is None or self._process != os.getpid():
            with signals_held():
                queue = SimpleQueue()
                for _ in range(self.count):
                    threading.Thread(target=serve, args=(queue,), daemon=True).start()
                self._queue, self._process = queue, os.getpid()
        return self._queue

    def close(self) -> None:
        """End the threads."""
        if self._queue is not None and self._process == os.getpid():
            for _ in range(self.count):
                self._queue.put(None)
        self._queue = None

    __del__ = close

    def __reduce__(self):
        return Threads, (self.count,)


def serve(queue: SimpleQueue) -> None:
    """Help with what comes in a queue, until it is None."""
    for shared in iter(queue.get, None):
        shared.help()
