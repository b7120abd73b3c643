"""The tab of the page from which fish are steered, and its keys."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from viser._messages import RunJavascriptMessage

from fish_env.lab.controls import Plot
from fish_env.lab.fields import BLUE, VERMILLION
from fish_env.lab.school import DRIVERS, MOST_FISH, TURN, School

if TYPE_CHECKING:
    from fish_env.lab.panel import Panel

NOBODY = "nobody: the objects above"

ARROWS = """
if (!window.fishEnvArrows) {
  window.fishEnvArrows = true;
  document.documentElement.addEventListener("keydown", event => {
    if (event.code.startsWith("Arrow")) event.stopPropagation();
  });
}
"""
"""Keeps the arrow keys, which steer, from turning the camera too: viser listens to hotkeys at the document's element,
and to keys of the camera at the document, which comes after it."""

UNFOCUS = "if (document.activeElement) document.activeElement.blur();"
"""Ends typing in the list that has just been used: keys that are typed somewhere do not steer."""


class Steering:
    """The tab of a school."""

    def __init__(self, panel: Panel, tab: Any):
        self.session, self.controls = panel.session, panel.controls
        add, self.gui = self.controls.add, self.controls.gui
        self.driver = add(
            "dropdown", "steered by", [NOBODY, *DRIVERS], initial_value=NOBODY,
            action=lambda value: self.choose(value, self.count.value),
        )  # fmt: skip
        self.count = add(
            "slider", "fish", 1, MOST_FISH, 1, 1, hint="all by one call of the policy", action=self.choose_count
        )
        for label, hotkey, name, action in (
            ("Left by 30 degrees (arrow key)", "arrowleft", "Turn left", lambda: self.school.turn(TURN)),
            ("Right by 30 degrees (arrow key)", "arrowright", "Turn right", lambda: self.school.turn(-TURN)),
            ("Left after right (L)", "L", "Left after right", lambda: self.school.left_after_right()),
        ):
            self.controls.add_button(label, action)
            self.controls.add_key(hotkey, name, action)
        self.controls.add_button("Take obstacles away", lambda: self.school.clear())
        self.gui.add_markdown(
            "A click on the water puts a target or an obstacle there, for a driver that sees them. Arrows: where each "
            "fish is to go. Each fish is alone in its own water."
        )
        lines = {"heading": BLUE, "command": VERMILLION}
        self.plot = Plot(self.gui, tab, "heading, blue, and command, red (degrees)", lines, 170)
        self._run(ARROWS)
        # viser takes coroutines too, and others would wait for a thread, as many as come
        register: Any = self.session.client.scene.on_click()
        register(self._take_click)

    @property
    def school(self) -> School:
        """The fish that are steered; ValueError if there are none."""
        if self.session.school is None:
            raise ValueError("nothing is steered; choose who steers, in the tab Steer")
        return self.session.school

    def choose(self, driver: str, count) -> None:
        """Put a school into the water, or the objects of the bench back."""
        if driver == NOBODY:
            self.session.show_bench()
            return
        self.session.wait("Compiling, or reading compiled code ...")
        self.session.show_school(School(driver, int(count)))
        self._run(UNFOCUS)

    def choose_count(self, count) -> None:
        """Have so many fish, now or as soon as somebody steers."""
        if self.session.school is not None:
            self.choose(self.session.school.driver, count)

    def _run(self, script: str) -> None:
        """Run one of the two scripts above in the browser."""
        self.gui._websock_interface.queue_message(RunJavascriptMessage(source=script))

    async def _take_click(self, event) -> None:
        """Have a click on the water put a target or an obstacle."""
        self.session.ask_at(self.put, origin=event.ray_origin, direction=event.ray_direction)

    def put(self, origin, direction) -> None:
        """Put a target or an obstacle where a ray of the scene, along which the mouse clicked, hits the water."""
        school, drawing = self.session.school, self.session.school_drawing
        if school is not None and drawing is not None and school.goal != "heading":
            school.put(drawing.place(origin, direction))

    def refresh(self) -> None:
        """Show who steers now."""
        school = self.session.school
        self.controls.show(self.driver, NOBODY if school is None else school.driver)
        if school is not None:
            self.controls.show(self.count, school.num_fish)

    def update(self) -> str:
        """Draw the plot; the text of the status."""
        school = self.school
        rows = np.array(school.history)
        if len(rows) > 1:
            self.plot.draw(rows[:, 0], np.degrees(rows[:, 1:].T))
        heading, aim = np.degrees(school.heading[0]), np.degrees(school.aim()[0])
        return f"**{school.num_fish} fish** by {school.driver}: heading {heading:.0f}, command {aim:.0f} degrees"
