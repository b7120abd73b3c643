"""Charts of the page: lines over time."""

from typing import Any

import numpy as np
import viser
import viser.uplot

from fish_env.lab import colours

PLOTS = {"energy": "energy (J)", "volume": "volume over rest", "strain": "largest strain"}
EVERY = 0.2  # s between two drawings of the plots


def add_plot(gui: viser.GuiApi, title: str, lines: dict, height: int) -> Any:
    """A chart without points yet, `height` pixels high, of lines over time: their names and colours."""
    series: list[dict[str, Any]] = [{"label": "t (s)"}] + [
        {"label": label, "stroke": colours.hexadecimal(colour), "width": 2, "points": {"show": False}}
        for label, colour in lines.items()
    ]
    return gui.add_uplot(
        tuple(np.zeros(1) for _ in series), tuple(viser.uplot.Series(**each) for each in series), title=title,
        scales={"x": viser.uplot.Scale(time=False)}, height=height, legend=viser.uplot.Legend(show=False),
    )  # fmt: skip


def padded(times, rows, count) -> tuple[np.ndarray, ...]:
    """Times and `count` rows of the same length, NaN where there are fewer."""
    rows = [np.nan_to_num(row, nan=np.nan, posinf=np.nan, neginf=np.nan) for row in rows]
    return (times, *rows, *(np.full(len(times), np.nan) for _ in range(count - len(rows))))
