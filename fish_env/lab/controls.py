"""Controls and charts of the page, whose actions are done in the simulation's thread."""

from __future__ import annotations

from collections.abc import Callable
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

    def add_plot(self, title: str, lines: dict, height: int = 150) -> Any:
        """Add a chart of lines over time, `height` pixels high: their names and colours."""
        series: list[dict[str, Any]] = [{"label": "t (s)"}] + [
            {"label": label, "stroke": f"#{bytes(colour).hex()}", "width": 2, "points": {"show": False}}
            for label, colour in lines.items()
        ]
        return self.gui.add_uplot(
            tuple(np.zeros(1) for _ in series), tuple(viser.uplot.Series(**each) for each in series), title=title,
            scales={"x": viser.uplot.Scale(time=False)}, height=height, legend=viser.uplot.Legend(show=False),
        )  # fmt: skip

    def show(self, handle, value) -> None:
        """Show a value unless it is shown already: what the user has chosen since then, and asks for, is left alone."""
        if self._shown.get(id(handle), handle.value) != value:
            handle.value = value
        self._shown[id(handle)] = value

    def remove(self, handle) -> None:
        """Remove a control."""
        self._shown.pop(id(handle), None)
        handle.remove()


def pad_rows(times, rows, count: int) -> tuple[np.ndarray, ...]:
    """Times and `count` rows of the same length, NaN where there are fewer or a number is not finite."""
    rows = [np.where(np.isfinite(row), row, np.nan) for row in rows]
    return (times, *rows, *(np.full(len(times), np.nan) for _ in range(count - len(rows))))
