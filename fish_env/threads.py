"""Threads that work on shares of the fish."""

import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor


class Threads:
    """A number of threads, started when they are first needed, and again after `close` or in a forked process.

    A forked process has none of the threads of its parent; it would wait for them without end. A pickle holds none.
    """

    def __init__(self, count: int):
        self.count = count
        self._pool, self._process = None, 0

    def run(self, work: Callable, jobs: list[tuple]) -> None:
        """Call `work(*job)` for every job, side by side; an error of one is raised when it is known."""
        if self._pool is None or self._process != os.getpid():
            self._pool, self._process = ThreadPoolExecutor(self.count), os.getpid()
        for job in [self._pool.submit(work, *job) for job in jobs]:
            job.result()

    def close(self) -> None:
        """End the threads."""
        if self._pool is not None and self._process == os.getpid():
            self._pool.shutdown()
        self._pool = None

    def __reduce__(self):
        return Threads, (self.count,)
