"""Stages: bodies that move, with their controls and plots. A stage knows nothing of a browser."""

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np

from fish_env.bodies import Fish
from fish_env.checks import real
from fish_env.scene.frame import Frame
from fish_env.scene.look import Look


@dataclass
class Control:
    """A control of the page.

    Args:
        kind: "button", "switch", "slider" or "choice".
        name: by which the page sets it.
        label: what stands on it.
        act: is called with the value that is chosen; a button's with None.
        group: under which it stands.
        value, default: now and at first; a button has none.
        low, high, step: of a slider.
        options: of a choice.
        help: a sentence that explains it.
        key: of the keyboard, as browsers name it.
    """

    kind: str
    name: str
    label: str
    act: Callable[[Any], Any]
    group: str = "Act"
    value: Any = None
    default: Any = None
    low: float = 0.0
    high: float = 1.0
    step: float = 0.01
    options: list[str] = field(default_factory=list)
    help: str = ""
    key: str = ""

    def set(self, value: Any) -> None:
        """Set a value that the page sends; ValueError, and nothing is set, for one that is not allowed."""
        if self.kind == "switch" and not isinstance(value, bool):
            raise ValueError(f"{self.label} is {value!r}; give true or false")
        if self.kind == "slider" and (isinstance(value, bool) or not self.low <= real(value) <= self.high):
            raise ValueError(f"{self.label} is {value!r}; give a number from {self.low:g} to {self.high:g}")
        if self.kind == "choice" and not (isinstance(value, str) and value in self.options):
            raise ValueError(f"unknown {self.label} {value!r}; choose from {', '.join(self.options)}")
        self.act(value)

    def shown(self) -> dict[str, Any]:
        """The control as JSON."""
        return {name: value for name, value in vars(self).items() if name != "act"}


class Plot(NamedTuple):
    """A chart over time."""

    title: str  # with its unit
    lines: list[str]


class Pointer(NamedTuple):
    """Action of a mouse or a finger: `phase` is "hover", "start", "move" or "end"."""

    phase: str
    point: np.ndarray  # (3,) m, on what was touched, or at the height of the bodies
    body: int  # that was touched, or -1


class Stage(ABC):
    """Bodies that move, and what the page may do with them."""

    title = hint = ""
    yaw, pitch, distance = -2.3, 0.5, 2.5  # of the camera at first: rad, rad, lengths
    looks: list[Look]
    plots: list[Plot]
    show: dict[str, bool]
    """Parts of a body that are drawn: see `Frame.show`."""
    films = False
    """Whether there may be a film."""
    version = 1
    """A number that changes with the looks, the plots or the camera."""
    follows = False
    """Whether a pointer that only hovers over the water leads what swims there."""
    upright = False
    """Whether the plane xy is shown standing, as for what falls within it."""
    note = ""
    """A remark on what has happened."""
    failure = ""
    """Why the simulation has stopped, in a sentence; "" while it runs."""
    failed = (-1, -1)
    """The body and the node at which it failed."""
    time = due = 0.0
    """Time since the start, of the last step and of the picture, s."""
    interval = 0.02
    """Time of a step, s."""

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
    def controls(self) -> list[Control]:
        """Those that apply now."""

    @abstractmethod
    def frame(self) -> Frame:
        """What is to be seen."""

    @abstractmethod
    def readings(self) -> list[list[float]]:
        """The latest value of every line of every plot."""

    def point(self, pointer: Pointer) -> None:
        """Answer a pointer; ValueError if that is not possible."""
        return

    def seen(self, away: float, focal: float) -> None:
        """Adapt to a camera that is so many lengths away, with a focal length in pixels."""
        return

    def film(self) -> dict[str, str]:
        """The last seconds as a film: name and text of a page; ValueError if there is none."""
        raise ValueError("a film shows one fish that is steered; choose such a scene")

    def close(self) -> None:
        """Free what it holds."""
        return

    def shown(self) -> tuple[str, ...]:
        """What is drawn of a body."""
        return tuple(name for name, on in self.show.items() if on)

    def view_controls(self) -> list[Control]:
        """Switches of what is drawn of a body."""
        return [
            Control("switch", f"show {name}", name.capitalize(), lambda on, name=name: self.show.__setitem__(name, on),
                    "View", on, name == "skin")
            for name, on in self.show.items()
        ]  # fmt: skip


def muscle_names(fish: Fish) -> list[str]:
    """A name for every muscle."""
    return [
        f"{'left' if side > 0 else 'right'}, segment {segment + 1}, {'upper' if height > 0 else 'lower'}"
        for side, segment, height in zip(fish.sides, fish.segments, fish.heights, strict=True)
    ]


def sliders(names: list[str], values: np.ndarray, low: float = 0.0) -> list[Control]:
    """A slider for each value of an array, which it sets."""
    return [
        Control("slider", f"muscle {m}", name, lambda value, m=m: values.__setitem__(m, value), "Muscles",
                float(values[m]), low, low)
        for m, name in enumerate(names)
    ]  # fmt: skip
