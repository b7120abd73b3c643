"""A session: the scene of one page, its clock, and the answers to the page's messages.

The page asks for every picture, so that a slow one gets fewer, and one that nobody sees costs nothing. A message is
answered before the next one is read: one thread at a time touches the scene.
"""

import json
import sys
import time
import traceback
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from fish_env.checks import check_names, is_whole, real
from fish_env.lab.objects import Entry, ObjectScene
from fish_env.lab.scene import Control, Scene
from fish_env.lab.swimmers import SwimmerScene
from fish_env.scene.frame import pack_frame
from fish_env.scene.look import PALETTE, pack_look

LATEST = 0.1  # s: what lies further behind real time is left out
PHASES = ("hover", "start", "move", "end")
REACH = 100.0  # lengths from the middle of the picture: a point of the page further away is not accepted
FOLLOW = "Move the pointer, or touch the water: the fish swims there. Drag turns the view, the wheel zooms."

SCENES: dict[str, Callable[[], Scene]] = {
    "follow me": lambda: SwimmerScene("A trained fish", FOLLOW),
    "left after right": lambda: SwimmerScene(
        "Left after right", "The button or key L: a left turn begins before the right one is over.",
        "policy for abrupt turns", follow=False,
    ),
    "fast start": lambda: SwimmerScene(
        "Fast start", "The button or key F: the fish is told to get away, from rest.", "policy for fast starts",
        follow=False,
    ),
    "school of 64": lambda: SwimmerScene("A school of 64", "One call of one policy moves all. " + FOLLOW, num_fish=64),
    "obstacles": lambda: SwimmerScene(
        "Obstacles", "Press on the water in front of the fish: a stone stands there.", "policy for obstacles"
    ),
    "targets": lambda: SwimmerScene("Targets", "Press on the water: the target moves there.", "policy for targets"),
    "what the method does": lambda: ObjectScene(
        [Entry("ring"), Entry("ring", "explicit_euler"), Entry("ring", "rk4")], "Three methods at one cost",
        "Pull at a ring: all are pulled alike, and the plot shows how far they are apart.", same_cost=True,
    ),
    "what the body does": lambda: ObjectScene(
        [Entry("mass_spring"), Entry("planar"), Entry("two_layer")], "Three bodies of one fish",
        "The same muscles contract in all; the plot shows how far they are apart.", motion="gait",
    ),
    "what the water does": lambda: ObjectScene(
        [Entry("mass_spring", water="reactive"), Entry("mass_spring", water="drag")], "Inertia of the water, and drag",
        "Two fish turn abruptly: the first in water with inertia, the second in drag alone.", motion="abrupt turns",
    ),
    "soft objects": lambda: ObjectScene(
        [Entry("uniform sphere")], "Soft objects", "Pull at the sphere. T throws it. Choose others under Objects.",
    ),
    "finite elements": lambda: ObjectScene(
        [Entry("beam")], "Finite elements", "Pull at the beam; Twist and Invert show what it comes back from.",
    ),
}  # fmt: skip
"""Scenes, one click each."""


class Session:
    """State of one page; `user` makes the scene of the user, if there is one."""

    def __init__(self, user: Callable[[], Scene] | None = None):
        self.scenes = {**({"your own": user} if user else {}), **SCENES}
        self._last, self._sent_controls, self._sent_looks = 0.0, "", []
        self.name, make = next(iter(self.scenes.items()))
        self.scene: Scene = make()
        self.paused, self.speed = False, 1.0
        self._prepare()

    def choose(self, name: Any) -> None:
        """Show a scene; ValueError, and the present one stays, for one that there is not."""
        check_names("unknown scene", self.scenes, name)
        scene = self.scenes[name]()
        self.scene.close()
        self.name, self.scene, self.paused, self.speed = name, scene, False, 1.0

    def answer(self, message: Any) -> list[str | bytes]:
        """Replies to a message of the page; never raises for what a page may send."""
        replies = list[str | bytes]()
        try:
            replies += self._answer(message if isinstance(message, Mapping) else {})
            if self._prepared is not self.scene.looks:
                self._prepare()
        except ValueError as error:
            replies.append(encode("error", str(error)))
            self._sent_controls = ""  # a choice that was refused is shown again as it was
        except Exception:  # a mistake of the laboratory: for who runs it, in full
            print(traceback.format_exc(), file=sys.stderr)
            replies.append(encode("error", "The laboratory made a mistake; its terminal says which."))
        if self._sent_looks is not self.scene.looks:
            replies.insert(0, encode("scene", self._describe()))
            self._sent_looks = self.scene.looks
        shown = encode("controls", [vars(control) | {"act": None} for control in self.controls()])
        if shown != self._sent_controls:
            self._sent_controls = shown
            replies.append(shown)
        return replies

    def _prepare(self) -> None:
        """Compile all that new bodies need before their first picture, free and dragged, so that a page waits once."""
        self.scene.advance(LATEST)
        self.scene.point("start", self.scene.frame().bodies[0].position[0], 0)
        self.scene.advance(LATEST)
        self.scene.readings()
        self.scene.reset()
        self._prepared = self.scene.looks

    def _answer(self, message: Mapping[str, Any]) -> list[str | bytes]:
        match message.get("do"):
            case "frame":
                passed = real(message.get("passed"))
                return [self.frame(passed if passed >= 0.0 else None)]
            case "scene":
                self.choose(message.get("name"))
            case "set":
                name = message.get("name")
                control = next((each for each in self.controls() if each.name == name), None)
                if control is None:
                    raise ValueError(f"there is no control {name!r} now")
                control.set(message.get("value"))
            case "point":
                self.point(*(message.get(name) for name in ("phase", "point", "body")))
            case "save":
                return [encode("download", self.scene.film())]
            case other:
                raise ValueError(f"the page cannot ask for {other!r}")
        return []

    def point(self, phase: Any, point: Any, body: Any) -> None:
        """Pass a pointer at a point (3,), in lengths, on to the scene."""
        frame, length = self.scene.frame(), self.scene.length
        place = length * np.array([real(each) for each in point] if isinstance(point, list) else np.nan)
        near = place.shape == (3,) and (np.abs(place - frame.middle) <= REACH * length).all()
        if not near or phase not in PHASES or not is_whole(body) or not -1 <= body < len(frame.bodies):
            allowed = f"three numbers at most {REACH:g} from the middle, one of {PHASES} and a body's number or -1"
            raise ValueError(f"the pointer is at {point!r}, {phase!r}, on body {body!r}; give {allowed}")
        self.scene.point(phase, place, body)

    def controls(self) -> list[Control]:
        """All that apply now: those of time, then those of the scene."""
        scene = self.scene

        def begin(value=None) -> None:
            scene.reset()
            self.paused = False

        def one_step(value=None) -> None:
            self.paused = True
            scene.step()

        return [
            Control("switch", "pause", "Pause", lambda on: setattr(self, "paused", on), "Time", self.paused, False,
                    key=" ", help="the space bar too"),
            Control("button", "one_step", "One step", one_step, "Time", key="n"),
            Control("button", "reset", "Start again", begin, "Time", key="r"),
            Control("slider", "speed", "Speed", lambda value: setattr(self, "speed", float(value)), "Time",
                    self.speed, 1.0, 0.02, 2.0, 0.02, help="over real time: below 1 is slow motion"),
            *scene.controls(),
        ]  # fmt: skip

    def frame(self, passed: float | None = None) -> bytes:
        """Move on by so many seconds, at most LATEST, or the time since the last picture; describe the picture."""
        now, scene = time.monotonic(), self.scene
        elapsed, self._last = min(now - self._last if passed is None else passed, LATEST), now
        if elapsed > 0.0 and not self.paused and not scene.failure:
            scene.advance(self.speed * elapsed)
        shown = scene.frame()._replace(time=scene.time, show=tuple(name for name, on in scene.show.items() if on))
        header, numbers = pack_frame(shown, scene.looks)
        values = [[value if np.isfinite(value) else None for value in row] for row in scene.readings()]
        about = {"paused": self.paused, "failure": scene.failure, "failed": scene.failed, "note": scene.note}
        text = json.dumps(header | about | {"values": values}).encode()
        text += b" " * (-len(text) % 4)
        return len(text).to_bytes(4, "little") + text + numbers.tobytes()

    def _describe(self) -> dict[str, Any]:
        scene = self.scene
        return {
            "name": self.name, "scenes": list(self.scenes), "title": scene.title, "hint": scene.hint,
            "camera": {"yaw": scene.yaw, "pitch": scene.pitch}, "labels": list(scene.labels),
            "looks": [pack_look(look) for look in scene.looks], "upright": scene.upright, "palette": PALETTE,
            "plots": [{"title": title, "lines": lines} for title, lines in scene.plots.items()],
            "follows": scene.follows, "films": scene.films,
        }  # fmt: skip

    def close(self) -> None:
        """End the threads of the scene."""
        self.scene.close()


def encode(name: str, value: Any) -> str:
    """A message to the page."""
    return json.dumps({name: value})
