"""The page's server: one session for each browser, on this machine only unless another address is given."""

import socket
import threading

import viser

from fish_env.lab.bench import Bench
from fish_env.lab.session import Session

MOST = 8  # sessions at once: each takes a thread
SHADE, BRIGHTNESS = (110, 110, 120), 3.5  # of the light from below, and of that from above
UPRIGHT = (0.5**0.5, 0.5**0.5, 0.0, 0.0)  # turns the direction of y to that of z


class PrivateServer(viser.ViserServer):
    """viser's server without its public tunnel, which any page could otherwise ask for."""

    def request_share_url(self, verbose: bool = True) -> str | None:
        """Refuse."""
        return None


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

    Args:
        host: address to listen at.
        port: TCP port; the next free one is taken if it is in use.

    Raises:
        ValueError: if the address cannot be listened at.
    """

    def __init__(self, host: str, port: int):
        self.sessions: dict[int, Session] = {}
        Bench().warm()  # of the first page; compiled here if it has never been
        self._closed = threading.Event()
        check_address(host)
        self.server = PrivateServer(host=host, port=port, label="fish_env laboratory", verbose=False)
        self.server.gui.configure_theme(show_logo=False, show_share_button=False, control_width="medium")
        self._light()
        self.server.on_client_connect(self._enter)
        self.server.on_client_disconnect(self._leave)

    def _light(self) -> None:
        """Light from above and below, for what the lamps do not reach.

        The environment that the page is lit by otherwise is computed when the page opens, for seconds without a
        graphics card.
        """
        self.server.scene.configure_environment_map(hdri=None)
        # its sky is in the direction of y: turn that up
        self.server.scene.add_light_hemisphere("/light", ground_color=SHADE, intensity=BRIGHTNESS, wxyz=UPRIGHT)

    @property
    def port(self) -> int:
        """The port that it listens at."""
        return self.server.get_port()

    async def _enter(self, client: viser.ClientHandle) -> None:
        if len(self.sessions) >= MOST:
            client.add_notification("The laboratory is full", f"{MOST} pages are open already.", color="red")
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
