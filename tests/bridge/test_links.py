"""Links over UDP and serial lines, and permitted hosts."""

import errno
import os
import random
import re
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import closing
from functools import partial
from types import SimpleNamespace
from typing import Any
from unittest.mock import Mock

import pytest
from serial import SerialException

from maglev_mj.bridge.links import (
    LONGEST,
    Deframer,
    Link,
    LinkError,
    PtyServer,
    SerialLink,
    Server,
    UdpLink,
    UdpServer,
    cobs_decode,
    cobs_encode,
    open_link,
    parse_url,
)
from maglev_mj.bridge.twin.simulated_links import TO_DEVICE, Line
from maglev_mj.errors import MissingPackageError, ParameterError
from maglev_mj.session.access import check_host, is_loopback

PATIENCE = 60.0
HOME = "127.0.0.1"
Pair = tuple[Link, Server]


def datagrams() -> Pair:
    server = UdpServer(HOME, 0)
    return UdpLink(*server.address), server


def serial_line() -> Pair:
    server = PtyServer()
    return SerialLink(server.path, 921600), server


class Port:
    """Serial port with what pyserial has on every system: no descriptor, which Windows' ports lack."""

    def __init__(self, port: Any) -> None:
        self._port, self.close = port, port.close

    @property
    def in_waiting(self) -> int:
        """Number of bytes that have come."""
        return int(self._port.in_waiting)

    def read(self, size: int) -> bytes:
        """Return up to `size` bytes."""
        return bytes(self._port.read(size))

    def write(self, data: bytes) -> int:
        """Send bytes."""
        return int(self._port.write(data))


def line_without_descriptor() -> Pair:
    server = PtyServer()
    link = SerialLink(server.path, 921600)
    link._port = Port(link._port)
    return link, server


PTY = pytest.mark.needs("pty")


ON_PTY = [pytest.param(one, marks=[PTY, pytest.mark.machine]) for one in (serial_line, line_without_descriptor)]


@pytest.fixture(params=[datagrams, *ON_PTY])
def pair(request: pytest.FixtureRequest) -> Iterator[Pair]:
    make: Callable[[], Pair] = request.param
    link, server = make()
    yield link, server
    link.close()
    server.close()
    link.close()
    server.close()


def frames(count: int, seed: int = 3) -> list[bytes]:
    """Return seeded frames of 1 to 300 bytes, many zero."""
    luck = random.Random(seed)
    return [
        bytes(luck.choice((0, 0, 255, luck.randrange(256))) for _ in range(luck.randint(1, 300))) for _ in range(count)
    ]


def test_frames_go_both_ways_in_their_order(pair: Pair) -> None:
    link, server = pair
    for frame in frames(100):
        link.send(frame)
        heard = server.receive(PATIENCE)
        assert heard is not None and heard[0] == frame
        for number in range(3):
            server.send(frame[::-1] + bytes([number]), heard[1])
        assert [link.receive(PATIENCE) for _ in range(3)] == [frame[::-1] + bytes([number]) for number in range(3)]
    before = link.now()
    assert link.receive(0.0) is None and server.receive(0.01) is None and link.now() - before >= 1e7


@pytest.mark.machine
def test_where_nobody_listens_there_is_silence_and_a_server_come_later_is_heard() -> None:
    server = UdpServer(HOME, 0)
    port = server.address[1]
    server.close()
    with closing(UdpLink(HOME, port)) as link:
        for _ in range(5):
            before = time.monotonic()
            link.send(b"anyone?")
            assert link.receive(0.02) is None
            assert time.monotonic() - before >= 0.02  # or who tries again would spin
        link.send(b"the command_fault of this one is still to come")
        with closing(UdpServer(HOME, port)) as late:
            link.send(b"there you are")
            heard = late.receive(PATIENCE)
            assert heard is not None and heard[0] == b"there you are"


class Down:
    """A socket of a host that is down."""

    def __init__(self, real: Any) -> None:
        self.fileno, self.close = real.fileno, real.close

    def send(self, *_: Any) -> Any:
        """Fail."""
        raise OSError(errno.EHOSTDOWN, "Host is down")

    sendto = recv = recvfrom = send


def test_every_error_of_a_socket_is_a_link_error() -> None:
    with closing(UdpServer(HOME, 0)) as server, closing(UdpLink(*server.address)) as link:
        link._socket = down = Down(link._socket)  # type: ignore[assignment]
        link._send, link._receive = down.send, down.recv
        server._socket = Down(server._socket)  # type: ignore[assignment]
        ways: list[Callable[[], object]] = [
            lambda: link.send(b"x"),
            lambda: link.receive(0.0),
            lambda: server.send(b"x", (HOME, 1)),
            lambda: server.receive(0.0),
        ]
        for way in ways:
            with pytest.raises(LinkError, match="Host is down") as caught:
                way()
            assert "\n" not in str(caught.value)


def test_a_closed_end_is_a_link_error_and_closes_again(pair: Pair) -> None:
    link, server = pair
    for end in (link, server):
        end.close()
        for timeout in (0.0, 0.01):
            with pytest.raises(LinkError):
                end.receive(timeout)
        end.close()
    with pytest.raises(LinkError):
        link.send(b"x")


@PTY
@pytest.mark.machine
def test_an_adapter_that_was_pulled_out_is_closed_without_a_word() -> None:
    with closing(PtyServer()) as server:
        link = SerialLink(server.path, 921600)
        close: Any = link._port.close
        descriptor, tried = link._port.fileno(), []

        def pulled() -> None:
            tried.append(descriptor)
            raise OSError(errno.EIO, "Input/output error")

        link._port.close = pulled
        link.close()
        assert tried == [descriptor]
        uses: list[Callable[[], object]] = [lambda: link.send(b"x"), lambda: link.receive(0.0)]
        for use in uses:  # not the number that may be another file's
            with pytest.raises(LinkError):
                use()
        assert server.receive(0.01) is None
        close()


def test_a_forged_sender_does_not_stop_a_server() -> None:
    with closing(UdpServer(HOME, 0)) as server, closing(UdpLink(*server.address)) as link:
        for address in ((HOME, 0), ("255.255.255.255", 9)):
            server.send(b"answer", address)
            link.send(b"question")
            heard = server.receive(PATIENCE)
            assert heard is not None and heard[0] == b"question"
            server.send(b"answer", heard[1])
            assert link.receive(PATIENCE) == b"answer" and link.receive(0.0) is None


def test_a_port_in_use_is_one_line_and_a_datagram_longer_than_any_frame_is_dropped() -> None:
    # Linux cuts it short, which no seal fits; on Windows it is an error of the socket.
    with closing(UdpServer(HOME, 0)) as server, closing(UdpLink(*server.address)) as link:
        with pytest.raises(LinkError, match=r"cannot listen at udp://127\.0\.0\.1:\d+: [^\n]+$"):
            UdpServer(HOME, server.address[1])
        link.send(bytes(3000))
        link.send(b"next")
        longer, after = server.receive(PATIENCE), server.receive(PATIENCE)
        assert longer is not None and len(longer[0]) < 3000 and after is not None and after[0] == b"next"
        refused = [OSError(errno.EMSGSIZE, "Message too long"), BlockingIOError(errno.EAGAIN, "none")]
        link._receive = Mock(side_effect=refused)
        assert link.receive(0.0) is None


def test_without_a_key_only_this_machine_is_spoken_to() -> None:
    assert is_loopback("127.8.9.10") and is_loopback("localhost") and not is_loopback("0")
    assert check_host(HOME, None) == HOME and check_host("192.0.2.1", b"0123456789abcdef") == "192.0.2.1"
    for host in ("0.0.0.0", "192.0.2.1", "", "a..b", "::1", "x" * 300, "a\0b"):
        with pytest.raises(ParameterError, match="host must be"):
            check_host(host, None)


def test_addresses() -> None:
    assert parse_url("udp://127.0.0.1:5678") == ("udp", HOME, 5678, False)
    assert parse_url("udp://localhost:0", server=True) == ("udp", "localhost", 0, False)
    assert parse_url("serial:///dev/ttyUSB0?baud=460800") == ("serial", "/dev/ttyUSB0", 460800, False)
    assert parse_url("serial:///dev/ttyUSB0") == ("serial", "/dev/ttyUSB0", 921600, False)
    assert parse_url("serial://COM3?baud=115200") == ("serial", "COM3", 115200, False)
    assert parse_url("serial:///dev/ttyACM0?baud=115200&dtr=1") == ("serial", "/dev/ttyACM0", 115200, True)


@pytest.mark.parametrize(
    "text",
    [
        "",
        "127.0.0.1:5678",
        "tcp://127.0.0.1:5678",
        "udp://127.0.0.1",
        "udp://127.0.0.1:0",
        "udp://127.0.0.1:65536",
        "udp://127.0.0.1:5678/",
        "udp://me@127.0.0.1:5678",
        "udp://[::1]:5678",
        "serial:///",
        "serial:///dev/ttyUSB0?baud=0",
        "serial:///dev/ttyUSB0?parity=even",
        "serial:///dev/ttyUSB0?baud=921600&dtr=0",
        "serial:///dev/ttyUSB0?dtr=1",
    ],
)
def test_what_is_no_address_is_named(text: str) -> None:
    with pytest.raises(ParameterError, match="must be udp://HOST:PORT with a port from 1 to 65535, or serial") as error:
        open_link(text)
    assert repr(text) in str(error.value) and "\n" not in str(error.value)
    with pytest.raises(ParameterError, match=r"port must be 1 to 65535 \(got -1"):
        UdpLink(HOME, -1)


COBS = {
    b"": b"\x01",
    b"\0": b"\x01\x01",
    b"\x11\x22\0\x33": b"\x03\x11\x22\x02\x33",
    bytes(range(1, 255)): b"\xff" + bytes(range(1, 255)),
    bytes(range(255)): b"\x01\xff" + bytes(range(1, 255)),
    bytes(range(1, 256)): b"\xff" + bytes(range(1, 255)) + b"\x02\xff",
    bytes(range(2, 256)) + b"\0": b"\xff" + bytes(range(2, 256)) + b"\x01\x01",
}
"""Data, and its published encoding."""


def test_cobs_is_the_published_one_without_a_zero_and_comes_back() -> None:
    luck = random.Random(1)
    for data in [*COBS, *(bytes(luck.choices((0, 1, 255), (1, 300, 300), k=length)) for length in range(600))]:
        encoded = cobs_encode(data)
        assert encoded == COBS.get(data, encoded) and b"\0" not in encoded
        assert len(encoded) <= len(data) + 1 + len(data) // 254 and cobs_decode(encoded) == data


def test_cobs_of_garbage_never_raises() -> None:
    luck = random.Random(2)
    assert cobs_decode(b"") is None and cobs_decode(b"\x03\x01") is None and cobs_decode(b"\x02\0") is None
    for _ in range(20_000):
        decoded = cobs_decode(luck.randbytes(luck.randrange(40)))
        assert decoded is None or len(decoded) < 40


def test_a_stream_is_cut_alike_however_it_arrives_and_what_is_too_long_is_dropped() -> None:
    sent, luck = frames(50), random.Random(4)
    stream = b"\x01" * (3 * LONGEST) + b"".join(b"\0" + cobs_encode(frame) + b"\0" for frame in sent)
    for most in (1, 7, 100, 5000):
        deframer, start = Deframer(), 0
        while start < len(stream):
            stop = start + luck.randint(1, most)
            deframer.feed(stream[start:stop])
            start = stop
        assert list(deframer.frames) == sent and deframer.dropped == 1


@PTY
@pytest.mark.machine
def test_a_serial_line_recovers_from_garbage_both_ways() -> None:
    server = PtyServer()
    link = SerialLink(server.path, 921600)
    other_end = os.open(server.path, os.O_WRONLY | os.O_NOCTTY)
    with closing(server), closing(link):
        for garbage in (b"\xff noise", b"\x05\x01\0\x09\x01\0\0\0", b"\x01" * 3000):
            os.write(other_end, garbage)
            link.send(b"to the device")
            server._write(b"\xee" * 300)
            os.write(server._descriptor, garbage)
            server.send(b"to the host", server.address)
            heard = server.receive(PATIENCE)
            while heard is not None and heard[0] != b"to the device":
                heard = server.receive(PATIENCE)
            answer = link.receive(PATIENCE)
            while answer is not None and answer != b"to the host":
                answer = link.receive(PATIENCE)
            assert heard and answer
        assert server._deframer.dropped > 0 and link._deframer.dropped > 0
    os.close(other_end)


@PTY
@pytest.mark.machine
def test_a_full_serial_line_loses_frames_and_goes_on() -> None:
    link, server = serial_line()

    def at_server(timeout: float) -> bytes | None:
        heard = server.receive(timeout)
        return None if heard is None else heard[0]

    ways: list[tuple[Callable[[bytes], None], Callable[[float], bytes | None]]] = [
        (link.send, at_server),
        (lambda data: server.send(data, ("", 0)), link.receive),
    ]
    with closing(server), closing(link):
        for send, receive in ways:
            for _ in range(500):
                send(bytes(200))
                send(b"x" * 200)
            heard = [*iter(partial(receive, 0.1), None)]
            whole = sum(one in (bytes(200), b"x" * 200) for one in heard)
            # each time that the line gets full one frame is cut short; its seal would tell
            assert 0 < whole < 1000 and len(heard) - whole < 0.1 * whole
            send(b"after")
            assert b"after" in (receive(PATIENCE), receive(0.1))  # the frame that was cut short may come first


@PTY
@pytest.mark.machine
def test_a_line_that_is_gone_is_an_error() -> None:
    server = PtyServer()
    with closing(SerialLink(server.path, 921600)) as link:
        with pytest.raises(LinkError, match="cannot open"):
            SerialLink(server.path, 921600)  # one program at a time
        server.close()
        with pytest.raises(LinkError, match="lost"):
            link.receive(PATIENCE)
        with pytest.raises(LinkError, match="lost"):
            link.send(b"hello?")
    with pytest.raises(LinkError, match="cannot open"):
        SerialLink("/dev/no such line", 921600)
    with closing(PtyServer()) as another, pytest.raises(ParameterError, match=r"baud must be .* \(got -1"):
        SerialLink(another.path, -1)


@pytest.mark.parametrize(
    ("error", "says"),
    [
        (SerialException("device reports readiness to read but returned no data"), "unplugged, or opened by another"),
        (SerialException(errno.ENOENT, "could not open port: [Errno 2] No such file"), "No such file or directory"),
        (SerialException(errno.EAGAIN, "Could not exclusively lock port"), "in use by another program"),
        (PermissionError(errno.EACCES, "x"), "Permission denied"),
    ],
)
def test_a_failed_serial_line_is_one_sentence_without_the_librarys_words(
    error: OSError, says: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(*_: object, **__: object) -> None:
        raise error

    monkeypatch.setattr("serial.Serial", fail)
    with pytest.raises(LinkError) as opening:
        SerialLink("/dev/line", 9600)
    assert str(opening.value).startswith(f"cannot open serial:///dev/line: {says}")
    monkeypatch.setattr("serial.Serial", lambda *_, **__: SimpleNamespace(write=fail, close=bool, open=bool))
    with closing(SerialLink("/dev/line", 9600)) as link, pytest.raises(LinkError) as writing:
        link.send(b"frame")
    assert str(writing.value).startswith(f"/dev/line lost: {says}")
    assert not re.search(r"Errno|readiness|could not|Could", f"{opening.value}{writing.value}")


@pytest.mark.needs("pty")
@pytest.mark.parametrize("dtr", [False, True])
def test_opening_a_port_changes_dtr_and_rts_only_on_request(dtr: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    # The system raises both when a port is opened, and lowers them when one with HUPCL is closed.
    import termios

    from serial import serialposix

    lines, edges, control = {"DTR", "RTS"}, list[str](), serialposix.fcntl.ioctl

    def ioctl(descriptor: int, request: int, *values: Any) -> Any:
        """Change the lines of a port; a pseudo-terminal has none."""
        if request not in (serialposix.TIOCMBIS, serialposix.TIOCMBIC):
            return control(descriptor, request, *values)
        name = "DTR" if values[0] == serialposix.TIOCM_DTR_str else "RTS"
        edges.extend([name] * ((name in lines) == (request == serialposix.TIOCMBIC)))
        return values[0]

    monkeypatch.setattr(serialposix.fcntl, "ioctl", ioctl)
    server = PtyServer()
    for _ in range(2):
        with closing(open_link(f"serial://{server.path}?baud=921600{'&dtr=1' * dtr}")):
            assert bool(termios.tcgetattr(server._slave)[2] & termios.HUPCL) is dtr
    server.close()
    assert not edges


@pytest.mark.parametrize("dtr", [False, True])
def test_where_no_system_raises_dtr_and_rts_they_stay_low(dtr: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    class Port(SimpleNamespace):
        def open(self) -> None:
            assert (self.port, self.dtr, self.rts) == ("COM3", dtr, dtr)
            opened.append(self)

    opened = list[Port]()
    monkeypatch.setattr("maglev_mj.bridge.links._RAISED", False)
    monkeypatch.setattr("serial.Serial", lambda *_, **__: Port(close=bool))
    open_link(f"serial://COM3?baud=115200{'&dtr=1' * dtr}").close()
    assert len(opened) == 1


def test_without_pyserial_one_line_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "serial", None)
    with pytest.raises(MissingPackageError, match=r"-m pip install 'pyserial>="):
        open_link("serial:///dev/ttyUSB0")


def test_a_line_delays_each_frame_and_keeps_their_order() -> None:
    line = Line(delay=0.002)
    for data in (b"first", b"second"):
        line.send(TO_DEVICE, data, 5)
    assert line.due == 2_000_005 and list(line.arrived(2_000_004)) == []
    assert list(line.arrived(2_000_005)) == [(TO_DEVICE, b"first"), (TO_DEVICE, b"second")]
    with pytest.raises(ParameterError, match=r"delay must be at least 0.* \(got -1"):
        Line(delay=-1.0)
