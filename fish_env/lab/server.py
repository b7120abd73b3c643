"""The laboratory's server: one page, and a websocket for each browser that opens it."""

import asyncio
import json
import logging
import threading
from collections.abc import Callable
from concurrent.futures import TimeoutError as FutureTimeout  # its own until Python 3.11
from contextlib import suppress
from http import HTTPStatus
from typing import Any

from websockets import Headers, Request, Response
from websockets.asyncio.server import Server, ServerConnection, serve
from websockets.exceptions import ConnectionClosed

from fish_env.kernels.data import data
from fish_env.kernels.progress import compiled
from fish_env.lab.access import Access, check_address
from fish_env.lab.own import Own
from fish_env.lab.session import Session, say

MOST = 8  # sessions at once
LARGEST = 4096  # bytes of a message of the page
OPENING = 10.0  # s that a request may take to come in
PAUSE = 0.3  # s, after which a page is told why it waits
TRIED = 20  # ports
LOGGER = logging.getLogger(__name__)
LOGGER.addFilter(lambda record: not record.getMessage().startswith("opening handshake failed"))
HEADERS = {
    "Content-Type": "text/html; charset=utf-8",
    "X-Frame-Options": "DENY",
    "Content-Security-Policy": "default-src 'none'; script-src 'unsafe-inline'; style-src 'unsafe-inline'; "
    "connect-src 'self'; img-src data: blob:; media-src blob:; base-uri 'none'; form-action 'none'",
}


def page() -> bytes:
    """The page with its scripts put in."""
    names = (("fish_env.scene", "renderer.js"), ("fish_env.lab", "page.js"))
    script = "".join(data(*name).read_text(encoding="utf-8") for name in names)
    return data("fish_env.lab", "page.html").read_text(encoding="utf-8").replace("/*SCRIPT*/", script).encode()


async def wait_for(connection: ServerConnection, work: Callable[..., Any], *given: Any) -> Any:
    """The result of what is done in a thread; a page that waits for long is told what is compiled."""
    doing = asyncio.create_task(asyncio.to_thread(work, *given))
    while not (await asyncio.wait({doing}, timeout=PAUSE))[0]:
        count = compiled()
        text = f"Compiling kernels, once per scene: {count}" if count else "Preparing ..."
        with suppress(ConnectionClosed, ConnectionError):  # the work is not left half done
            await connection.send(say("busy", {"text": text, "part": None}))
    return doing.result()


class Laboratory:
    """A server that gives every browser a session of its own, and ends it when the browser leaves.

    The next free port is taken if the one given is in use.

    Raises:
        ValueError: if the address cannot be listened at.
    """

    def __init__(self, host: str, port: int, own: Own | None = None):
        check_address(host)
        self.host, self.own, self.access = host, own, Access(host)
        self.sessions: dict[Any, Session] = {}
        self._pages: set[Any] = set()  # and those whose session is being made
        self._page, self._loop = page(), asyncio.new_event_loop()
        self._closed, self._closing = threading.Event(), threading.Lock()
        self._server = self._loop.run_until_complete(self._open(port))
        self.port: int = next(iter(self._server.sockets)).getsockname()[1]
        self._thread = threading.Thread(target=self._loop.run_forever, name="laboratory", daemon=True)
        self._thread.start()

    async def _open(self, port: int) -> Server:
        for number in range(port, min(port + TRIED, 65536)):
            try:
                return await serve(
                    self._enter, self.host, number, process_request=self._answer, max_size=LARGEST,
                    open_timeout=OPENING, compression=None, logger=LOGGER,
                )  # fmt: skip
            except OSError as error:
                failure = error
        raise ValueError(f"ports {port} to {number} are in use ({failure}); give another port")

    def _answer(self, connection: ServerConnection, request: Request) -> Response | None:
        """Refuse a request, hand out the page, or let a websocket open."""
        refusal = self.access.refusal(request.headers, self.port)
        if refusal:
            return connection.respond(HTTPStatus.FORBIDDEN, f"{refusal}\n")
        if request.path == "/socket":
            return None
        if request.path != "/":
            return connection.respond(HTTPStatus.NOT_FOUND, "There is nothing here; the laboratory is at /.\n")
        headers = Headers(HEADERS)
        headers["Content-Length"] = str(len(self._page))
        return Response(HTTPStatus.OK, "OK", headers, self._page)

    async def _enter(self, connection: ServerConnection) -> None:
        """Answer the messages of a page, one after another, until it leaves."""
        if len(self._pages) >= MOST:
            await connection.close(1013, f"{MOST} pages are open already; close one and load this page again.")
            return
        self._pages.add(connection)
        try:
            self.sessions[connection] = session = await wait_for(connection, Session, self.own)
            async for raw in connection:
                try:
                    message = json.loads(raw)
                except (ValueError, RecursionError):
                    await connection.close(1008, "the laboratory's page sends no such message")
                    return
                for reply in await wait_for(connection, session.answer, message):
                    await connection.send(reply)
        except (ConnectionClosed, ConnectionError):
            pass
        finally:
            self._pages.discard(connection)
            ended = self.sessions.pop(connection, None)
            if ended:
                ended.close()

    def wait(self) -> None:
        """Wait until it is interrupted; then close all sessions."""
        try:
            self._closed.wait()
        finally:
            self.close()

    def close(self) -> None:
        """End all sessions and the server."""
        with self._closing:
            if self._closed.is_set():
                return
            self._closed.set()

        async def end() -> None:
            self._server.close()
            await self._server.wait_closed()

        with suppress(TimeoutError, FutureTimeout):  # something takes long; it ends with the process
            asyncio.run_coroutine_threadsafe(end(), self._loop).result(10.0)
        self._loop.call_soon_threadsafe(self._loop.stop)
        self._thread.join(10.0)
