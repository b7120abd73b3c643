"""Scenes: bodies that move, with their controls and charts. A scene knows nothing of a browser."""

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from fish_env.checks import check_names, real
from fish_env.scene.frame import Frame
from fish_env.scene.look import Look


@dataclass
class Control:
    """A control of the page."""

    kind: str  # "button", "switch", "slider" or "choice"
    name: str  # by which the page sets it
    label: str
    act: Callable[[Any], Any]  # is called with the value that is chosen; a button's with None
    group: str = "Act"
    value: Any = None
    default: Any = None  # a button has none
    low: float = 0.0
    high: float = 1.0
    step: float = 0.01
    options: list[str] = field(default_factory=list)
    help: str = ""
    key: str = ""  # of the keyboard, as browsers name it

    def set(self, value: Any) -> None:
        """Set a value that the page sends; ValueError, and nothing is set, for one that is not allowed."""
        if self.kind == "switch" and not isinstance(value, bool):
            raise ValueError(f"{self.label} is {value!r}; give true or false")
        if self.kind == "slider" and (isinstance(value, bool) or not self.low <= real(value) <= self.high):
            raise ValueError(f"{self.label} is {value!r}; give a number from {self.low:g} to {self.high:g}")
        if self.kind == "choice":
            check_names(f"unknown {self.label}", self.options, value)
        self.act(value)


class Scene(ABC):
    """Bodies that move, and what the page may do with them."""

    title = hint = ""
    yaw, pitch = -2.3, 0.5  # rad, of the camera at first
    labels: Sequence[str] = ()  # of bodies that are compared
    looks: list[Look]  # of the bodies: another list whenever looks or plots change
    plots: dict[str, list[str]]  # names of the lines by the title of their chart
    show: dict[str, bool]  # the parts of a body that are drawn: see `Frame.show`
    films = False  # whether there may be a film
    follows = False  # whether a pointer over the water leads what swims there
    upright = False  # whether the plane xy is shown standing, as for what falls within it
    note = ""  # a remark on what has happened
    failure = ""  # why the simulation has stopped, in a sentence; "" while it runs
    failed = (-1, -1)  # the body and the node at which it failed
    time = due = 0.0  # since the start, of the last step and of the picture, s
    interval = 0.02  # of a step, s

    @property
    def length(self) -> float:
        """Length of the first body, m."""
        return self.looks[0].length

    def advance(self, seconds: float) -> None:
        """Move on by a part of a second, by whole steps."""
        self.due += seconds
        while self.time + self.interval <= self.due + 1e-9 and not self.failure:
            self.step()

    @abstractmethod
    def step(self) -> None:
        """Move on by one step."""

    @abstractmethod
    def reset(self) -> None:
        """Start again."""

    @abstractmethod
    def frame(self) -> Frame:
        """The present picture."""

    @abstractmethod
    def readings(self) -> list[list[float]]:
        """The latest value of every line of every plot."""

    def point(self, phase: str, point: np.ndarray, body: int) -> None:
        """Answer a pointer at a point (3,) m on a body, or -1; `phase` is "hover", "start", "move" or "end"."""
        return

    def film(self) -> dict[str, str]:
        """The last seconds as a film: name and text of a page; ValueError if there is none."""
        raise ValueError("a film shows one fish that is steered; choose such a scene")

    def close(self) -> None:
        """End its threads."""
        return

    def controls(self) -> list[Control]:
        """Those that apply now: of every scene, switches of what is drawn of a body."""
        return [
            Control("switch", f"show {name}", name.capitalize(), lambda on, name=name: self.show.__setitem__(name, on),
                    "View", on, name == "skin")
            for name, on in self.show.items()
        ]  # fmt: skip
