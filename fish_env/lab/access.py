"""Who may open the laboratory's page: browsers that name it by an address of this machine, and only its own page.

A port of this machine is open to every web page in its browsers. Another page stands in `Origin`, and a foreign name
that leads to this machine in `Host`.
"""

import ipaddress
import socket
from typing import Any


def check_address(host: str) -> None:
    """Raise ValueError unless this machine can listen at an address."""
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


class Access:
    """Access control of the page at an address."""

    def __init__(self, host: str):
        self.names = {"localhost", "127.0.0.1", "[::1]", f"[{host}]" if ":" in host else host.lower()}
        self.everywhere = host in ("0.0.0.0", "::")
        if self.everywhere:
            self.names.add(socket.gethostname().lower())

    def knows(self, name: str) -> bool:
        """Return True for a name of this machine; if it listens at all addresses, also for every numeric address."""
        if name in self.names or not self.everywhere:
            return name in self.names
        try:
            return bool(ipaddress.ip_address(name.strip("[]")))
        except ValueError:
            return False

    def refusal(self, headers: Any, port: int) -> str:
        """Reason to reject a request; "" to accept it. A websocket without `Origin` does not come from a page."""
        hosts, origins = headers.get_all("Host"), headers.get_all("Origin")
        name, _, number = "".join(hosts).rpartition(":")
        if len(hosts) != 1 or number != str(port) or not self.knows(name.lower()):
            return "This is no address of the laboratory; open the one that its terminal names."
        if origins != [f"http://{hosts[0]}"] and (origins or "Upgrade" in headers):
            return "Only the laboratory's own page may do this."
        return ""
