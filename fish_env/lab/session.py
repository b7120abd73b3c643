"""A session: the bench of one browser, its thread, and the requests of the page, executed between frames.

The page's events come on the server's event loop. They only put requests into a queue, so that the event loop never
waits for the simulation, and the simulation is touched by one thread alone.
"""

import sys
import threading
import time
import traceback
from collections import deque
from collections.abc import Callable
from contextlib import suppress

import viser

from fish_env.lab.bench import Bench
from fish_env.lab.drawing import Drawing
from fish_env.lab.panel import Panel
from fish_env.lab.school import School
from fish_env.lab.school_drawing import SchoolDrawing
from fish_env.lab.settings import checked_point

FAST, SLOW = 1 / 60, 1 / 30  # s between two pictures of few nodes, and of many
MANY = 100  # nodes from which pictures come less often
PAUSE = 0.002  # s that are always left to the event loop between two frames
LATEST = 0.1  # s: what lies further behind real time is left out
WAITING = 1000  # requests of the page that may wait; the oldest are left out
NOTES, RECENT = 50, 10.0  # messages shown at most in so many seconds: a page that does not read them lets them pile up


class Session:
    """State and requests of one browser."""

    def __init__(self, client: viser.ClientHandle):
        self.client = client
        self.bench = Bench()
        self.school: School | None = None
        self.school_drawing: SchoolDrawing | None = None
        self.paused, self.speed, self.frames = False, 1.0, 0
        self._requests: deque[Callable[[], None]] = deque(maxlen=WAITING)
        self._told: deque[float] = deque(maxlen=NOTES)
        self._closed = threading.Event()
        self._thread = threading.Thread(target=self._run, name=f"laboratory {client.client_id}", daemon=True)

    def start(self) -> None:
        """Build the page and begin."""
        self._thread.start()

    def close(self) -> None:
        """End the simulation; dragged nodes are released."""
        self._closed.set()

    @property
    def alive(self) -> bool:
        """Return True while its thread runs."""
        return self._thread.is_alive()

    def ask(self, request: Callable[[], None]) -> None:
        """Execute a request between two frames; its ValueError is shown to the user."""
        self._requests.append(request)

    def ask_at(self, request: Callable[..., None], **vectors) -> None:
        """Have `request(*vectors)` done with the points or directions (3,) of a message, named by keyword, if valid."""
        self.ask(lambda: request(*(checked_point(value, what=what) for what, value in vectors.items())))

    def tell(self, text: str, title: str = "Not possible") -> None:
        """Show a message on the page, unless there have been NOTES in the last RECENT seconds."""
        now = time.monotonic()
        if len(self._told) == NOTES and now < self._told[0] + RECENT:
            return
        self._told.append(now)
        self.client.add_notification(title, text, auto_close_seconds=10.0, color="orange")

    def wait(self, text: str) -> None:
        """Say why the page will not answer for a while."""
        self.panel.status.content = text
        self.client.flush()

    def show_bench(self) -> None:
        """Draw what is now on the bench from scratch; nothing is steered any more."""
        self._drop_school()
        self.drawing.build()
        self.panel.refresh()

    def look(self) -> None:
        """Turn the camera to the objects."""
        (self.school_drawing or self.drawing).look()

    def turn_camera(self, position, look_at) -> None:
        """Put the camera at a point and look at another one, unless the page reports an invalid camera."""
        camera = self.client.camera
        with suppress(TypeError, ValueError):  # viser continues from the camera that the page reported last
            camera.position, camera.look_at = position, look_at

    def show_school(self, school: School) -> None:
        """Show fish that are steered, in place of the bench."""
        self._drop_school()
        self.bench.let_go()
        self.drawing.clear()
        self.school, self.school_drawing = school, SchoolDrawing(self, school)
        self.panel.refresh()

    def _drop_school(self) -> None:
        if self.school is not None and self.school_drawing is not None:
            self.school_drawing.clear()
            self.school.close()
        self.school = self.school_drawing = None

    def step(self) -> None:
        """One integrator step of the first object while paused, or one environment step of what is steered."""
        if self.school is not None:
            self.school.advance(self.school.interval)
        else:
            self.bench.advance(self.bench.specimens[0].tank.dt)

    def _run(self) -> None:
        self.drawing = Drawing(self)
        with self.client.atomic():  # the browser builds all controls at once
            self.panel = Panel(self)
        self.drawing.build()
        last = time.monotonic()
        while not self._closed.is_set():
            self._answer()
            now = time.monotonic()
            elapsed, last = min(now - last, LATEST), now
            if not self.paused:
                (self.school or self.bench).advance(self.speed * elapsed)
            self._report()
            with self.client.atomic():
                if self.school_drawing is not None:
                    self.school_drawing.update(elapsed)
                else:
                    self.drawing.update()
            self.panel.update(now)
            self.frames += 1
            frame = FAST if self.school or self.bench.nodes <= MANY else SLOW
            self._closed.wait(max(PAUSE, now + frame - time.monotonic()))
        self._drop_school()
        self.bench.let_go()

    def _answer(self) -> None:
        """Execute the requests of the page since the last frame; none of them ends the session."""
        for _ in range(len(self._requests)):  # those that come meanwhile are for the next frame
            if self._closed.is_set():
                return
            try:
                self._requests.popleft()()
            except ValueError as error:
                self.tell(str(error))
                self.panel.refresh()
            except Exception:  # a mistake of the laboratory: for who runs it, in full
                print(traceback.format_exc(), file=sys.stderr)
                self.tell("The laboratory made a mistake; its terminal says which.", "An error")

    def _report(self) -> None:
        """Tell the user what failed."""
        messages = (self.school or self.bench).messages
        while messages:
            self.tell(messages.popleft(), "The simulation failed")
