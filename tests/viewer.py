"""A browser that is none: it speaks to the laboratory's server by viser's protocol, and keeps what it is told.

The server cannot tell it from a page: the events of the mouse and of controls are the same messages. Nothing is drawn.
"""

import threading
import time

import msgspec.msgpack
import numpy as np
import viser
import zstandard
from websockets.exceptions import ConnectionClosed
from websockets.sync.client import connect
from websockets.typing import Origin

PATIENCE = 180.0  # s; no time is asserted, but a test that waits in vain ends
CAMERA = {
    "wxyz": (1.0, 0.0, 0.0, 0.0), "position": (0.0, -3.0, 1.0), "fov": 0.8, "near": 0.01, "far": 100.0,
    "image_height": 600, "image_width": 900, "look_at": (0.0, 0.0, 0.0), "up_direction": (0.0, 0.0, 1.0),
}  # fmt: skip


def until(condition):
    """Wait until a condition holds, and return its value."""
    end = time.monotonic() + PATIENCE
    while time.monotonic() < end:
        found = condition()
        if found:
            return found
        time.sleep(0.01)
    raise AssertionError("waited in vain")


def with_arrays(value, arrays):
    """A message whose places of arrays hold the arrays, flat."""
    if isinstance(value, dict) and "__binary_index" in value:
        return np.frombuffer(arrays[value["__binary_index"]], value["dtype"])
    if isinstance(value, dict):
        return {key: with_arrays(each, arrays) for key, each in value.items()}
    if isinstance(value, list):
        return [with_arrays(each, arrays) for each in value]
    return value


def plain(point):
    """A point as a message has it; what is not one, as it is."""
    return tuple(map(float, point)) if isinstance(point, np.ndarray) else point


class Viewer:
    """A page that is connected to a laboratory.

    Args:
        laboratory: fish_env.lab.server.Laboratory.
    """

    def __init__(self, laboratory):
        self.controls, self.commands, self.nodes = {}, {}, {}
        self.notes, self.session = [], None
        protocol = f"viser-v{viser.__version__}"
        address = f"127.0.0.1:{laboratory.port}"
        self._socket = connect(
            f"ws://{address}", origin=Origin(f"http://{address}"), subprotocols=[protocol], max_size=None
        )
        self._thread = threading.Thread(target=self._listen, daemon=True)
        self._thread.start()
        before = set(laboratory.sessions)
        self.send("ViewerCameraMessage", **CAMERA)
        self._laboratory, self._before = laboratory, before

    def entered(self):
        """This page, once it is built and its session known."""
        laboratory = self._laboratory
        (key,) = until(lambda: set(laboratory.sessions) - self._before)
        self.session = laboratory.sessions[key]
        until(lambda: any("pictures a second" in str(each) for each in self.controls.values()))
        return self

    def leave(self):
        """Close the page, and wait until its session has ended."""
        self._socket.close()
        self._thread.join(PATIENCE)
        until(lambda: self.session is None or not self.session.alive)

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.leave()

    def send(self, kind, **fields):
        """Send a message of viser's."""
        self._socket.send(msgspec.msgpack.encode({"type": kind, **fields}))

    def _listen(self):
        unpack = zstandard.ZstdDecompressor()
        try:
            for raw in self._socket:
                size = int.from_bytes(raw[8:16], "little")
                window = msgspec.msgpack.decode(unpack.decompress(raw[16 : 16 + size]))
                arrays, place = [], 16 + size
                for length in window["binaryBufferLengths"]:
                    place = -(-place // 8) * 8
                    arrays.append(raw[place : place + length])
                    place += length
                for message in window["messages"]:
                    self._take(with_arrays(message, arrays))
        except ConnectionClosed:
            pass

    def _take(self, message):
        """Keep what a page would show of a message."""
        kind, props = message["type"], message.get("props", {})
        if kind == "NotificationShowMessage":
            self.notes.append(f"{props['title']}: {props['body']}")
        elif kind == "RegisterCommandMessage":
            self.commands[props["label"]] = message["uuid"]
        elif kind == "GuiUpdateMessage":
            self.controls.setdefault(message["uuid"], {}).update(message["updates"])
        elif kind == "GuiRemoveMessage":
            self.controls.pop(message["uuid"], None)
        elif kind.startswith("Gui") and "uuid" in message:
            self.controls[message["uuid"]] = {**props, "value": message.get("value")}
        elif kind == "RemoveSceneNodeMessage":
            self.nodes.pop(message["name"], None)
        elif kind == "SetSceneNodeVisibilityMessage" and message["name"] in self.nodes:
            self.nodes[message["name"]]["visible"] = message["visible"]
        elif kind == "SceneNodeUpdateMessage" and message["name"] in self.nodes:
            self.nodes[message["name"]].update(message["updates"])
        elif "name" in message and props:
            self.nodes[message["name"]] = {**props, "owner": message["owner"]}

    def _control(self, label):
        """The identifier of a control by its label."""
        (found,) = [uuid for uuid, each in list(self.controls.items()) if each.get("label") == label]
        return found

    def has(self, label):
        """Return True if there is a control with a label."""
        return any(each.get("label") == label for each in list(self.controls.values()))

    def shows(self, label):
        """The value that a control shows."""
        return self.controls[self._control(label)]["value"]

    def choose(self, label, value):
        """Set a control, or press a button with the value True, as a user does."""
        uuid = self._control(label)
        self.controls[uuid]["value"] = value
        self.send("GuiUpdateMessage", uuid=uuid, updates={"value": value})

    def press(self, label):
        """Press a button."""
        self.choose(label, True)

    def key(self, label):
        """Press the key of a command."""
        self.send("CommandTriggerMessage", uuid=self.commands[label])

    def drag(self, phase, name, start, end):
        """Drag a part of the scene from a point to a point, (3,) each: "start", "update" or "end"."""
        self.send(
            "SceneNodeDragMessage", phase=phase, name=name, instance_index=None, button="left", modifier=None,
            start_position=plain(start), end_position=plain(end), start_screen_pos=(0.5, 0.5),
            end_screen_pos=(0.5, 0.5), owner=self.nodes[name]["owner"],
        )  # fmt: skip

    def click(self, origin, direction):
        """Click on the scene along a ray."""
        self.send(
            "ScenePointerMessage", event_type="click", ray_origin=origin, ray_direction=direction,
            screen_pos=((0.5, 0.5),), modifier=None,
        )  # fmt: skip
