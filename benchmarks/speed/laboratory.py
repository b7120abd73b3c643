"""The laboratory in the browser: updates a second, the time until its page is usable, and its pictures.

    python -m benchmarks.speed.laboratory --rates       every body and object: results/speed/laboratory.csv
    python -m benchmarks.speed.laboratory --start       until the page is usable: results/speed/laboratory_start.csv
    python -m benchmarks.speed.laboratory --pictures    every scene as the browser shows it: docs/images/laboratory/

They need the extra [browser] and Chromium (FISH_ENV_CHROMIUM names one that is installed). An update is what the
server does for one picture: it moves the object on by 1/30 s, a fish by 1/60 s, measures, and sends what has changed to
a browser that is connected. It is counted in processor time of the server's process, all threads of it.
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
LIMIT = 1000  # nodes up to which the laboratory is to keep up
SLOW, FAST = 30, 60  # updates a second that are to be reached: of objects, and of fish
FLAGS = ["--no-sandbox", "--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"]
REFINED = (
    Entry("ring", "", (("nodes", 24),)),
    Entry("sphere", "", (("slices", 24), ("stacks", 12))),
    Entry("uniform sphere", "", (("level", 3),)),
    Entry("tetrahedral", "", (("level", 2),)),
    Entry("tetrahedral", "", (("level", 3),)),
)


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
        session.bench.advance(1.0 / rate)
        with session.client.atomic():
            session.drawing.update()
        session.panel.update(k / rate)
        time.sleep(max(0.0, due - time.perf_counter()))  # the browser's messages are sent, none is left out
    session.client.flush()
    return UPDATES / (time.process_time() - begin)


def rates() -> list[dict]:
    """Updates a second of every body and object up to LIMIT nodes, one core, beside what is to be reached."""
    rows = []
    entries = [*map(Entry, [*OBJECTS, *BODIES]), *REFINED]
    with opened() as (_, _, session, _):
        session.close()  # its own thread ends; the page stays
        session._thread.join()
        for entry in entries:
            session.bench.choose([entry])
            nodes = session.bench.nodes
            if nodes > LIMIT:
                continue
            session.show_bench()
            session.bench.warm()
            fish = session.bench.specimens[0].is_fish
            session.bench.swim(fish)
            rate = FAST if fish and nodes <= 100 else SLOW
            updates(session, rate)
            found = median(updates(session, rate) for _ in range(REPEATS))
            row = {"object": entry.thing, "made_with": " ".join(f"{k} {v}" for k, v in entry.level), "nodes": nodes,
                   "updates_per_s": round(found, 1), "lowest": rate, "met": found >= rate}  # fmt: skip
            print(row, flush=True)
            rows.append(row)
    return rows


def starts() -> list[dict]:
    """From the address typed to a page that answers, s, and what the server computes until then; kernels compiled."""
    found: list[tuple[float, float]] = []
    for k in range(STARTS):
        begin = time.process_time()
        with opened(port=18310 + k) as (_, _, _, usable):
            found.append((usable, time.process_time() - begin))
            print(found[-1], flush=True)
    names = ("until the page is usable, software rendering, s", "processor time of the server until then, s")
    rows = []
    for which, starts in (("first of the process", found[:1]), ("median of all", found)):
        for name, values in zip(names, zip(*starts, strict=True), strict=True):
            value = round(median(values), 2)
            rows.append({"start": which, "quantity": name, "value": value, "highest": 3.0, "met": value <= 3.0})
    return rows


def pictures() -> None:
    """Every body and object, objects side by side, forces, and fish that are steered, as the browser shows them."""
    from io import BytesIO

    import numpy as np
    from PIL import Image

    from fish_env.lab.school import TURN, School

    folder = IMAGES / "laboratory"
    with opened((960, 600)) as (_, page, session, _):
        close = page.locator(".mantine-Notification-closeButton")

        def done(action) -> None:
            """Have something done by the session, and wait."""
            over: list[bool] = []
            session.ask(lambda: (action(), over.append(True)))
            while not over:
                page.wait_for_timeout(50)

        def picture(name: str, seconds: float, whole: bool = False) -> None:
            clock = (session.school or session.bench).clock
            while (session.school or session.bench).clock < clock + seconds:
                page.wait_for_timeout(50)
            session.paused = True
            page.wait_for_timeout(2500)
            image = Image.open(BytesIO(page.screenshot()))
            if not whole:
                image = image.crop((150, 60, 630, 520) if session.school else (12, 60, 612, 520))
            image.convert("RGB").save(folder / f"{name}.webp", quality=80, method=6)
            session.paused = False
            print(name, flush=True)

        if close.count():
            close.first.click()  # the note that there is no graphics card
        for name in (*OBJECTS, *BODIES):
            done(
                lambda name=name: (session.bench.choose([Entry(name)]), session.show_bench(), session.bench.swim(True))
            )
            picture(name.replace(" ", "_"), 0.35)
        methods = ("leapfrog_chebyshev", "semi_implicit", "rk4")
        done(lambda: (session.bench.choose([Entry("ring", name) for name in methods]), session.show_bench()))
        picture("side_by_side", 1.5, whole=True)
        done(lambda: (session.bench.choose([Entry("uniform sphere")]), session.show_bench(),
                      session.drawing.show("forces", True)))  # fmt: skip
        done(lambda: session.bench.grab(0, session.bench.specimens[0].position[0]))
        done(lambda: session.bench.drag(session.bench.specimens[0].position[0] * 2.5))
        picture("drag", 0.6)
        done(lambda: (session.bench.let_go(), session.drawing.show("forces", False)))
        page.get_by_role("tab", name="Steer").click()
        done(lambda: session.show_school(School("policy turn", 16)))
        done(lambda: session.school.advance(1.0))
        done(lambda: session.school.turn(3 * TURN))
        picture("steer", 0.5, whole=True)
        done(lambda: session.show_school(School("policy avoid", 1)))
        done(lambda: session.school.advance(1.0))
        ahead = session.school.shown()[0].mean(axis=0) + session.school.fish.length * np.array([2.0, 0.05, 0.0])
        done(lambda: session.school.put(ahead))
        picture("obstacle", 0.8)
        done(lambda: session.show_school(School("policy target", 4)))
        done(lambda: session.school.advance(0.8))
        picture("targets", 0.3)


def main() -> int:
    """Measure and write; exit 1 if a bar is missed."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    for part in ("rates", "start", "pictures"):
        parser.add_argument(f"--{part}", action="store_true")
    chosen, rows = parser.parse_args(), []
    if chosen.rates:
        rows += rates()
        print(f"written to {write_csv('speed/laboratory.csv', rows, COMMAND + ' --rates')}")
    if chosen.start:
        rows += (begun := starts())
        print(f"written to {write_csv('speed/laboratory_start.csv', begun, COMMAND + ' --start')}")
    if chosen.pictures:
        pictures()
    return 0 if all(row["met"] for row in rows) else 1


if __name__ == "__main__":
    raise SystemExit(main())
