"""The pictures of the laboratory's page, taken in the browser.

python docs/site/laboratory_pictures.py                    writes docs/images/laboratory/
python docs/site/laboratory_pictures.py methods steered    these scenes only

Needs the extra [browser] and Chromium; FISH_ENV_CHROMIUM names one that is installed.
"""

import argparse
import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from io import BytesIO
from pathlib import Path

import numpy as np
from PIL import Image
from playwright.sync_api import sync_playwright

from fish_env.bodies import BODIES
from fish_env.bodies.objects import SOLIDS, SONG
from fish_env.lab.school import TURN, School
from fish_env.lab.server import Laboratory
from fish_env.lab.specimen import Entry

FOLDER = Path(__file__).parents[1] / "images" / "laboratory"
FLAGS = ["--no-sandbox", "--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"]
WIDTH = 1200  # pixels of pictures side by side


@contextmanager
def opened(size=(960, 600), port=18300) -> Iterator[tuple]:
    """A page of a laboratory, and the session that belongs to it."""
    laboratory = Laboratory("127.0.0.1", port)
    with sync_playwright() as running:
        path = os.environ.get("FISH_ENV_CHROMIUM") or shutil.which("chromium")
        chromium = running.chromium.launch(executable_path=path, args=FLAGS)
        page = chromium.new_page(viewport={"width": size[0], "height": size[1]})
        page.set_default_timeout(180e3)
        page.goto(f"http://127.0.0.1:{laboratory.port}")
        page.get_by_text("pictures a second").wait_for()
        yield page, next(iter(laboratory.sessions.values()))
        chromium.close()
    laboratory.close()


def save(name: str, image: Image.Image, quality=80) -> None:
    """Write a picture."""
    path = FOLDER / f"{name}.webp"
    image.convert("RGB").save(path, quality=quality, method=6)
    print(f"{path}: {path.stat().st_size // 1000} kB", flush=True)


def save_side_by_side(name: str, images: list[Image.Image], columns: int) -> None:
    """Write pictures of one size in rows of so many."""
    width, height = WIDTH // columns, round(WIDTH / columns * images[0].height / images[0].width)
    whole = Image.new("RGB", (columns * width, -(-len(images) // columns) * height), "white")
    for k, image in enumerate(images):
        whole.paste(image.convert("RGB").resize((width, height)), (k % columns * width, k // columns * height))
    save(name, whole)


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

    def picture(self, seconds: float = 0.0, whole: bool = False, closer: float = 1.0) -> Image.Image:
        """The page after so many seconds, whole or what the panel leaves free."""
        now = self.session.school or self.bench
        self.do(lambda: [now.advance(1 / 60) for _ in range(round(60 * seconds))])
        if closer != 1.0:
            self.closer(closer)
        self.page.wait_for_timeout(2500)
        image = Image.open(BytesIO(self.page.screenshot()))
        return image if whole else image.crop((12, 60, 612, 520))


def gallery(at: Photographer) -> None:
    """Objects that fall or are pulled about, and fish that swim; solids nearer, when the floor has pressed them."""
    moments = {"beam": (0.45, 0.55), "block": (0.57, 0.8), "ball": (0.57, 0.55), "two materials": (0.4, 0.55)}

    def shown(names) -> list[Image.Image]:
        found = []
        for name in names:
            at.show(Entry(name))
            seconds, closer = moments.get(name, (0.35, 0.75 if name in BODIES else 1.0))
            found.append(at.picture(seconds, closer=closer))
        return found

    save_side_by_side("objects", [*shown(SONG), *thrown_and_dragged(at)], 3)
    save_side_by_side("solids", [*shown(SOLIDS), *out_of_shape(at)], 3)
    save_side_by_side("fish", shown(BODIES), 3)


def thrown_and_dragged(at: Photographer) -> list[Image.Image]:
    """A sphere thrown at the wall, and dragged, with its forces."""
    at.show(Entry("uniform sphere"))
    length = at.bench.specimens[0].thing.length
    at.do(lambda: at.session.drawing.show("forces", True), lambda: at.bench.grab(0, (0.5 * length, 0.0, 0.0)),
          lambda: at.bench.drag((1.1 * length, -0.4 * length, 0.7 * length)))  # fmt: skip
    dragged = at.picture(0.5, closer=0.6)
    at.do(at.bench.let_go, lambda: at.session.drawing.show("forces", False), at.bench.throw, at.session.look)
    return [at.picture(0.25), dragged]


def out_of_shape(at: Photographer) -> list[Image.Image]:
    """A twisted beam and an inverted block, returning to their shapes."""
    found = []
    for name, how, seconds in (("beam", "twisted", 0.03), ("block", "inverted", 0.1)):
        at.show(Entry(name))
        at.do(lambda how=how: at.bench.distort(how))
        found.append(at.picture(seconds, closer=0.45 if name == "beam" else 0.8))
    return found


def methods(at: Photographer) -> None:
    """Objects side by side: one by several methods, one layer and two, and a method that fails."""
    at.show(*(Entry("ring", name) for name in ("leapfrog_chebyshev", "semi_implicit", "rk4")))
    save("side_by_side", at.picture(1.5, whole=True), 60)
    at.show(Entry("ring"), Entry("ring", "", (("layers", 1),)))
    numbers = {"pressure": 0.0, "stiffness": 3.0, "gravity": 2.0, "restitution": 0.0}
    at.do(lambda: [at.bench.set(*each) for each in numbers.items()])
    save("layers", at.picture(1.3, closer=0.75))
    at.show(Entry("ring"), Entry("ring", "explicit_euler"))
    at.do(lambda: at.bench.set("step", 4.0), at.bench.throw)
    save("failed", at.picture(0.3, whole=True), 60)
    at.page.locator(".mantine-Notification-closeButton").first.click()


def steered(at: Photographer) -> None:
    """Fish that are steered: sixteen that turn, one that passes an obstacle, four with their targets."""
    at.page.get_by_role("tab", name="Steer").click()
    at.steer("policy turn", 16, 1.0)
    at.do(lambda: at.session.school.turn(3 * TURN))
    save("steer", at.picture(0.5, whole=True), 60)
    at.steer("policy avoid", 1, 1.0)
    school = at.session.school
    at.do(
        lambda: school.put(school.shown_positions()[0].mean(axis=0) + school.fish.length * np.array([2.0, 0.05, 0.0]))
    )
    obstacle = at.picture(0.8)
    at.steer("policy target", 4, 0.8)
    save_side_by_side("tasks", [obstacle, at.picture(0.3)], 2)


SCENES = {"gallery": gallery, "methods": methods, "steered": steered}


def main() -> None:
    """The command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scenes", nargs="*", help=f"of {', '.join(SCENES)} (all)")
    chosen = parser.parse_args().scenes
    with opened() as (page, session):
        photographer = Photographer(page, session)
        for name in chosen or SCENES:
            SCENES[name](photographer)


if __name__ == "__main__":
    main()
