"""The laboratory's door: who may open its page, what it lets in, and what it keeps of that, which is nothing."""

import contextlib
import gc
import os
import socket
import subprocess
import sys
from pathlib import Path

import msgspec.msgpack
import pytest

viser = pytest.importorskip("viser", reason='needs pip install -e ".[lab]"')

from viewer import CAMERA, PATIENCE, Viewer, until
from websockets.exceptions import ConnectionClosed, InvalidStatus
from websockets.frames import Frame, Opcode
from websockets.sync.client import connect

from fish_env.lab import door, server
from fish_env.lab.door import Door
from fish_env.lab.session import NOTES, WAITING

FOREIGN = ["evil.example:{port}", "evil.example", "127.0.0.1.evil.example:{port}", "127.0.0.1", "127.0.0.1:1",
           "192.0.2.1:{port}", "127.0.0.1:{port}:{port}", "x@127.0.0.1:{port}", "0.0.0.0:{port}", ":{port}",
           ""]  # fmt: skip
OTHERS = ["http://evil.example", "http://evil.example:{port}", "null", "", "http://127.0.0.1", "http://127.0.0.1:1",
          "http://localhost:{port}", "https://127.0.0.1:{port}", None]  # fmt: skip
UPGRADE = ["Upgrade: websocket", "Connection: Upgrade", "Sec-WebSocket-Version: 13",
           "Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ=="]  # fmt: skip
UPLOAD = {"source_component_uuid": "a", "transfer_uuid": "b"}
STRANGE = {
    "start of an upload": {"type": "FileTransferStartUpload", "filename": "c", "mime_type": "d", "part_count": 9,
                           "size_bytes": 10**9, **UPLOAD},
    "part of an upload": {"type": "FileTransferPart", "part_index": 0, "content": b"c", **UPLOAD},
    "form": {"type": "GuiFormDirtyMessage", "uuid": "a"},
    "public address": {"type": "ShareUrlRequest"},
    "unknown": {"type": "Nonsense"},
    "no kind": {"uuid": "a"},
    "kind of a kind": {"type": ["GuiUpdateMessage"]},
    "no message": [1, 2, 3],
    "not a value": {"type": "GuiUpdateMessage", "uuid": "a", "updates": {"update_cb": 1}},
    "two values": {"type": "GuiUpdateMessage", "uuid": "a", "updates": {"value": 1, "label": "b"}},
    "no values": {"type": "GuiUpdateMessage", "uuid": "a", "updates": {}},
    "a list": {"type": "GuiUpdateMessage", "uuid": "a", "updates": {"value": [1]}},
    "camera without a place": {"type": "ViewerCameraMessage", **CAMERA, "position": (0.0, 0.0)},
    "camera of words": {"type": "ViewerCameraMessage", **CAMERA, "fov": "wide"},
}  # fmt: skip
RAW = {"text": "{}", "nothing": b"", "cut short": b"\x81\xa4type", "nested": b"\x91" * 4000, "no UTF-8": b"\xa1\xff"}
RAW |= {name: msgspec.msgpack.encode(message) for name, message in STRANGE.items()}


@pytest.fixture(scope="module")
def laboratory():
    """A laboratory at a port of its own."""
    laboratory = server.Laboratory("127.0.0.1", 18500)
    yield laboratory
    laboratory.close()


@pytest.fixture
def page(laboratory):
    """A page that has just been opened."""
    with Viewer(laboratory).entered() as page:
        yield page


def socket_to(port, camera=True, origin="http://127.0.0.1:{port}"):
    """A websocket as a page opens it: one that gives an origin, and then says where its camera is."""
    protocols = [f"viser-v{viser.__version__}"]
    found = connect(
        f"ws://127.0.0.1:{port}", origin=origin and origin.format(port=port), subprotocols=protocols, max_size=None,
        close_timeout=1.0,
    )  # fmt: skip
    if camera:
        found.send(msgspec.msgpack.encode({"type": "ViewerCameraMessage", **CAMERA}))
    return found


def request_page(port, *headers):
    """Request the page; status, headers and body of the answer."""
    with socket.create_connection(("127.0.0.1", port), timeout=PATIENCE) as client:
        lines = ["GET / HTTP/1.1", *(header.format(port=port) for header in headers), "", ""]
        client.sendall("\r\n".join(lines).encode())
        head, body = b"".join(iter(lambda: client.recv(65536), b"")).split(b"\r\n\r\n", 1)
        return int(head.split()[1]), head.decode(), body


def close_code(client):
    """Code and reason with which the laboratory closed a websocket."""
    with pytest.raises(ConnectionClosed) as closed:
        while True:
            client.recv(timeout=PATIENCE)
    return closed.value.rcvd.code, closed.value.rcvd.reason


@pytest.mark.parametrize("host", ["127.0.0.1:{port}", "localhost:{port}", "LOCALHOST:{port}", "[::1]:{port}"])
def test_the_page_is_opened_by_the_addresses_of_this_machine(laboratory, host):
    """The page is opened by the addresses of this machine, and is not shown in a frame of another page."""
    status, head, body = request_page(laboratory.port, f"Host: {host}")
    assert status == 200 and b"<html" in body and "X-Frame-Options: DENY" in head
    assert request_page(laboratory.port, f"Host: {host}", f"Origin: http://{host}")[0] == 200


@pytest.mark.parametrize("host", FOREIGN)
def test_a_name_of_another_is_refused(laboratory, host):
    """A name that leads here but is another's is refused in one line: the page, and a websocket of its own origin."""
    status, _, body = request_page(laboratory.port, f"Host: {host}", f"Origin: http://{host}")
    assert status == 403 and body.count(b"\n") == 1 and b"no address of the laboratory" in body
    assert request_page(laboratory.port, f"Host: {host}", f"Origin: http://{host}", *UPGRADE)[0] == 403
    assert laboratory.sessions == {} and laboratory.server.get_clients() == {}


def test_a_request_of_no_name_or_of_two_is_refused(laboratory):
    """A request that names no host, or two of them, is refused; so is one with two origins."""
    own = "127.0.0.1:{port}"
    assert (
        request_page(laboratory.port)[0]
        == request_page(laboratory.port, f"Host: {own}", "Host: evil.example")[0]
        == 403
    )
    assert (
        request_page(laboratory.port, f"Host: {own}", f"Origin: http://{own}", "Origin: http://evil.example")[0] == 403
    )


@pytest.mark.parametrize("origin", OTHERS)
def test_a_page_of_another_origin_is_refused(laboratory, origin):
    """A websocket of another page is refused, and one of no page; no session is begun for them."""
    for _ in range(2 * server.MOST):
        with pytest.raises(InvalidStatus) as refused:
            socket_to(laboratory.port, origin=origin)
        answer = refused.value.response
        assert answer.status_code == 403 and b"own page" in (answer.body or b"")
    assert laboratory.sessions == {} and laboratory.server.get_clients() == {}


def test_everywhere_is_opened_by_numbers_and_the_name_of_the_machine():
    """At all addresses, numbers and this machine's name open the page, and no other name does; at one, only itself."""
    own = socket.gethostname().lower()
    for host in ("0.0.0.0", "::"):
        opened = Door(host)
        assert all(map(opened.knows, ("localhost", own, "192.0.2.1", "[2001:db8::1]", "0.0.0.0")))
        assert not any(map(opened.knows, ("evil.example", "192.0.2.1.evil.example", "", "[evil.example]", "1e3")))
    assert Door("192.0.2.1").knows("192.0.2.1") and Door("2001:db8::1").knows("[2001:db8::1]")
    assert Door("Fish.Example").knows("fish.example") and not Door("fish.example").knows("192.0.2.1")
    assert not Door("127.0.0.1").knows("192.0.2.1") and not Door("127.0.0.1").knows(f"{own}.example")


def test_the_door_is_there_or_the_laboratory_does_not_open(monkeypatch):
    """If viser opens its port in another way than the door knows, the laboratory says so and does not open."""
    monkeypatch.setattr(Door, "guarding", lambda self: contextlib.nullcontext())
    with pytest.raises(RuntimeError, match="cannot guard its page with viser"):
        server.PrivateServer("127.0.0.1", 18510)
    with pytest.raises(OSError):
        socket.create_connection(("127.0.0.1", 18510), timeout=PATIENCE).close()


def test_what_the_page_never_sends_ends_its_session_alone(laboratory, page):
    """A message that the page never sends ends its session, and nothing is kept of it; the other one goes on."""
    for name, message in RAW.items():
        with_session = name in ("text", "a list")
        client = socket_to(laboratory.port, camera=with_session)
        until(lambda with_session=with_session: len(laboratory.sessions) == 1 + with_session)
        client.send(message)
        code, reason = close_code(client)
        assert code == 1008 and ("no such message" in reason or "nothing but the values" in reason), name
        until(lambda: list(laboratory.sessions.values()) == [page.session])
    clock = page.session.bench.clock
    until(lambda: page.session.bench.clock > clock)


def test_a_value_that_viser_cannot_use_is_one_line_in_the_terminal(page, capsys):
    """A value that viser can do nothing with is one line in the terminal, and the session goes on."""
    lines = []
    page.choose("speed", "abc\ndef")

    def told():
        """Lines that have been written."""
        lines.extend(capsys.readouterr().err.splitlines())
        return lines

    until(told)
    page.choose("speed", 0.5)
    until(lambda: page.session.speed == 0.5)
    assert len(told()) == 1 and "could not convert string to float" in lines[0]


def test_a_long_message_ends_its_session(laboratory):
    """A message longer than any of the page's ends its session, before it has come in."""
    client = socket_to(laboratory.port, camera=False)
    client.send(b"\0" * (door.LARGEST + 1))
    assert close_code(client)[0] == 1009


def test_empty_pieces_of_a_message_are_not_kept(laboratory):
    """Of a message in pieces the empty ones are not kept, however many come."""
    client, kept = socket_to(laboratory.port, camera=False), []

    def pieces():
        """A piece, many that are empty, and the last."""
        yield b"a"
        yield from [b""] * 3000
        assert client.ping().wait(PATIENCE)  # all before it have come in
        gc.collect()  # what nobody keeps
        kept.append(sum(type(each) is Frame for each in gc.get_objects()))
        yield b"b"

    client.send(pieces())
    assert close_code(client)[0] == 1008 and kept[0] < 100


def test_who_asks_for_answers_and_does_not_read_them_is_sent_away(laboratory, monkeypatch):
    """A connection that asks for answers without end and reads none of them is closed."""
    monkeypatch.setattr(door, "UNREAD", 2**16)
    own = f"127.0.0.1:{laboratory.port}"
    head = [f"Host: {own}", f"Origin: http://{own}", f"Sec-WebSocket-Protocol: viser-v{viser.__version__}", *UPGRADE]
    with socket.create_connection(("127.0.0.1", laboratory.port), timeout=PATIENCE) as client:
        client.sendall("\r\n".join(["GET / HTTP/1.1", *head, "", ""]).encode())
        assert b" 101 " in client.recv(1000)
        ping = Frame(Opcode.PING, b"a" * 125).serialize(mask=True)
        with pytest.raises(ConnectionError):
            for _ in range(800):  # 100 MB
                client.sendall(ping * 1000)


def test_one_too_many_is_told_and_sent_away(laboratory, page, monkeypatch):
    """A page that is one too many is told so, and its connection is closed."""
    monkeypatch.setattr(server, "MOST", 1)
    monkeypatch.setattr(server, "READING", 0.3)
    late = Viewer(laboratory)
    until(lambda: any("full" in note for note in late.notes))
    until(lambda: not late._thread.is_alive())
    until(lambda: len(laboratory.server.get_clients()) == 1)
    assert list(laboratory.sessions.values()) == [page.session]


def test_a_page_that_says_nothing_is_sent_away(laboratory, monkeypatch):
    """A connection that never says where its camera is, is closed."""
    monkeypatch.setattr(door, "SILENT", 0.2)
    assert close_code(socket_to(laboratory.port, camera=False)) == (1008, "nothing was said")


def test_connections_are_few_and_end(monkeypatch):
    """Connections beyond a number are closed at once, and so is soon one whose request is never complete."""
    monkeypatch.setattr(door, "MOST_OPEN", 3)
    monkeypatch.setattr(door, "OPENING", 2.0)
    laboratory = server.Laboratory("127.0.0.1", 18520)
    clients = [socket.create_connection(("127.0.0.1", laboratory.port), timeout=PATIENCE) for _ in range(9)]
    for client in clients:
        with contextlib.suppress(OSError):  # of those that are closed already
            client.sendall(b"GET / HTTP/1.1\r\nHost: ")
    for client in clients:
        with contextlib.suppress(ConnectionResetError):
            assert client.recv(1) == b""
    assert request_page(laboratory.port, "Host: 127.0.0.1:{port}")[0] == 200
    laboratory.close()


def test_requests_and_messages_of_a_session_are_few(page):
    """Of a flood of requests a session keeps the last, and tells of the first that are not possible."""
    session, done = page.session, []
    session._answer = lambda: None  # as while kernels are compiled
    for k in range(3 * WAITING):
        session.ask(lambda k=k: done.append(k))
    del session._answer
    until(lambda: done and done[-1] == 3 * WAITING - 1)
    assert len(done) <= WAITING
    for k in range(3 * NOTES):
        session.tell(f"number {k}")
    page.press("One step (N)")
    until(lambda: session.paused and f"Not possible: number {NOTES - 1}" in page.notes)
    assert len(page.notes) == NOTES


HOST = """
import contextlib, gc, sys
from fish_env.lab.server import Laboratory
with contextlib.redirect_stdout(sys.stderr):
    laboratory = Laboratory("127.0.0.1", 18530)
print(laboratory.port, flush=True)
for line in sys.stdin:
    gc.collect()
    print(len(laboratory.sessions), flush=True)
"""
"""A laboratory in a process of its own that says how many sessions it has, each time it is asked."""


class Apart:
    """A laboratory in a process of its own, whose messages go to a file."""

    sessions = ()  # a page asks for those that were there before it

    def __init__(self, errors):
        self.process = subprocess.Popen([sys.executable, "-c", HOST], stdin=-1, stdout=-1, stderr=errors, text=True)
        self.port = int(self.process.stdout.readline())

    def memory(self):
        """Memory that it holds, MB, once nobody is there."""

        def count():
            self.process.stdin.write("\n")
            self.process.stdin.flush()
            return int(self.process.stdout.readline())

        until(lambda: count() == 0)
        status = Path(f"/proc/{self.process.pid}/status").read_text()
        return int(status.split("VmRSS:")[1].split()[0]) / 1024

    def send(self, messages, camera=False):
        """Send messages, over as many connections as it takes; bytes sent."""
        client, sent = socket_to(self.port, camera), 0
        for message in messages:
            try:
                client.send(message)
                sent += len(message)
            except ConnectionClosed:
                client = socket_to(self.port, camera)
        client.close()
        return sent

    def upload(self, size):
        """Open a page, and address a file of so many MB to a slider of it; bytes sent."""
        page, sent = Viewer(self), 0
        until(lambda: page.has("speed") and any("pictures a second" in str(each) for each in page.controls.values()))
        file = {"source_component_uuid": page._control("speed"), "transfer_uuid": "a"}
        with contextlib.suppress(ConnectionClosed):
            page.send("FileTransferStartUpload", **file, filename="a", mime_type="b", part_count=99, size_bytes=10**9)
            for k in range(size):
                page.send("FileTransferPart", **file, part_index=k, content=b"a" * 2**20)
                sent += 2**20
        page.leave()
        return sent


@pytest.mark.slow
@pytest.mark.skipif(not os.path.exists("/proc/self/status"), reason="reads the memory of a process where Linux says it")
def test_nothing_is_kept_of_300_mb_that_pages_send(tmp_path):
    """Uploads, forms, nonsense, large frames and floods of events, 300 MB of them, leave at most 20 MB behind."""
    click = {"type": "ScenePointerMessage", "event_type": "click", "ray_origin": (float("nan"),) * 3,
             "ray_direction": (0.0,) * 3, "screen_pos": ((0.5, 0.5),), "modifier": None}  # fmt: skip
    value = {"type": "GuiUpdateMessage", "uuid": "a", "updates": {"value": "b" * 3500}}
    floods = [[STRANGE["form"] | {"uuid": f"{k}" + "a" * 2**20} for k in range(100)],
              [{"type": "Nonsense", "a": "b" * 3000}] * 100]  # fmt: skip
    with open(tmp_path / "errors", "w") as errors:
        apart = Apart(errors)
    try:
        apart.upload(0)
        apart.upload(0)
        before = apart.memory()
        sent = apart.upload(90) + apart.send([b"\0" * 2**25] * 12) + apart.send([*RAW.values()] * 5)
        sent += sum(apart.send(map(msgspec.msgpack.encode, flood)) for flood in floods)
        for event in ([click] * 10000, [value] * 4000, [{"type": "ViewerCameraMessage", **CAMERA}] * 4000):
            sent += apart.send(map(msgspec.msgpack.encode, event), camera=True)
        while sent <= 300e6:  # a busy machine closes connections before all is sent
            sent += apart.send([b"\0" * 2**22] * 12)
        after = apart.memory()
        assert after < before + 20.0, (sent, before, after)
        assert "Traceback" not in (tmp_path / "errors").read_text()
    finally:
        apart.process.kill()
        apart.process.communicate()
