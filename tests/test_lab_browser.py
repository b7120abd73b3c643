"""The laboratory in a real browser without a window: Chromium by Playwright.

    pip install -c constraints.txt -e ".[dev,browser]"
    playwright install chromium          or: FISH_ENV_CHROMIUM=/usr/bin/chromium
    pytest -m slow -n 0 tests/test_lab_browser.py

Waiting is bounded by PATIENCE only: software rendering on a busy machine is slow, and no time is asserted.
"""

import os
import shutil
import threading
import time
from http.server import BaseHTTPRequestHandler, HTTPServer

import numpy as np
import pytest

playwright = pytest.importorskip("playwright.sync_api", reason='needs pip install -e ".[browser]"')
pytest.importorskip("websockets", reason='needs pip install -e ".[lab]"')

from fish_env.lab.scenes import SCENES
from fish_env.lab.server import Laboratory

pytestmark = pytest.mark.slow
PATIENCE = 180.0  # s
SIZE, PHONE = {"width": 1000, "height": 620}, {"width": 390, "height": 780}
CHROMIUM = os.environ.get("FISH_ENV_CHROMIUM") or shutil.which("chromium")
FLAGS = ["--no-sandbox", "--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader",
         "--host-resolver-rules=MAP evil.example 127.0.0.1"]  # fmt: skip
WATCH = """([count, passed]) => new Promise((done) => {
  const found = [];
  lab.passed = passed;
  lab.heard = () => {
    const x = lab.frame.bodies[0].x, middle = [0, 0, 0];
    for (let k = 0; k < x.length; k++) middle[k % 3] += 3 * x[k] / x.length;
    found.push([...project(lab.camera, middle).slice(0, 2), ...middle]);
    if (found.length >= count) { lab.heard = null; done(found); }
  };
})"""
"""Draw so many pictures, so many seconds apart: where the first body is in the picture, -1 to 1, and in the water."""


def until(condition):
    """Wait until a condition holds, and return its value."""
    end = time.monotonic() + PATIENCE
    while time.monotonic() < end:
        found = condition()
        if found:
            return found
        time.sleep(0.02)
    raise AssertionError("waited in vain")


@pytest.fixture(scope="module")
def laboratory():
    """A laboratory at a port of its own."""
    laboratory = Laboratory("127.0.0.1", 18200)
    yield laboratory
    laboratory.close()


@pytest.fixture(scope="module")
def browser():
    """Chromium, or a skip that names what to install."""
    with playwright.sync_playwright() as running:
        try:
            chromium = running.chromium.launch(executable_path=CHROMIUM, args=FLAGS)
        except playwright.Error as error:
            pytest.skip(f"no browser: playwright install chromium, or set FISH_ENV_CHROMIUM ({error})")
        yield chromium
        chromium.close()


class Visitor:
    """A page of the laboratory, and the session that belongs to it."""

    def __init__(self, laboratory, browser, size):
        before = set(laboratory.sessions)
        self.page = browser.new_page(viewport=size, bypass_csp=True)  # waiting for a condition evaluates text
        self.page.set_default_timeout(1e3 * PATIENCE)
        self.errors = []
        self.page.on("console", lambda message: self.errors.append(message.text) if message.type == "error" else None)
        self.page.on("pageerror", lambda error: self.errors.append(str(error)))
        self.page.goto(f"http://127.0.0.1:{laboratory.port}")
        self.page.wait_for_function("lab.drawn > 0")
        (key,) = set(laboratory.sessions) - before
        self.session = laboratory.sessions[key]

    def open(self, scene):
        """Show a scene by its button."""
        self.page.get_by_role("button", name=scene, exact=True).click()
        until(lambda: self.session.scene == scene)
        self.page.wait_for_function("(name) => lab.stage.scene === name && lab.frame", arg=scene)

    def press(self, name):
        """Press a button."""
        self.page.get_by_role("button", name=name, exact=True).click()

    def watch(self, count, passed=0.1):
        """Where the first body is in so many pictures: (K,2) in the picture, (K,3) in the water, lengths."""
        found = np.array(self.page.evaluate(WATCH, [count, passed]))
        return found[:, :2], found[:, 2:]


@pytest.fixture
def visit(laboratory, browser):
    """Opens pages that say nothing of errors to the end."""
    visitors = []

    def opened(size=SIZE):
        visitors.append(Visitor(laboratory, browser, size))
        return visitors[-1]

    yield opened
    for visitor in visitors:
        visitor.page.close()
    assert [visitor.errors for visitor in visitors] == [[] for _ in visitors]
    until(lambda: not laboratory.sessions)


def test_the_fish_stays_in_the_picture(visit):
    """For a minute under random commands, the fish is in what the panel leaves free of the picture."""
    visitor, generator = visit(), np.random.default_rng(0)
    for _ in range(30):
        visitor.session.stage.turn(generator.uniform(-2.5, 2.5))
        place, _ = visitor.watch(20)
        assert np.abs(place[:, 1]).max() < 0.95 and place[:, 0].min() > -0.95 and place[:, 0].max() < 0.35


def test_the_pointer_leads_the_fish(visit):
    """The fish swims to where the pointer is: to the left of its way, and then to the right."""
    visitor = visit()
    visitor.watch(10)
    for side in (1.0, -1.0):
        for _ in range(10):
            at = visitor.page.evaluate(
                """(side) => {
                  const { x } = lab.frame.bodies[0], middle = lab.frame.middle, nose = [x[0], x[1], x[2]];
                  const way = Math.atan2(nose[1] - middle[1], nose[0] - middle[0]) + side * Math.PI / 2;
                  const goal = [middle[0] + 2 * Math.cos(way), middle[1] + 2 * Math.sin(way), middle[2]];
                  const [a, b] = project(lab.camera, goal);
                  const box = document.getElementById("view").getBoundingClientRect();
                  return [box.width * (a + 1) / 2, box.height * (1 - b) / 2];
                }""", side)  # fmt: skip
            visitor.page.mouse.move(*np.clip(at, 5, [SIZE["width"] - 330, SIZE["height"] - 5]))
            visitor.watch(2)
        before = visitor.session.stage.facing[0]
        visitor.watch(5)
        turned = np.degrees(visitor.session.stage.facing[0])
        assert side * turned > 20.0 or side * (turned - np.degrees(before)) > 0.0


@pytest.mark.parametrize("scene", SCENES)
def test_every_button_acts(scene, visit):
    """Every scene opens, every button of it reaches the stage, and charts have numbers."""
    visitor = visit()
    visitor.open(scene)
    visitor.watch(10, 0.05)
    for control in visitor.session.controls():
        if control.kind != "switch" or control.name == "fixing":
            continue
        group = visitor.page.locator(f'details[data-group="{control.group}"]')
        if group.get_attribute("open") is None:
            group.locator("summary").click()
        before = control.value
        visitor.press(control.label)
        until(lambda name=control.name, before=before: next(
            each.value for each in visitor.session.controls() if each.name == name) != before)  # fmt: skip
        visitor.press(control.label)
    values = visitor.page.evaluate("lab.frame.values")
    assert values and all(isinstance(value, int | float) for row in values for value in row)
    rows = visitor.page.evaluate("lab.plots.length")
    assert rows > 3
    visitor.press("One step")
    until(lambda: visitor.session.paused)


def test_charts_of_one_two_and_three_objects(visit):
    """There are as many lines as objects, all of them numbers."""
    visitor = visit()
    visitor.open("soft objects")
    for count in (1, 2, 3):
        if count > 1:
            visitor.page.get_by_label(f"The {('second', 'third')[count - 2]}").select_option("ring")
        visitor.page.wait_for_function("(count) => lab.frame && lab.frame.bodies.length === count", arg=count)
        visitor.watch(5, 0.05)
        values = visitor.page.evaluate("lab.frame.values")
        assert len(values[0]) == count and all(value is not None for row in values for value in row)
        assert visitor.page.locator("#plots figure").count() == len(values)


def test_a_drag_moves_the_node(visit):
    """The mouse takes hold of a node, and the node follows it."""
    visitor = visit()
    visitor.open("finite elements")
    visitor.watch(3, 0.0)
    at = visitor.page.evaluate("""() => {
      const { x } = lab.frame.bodies[0], box = document.getElementById("view").getBoundingClientRect();
      for (let k = 0; k < x.length; k += 3) {
        const [a, b] = project(lab.camera, [x[k], x[k + 1], x[k + 2]]);
        const place = [box.width * (a + 1) / 2, box.height * (1 - b) / 2];
        if (document.elementFromPoint(...place)?.id === "view") return place;
      }
    }""")
    mouse, stage = visitor.page.mouse, visitor.session.stage
    mouse.move(*at)
    mouse.down()
    until(lambda: stage.hand)
    start = stage.specimens[0].position[stage.hand.node].copy()
    mouse.move(at[0], at[1] - 120, steps=6)
    visitor.watch(10, 0.1)
    assert stage.specimens[0].position[stage.hand.node, 2] > start[2] + 0.05 * stage.length
    mouse.up()
    until(lambda: stage.hand is None)


def test_what_is_shown_is_drawn(visit):
    """Without skin, or with strains, the picture is another one; shown again, it is as it was."""
    visitor = visit()
    visitor.open("finite elements")
    visitor.session.stage.distort("twisted")
    visitor.session.paused = True
    pictures = []
    for name in ("skin", "skin", "strain", "strain"):
        visitor.watch(20, 0.0)  # the camera has come to rest
        visitor.page.evaluate("ratio = 0.5")
        visitor.watch(2, 0.0)
        pictures.append(visitor.page.evaluate("canvas.toDataURL()"))
        visitor.page.evaluate(
            "(name) => set(`show ${name}`, !controls.find((c) => c.name === `show ${name}`).value)", name
        )
    visitor.watch(2, 0.0)
    assert pictures[0] != pictures[1] and pictures[2] != pictures[3] and len(set(pictures)) == 3


def test_time_can_be_looked_back_at(visit):
    """The slider shows an earlier moment and pauses; at its end the present is shown again."""
    visitor = visit()
    visitor.watch(40, 0.1)
    scrub = visitor.page.locator("#scrub")
    scrub.fill("500")
    until(lambda: visitor.session.paused)
    visitor.page.wait_for_function("lab.frame.time < lab.plots.at(-1).time - 0.5")
    scrub.fill("1000")
    visitor.page.wait_for_function("lab.frame.time === lab.plots.at(-1).time")


def test_a_failure_is_shown_once(visit):
    """What fails is named once, with a way on."""
    visitor = visit()
    visitor.open("what the method does")
    visitor.page.get_by_label("its method").first.select_option("explicit_euler")
    until(lambda: visitor.session.stage.specimens[0].method == "explicit_euler")
    visitor.session.stage.set("step", 50.0)
    visitor.session.stage.throw()
    for _ in range(20):
        visitor.watch(10, 0.1)
        if visitor.session.stage.failure:
            break
    visitor.page.get_by_text("explicit_euler failed on the ring").wait_for()
    assert visitor.page.locator("#trouble").count() == 1
    visitor.page.locator("#rescue").get_by_role("button", name="Halve the step").click()
    until(lambda: not visitor.session.stage.failure)
    assert visitor.session.stage.numbers["step"] == 25.0


def test_a_phone(visit):
    """At 390 pixels nothing hangs over, the fish is in the picture, and the controls unfold."""
    visitor = visit(PHONE)
    place, _ = visitor.watch(20)
    assert np.abs(place).max() < 0.95
    assert visitor.page.evaluate("document.documentElement.scrollWidth") <= PHONE["width"]
    assert not visitor.page.get_by_role("button", name="Left after right", exact=True).is_visible()
    visitor.press("Controls")
    visitor.press("Left after right")
    until(lambda: visitor.session.stage._planned or visitor.session.stage.commanded[0] != 0.0)


def test_keys_and_help(visit):
    """Keys act, and F1 lists them."""
    visitor = visit()
    visitor.watch(3)
    visitor.page.keyboard.press("ArrowLeft")
    until(lambda: visitor.session.stage.commanded[0] > 0.5)
    visitor.page.keyboard.press(" ")
    until(lambda: visitor.session.paused)
    visitor.page.keyboard.press("F1")
    visitor.page.get_by_text("commands a right turn, and a left one before it is complete").wait_for()


INTRUDER = """<p id=said></p><iframe src="http://ADDRESS"></iframe><script>
    let left = 10
    for (let k = 0; k < 10; k++) {
        const socket = new WebSocket("ws://ADDRESS/socket")
        socket.onopen = () => said.textContent += "opened "
        socket.onclose = () => { left -= 1; if (!left) said.textContent += "all are closed" }
    }
</script>"""
"""Another page, which shows the laboratory's in a frame and connects to it as often as it can."""


class Elsewhere(BaseHTTPRequestHandler):
    """Answers with that page."""

    def do_GET(self):
        """Answer."""
        self.send_response(200)
        self.send_header("Content-Type", "text/html")
        self.end_headers()
        self.wfile.write(self.server.page.encode())

    def log_message(self, *_):
        """Say nothing."""


def test_another_page_in_the_same_browser_gets_nothing(laboratory, browser):
    """A page of another origin gets no session, by sockets, in a frame or by a name that leads here."""
    until(lambda: not laboratory.sessions)
    other = HTTPServer(("127.0.0.1", 0), Elsewhere)
    other.page = INTRUDER.replace("ADDRESS", f"127.0.0.1:{laboratory.port}")
    threading.Thread(target=other.serve_forever, daemon=True).start()
    page = browser.new_page()
    try:
        page.goto(f"http://127.0.0.1:{other.server_port}")
        page.get_by_text("all are closed").wait_for(timeout=1e3 * PATIENCE)
        assert page.locator("#said").text_content() == "all are closed"
        until(lambda: page.frames[1].url.startswith("chrome-error:"))
        refused = page.goto(f"http://evil.example:{laboratory.port}")
        assert refused.status == 403 and "no address of the laboratory" in page.content()
        assert laboratory.sessions == {}
    finally:
        page.close()
        other.shutdown()
        other.server_close()
