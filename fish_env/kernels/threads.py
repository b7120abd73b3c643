"""Threads that work on parts of the fish, and signals that are deferred until the end of an uninterruptible block."""

import os
import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from itertools import count
from queue import SimpleQueue


@contextmanager
def defer_signals() -> Iterator[None]:
    """Defer signals in this block, such as Ctrl-C, to its end. Only the main thread handles signals."""
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
    """Calls of a function that threads process: each takes the next one until none is left."""

    def __init__(self, work: Callable, jobs: list[tuple]):
        self.work, self.left, self.total = work, list(jobs), len(jobs)
        self.errors: list[BaseException] = []
        self.over, self._ended, self._count = False, threading.Lock(), count(1)
        self._ended.acquire()

    def help(self) -> None:
        """Process the remaining calls, in a thread of a pool."""
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
        """Wait until all calls have ended."""
        if not self.over:
            self._ended.acquire()


class Threads:
    """A number of threads, started on first use, and again after `close` or in a forked process, which has none."""

    def __init__(self, count: int):
        self.count = count
        self._queue, self._process = None, 0

    def run(self, work: Callable, jobs: list[tuple]) -> None:
        """Call `work(*job)` for every job in parallel, and raise an error of one when all have ended."""
        # An interruption of the wait, such as Ctrl-C, is also raised then. Therefore all actions may be repeated, and
        # locks are those that Python acquires and releases atomically.
        if not jobs:
            return
        queue, shared, interruption = self._started(), Jobs(work, jobs), None
        while not shared.over:
            try:
                for _ in jobs:  # one request per job; a thread without a remaining job waits for the next request
                    queue.put(shared)
                shared.wait()
            except BaseException as error:
                interruption = interruption or error
        for error in (interruption, *shared.errors):
            if error is not None:
                raise error

    def _started(self) -> SimpleQueue:
        if self._queue is None or self._process != os.getpid():
            with defer_signals():
                queue = SimpleQueue()
                for _ in range(self.count):
                    threading.Thread(target=serve, args=(queue,), daemon=True).start()
                self._queue, self._process = queue, os.getpid()
        return self._queue

    def close(self) -> None:
        """Stop the threads."""
        if self._queue is not None and self._process == os.getpid():
            for _ in range(self.count):
                self._queue.put(None)
        self._queue = None

    __del__ = close

    def __reduce__(self):
        return Threads, (self.count,)


def serve(queue: SimpleQueue) -> None:
    """Process the jobs of a queue until it contains None."""
    while (shared := queue.get()) is not None:
        shared.help()
        del shared  # an idle thread would keep all that its last job refers to
