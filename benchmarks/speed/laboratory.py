"""The laboratory in the browser: updates a second, the time until its page is usable, and its pictures.

    python -m benchmarks.speed.laboratory               results/speed/laboratory.csv (6 minutes)
    python -m benchmarks.speed.laboratory --pictures    every scene as the browser shows it: docs/images/laboratory/

Both need the extra [browser] and Chromium (FISH_ENV_CHROMIUM names one that is installed). An update is what the
server does for one picture: it moves the object on by 1/30 s, small or steered fish by 1/60 s, measures, and sends what
has changed to a browser that is connected. It is counted in processor time of the server's process, all threads of it.
What fails while it is measured, or needs more time than it shows, does not keep up. The start is by the clock.
"""

import argparse
import os
import shutil
import time
from collections.abc import Iterator
from contextlib import contextmanager
from statistics import median

from benchmarks.common.tables import IMAGES, write_csv
from fish_env.bodies import BODIES
from fish_env.bodies.objects import OBJECTS
from fish_env.lab.specimen import Entry

COMMAND = "python -m benchmarks.speed.laboratory"
UPDATES = 60  # of a measurement
REPEATS = 3  # measurements, of which the median counts
STARTS = 5
START = 3.0  # s until the page is usable
LIMIT = 1000  # nodes up to which the laboratory is to keep up
SLOW, FAST = 30, 60  # updates a second that are to be reached: of objects, and of fish
FLAGS = ["--no-sandbox", "--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"]
REFINED = (
    Entry("ring", "", (("nodes", 20),)),
    Entry("sphere", "", (("slices", 24), ("stacks", 12))),
    Entry("uniform sphere", "", (("level", 3),)),
    Entry("tetrahedral", "", (("level", 2),)),
    Entry("tetrahedral", "", (("level", 3),)),
    Entry("beam", "", (("cells", 19), ("across", 6))),
    Entry("block", "", (("cells", 8),)),
    Entry("ball", "", (("cells", 8),)),
    Entry("two materials", "", (("cells", 18), ("across", 6))),
)
STEERED = ("policy turn", 64)  # who steers, and how many fish


@contextmanager
def opened(size=(320, 200), port=18300) -> Iterator[tuple]:
    """A laboratory and a page of it: (laboratory, page, session, time until it was usable, s)."""
    from playwright.sync_api import sync_playwright

    from fish_env.lab.server import Laboratory

    laboratory = Laboratory("127.0.0.1", port)
    with sync_playwright() as running:
        path = os.environ.get("FISH_ENV_CHROMIUM") or shutil.which("chromium")
        chromium = running.chromium.launch(executable_path=path, args=FLAGS)
        page = chromium.new_page(viewport={"width": size[0], "height": size[1]})
        page.set_default_timeout(180e3)
        begin = time.perf_counter()
        page.goto(f"http://127.0.0.1:{laboratory.port}")
        page.get_by_text("pictures a second").wait_for()
        usable = time.perf_counter() - begin
        yield laboratory, page, next(iter(laboratory.sessions.values())), usable
        chromium.close()
    laboratory.close()


def updates(session, rate: int) -> float:
    """Updates a second of processor time, each of them 1/rate s of the simulation."""
    begin = time.process_time()
    for k in range(UPDATES):
        due = time.perf_counter() + 1.0 / rate
        (session.school or session.bench).advance(1.0 / rate)
        with session.client.atomic():
            if session.school_drawing is not None:
                session.school_drawing.update(1.0 / rate)
            else:
                session.drawing.update()
        session.panel.update(k / rate)
        time.sleep(max(0.0, due - time.perf_counter()))  # the browser's messages are sent, none is left out
    session.client.flush()
    return UPDATES / (time.process_time() - begin)


def measured(session, name: str, made_with: str, nodes: int, rate: int) -> dict:
    """A row: updates a second of what is shown, and whether it lasted."""
    updates(session, rate)
    found = median(updates(session, rate) for _ in range(REPEATS))
    failed = list((session.school or session.bench).messages)
    print(name, made_with, nodes, found, *failed, flush=True)
    return row(name, made_with, nodes, "updates/s", round(found, 1), rate, found >= rate and not failed)


def row(name: str, made_with: str, nodes: int | str, quantity: str, value: float, bar: float, met: bool) -> dict:
    """A row of the table."""
    return {"object": name, "made_with": made_with, "nodes": nodes, "quantity": quantity, "value": value, "bar": bar,
            "met": met}  # fmt: skip


def rates() -> list[dict]:
    """Updates a second of every body and object up to LIMIT nodes, and of a school, beside what is to be reached."""
    from fish_env.lab.school import School

    rows = []
    entries = [*map(Entry, [*OBJECTS, *BODIES]), *REFINED]
    with opened() as (_, _, session, _):
        session.close()  # its own thread ends; the page stays
        session._thread.join()
        for entry in entries:
            session.bench.messages.clear()
            session.bench.choose([entry])
            nodes = session.bench.nodes
            if nodes > LIMIT:
                continue
            session.show_bench()
            session.bench.warm()
            fish = session.bench.specimens[0].is_fish
            session.bench.swim(fish)
            made_with = " ".join(f"{k} {v}" for k, v in entry.level)
            rows.append(measured(session, entry.thing, made_with, nodes, FAST if fish and nodes <= 100 else SLOW))
        driver, count = STEERED
        session.show_school(School(driver, count))
        nodes = count * len(session.school.fish.body.mass)
        rows.append(measured(session, f"{count} fish", driver, nodes, FAST))
    return rows


def starts() -> list[dict]:
    """From the address typed to a page that answers, s: the first of the process, and the median; kernels compiled."""
    found: list[float] = []
    for k in range(STARTS):
        with opened(port=18310 + k) as (_, _, _, usable):
            found.append(usable)
    values = {"first": round(found[0], 2), "median": round(median(found), 2)}
    return [row("page", which, "", "s until usable", value, START, value <= START) for which, value in values.items()]


class Photographer:
    """Puts scenes on a page whose time stands still, and takes pictures of it.

    Args:
        page: of the browser.
        session: that belongs to it.
    """

    def __init__(self, page, session):
        self.page, self.session, self.bench = page, session, session.bench
        session.paused = True
        close = page.locator(".mantine-Notification-closeButton")
        if close.count():
            close.first.click()  # the note that there is no graphics card

    def do(self, *actions) -> None:
        """Have something done by the session, and wait."""
        over: list[bool] = []
        self.session.ask(lambda: ([action() for action in actions], over.append(True)))
        while not over:
            self.page.wait_for_timeout(50)

    def show(self, *entries: Entry) -> None:
        """Put objects on the bench."""
        self.do(lambda: self.bench.choose(entries), self.session.show_bench, lambda: self.bench.swim(True))

    def steer(self, driver: str, count: int, seconds: float) -> None:
        """Have fish steered for some seconds."""
        from fish_env.lab.school import School

        self.do(lambda: self.session.show_school(School(driver, count)), lambda: self.session.school.advance(seconds))

    def closer(self, part: float) -> None:
        """Look at the objects from a part of the distance."""
        camera, drawing = self.session.client.camera, self.session.drawing
        place, aside = camera.position, camera.look_at
        objects = enumerate(self.bench.specimens)
        middle = sum(drawing._to_scene(k, each.position).mean(axis=0) for k, each in objects) / len(
            self.bench.specimens
        )
        self.do(lambda: self.session.turn_camera(middle + part * place, middle + part * aside))

    def take(self, name: str, seconds: float = 0.0, whole: bool = False, closer: float = 1.0) -> None:
        """A picture of what is seen after so many seconds, of the whole page or of what the panel leaves free."""
        from io import BytesIO

        from PIL import Image

        now = self.session.school or self.bench
        self.do(lambda: [now.advance(1 / 60) for _ in range(round(60 * seconds))])
        if closer != 1.0:
            self.closer(closer)
        self.page.wait_for_timeout(2500)
        image = Image.open(BytesIO(self.page.screenshot()))
        if not whole:
            image = image.crop((12, 60, 612, 520))
        path = IMAGES / "laboratory" / f"{name}.webp"
        image.convert("RGB").save(path, quality=60 if whole else 80, method=6)
        print(f"{path}: {path.stat().st_size // 1000} kB", flush=True)


def pictures(only: list[str]) -> None:
    """Every body and object, objects side by side, forces, and fish that are steered, as the browser shows them."""
    with opened((960, 600)) as (_, page, session, _):
        photographer = Photographer(page, session)
        for scene in (gallery, deeds, methods, steered):
            if not only or scene.__name__ in only:
                scene(photographer)


def gallery(at: Photographer) -> None:
    """Every object as it falls, every fish as it swims; solids nearer, when the floor has pressed them."""
    moments = {"beam": (0.45, 0.55), "block": (0.57, 0.8), "ball": (0.57, 0.55), "two materials": (0.4, 0.55)}
    for name in (*OBJECTS, *BODIES):
        at.show(Entry(name))
        seconds, closer = moments.get(name, (0.35, 0.75 if name in BODIES else 1.0))
        at.take(name.replace(" ", "_"), seconds, closer=closer)


def deeds(at: Photographer) -> None:
    """What is done to objects: dragged, with forces; thrown; twisted and inverted."""
    at.show(Entry("uniform sphere"))
    length = at.bench.specimens[0].thing.length
    at.do(lambda: at.session.drawing.show("forces", True), lambda: at.bench.grab(0, (0.5 * length, 0.0, 0.0)),
          lambda: at.bench.drag((1.1 * length, -0.4 * length, 0.7 * length)))  # fmt: skip
    at.take("drag", 0.5, closer=0.6)
    at.do(at.bench.let_go, lambda: at.session.drawing.show("forces", False), at.bench.throw, at.session.look)
    at.take("thrown", 0.25)
    for name, how, seconds in (("beam", "twisted", 0.03), ("block", "inverted", 0.1)):
        at.show(Entry(name))
        at.do(lambda how=how: at.bench.distort(how))
        at.take(how, seconds, closer=0.45 if name == "beam" else 0.8)


def methods(at: Photographer) -> None:
    """Objects side by side: one by several methods, one layer and two, and a method that fails."""
    at.show(*(Entry("ring", name) for name in ("leapfrog_chebyshev", "semi_implicit", "rk4")))
    at.take("side_by_side", 1.5, whole=True)
    at.show(Entry("ring"), Entry("ring", "", (("layers", 1),)))
    numbers = {"pressure": 0.0, "stiffness": 3.0, "gravity": 2.0, "restitution": 0.0}
    at.do(lambda: [at.bench.set(*each) for each in numbers.items()])
    at.take("layers", 1.3, closer=0.75)
    at.show(Entry("ring"), Entry("ring", "explicit_euler"))
    at.do(lambda: at.bench.set("step", 4.0), at.bench.throw)
    at.take("failed", 0.3, whole=True)
    at.page.locator(".mantine-Notification-closeButton").first.click()


def steered(at: Photographer) -> None:
    """Fish that are steered: sixteen that turn, one that passes an obstacle, four with their targets."""
    import numpy as np

    from fish_env.lab.school import TURN

    at.page.get_by_role("tab", name="Steer").click()
    at.steer("policy turn", 16, 1.0)
    at.do(lambda: at.session.school.turn(3 * TURN))
    at.take("steer", 0.5, whole=True)
    at.steer("policy avoid", 1, 1.0)
    school = at.session.school
    at.do(
        lambda: school.put(school.shown_positions()[0].mean(axis=0) + school.fish.length * np.array([2.0, 0.05, 0.0]))
    )
    at.take("obstacle", 0.8)
    at.steer("policy target", 4, 0.8)
    at.take("targets", 0.3)


def main() -> int:
    """Measure and write; exit 1 if a bar is missed."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--pictures", action="store_true", help="take the pictures instead")
    parser.add_argument("--scenes", nargs="+", default=[], choices=("gallery", "deeds", "methods", "steered"),
                        help="pictures of these only")  # fmt: skip
    chosen = parser.parse_args()
    if chosen.pictures:
        pictures(chosen.scenes)
        return 0
    rows = starts() + rates()
    print(f"written to {write_csv('speed/laboratory.csv', rows, COMMAND)}")
    return 0 if all(row["met"] for row in rows) else 1


if __name__ == "__main__":
    raise SystemExit(main())
