"""The page's server: one session for each browser, on this machine only unless another address is given."""

import asyncio
import socket
import sys
import threading
import warnings

import viser

from fish_env.lab.bench import Bench
from fish_env.lab.door import Door
from fish_env.lab.session import Session

MOST = 8  # sessions at once: each takes a thread
READING = 5.0  # s to read that there are too many
SHADE, BRIGHTNESS = (110, 110, 120), 3.5  # of the light from below, and of that from above
UPRIGHT = (0.5**0.5, 0.5**0.5, 0.0, 0.0)  # turns the direction of y to that of z

warnings.filterwarnings("ignore", "Queued a .* on a closed connection")  # of a session whose page has just been closed


class PrivateServer(viser.ViserServer):
    """viser's server behind a door, and without its public tunnel, which any page could otherwise ask for.

    Raises:
        RuntimeError: if viser opens its port in a way that the door does not know.
    """

    def __init__(self, host: str, port: int):
        door = Door(host)
        with door.guarding():
            super().__init__(host=host, port=port, label="fish_env laboratory", verbose=False)
        self.get_event_loop().set_exception_handler(report)
        if not door.guards:
            self.stop()
            raise RuntimeError(f"the laboratory cannot guard its page with viser {viser.__version__}; install 1.1.1")

    def request_share_url(self, verbose: bool = True) -> str | None:
        """Reject."""
        return None

    async def send_away(self, client: viser.ClientHandle, reason: str) -> None:
        """Close the connection of a page, which may already be closed."""
        connection = self._websock_server._live_connections.get(client.client_id)
        if connection is not None:
            await connection.close(1013, reason)


def report(loop: asyncio.AbstractEventLoop, context: dict) -> None:
    """Say in one line that viser could do nothing with what a page sent."""
    print(f"laboratory: {context['message']}: {context.get('exception')!r:.200}", file=sys.stderr)


def check_address(host: str) -> None:
    """Raise ValueError unless this machine can listen at an address: viser would try other ports, and wait for ever."""
    failure: Exception = OSError("no such address")
    try:
        for family, kind, protocol, _, address in socket.getaddrinfo(host, 0, type=socket.SOCK_STREAM):
            try:
                with socket.socket(family, kind, protocol) as tried:
                    tried.bind(address)
                    return
            except OSError as error:
                failure = error
    except (OSError, UnicodeError) as error:  # no such name
        failure = error
    raise ValueError(f"cannot listen at {host!r} ({failure}); give an address of this machine") from failure


class Laboratory:
    """A server that gives every browser a session of its own, and ends it when the browser leaves.

    The next free port is taken if the one given is in use.

    Raises:
        ValueError: if the address cannot be listened at.
    """

    def __init__(self, host: str, port: int):
        self.sessions: dict[int, Session] = {}
        Bench().warm()  # of the first page; compiled here if it has never been
        self._closed = threading.Event()
        check_address(host)
        self.server = PrivateServer(host, port)
        self.server.gui.configure_theme(show_logo=False, show_share_button=False, control_width="medium")
        self._light()
        self.server.on_client_connect(self._enter)
        self.server.on_client_disconnect(self._leave)

    def _light(self) -> None:
        """Light the scene from above and below; viser's environment takes seconds without a graphics card."""
        self.server.scene.configure_environment_map(hdri=None)
        # the sky of the light is in the direction of y: turn that up
        self.server.scene.add_light_hemisphere("/light", ground_color=SHADE, intensity=BRIGHTNESS, wxyz=UPRIGHT)

    @property
    def port(self) -> int:
        """The port that it listens at."""
        return self.server.get_port()

    async def _enter(self, client: viser.ClientHandle) -> None:
        if len(self.sessions) >= MOST:
            text = f"{MOST} pages are open already."
            client.add_notification("The laboratory is full", text, color="red", auto_close_seconds=READING)
            await asyncio.sleep(READING)
            await self.server.send_away(client, "the laboratory is full")
            return
        session = Session(client)
        self.sessions[client.client_id] = session
        session.start()

    async def _leave(self, client: viser.ClientHandle) -> None:
        session = self.sessions.pop(client.client_id, None)
        if session is not None:
            session.close()

    def wait(self) -> None:
        """Wait until it is interrupted; then close all sessions."""
        try:
            self._closed.wait()
        finally:
            self.close()

    def close(self) -> None:
        """End all sessions and the server."""
        self._closed.set()
        for session in self.sessions.values():
            session.close()
        self.server.stop()
