"""The laboratory's server: one page, and a websocket for each browser that opens it.

A port of this machine is open to every web page in its browsers. Another page stands in `Origin`, and a foreign name
that leads to this machine in `Host`: both are refused.
"""

import asyncio
import errno
import json
import logging
import re
import socket
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from http import HTTPStatus
from typing import Any

from websockets import Headers, Request, Response
from websockets.asyncio.server import Server, ServerConnection, serve
from websockets.exceptions import ConnectionClosed

from fish_env.kernels.data import data
from fish_env.kernels.progress import compiled
from fish_env.lab.scene import Scene
from fish_env.lab.session import Session, encode

LARGEST = 4096  # bytes of a message of the page
PAUSE = 0.3  # s, after which a page is told why it waits
PORTS = 20  # that are tried
LOGGER = logging.getLogger(__name__)
LOGGER.addFilter(lambda record: not record.getMessage().startswith("opening handshake failed"))
HEADERS = {
    "Content-Type": "text/html; charset=utf-8",
    "X-Frame-Options": "DENY",
    "Content-Security-Policy": "default-src 'none'; script-src 'unsafe-inline'; style-src 'unsafe-inline'; "
    "connect-src 'self'; img-src data: blob:; media-src blob:; base-uri 'none'; form-action 'none'",
}


def hosts_of(host: str) -> re.Pattern[str]:
    """Pattern of the names of this machine by which browsers reach an address: at all addresses, numbers too."""
    names = ["localhost", r"127\.0\.0\.1", r"\[::1\]", re.escape(f"[{host}]" if ":" in host else host)]
    if host in ("0.0.0.0", "::"):
        names += [r"[\d.]+", r"\[[\da-f:.]+\]", re.escape(socket.gethostname())]
    return re.compile("|".join(names), re.IGNORECASE)


async def wait_for(connection: ServerConnection, work: Callable[..., Any], *given: Any) -> Any:
    """The result of what is done in a thread; a page that waits for long is told for how long."""
    begin, compiling, doing = time.monotonic(), False, asyncio.create_task(asyncio.to_thread(work, *given))
    while not (await asyncio.wait({doing}, timeout=PAUSE))[0]:
        compiling = compiling or compiled() > 0
        text = f"{'compiling, once per scene' if compiling else 'preparing'}, {time.monotonic() - begin:.0f} s"
        with suppress(ConnectionClosed, ConnectionError):  # the work is not left half done
            await connection.send(encode("busy", text))
    return doing.result()


class Laboratory:
    """A server that gives every browser a session of its own, and ends it when the browser leaves."""

    # The next free port is taken if the one given is in use; ValueError if none can be listened at.

    def __init__(self, host: str, port: int, user: Callable[[], Scene] | None = None):
        self.host, self.user, self._hosts = host, user, hosts_of(host)
        scripts = (data("fish_env.scene", "renderer.js"), data("fish_env.lab", "page.js"))
        text, *parts = (each.read_text(encoding="utf-8") for each in (data("fish_env.lab", "page.html"), *scripts))
        self._page, self._loop = text.replace("/*SCRIPT*/", "".join(parts)).encode(), asyncio.new_event_loop()
        self._server = self._loop.run_until_complete(self._open(port))
        self.port: int = next(iter(self._server.sockets)).getsockname()[1]
        self._thread = threading.Thread(target=self._loop.run_forever, name="laboratory", daemon=True)
        self._thread.start()

    async def _open(self, port: int) -> Server:
        for number in range(port, min(port + PORTS, 65536)):
            try:
                return await serve(
                    self._serve_page, self.host, number, process_request=self._answer, max_size=LARGEST,
                    compression=None, logger=LOGGER,
                )  # fmt: skip
            except (OSError, UnicodeError) as error:
                if getattr(error, "errno", None) != errno.EADDRINUSE:
                    message = f"cannot listen at {self.host!r} ({error}); give an address of this machine"
                    raise ValueError(message) from error
        raise ValueError(f"ports {port} to {number} are in use; give another port")

    def _answer(self, connection: ServerConnection, request: Request) -> Response | None:
        """Refuse a request, hand out the page, or let a websocket open, which without `Origin` is not from a page."""
        hosts, origins = request.headers.get_all("Host"), request.headers.get_all("Origin")
        name, _, number = "".join(hosts).rpartition(":")
        if len(hosts) != 1 or number != str(self.port) or not self._hosts.fullmatch(name):
            text = "This is no address of the laboratory; open the one that its terminal names.\n"
            return connection.respond(HTTPStatus.FORBIDDEN, text)
        if origins != [f"http://{hosts[0]}"] and (origins or "Upgrade" in request.headers):
            return connection.respond(HTTPStatus.FORBIDDEN, "Only the laboratory's own page may do this.\n")
        if request.path == "/socket":
            return None
        if request.path != "/":
            return connection.respond(HTTPStatus.NOT_FOUND, "There is nothing here; the laboratory is at /.\n")
        return Response(HTTPStatus.OK, "OK", Headers(HEADERS | {"Content-Length": str(len(self._page))}), self._page)

    async def _serve_page(self, connection: ServerConnection) -> None:
        """Answer the messages of a page, one after another, until it leaves."""
        session = None
        try:
            session = await wait_for(connection, Session, self.user)
            async for raw in connection:
                for reply in await wait_for(connection, session.answer, json.loads(raw)):
                    await connection.send(reply)
        except (ValueError, RecursionError):
            await connection.close(1008, "the laboratory's page sends no such message")
        except (ConnectionClosed, ConnectionError):
            pass
        finally:
            if session is not None:
                session.close()

    def wait(self) -> None:
        """Wait until it is closed or interrupted; then close all sessions."""
        try:
            self._thread.join()
        finally:
            self.close()

    def close(self) -> None:
        """End all sessions and the server; work that takes long ends with the process."""

        async def end() -> None:
            self._server.close()
            await self._server.wait_closed()
            self._loop.stop()

        if self._thread.is_alive():
            asyncio.run_coroutine_threadsafe(end(), self._loop)
            self._thread.join(10.0)
