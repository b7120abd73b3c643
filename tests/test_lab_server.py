"""Who may open the laboratory, by real requests and websockets."""

import json
import socket
import threading
import time
from contextlib import suppress
from http.client import HTTPConnection
from types import SimpleNamespace

import pytest

pytest.importorskip("websockets", reason='needs pip install -e ".[lab]"')

from websockets.exceptions import ConnectionClosed, InvalidStatus
from websockets.sync.client import connect

from fish_env.lab import serve, server
from fish_env.lab.session import Session

PATIENCE = 180.0  # s; no time is asserted, but a test that waits in vain ends


def until(condition):
    """Wait until a condition holds, and return its value."""
    end = time.monotonic() + PATIENCE
    while time.monotonic() < end:
        found = condition()
        if found:
            return found
        time.sleep(0.01)
    raise AssertionError("waited in vain")


@pytest.fixture(scope="module")
def laboratory():
    """A laboratory at a port of its own."""
    laboratory = server.Laboratory("127.0.0.1", 18600)
    yield laboratory
    laboratory.close()


@pytest.fixture
def sessions(monkeypatch):
    """The sessions that are open, from now on."""
    opened, end = [], Session.close
    monkeypatch.setattr(server, "Session", lambda user: opened.append(Session(user)) or opened[-1])
    monkeypatch.setattr(Session, "close", lambda session: opened.remove(session) or end(session))
    yield opened
    until(lambda: not opened)


def enter(laboratory, origin=""):
    """A websocket of a page, with the headers that a browser sends."""
    origin = origin if origin != "" else f"http://127.0.0.1:{laboratory.port}"
    return connect(f"ws://127.0.0.1:{laboratory.port}/socket", max_size=None, origin=origin)


def ask(page, message) -> list:
    """Send a message, and read until its picture comes: the messages."""
    page.send(json.dumps(message))
    page.send(json.dumps({"do": "frame"}))
    found = [page.recv(PATIENCE)]
    while not isinstance(found[-1], bytes):
        found.append(page.recv(PATIENCE))
    return [one for one in found if isinstance(one, bytes) or "busy" not in json.loads(one)]


def get(laboratory, path="/", **headers):
    """Status, headers and text of a request."""
    connection = HTTPConnection("127.0.0.1", laboratory.port, timeout=PATIENCE)
    connection.request("GET", path, headers=headers)
    answer = connection.getresponse()
    return answer.status, dict(answer.getheaders()), answer.read().decode()


def test_the_page_stands_alone(laboratory):
    """The page loads nothing from anywhere, cannot be framed, and there is no other path."""
    status, headers, text = get(laboratory)
    assert status == 200 and headers["X-Frame-Options"] == "DENY" and "connect-src 'self'" in str(headers)
    assert text.count("href=") == text.count('href="data:,"') == 1
    for loaded in ("src=", "import(", "fetch(", "url(", "//cdn"):
        assert loaded not in text, loaded
    assert "/*SCRIPT*/" not in text and "makeRenderer" in text
    assert get(laboratory, "/etc/passwd")[0] == 404


def test_others_are_refused(laboratory):
    """A name that leads here but is not of this machine gets nothing; only its own page opens a websocket."""
    for host in ("evil.example", "127.0.0.2", "localhost.evil.example", ""):
        assert get(laboratory, Host=f"{host}:{laboratory.port}")[0] == 403
    assert get(laboratory, Host="127.0.0.1:1")[0] == 403
    assert get(laboratory, Host=f"LOCALHOST:{laboratory.port}")[0] == 200
    for origin in ("http://evil.example", "null", "http://127.0.0.1:1", None):
        with pytest.raises(InvalidStatus, match="403"):
            enter(laboratory, origin=origin)
    with enter(laboratory) as page:
        assert "scene" in json.loads(ask(page, {"do": "frame"})[0])


def test_everywhere_is_opened_by_numbers_and_the_name_of_the_machine():
    """At all addresses, numeric ones and the machine's name are known; other names are not."""
    here, one = server.hosts_of("0.0.0.0").fullmatch, server.hosts_of("192.168.0.5").fullmatch
    assert all(here(name) for name in ("10.0.0.7", "[fe80::1]", socket.gethostname().upper(), "localhost"))
    assert not any(here(name) for name in ("evil.example", "10.0.0.7.evil.example", ""))
    assert one("192.168.0.5") and one("[::1]") and not one("10.0.0.7") and not one("192x168.0.5")


def test_pages_are_independent_and_end(laboratory, sessions):
    """Two pages have sessions of their own; a page that vanishes takes its session along."""
    with enter(laboratory) as one, enter(laboratory) as two:
        ask(one, {"do": "scene", "name": "soft objects"})
        ask(two, {"do": "set", "name": "pause", "value": True})
        assert sorted(session.name for session in sessions) == ["follow me", "soft objects"]
        assert sorted(session.paused for session in sessions) == [False, True]
    until(lambda: not sessions)


@pytest.mark.parametrize("raw", ["{", b"\x00\xff", "[" * 3000, "x" * 5000])
def test_what_is_no_message_ends_its_session_alone(laboratory, raw):
    """A page that sends what is not JSON, or too much of it, is sent away; the other one goes on."""
    with enter(laboratory) as page, enter(laboratory) as other:
        ask(other, {"do": "frame"})
        with pytest.raises(ConnectionClosed):
            page.send(raw)
            for _ in range(10):
                page.recv(PATIENCE)
        assert ask(other, {"do": "frame"})


def test_a_page_that_reads_nothing_holds_up_nobody(laboratory, sessions):
    """Thousands of requests whose answers are not read wait for their reader; another page is answered meanwhile."""
    with enter(laboratory) as deaf, enter(laboratory) as other:

        def flood():
            with suppress(ConnectionClosed, OSError):
                while True:
                    deaf.send('{"do": "frame"}')

        threading.Thread(target=flood, daemon=True).start()
        for _ in range(20):
            assert ask(other, {"do": "frame"})
        deaf.socket.close()
    until(lambda: not sessions)


def test_it_waits_until_it_is_closed():
    """`wait` ends when the laboratory is closed; the next free port is taken, and after the last there is none."""
    first, second = server.Laboratory("127.0.0.1", 18650), server.Laboratory("127.0.0.1", 18650)
    assert second.port > first.port
    thread = threading.Thread(target=first.wait)
    thread.start()
    for closed in (first, second, second):
        closed.close()
    thread.join(PATIENCE)
    assert not thread.is_alive()
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 65535))
        taken.listen()
        with pytest.raises(ValueError, match="in use"):
            server.Laboratory("127.0.0.1", 65535)


@pytest.mark.parametrize("host", ["no.such.name.invalid", "8.8.8.8", "256.1.1.1", "a" * 70])
def test_an_address_that_cannot_be_listened_at_is_refused(host):
    """An address of another machine, or none, is refused at once."""
    with pytest.raises(ValueError, match="give an address of this machine"):
        server.Laboratory(host, 18690)


@pytest.mark.parametrize(("host", "warned"), [("127.0.0.1", False), ("localhost", False), ("0.0.0.0", True)])
def test_another_address_than_this_machine_is_warned_of(host, warned, monkeypatch, capsys):
    """Another address than this machine's own is warned of before the page opens there."""
    opened = SimpleNamespace(port=9000, wait=lambda: None)
    monkeypatch.setattr(server, "Laboratory", lambda *given: vars(opened).update(given=given) or opened)
    serve(host, 9000)
    assert opened.given == (host, 9000, None) and ("WARNING" in capsys.readouterr().err) == warned
    with pytest.raises(ValueError, match="1024 to 65535"):
        serve(port=80)
