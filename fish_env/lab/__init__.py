"""The laboratory in the browser, `fish_env lab`: steer trained fish, pull at soft bodies, compare methods.

- `scene`: the base of all scenes; `swimmers` are steered, `objects` are pulled, `session` lists them;
- `session`, `server`: answers to a page's messages, by websockets (the extra [lab]);
- `page.html`, `page.js`: the page, which draws with the film's renderer (`fish_env/scene/renderer.js`).
"""

import sys
from collections.abc import Callable
from typing import Any

__all__ = ["LOOPBACK", "serve"]

LOOPBACK = "127.0.0.1"


def serve(host: str = LOOPBACK, port: int = 8080, user: Callable[[], Any] | None = None) -> None:
    """Open the laboratory on this machine until it is interrupted.

    Args:
        host: address to listen at; the page is opened by it or as localhost. Any other than this machine's own is
            warned of: whoever reaches it can use the page. At 0.0.0.0 that is every machine that reaches this one.
        port: TCP port, 1024 to 65535; the next free one is taken if it is in use.
        user: makes a `scene.Scene` of the user, which comes first; None for no such scene.

    Raises:
        ValueError: for a port out of range or an address that cannot be listened at.
        RuntimeError: without websockets.
    """
    if not (isinstance(port, int) and 1024 <= port <= 65535):
        raise ValueError(f"port is {port!r}; give a whole number from 1024 to 65535")
    try:
        from fish_env.lab.server import Laboratory
    except ModuleNotFoundError as error:
        raise RuntimeError('the laboratory needs websockets: pip install "fish_env[lab]"') from error

    if host not in (LOOPBACK, "localhost", "::1"):
        print(f"WARNING: the laboratory listens at {host}; every machine that reaches it can use it.", file=sys.stderr)
    laboratory = Laboratory(host, port, user)
    name = f"[{host}]" if ":" in host else host
    print(f"The laboratory is open: http://{name}:{laboratory.port}  (Ctrl+C ends it)", flush=True)
    laboratory.wait()
