"""Controls and charts of the page, whose actions are done in the simulation's thread."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import TYPE_CHECKING, Any

import numpy as np
import viser.uplot

if TYPE_CHECKING:
    from fish_env.lab.session import Session


class Controls:
    """Adds controls to the page of one browser, whose session does what they ask for."""

    def __init__(self, session: Session):
        self.session, self.gui = session, session.client.gui
        self._shown: dict[int, Any] = {}  # what a control was last set to, by its id: viser's have no hash

    def add(self, kind: str, label: str, *args, action: Callable[[Any], None], **options) -> Any:
        """Add a "dropdown", "checkbox", "slider" or "number" that has `action(value)` done when the user changes it."""
        handle = getattr(self.gui, f"add_{kind}")(label, *args, **options)

        async def changed(event) -> None:
            if event.client_id is not None:  # else the program has set it
                value = event.target.value
                self.session.ask(lambda: take(value))

        def take(value) -> None:
            self._shown[id(handle)] = value
            action(value)

        handle.on_update(changed)
        return handle

    def add_button(self, label: str, action: Callable[[], None], hint: str | None = None) -> None:
        """Add a button that has `action()` done."""

        async def pressed(event) -> None:
            self.session.ask(action)

        self.gui.add_button(label, hint=hint).on_click(pressed)

    def add_key(self, hotkey: Any, label: str, action: Callable[[], None]) -> None:
        """Add a key that has `action()` done."""

        async def pressed(event) -> None:
            self.session.ask(action)

        command: Any = self.gui.add_command(label, hotkey=hotkey)
        command.on_trigger(pressed)

    def show(self, handle, value) -> None:
        """Show a value unless it is shown already: what the user has chosen since then, and asks for, is left alone."""
        if self._shown.get(id(handle), handle.value) != value:
            handle.value = value
        self._shown[id(handle)] = value

    def remove(self, handle) -> None:
        """Remove a control."""
        self._shown.pop(id(handle), None)
        handle.remove()


class Plot:
    """A chart of lines over time.

    The page cannot scale a chart with a line of NaN: one whose numbers are not finite is left out, until they are.

    Args:
        gui: of the page.
        container: tab or folder that it stands in, open now.
        title: of the chart.
        lines: names and colours.
        height: in pixels.
    """

    def __init__(self, gui: Any, container: Any, title: str, lines: dict[str, tuple], height: int = 150):
        self.gui, self.container, self.lines = gui, container, lines
        self.options = {
            "title": title, "height": height, "scales": {"x": viser.uplot.Scale(time=False)},
            "legend": viser.uplot.Legend(show=False),
        }  # fmt: skip
        self._names, self._handle = list(lines)[:1], None
        self._add()

    def _add(self) -> None:
        """Add the chart, in place of the one there is, with the lines that can be drawn."""
        order = None
        if self._handle is not None:
            order = self._handle.order
            self._handle.remove()
        series: list[dict[str, Any]] = [{"label": "t (s)"}] + [
            {"label": name, "stroke": f"#{bytes(self.lines[name]).hex()}", "width": 2, "points": {"show": False}}
            for name in self._names
        ]
        points = tuple(np.zeros(1) for _ in series)
        self._handle: Any = self.gui.add_uplot(
            points, tuple(viser.uplot.Series(**each) for each in series), order=order, **self.options
        )

    def draw(self, times: np.ndarray, rows: Iterable[np.ndarray]) -> None:
        """Draw rows over times; there may be fewer than lines."""
        finite = {name: row for name, row in zip(self.lines, rows, strict=False) if np.isfinite(row).all()}
        if finite and list(finite) != self._names:
            self._names = list(finite)
            with self.container:
                self._add()
        if finite:
            self._handle.data = (times, *finite.values())
