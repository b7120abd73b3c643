"""Who may open the laboratory's page, and which messages of it come in.

A port of this machine is open to every web page in its browsers, and viser asks nobody who they are. websockets, by
which viser serves, can check requests and messages, but viser has no option for that: see `Door.guarding`.
"""

import asyncio
import ipaddress
import logging
import socket
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from http import HTTPStatus
from typing import Any

import msgspec
import websockets.asyncio.server
from viser import _messages
from websockets import Headers
from websockets.asyncio.server import ServerConnection
from websockets.frames import Frame, Opcode
from websockets.http11 import Request, Response
from websockets.protocol import Event

LARGEST = 4096  # bytes of a message: the page sends at most 256
MOST_OPEN = 32  # connections at once, whatever they are
OPENING = 10.0  # s that a request may take to come in
SILENT = 60.0  # s until a page that says nothing is sent away
UNREAD = 2**23  # bytes that may wait for a page which does not read them
KINDS = {
    kind.__name__: kind
    for kind in (
        _messages.ViewerCameraMessage, _messages.GuiUpdateMessage, _messages.CommandTriggerMessage,
        _messages.SceneNodeDragMessage, _messages.ScenePointerMessage,
    )
}  # fmt: skip
"""The messages that the page sends; viser knows more, among them uploads and forms, which it would keep."""

LOGGER = logging.getLogger(__name__)


def shorten_report(record: logging.LogRecord) -> bool:
    """Shorten a report of a connection that failed to one line, and leave out those that never became one."""
    if record.exc_info:
        record.msg, record.args = f"{record.getMessage()}: {record.exc_info[1]!r:.200}", ()
        record.exc_info = None
    return not record.msg.startswith("opening handshake failed")


LOGGER.addFilter(shorten_report)


def check_message(raw: str | bytes) -> None:
    """Raise ValueError unless a message is one of KINDS, with the fields of its kind."""
    try:
        message = msgspec.msgpack.decode(raw) if isinstance(raw, bytes) else {}
        fields = msgspec.convert(message, KINDS[message.pop("type")])
    except (msgspec.MsgspecError, ValueError, TypeError, AttributeError, LookupError, RecursionError) as error:
        raise ValueError("the laboratory's page sends no such message") from error
    if isinstance(fields, _messages.GuiUpdateMessage):
        value = fields.updates.get("value")
        if len(fields.updates) != 1 or not isinstance(value, bool | int | float | str):
            raise ValueError("the page changes nothing but the values of its controls")


class Connection(ServerConnection):
    """A connection that hands on what the laboratory's page sends, and is closed by anything else."""

    _said = False

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """Begin, unless too many are open."""
        super().connection_made(transport)
        if len(self.server.handlers) > MOST_OPEN:
            self.transport.abort()

    def data_received(self, data: bytes) -> None:
        """Take what comes in; end a connection that asks for answers and does not read them."""
        super().data_received(data)
        if self.transport.get_write_buffer_size() > UNREAD:
            self.transport.abort()

    def process_event(self, event: Event) -> None:
        """Take a request or a frame; pieces of messages that are empty are left out, or they would pile up for ever."""
        if isinstance(event, Frame) and event.opcode is Opcode.CONT and not (event.data or event.fin):
            return
        super().process_event(event)

    async def recv(self, decode: bool | None = None) -> Any:
        """The next message; ConnectionClosed if there is none, or one that the page never sends."""
        try:
            raw = await asyncio.wait_for(super().recv(decode), None if self._said else SILENT)
            check_message(raw)
        except (asyncio.TimeoutError, ValueError) as error:
            await self.close(1008, str(error) or "nothing was said")
            raise self.protocol.close_exc from error
        self._said = True
        return raw


class Door:
    """Access control of the page at an address."""

    def __init__(self, host: str):
        self.names = {"localhost", "127.0.0.1", "[::1]", f"[{host}]" if ":" in host else host.lower()}
        self.everywhere = host in ("0.0.0.0", "::")
        if self.everywhere:
            self.names.add(socket.gethostname().lower())
        self.guards = False

    def knows(self, name: str) -> bool:
        """Return True for a name of this machine; if it listens at all addresses, also for every numeric address."""
        if name in self.names or not self.everywhere:
            return name in self.names
        try:
            return bool(ipaddress.ip_address(name.strip("[]")))
        except ValueError:
            return False

    def refusal(self, headers: Headers, port: int) -> str:
        """Reason to reject a request; "" to accept it.

        Another page stands in `Origin`, and a foreign name that resolves to this machine in `Host`. A websocket without
        `Origin` does not come from a page.
        """
        hosts, origins = headers.get_all("Host"), headers.get_all("Origin")
        name, _, number = "".join(hosts).rpartition(":")
        if len(hosts) != 1 or number != str(port) or not self.knows(name.lower()):
            return "This is no address of the laboratory; open the one that its terminal names."
        if origins != [f"http://{hosts[0]}"] and (origins or "Upgrade" in headers):
            return "Only the laboratory's own page may do this."
        return ""

    def _answer(self, page: Callable, connection: ServerConnection, request: Request) -> Response | None:
        """Reject a request, or let viser answer; the page must not be framed in another one."""
        refusal = self.refusal(request.headers, connection.local_address[1])
        if refusal:
            return connection.respond(HTTPStatus.FORBIDDEN, f"{refusal}\n")
        response = page(connection, request)
        if response is not None:
            response.headers["X-Frame-Options"] = "DENY"
        return response

    @contextmanager
    def guarding(self) -> Iterator[None]:
        """Check requests to the port that viser opens in this context; `guards` then says whether it did."""
        serve = websockets.asyncio.server.serve

        def guarded(*args, process_request, **options):
            self.guards = True
            options |= {"process_request": partial(self._answer, process_request), "create_connection": Connection}
            return serve(*args, **options | {"max_size": LARGEST, "open_timeout": OPENING, "logger": LOGGER})

        websockets.asyncio.server.serve = guarded  # pyright: ignore
        try:
            yield
        finally:
            websockets.asyncio.server.serve = serve
