"""A session: the stage of one page, its clock, and the answers to the page's messages.

The page asks for every picture, so that a slow one gets fewer, and one that nobody sees costs nothing. A message is
answered before the next one is read: one thread at a time touches the stage.
"""

import json
import sys
import time
import traceback
from collections.abc import Mapping
from typing import Any

import numpy as np

from fish_env.checks import is_whole, real
from fish_env.lab.own import Own
from fish_env.lab.scenes import SCENES, make_scene
from fish_env.lab.stage import Control, Pointer, Stage
from fish_env.scene.frame import pack_frame
from fish_env.scene.look import PALETTE, pack_look

LATEST = 0.1  # s: what lies further behind real time is left out
FAR = 1e6  # lengths and pixels: a camera is not further away
REACH = 100.0  # lengths from the middle of the picture: a point of the page further away is not accepted
PHASES = ("hover", "start", "move", "end")
Message = str | bytes


class Session:
    """State of one page; `own` is what the command line gave."""

    def __init__(self, own: Own | None = None):
        self.own = own or Own()
        self.scene = next(iter(self.scenes()))
        self.stage: Stage = make_scene(self.scene, self.own)
        self.paused, self.speed = False, 1.0
        self._last, self._told = 0.0, ""
        self._known: tuple[Any, int] = (None, 0)  # the stage that the page knows, and its version

    def scenes(self) -> list[str]:
        """Names of the scenes, the first one first."""
        return [*(["your own"] if self.own.given else []), *SCENES]

    def answer(self, message: Any) -> list[Message]:
        """Replies to a message of the page; never raises for what a page may send."""
        try:
            replies: list[Message] = self._answer(message if isinstance(message, Mapping) else {})
        except ValueError as error:
            replies = [say("tell", str(error))]
            self._told = ""  # what was chosen in vain is shown again as it was
        except Exception:  # a mistake of the laboratory: for who runs it, in full
            print(traceback.format_exc(), file=sys.stderr)
            replies = [say("tell", "The laboratory made a mistake; its terminal says which.")]
        if self._known != (self.stage, self.stage.version):
            moved = self._known[0] is self.stage
            self._known = (self.stage, self.stage.version)
            replies.insert(0, say("stage", self._about() | {"again": moved}))
        shown = say("controls", [control.shown() for control in self.controls()])
        if shown != self._told:
            self._told = shown
            replies.append(shown)
        return replies

    def _answer(self, message: Mapping[str, Any]) -> list[Message]:
        match message.get("do"):
            case "frame":
                away, focal = real(message.get("away")), real(message.get("focal"))
                if away > 0.0 and focal > 0.0:
                    self.stage.seen(min(away, FAR), min(focal, FAR))
                passed = real(message.get("passed"))
                return [self.frame(passed if passed >= 0.0 else None)]
            case "scene":
                self.choose(message.get("name"))
            case "set":
                self.set(message.get("name"), message.get("value"))
            case "point":
                self.point(*(message.get(name) for name in ("phase", "point", "body")))
            case "save":
                return [say("download", self.stage.film())]
            case other:
                raise ValueError(f"the page cannot ask for {other!r}")
        return []

    def choose(self, name: Any) -> None:
        """Show another scene; ValueError, and the present one stays, for one that there is not."""
        if name not in self.scenes():
            raise ValueError(f"unknown scene {name!r}; choose from {', '.join(self.scenes())}")
        stage = make_scene(name, self.own)
        self.stage.close()
        self.scene, self.stage = name, stage
        self.paused, self.speed = False, 1.0

    def set(self, name: Any, value: Any) -> None:
        """Set a control, by its name."""
        control = next((each for each in self.controls() if each.name == name), None)
        if control is None:
            raise ValueError(f"there is no control {name!r} now")
        control.set(value)

    def point(self, phase: Any, point: Any, body: Any) -> None:
        """Hand a pointer at a point (3,), in lengths, to the stage."""
        frame = self.stage.frame()
        if phase not in PHASES or not is_whole(body) or not -1 <= body < len(frame.bodies):
            raise ValueError(f"phase is {phase!r}, body {body!r}; give one of {PHASES}, and the number of a body or -1")
        numbers = list(map(real, point)) if isinstance(point, list) and len(point) == 3 else [np.nan]
        place = self.stage.length * np.array(numbers)
        if not (np.abs(place - frame.middle) <= REACH * self.stage.length).all():
            raise ValueError(f"point is {point!r}; give three numbers, at most {REACH:g} lengths from the middle")
        self.stage.point(Pointer(phase, place, body))

    def controls(self) -> list[Control]:
        """All that apply now: those of time, then those of the stage."""
        stage = self.stage

        def begin(value=None) -> None:
            stage.reset()
            self.paused = False

        def one_step(value=None) -> None:
            self.paused = True
            stage.step()

        return [
            Control("switch", "pause", "Pause", lambda on: setattr(self, "paused", on), "Time", self.paused, False,
                    key=" ", help="the space bar too"),
            Control("button", "one_step", "One step", one_step, "Time", key="n"),
            Control("button", "reset", "Start again", begin, "Time", key="r"),
            Control("slider", "speed", "Speed", lambda value: setattr(self, "speed", float(value)), "Time",
                    self.speed, 1.0, 0.02, 2.0, 0.02, help="over real time: below 1 is slow motion"),
            *stage.controls(),
        ]  # fmt: skip

    def frame(self, passed: float | None = None) -> bytes:
        """Move on by so many seconds, at most LATEST, or the time since the last picture; describe the picture."""
        now, stage = time.monotonic(), self.stage
        elapsed, self._last = min(now - self._last if passed is None else passed, LATEST), now
        if elapsed > 0.0 and not self.paused and not stage.failure:
            stage.advance(self.speed * elapsed)
        header, numbers = pack_frame(stage.frame(), stage.looks)
        values = [[value if np.isfinite(value) else None for value in row] for row in stage.readings()]
        about = {"paused": self.paused, "failure": stage.failure, "failed": stage.failed, "note": stage.note}
        text = json.dumps(header | about | {"values": values}).encode()
        text += b" " * (-len(text) % 4)
        return len(text).to_bytes(4, "little") + text + numbers.tobytes()

    def _about(self) -> dict[str, Any]:
        stage = self.stage
        return {
            "scene": self.scene, "scenes": self.scenes(), "title": stage.title, "hint": stage.hint,
            "camera": {"yaw": stage.yaw, "pitch": stage.pitch, "distance": stage.distance},
            "looks": [pack_look(look) for look in stage.looks], "plots": [plot._asdict() for plot in stage.plots],
            "upright": stage.upright, "palette": PALETTE, "follows": stage.follows, "films": stage.films,
        }  # fmt: skip

    def close(self) -> None:
        """Free the stage."""
        self.stage.close()


def say(what: str, value: Any) -> str:
    """A message to the page."""
    return json.dumps({what: value})
