"""The laboratory in a real browser without a window: Chromium by Playwright.

    pip install -c constraints.txt -e ".[dev,browser]"
    playwright install chromium          or: FISH_ENV_CHROMIUM=/usr/bin/chromium
    pytest -m slow -n 0 tests/test_lab_browser.py

Waiting is bounded by PATIENCE only: software rendering on a busy machine is slow, and no time is asserted.
"""

import os
import shutil

import gymnasium as gym
import numpy as np
import pytest

playwright = pytest.importorskip("playwright.sync_api", reason='needs pip install -e ".[browser]"')

from test_lab_server import PATIENCE, laboratory, sessions, until  # noqa: F401 - the fixtures

from fish_env.control import record, write_film
from fish_env.lab.session import SCENES

pytestmark = pytest.mark.slow
SIZE, PHONE = {"width": 1000, "height": 620}, {"width": 390, "height": 780}
SIZES = {"desktop": {"width": 1280, "height": 800}, "phone": {"width": 390, "height": 844}}
CHROMIUM = os.environ.get("FISH_ENV_CHROMIUM") or shutil.which("chromium")
FLAGS = ["--no-sandbox", "--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"]
WATCH = """([count, passed]) => new Promise((done) => {
  const found = [];
  lab.passed = passed;
  lab.heard = () => {
    const sum = (x, c) => x.reduce((total, value, k) => total + (k % 3 === c ? 3 * value / x.length : 0), 0);
    found.push(lab.frame.bodies.map(({ x }) => project(lab.camera, [0, 1, 2].map((c) => sum(x, c))).slice(0, 2)));
    if (found.length >= count) { lab.heard = null; done(found); }
  };
})"""
"""Draw so many pictures, so many seconds apart: where every body is in the picture, -1 to 1."""
HIDDEN = """() => {
  const { bodies, spheres } = lab.frame, all = (which) => [...document.querySelectorAll(which)];
  const panels = all(".card").map((card) => card.getBoundingClientRect()).filter((box) => box.width);
  const places = [...bodies.flatMap(({ x }) => points(x)), ...spheres].map((p) => project(lab.camera, p))
    .map(([a, b]) => [innerWidth * (a + 1) / 2, innerHeight * (1 - b) / 2]);
  const labels = all("#labels span").map((label) => label.getBoundingClientRect());
  for (const { left, top, right, bottom } of labels) places.push([left, top], [right, bottom]);
  return places.filter(([x, y]) => x < 0 || y < 0 || x > innerWidth || y > innerHeight
    || panels.some((box) => x > box.left && x < box.right && y > box.top && y < box.bottom));
}"""
"""Pixels of nodes, spheres and corners of labels that are outside the window or behind a panel."""


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

    def __init__(self, port, opened, browser, size):
        self.page = browser.new_page(viewport=size, bypass_csp=True)  # waiting for a condition evaluates text
        self.page.set_default_timeout(1e3 * PATIENCE)
        self.errors = []
        self.page.on("console", lambda message: self.errors.append(message.text) if message.type == "error" else None)
        self.page.on("pageerror", lambda error: self.errors.append(str(error)))
        self.page.goto(f"http://127.0.0.1:{port}")
        self.page.wait_for_function("lab.drawn > 0")
        self.session = opened[-1]

    def open(self, scene):
        """Show a scene by its button; it is returned."""
        self.press(scene)
        self.page.wait_for_function("(name) => lab.scene.name === name && lab.frame", arg=scene)
        return self.session.scene

    def press(self, name):
        """Press a button."""
        self.page.get_by_role("button", name=name, exact=True).click()

    def watch(self, count, passed=0.1):
        """Where every body is in so many pictures, (K,bodies,2)."""
        return np.array(self.page.evaluate(WATCH, [count, passed]))


@pytest.fixture
def visit(laboratory, sessions, browser):  # noqa: F811
    """Opens pages that say nothing of errors to the end."""
    visitors = []
    yield lambda size=SIZE: visitors.append(Visitor(laboratory.port, sessions, browser, size)) or visitors[-1]
    for visitor in visitors:
        visitor.page.close()
        assert visitor.errors == []


def test_the_fish_stays_in_the_picture(visit):
    """For a minute under random commands, the fish is in what the panel leaves free of the picture."""
    visitor, generator = visit(), np.random.default_rng(0)
    for _ in range(30):
        visitor.session.scene.turn(generator.uniform(-2.5, 2.5))
        place = visitor.watch(20)[:, 0]
        assert np.abs(place[:, 1]).max() < 0.95 and place[:, 0].min() > -0.95 and place[:, 0].max() < 0.35


def test_the_pointer_leads_the_fish(visit):
    """The fish swims to where the pointer is: to the left of its way, and then to the right."""
    visitor = visit()
    visitor.watch(10)
    for side in (1.0, -1.0):
        facing = [visitor.session.scene.facing[0]]
        for _ in range(5):
            at = visitor.page.evaluate(
                """(side) => {
                  const { x } = lab.frame.bodies[0], middle = lab.frame.middle;
                  const way = Math.atan2(x[1] - middle[1], x[0] - middle[0]) + side * Math.PI / 2;
                  const [a, b] = project(lab.camera, add(middle, [Math.cos(way), Math.sin(way), 0], 2));
                  const box = canvas.getBoundingClientRect();
                  return [box.width * (a + 1) / 2, box.height * (1 - b) / 2];
                }""", side)  # fmt: skip
            visitor.page.mouse.move(*np.clip(at, 5, [SIZE["width"] - 330, SIZE["height"] - 5]))
            visitor.watch(2)
            facing.append(visitor.session.scene.facing[0])
        assert side * np.ptp(np.unwrap(facing)) * np.sign(np.unwrap(facing)[-1] - facing[0]) > 0.2


def test_film_on_a_phone(visit, tmp_path):
    """Every view of a film can be chosen on a narrow screen, and no panel covers another one."""
    path = write_film(record(gym.make("FishEnv/Avoid-v0", max_episode_steps=20), "avoid", 1), tmp_path / "film.html")
    page = visit({"width": 342, "height": 524}).page  # as it is in a report
    page.goto(path.as_uri())
    page.wait_for_function("film.drawn > 0")
    for view, pitch in (("Above", 1.55), ("Side", 0.05), ("Behind", 0.3)):
        page.get_by_role("button", name=view, exact=True).click()
        assert page.evaluate("film.pitch") == pitch
    boxes = [page.locator(f"#{name}").bounding_box() for name in ("facts", "legend", "controls")]
    assert boxes[0]["x"] + boxes[0]["width"] < boxes[1]["x"] and boxes[1]["x"] + boxes[1]["width"] <= 342
    assert max(box["y"] + box["height"] for box in boxes[:2]) < boxes[2]["y"]


@pytest.mark.parametrize("size", SIZES)
def test_nothing_is_behind_a_panel(size, visit):
    """Bodies, targets and labels are seen in every scene, also after a turn or a throw; what is compared has labels."""
    visitor = visit(SIZES[size])
    for name in SCENES:
        scene = visitor.open(name)
        for command in (None, "left_after_right", "throw"):
            if command and command not in {each.name for each in visitor.session.controls()}:
                continue
            if command:
                visitor.page.evaluate("set", command)
            visitor.watch(5 if "school" in name else 30, 0.06)
            hidden = visitor.page.evaluate(HIDDEN)
            assert hidden == [], (name, command)
        labels = visitor.page.locator("#labels span").all_inner_texts()
        assert labels == list(scene.labels) and len(labels) == (len(scene.looks) if len(scene.looks) > 1 else 0)


def test_zoom_of_the_user_stays(visit):
    """A fish that is looked at from near by is not moved away again."""
    visitor = visit()
    visitor.watch(10)
    visitor.page.keyboard.press("+")
    before = visitor.page.evaluate("lab.view.distance / fitted")
    visitor.watch(20)
    assert visitor.page.evaluate("lab.view.distance / fitted") == pytest.approx(before) and before < 0.95


@pytest.mark.parametrize("scene", SCENES)
def test_every_button_acts(scene, visit):
    """Every scene opens, every switch of it reaches the scene, and charts have numbers."""
    visitor = visit()
    visitor.open(scene)
    visitor.watch(10, 0.05)
    visitor.page.evaluate("for (const group of document.querySelectorAll('details')) group.open = true")
    for control in [each for each in visitor.session.controls() if each.kind == "switch"]:
        visitor.press(control.label)
        until(lambda name=control.name, before=control.value: next(
            each.value for each in visitor.session.controls() if each.name == name) != before)  # fmt: skip
        visitor.press(control.label)
    values = visitor.page.evaluate("lab.frame.values")
    assert values and all(isinstance(value, int | float) for row in values for value in row)
    assert visitor.page.locator("#plots figure").count() == len(values)


def test_a_drag_moves_the_node_and_what_is_shown_is_drawn(visit):
    """A node follows the mouse. Without skin, or with strains, the picture is another one; then it is as it was."""
    visitor = visit()
    scene, mouse = visitor.open("finite elements"), visitor.page.mouse
    visitor.watch(3, 0.0)
    at = visitor.page.evaluate("""() => {
      const { x } = lab.frame.bodies[0], box = canvas.getBoundingClientRect();
      for (let k = 0; k < x.length; k += 3) {
        const [a, b] = project(lab.camera, [x[k], x[k + 1], x[k + 2]]);
        const place = [box.width * (a + 1) / 2, box.height * (1 - b) / 2];
        if (document.elementFromPoint(...place)?.id === "view") return place;
      }
    }""")
    mouse.move(*at)
    mouse.down()
    _, node = until(lambda: scene.dragged)
    height = scene.objects[0].position[node, 2]
    mouse.move(at[0], at[1] - 120, steps=6)
    until(lambda: visitor.watch(1).size and scene.objects[0].position[node, 2] > height + 0.05 * scene.length)
    mouse.up()
    until(lambda: scene.dragged is None)
    visitor.session.paused = True
    pictures = []
    for name in ("skin", "skin", "strain", "strain"):
        visitor.watch(20, 0.0)  # the camera has come to rest
        pictures.append(visitor.page.evaluate("() => { ratio = 0.5; show(); return canvas.toDataURL(); }"))
        visitor.page.evaluate("(n) => set(`show ${n}`, !controls.find((c) => c.name === `show ${n}`).value)", name)
    assert pictures[0] != pictures[1] and pictures[2] != pictures[3] and len(set(pictures)) == 3


def test_time_keys_and_help(visit):
    """The slider shows an earlier moment and pauses; keys act, and F1 lists them."""
    visitor = visit()
    visitor.watch(40, 0.1)
    scrub = visitor.page.locator("#scrub")
    scrub.fill("500")
    until(lambda: visitor.session.paused)
    visitor.page.wait_for_function("lab.frame.time < lab.plots.at(-1).time - 0.5")
    scrub.fill("1000")
    visitor.page.wait_for_function("lab.frame.time === lab.plots.at(-1).time")
    scrub.blur()
    visitor.page.keyboard.press("ArrowLeft")
    until(lambda: visitor.session.scene.commanded[0] > 0.5)
    visitor.page.keyboard.press(" ")
    until(lambda: not visitor.session.paused)
    visitor.page.keyboard.press("F1")
    visitor.page.get_by_text("commands a right turn, and a left one before it is complete").wait_for()


def test_a_failure_is_shown_once(visit):
    """What fails is named once, with a way on."""
    visitor = visit()
    scene = visitor.open("what the method does")
    visitor.page.get_by_label("its method").first.select_option("explicit_euler")
    until(lambda: scene.objects[0].entry.integrator == "explicit_euler")
    scene.set("step", 50.0)
    scene.throw()
    while not scene.failure:
        visitor.watch(10, 0.1)
    visitor.page.get_by_text("explicit_euler failed on the ring").wait_for()
    visitor.page.locator("#rescue").get_by_role("button", name="Halve the step").click()
    until(lambda: not scene.failure)
    assert scene.settings["step"] == 25.0


def test_a_phone(visit):
    """At 390 pixels nothing hangs over, the controls unfold, and rings are between the charts and the panel."""
    visitor = visit(PHONE)
    assert np.abs(visitor.watch(20)).max() < 0.95
    assert visitor.page.evaluate("document.documentElement.scrollWidth") <= PHONE["width"]
    assert not visitor.page.get_by_role("button", name="Left after right", exact=True).is_visible()
    visitor.press("Controls")
    visitor.press("Left after right")
    until(lambda: visitor.session.scene.commanded[0] != 0.0)
    visitor.press("Controls")
    visitor.open("what the method does")
    rings = visitor.watch(20, 0.0)[-1]
    low, high = visitor.page.evaluate("[$('panel').getBoundingClientRect().top, $('plots').getBoundingClientRect()"
                                      ".bottom].map((y) => 1 - 2 * y / innerHeight)")  # fmt: skip
    assert np.abs(rings[:, 0]).max() < 0.95 and low < rings[:, 1].min() and rings[:, 1].max() < high
