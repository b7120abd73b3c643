"""A session: the bench of one browser, its thread, and what the page asks for, done one after another between frames.

The page's events come on the server's event loop. They only put requests into a queue, so that the event loop never
waits for the simulation, and the simulation is touched by one thread alone.
"""

import queue
import threading
import time
from collections.abc import Callable

import viser

from fish_env.lab.bench import Bench
from fish_env.lab.drawing import Drawing
from fish_env.lab.panel import Panel

FAST, SLOW = 1 / 60, 1 / 30  # s between two pictures of few nodes, and of many
MANY = 100  # nodes from which pictures come less often
PAUSE = 0.002  # s that are always left to the event loop between two frames
LATEST = 0.1  # s: what lies further behind real time is left out
RESTORE = 0.4  # s after an arrow key steered: the view is turned back by what the key turned it


class Session:
    """What one browser sees and does.

    Args:
        client: the browser.
    """

    def __init__(self, client: viser.ClientHandle):
        self.client = client
        self.bench = Bench()
        self.paused, self.speed, self.frames = False, 1.0, 0
        self._requests: queue.SimpleQueue[Callable[[], None]] = queue.SimpleQueue()
        self._closed = threading.Event()
        self._thread = threading.Thread(target=self._run, name=f"laboratory {client.client_id}", daemon=True)

    def start(self) -> None:
        """Build the page and begin."""
        self._thread.start()

    def close(self) -> None:
        """End the simulation; what was held is let go."""
        self._closed.set()

    @property
    def alive(self) -> bool:
        """Whether its thread still runs."""
        return self._thread.is_alive()

    def ask(self, request: Callable[[], None]) -> None:
        """Have something done between two frames; a ValueError of it is told to the user."""
        self._requests.put(request)

    def tell(self, text: str, title: str = "Not possible") -> None:
        """Show a message on the page."""
        self.client.add_notification(title, text, auto_close_seconds=10.0, color="orange")

    def rebuild(self) -> None:
        """Draw what is now on the bench from scratch."""
        self.drawing.build()
        self.panel.refresh()

    def step(self) -> None:
        """One integrator step of the first object while paused."""
        self.bench.advance(self.bench.specimens[0].tank.dt)

    def _run(self) -> None:
        self.drawing = Drawing(self)
        self.panel = Panel(self)
        self.drawing.build()
        last = time.monotonic()
        while not self._closed.is_set():
            self._answer()
            now = time.monotonic()
            elapsed, last = min(now - last, LATEST), now
            if not self.paused:
                self.bench.advance(self.speed * elapsed)
            self._report()
            with self.client.atomic():
                self.drawing.update()
            self.panel.update(now)
            self.frames += 1
            nodes = sum(len(specimen.position) for specimen in self.bench.specimens)
            frame = FAST if nodes <= MANY else SLOW
            self._closed.wait(max(PAUSE, now + frame - time.monotonic()))
        self.bench.let_go()

    def _answer(self) -> None:
        """Do what the page has asked for since the last frame."""
        while not self._closed.is_set():
            try:
                request = self._requests.get_nowait()
            except queue.Empty:
                return
            try:
                request()
            except ValueError as error:
                self.tell(str(error))
                self.panel.refresh()

    def _report(self) -> None:
        """Tell the user what failed."""
        while self.bench.messages:
            self.tell(self.bench.messages.popleft(), "A method failed")
