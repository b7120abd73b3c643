"""The laboratory in a real browser without a window: Chromium by Playwright.

    pip install -c constraints.txt -e ".[dev,browser]"
    playwright install chromium          or: FISH_ENV_CHROMIUM=/usr/bin/chromium
    pytest -m slow -n 0 tests/test_lab_browser.py

Waiting is bounded by PATIENCE only: software rendering on a busy machine is slow, and no time is asserted.
"""

import os
import shutil
import threading
from http.server import BaseHTTPRequestHandler, HTTPServer

import numpy as np
import pytest

playwright = pytest.importorskip("playwright.sync_api", reason='needs pip install -e ".[browser]"')
viser = pytest.importorskip("viser", reason='needs pip install -e ".[lab]"')

from viewer import PATIENCE, until

from fish_env.lab.server import Laboratory
from fish_env.lab.settings import SETTINGS

pytestmark = pytest.mark.slow
SIZE = {"width": 760, "height": 460}
CHROMIUM = os.environ.get("FISH_ENV_CHROMIUM") or shutil.which("chromium")
PASSIVE = "Unable to preventDefault inside passive event listener"  # viser's page says so at the end of every drag
FLAGS = ["--no-sandbox", "--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader",
         "--host-resolver-rules=MAP evil.example 127.0.0.1"]  # fmt: skip


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

    def __init__(self, laboratory, browser):
        before = set(laboratory.sessions)
        self.page = browser.new_page(viewport=SIZE)
        self.page.set_default_timeout(1e3 * PATIENCE)
        self.errors = []
        self.page.on("console", self.hear)
        self.page.on("pageerror", lambda error: self.errors.append(str(error)))
        self.page.goto(f"http://127.0.0.1:{laboratory.port}")
        self.page.get_by_text("pictures a second").wait_for()
        (key,) = set(laboratory.sessions) - before
        self.session = laboratory.sessions[key]
        self.bench = self.session.bench

    def hear(self, message):
        """Keep what the console says of errors."""
        if message.type == "error" and PASSIVE not in message.text:
            self.errors.append(message.text)

    def tab(self, name):
        """Open a tab."""
        self.page.get_by_role("tab", name=name).click()

    def choose(self, label, option):
        """Choose from a list."""
        self.page.get_by_label(label, exact=True).click()
        self.page.get_by_role("option", name=option, exact=True).click()

    def fill(self, label, value):
        """Type a number beside a slider."""
        row = self.page.get_by_text(label, exact=True).locator("xpath=ancestor::*[.//input[@inputmode]][1]")
        field = row.locator("input[inputmode]").first
        field.fill(str(value))
        field.press("Enter")

    def press(self, name):
        """Press a button."""
        self.page.get_by_role("button", name=name).click()

    def screen(self, point):
        """Place of a point of the scene on the screen, pixels."""
        camera = self.session.client.camera
        eye, ahead = np.array(camera.position), np.array(camera.look_at) - np.array(camera.position)
        ahead /= np.linalg.norm(ahead)
        right = np.cross(ahead, (0.0, 0.0, 1.0))
        right /= np.linalg.norm(right)
        way = np.asarray(point) - eye
        scale = 0.5 * SIZE["height"] / np.tan(0.5 * camera.fov) / (way @ ahead)
        return 0.5 * SIZE["width"] + scale * (way @ right), 0.5 * SIZE["height"] - scale * (
            way @ np.cross(right, ahead)
        )

    def hold(self):
        """Press the mouse on the object, in the middle of what is seen of it, and take hold."""
        middle = self.session.drawing._to_scene(0, self.bench.specimens[0].position).mean(axis=0)
        x, y = self.screen(middle)
        mouse = self.page.mouse
        mouse.move(x, y)
        mouse.down()
        mouse.move(x, y - 8, steps=2)
        until(lambda: self.bench.hand)
        return x, y


@pytest.fixture
def visitor(laboratory, browser):
    """A page that has just been opened."""
    visitor = Visitor(laboratory, browser)
    yield visitor
    if not visitor.page.is_closed():
        visitor.page.close()


def test_a_drag_moves_the_node_towards_the_pointer(visitor):
    """The page loads without errors, time passes, and a drag moves the node towards the pointer."""
    bench = visitor.bench
    until(lambda: bench.clock > 1.0)
    x, y = visitor.hold()
    node = bench.hand.node
    start = bench.specimens[0].position[node].copy()
    visitor.page.mouse.move(x, y - 120, steps=6)
    until(lambda: np.linalg.norm(bench.hand.point - start) > 0.2 * bench.specimens[0].thing.length)
    aim = bench.hand._goal.copy()
    gap = np.linalg.norm(start - aim)
    until(lambda: np.linalg.norm(bench.specimens[0].position[node] - aim) < 0.5 * gap)
    visitor.page.mouse.up()
    until(lambda: bench.hand is None)
    assert visitor.errors == []


def test_controls_act(visitor):
    """Lists, numbers, buttons and boxes of the tabs act; what the messages of each do, test_lab_page tests."""
    bench, session = visitor.bench, visitor.session
    visitor.choose("object", "ring")
    until(lambda: bench.specimens[0].entry.thing == "ring")
    visitor.fill("speed", 0.5)
    until(lambda: session.speed == 0.5)
    visitor.press("Throw")
    until(lambda: bench.specimens[0].position[:, 0].mean() > 0.05 * bench.specimens[0].thing.length)
    visitor.press("One step")
    until(lambda: session.paused)
    visitor.tab("Change")
    for name, setting in SETTINGS.items():
        value = round(0.3 * setting.low + 0.7 * setting.high, 1)
        visitor.fill(setting.label, value)
        until(lambda name=name, value=value: bench.numbers[name] == pytest.approx(value))
    visitor.choose("walls", "none")
    until(lambda: bench.specimens[0].tank.world.planes is None)
    visitor.tab("Compare")
    visitor.choose("second object", "ring")
    visitor.choose("second integrator", "explicit_euler")
    until(lambda: len(bench.specimens) == 2 and bench.specimens[1].tank.integrator.name == "explicit_euler")
    visitor.page.get_by_label("same cost", exact=True).click()
    until(lambda: bench.same_cost)
    visitor.page.get_by_text(f"explicit_euler, step {1e3 * bench.specimens[1].tank.dt:.3g} ms").wait_for()
    assert visitor.errors == []


@pytest.mark.parametrize(("view", "thing"), [("springs", "mass_spring"), ("tetrahedra", "tetrahedral")])
def test_a_view_is_shown_and_hidden(visitor, view, thing):
    """A box of the tab View hides or shows its part: the picture of a still fish changes, and back again."""
    visitor.choose("object", thing)
    until(lambda: visitor.bench.specimens[0].entry.thing == thing and visitor.bench.clock > 0.3)
    visitor.press("One step")
    until(lambda: visitor.session.paused)
    visitor.tab("View")
    box = visitor.page.get_by_label(view, exact=True)

    def picture():
        """Screenshot left of the panel and below messages, once it has not changed five times."""
        looks = []
        while len(set(looks[-5:])) > 1 or len(looks) < 5:
            visitor.page.wait_for_timeout(400)
            looks.append(visitor.page.screenshot(clip={"x": 0, "y": 185, "width": 400, "height": 245}))
        return looks[-1]

    def alternate():
        """Click twice; True if the pictures are two by turns: earlier ones may show what was drawn late."""
        for _ in range(2):
            box.click()
            looks.append(picture())
        return looks[-1] == looks[-3] and looks[-1] != looks[-2]

    looks = [picture()]
    until(alternate)
    assert visitor.errors == []


def test_arrow_keys_turn_the_fish_by_the_commanded_angle(visitor):
    """Arrow keys turn the fish by the commanded angle, and leave the camera where it is."""
    visitor.tab("Steer")
    visitor.choose("steered by", "policy turn")
    school = until(lambda: visitor.session.school)
    until(lambda: school.time > 1.0)
    camera = np.array(visitor.session.client.camera.position)
    for _ in range(2):
        visitor.page.keyboard.press("ArrowLeft")
    until(lambda: school.commanded[0] > 1.0)
    assert np.degrees(school.commanded[0]) == pytest.approx(60.0)
    then = school.time
    until(lambda: school.time > then + 3.0)
    assert np.degrees(school.heading[0]) == pytest.approx(60.0, abs=12.0)
    visitor.page.keyboard.press("ArrowRight")
    until(lambda: np.degrees(school.commanded[0]) == pytest.approx(30.0))
    visitor.page.wait_for_timeout(500)
    assert np.array(visitor.session.client.camera.position) == pytest.approx(camera)
    assert visitor.errors == []


def test_a_click_puts_a_target_on_the_water(visitor):
    """A click puts a target on the water."""
    visitor.tab("Steer")
    visitor.choose("steered by", "policy target")
    school = until(lambda: visitor.session.school)
    until(lambda: school.time > 0.5)
    visitor.tab("Object")
    visitor.press("One step")  # pauses: else the fish may reach the target, and another one is drawn
    until(lambda: visitor.session.paused)
    before = school.targets().copy()
    visitor.page.mouse.click(150, 300)
    until(lambda: not np.array_equal(school.targets(), before))
    assert school.targets()[0, 2] == pytest.approx(0.0, abs=1e-9)
    assert visitor.errors == []


INTRUDER = """<p id=said></p><iframe src="http://ADDRESS"></iframe><script>
    let left = 10
    for (let k = 0; k < 10; k++) {
        const socket = new WebSocket("ws://ADDRESS", ["viser-vVERSION"])
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
    other.page = INTRUDER.replace("ADDRESS", f"127.0.0.1:{laboratory.port}").replace("VERSION", viser.__version__)
    threading.Thread(target=other.serve_forever, daemon=True).start()
    page = browser.new_page()
    try:
        page.goto(f"http://127.0.0.1:{other.server_port}")
        page.get_by_text("all are closed").wait_for(timeout=1e3 * PATIENCE)
        assert page.locator("#said").text_content() == "all are closed"
        until(lambda: page.frames[1].url.startswith("chrome-error:"))
        refused = page.goto(f"http://evil.example:{laboratory.port}")
        assert refused.status == 403 and "no address of the laboratory" in page.content()
        assert laboratory.sessions == {} and laboratory.server.get_clients() == {}
    finally:
        page.close()
        other.shutdown()
        other.server_close()
