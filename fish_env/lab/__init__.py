"""The laboratory in the browser, `fish_env lab`: look at soft bodies, pull and change them, compare methods.

- `bench`: objects side by side, the hand that drags, measurements, failures with their reason. It knows nothing of a
  browser, and validates all requests; `specimen`, `settings`, `hand`, `geometry` and `fields` are its parts;
- `school`: fish that are steered while they swim, many at once; it knows nothing of a browser either;
- `drawing`, `school_drawing`, `panel`, `controls`, `comparison`, `steering`, `session`, `server`: the page, by viser
  (the extra [lab]); each browser has a session of its own, and `door` decides who may open it.

viser is imported only in these, and they are loaded only by `serve`.
"""

import sys

__all__ = ["LOOPBACK", "serve"]

LOOPBACK = "127.0.0.1"


def serve(host: str = LOOPBACK, port: int = 8080) -> None:
    """Open the laboratory on this machine until it is interrupted.

    Args:
        host: address to listen at; the page is opened by it or as localhost. Any other than this machine's own is
            warned of: whoever reaches it can use the page. At 0.0.0.0 that is every machine that reaches this one.
        port: TCP port, 1024 to 65535; the next free one is taken if it is in use.

    Raises:
        ValueError: for a port out of range or an address that cannot be listened at.
        RuntimeError: without viser, or with one that the page cannot be guarded in.
    """
    if not (isinstance(port, int) and 1024 <= port <= 65535):
        raise ValueError(f"port is {port!r}; give a whole number from 1024 to 65535")
    try:
        import viser  # noqa: F401
    except ImportError as error:
        raise RuntimeError('the laboratory needs viser: pip install "fish_env[lab]"') from error
    from fish_env.lab.server import Laboratory

    if host not in (LOOPBACK, "localhost", "::1"):
        print(f"WARNING: the laboratory listens at {host}; every machine that reaches it can use it.", file=sys.stderr)
    laboratory = Laboratory(host, port)
    name = f"[{host}]" if ":" in host else host
    print(f"The laboratory is open: http://{name}:{laboratory.port}  (Ctrl+C ends it)", flush=True)
    laboratory.wait()
