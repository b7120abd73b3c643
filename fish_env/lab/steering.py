"""The tab of the page from which fish are steered, and its keys."""

from typing import Any

import numpy as np
from viser._messages import RunJavascriptMessage

from fish_env.lab import colours
from fish_env.lab.plots import add_plot
from fish_env.lab.requests import PanelLike
from fish_env.lab.school import DRIVERS, MOST_FISH, TURN, School

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
    """The controls of a school.

    Args:
        panel: whose tab they fill.
    """

    def __init__(self, panel: PanelLike):
        self.panel, self.session, self.gui = panel, panel.session, panel.gui
        self.driver = panel.when(
            self.gui.add_dropdown("steered by", [NOBODY, *DRIVERS], initial_value=NOBODY),
            lambda value: self.choose(value, self.count.value),
        )
        self.count = panel.when(
            self.gui.add_slider("fish", 1, MOST_FISH, 1, 1, hint="all by one call of the policy"), self.choose_count
        )
        panel.button("Left by 30 degrees (arrow key)", lambda: self.school.turn(TURN))
        panel.button("Right by 30 degrees (arrow key)", lambda: self.school.turn(-TURN))
        panel.button("Left after right (L)", lambda: self.school.left_after_right())
        panel.button("Take obstacles away", lambda: self.school.clear())
        self.gui.add_markdown(
            "A click on the water puts a target or an obstacle there, for a driver that sees them. Arrows: where each "
            "fish is to go. Each fish is alone in its own water."
        )
        lines = {"heading": colours.BLUE, "command": colours.VERMILLION}
        self.plot = add_plot(self.gui, "heading, blue, and command, red (degrees)", lines, 170)
        panel.key("arrowleft", "Turn left", lambda: self.school.turn(TURN))
        panel.key("arrowright", "Turn right", lambda: self.school.turn(-TURN))
        panel.key("L", "Left after right", lambda: self.school.left_after_right())
        self._run(ARROWS)
        self._listen()

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

    def _listen(self) -> None:
        """Have clicks on the water put targets and obstacles."""

        async def clicked(event) -> None:
            self.session.ask_at(self.put, origin=event.ray_origin, direction=event.ray_direction)

        # viser takes coroutines too, and others would wait for a thread, as many as come
        register: Any = self.session.client.scene.on_click()
        register(clicked)

    def put(self, origin, direction) -> None:
        """The mouse clicked along a ray of the scene."""
        school, drawing = self.session.school, self.session.school_drawing
        if school is not None and drawing is not None and school.goal != "heading":
            school.put(drawing.place(origin, direction))

    def refresh(self) -> None:
        """Show who steers now."""
        school = self.session.school
        self.panel.show(self.driver, NOBODY if school is None else school.driver)
        if school is not None:
            self.panel.show(self.count, school.num_fish)

    def update(self) -> str:
        """Draw the plot; what the status is to say."""
        school = self.school
        rows = np.array(school.history)
        if len(rows) > 1:
            self.plot.data = (rows[:, 0], np.degrees(rows[:, 1]), np.degrees(rows[:, 2]))
        heading, aim = np.degrees(school.heading[0]), np.degrees(school.aim()[0])
        return f"**{school.num_fish} fish** by {school.driver}: heading {heading:.0f}, command {aim:.0f} degrees"
