"""Links to a device: UDP and serial lines."""

from __future__ import annotations

import errno
import os
import re
import socket
import time
from abc import ABC, abstractmethod
from collections import deque
from contextlib import suppress
from select import select
from typing import Any, NamedTuple, Protocol, TypeAlias

from maglev_mj.errors import MaglevError, ParameterError, one_line, require
from maglev_mj.parameters import flag
from maglev_mj.session.access import check_host, resolve

BAUD = 921600
"""Default baud rate of a serial line.

139 bytes a sample and as many an answer need 3/5 of it at 200 Hz.
"""

_UDP = re.compile(r"udp://([\w.-]+):(\d{1,5})", re.ASCII)
_SERIAL = re.compile(r"serial://(/[^?#]+|COM\d{1,3})(?:\?baud=(\d{1,8}))?", re.ASCII)


class Url(NamedTuple):
    """Address of a link, parsed.

    Scheme "udp", host and port; or "serial", path of the line and baud rate [1/s].
    """

    scheme: str
    place: str
    number: int


def parse_url(text: str, *, server: bool = False) -> Url:
    """Parse udp://HOST:PORT or serial:///PATH?baud=RATE, on Windows serial://COM3?baud=RATE.

    A server may have port 0, for any free one.

    Raises:
        ParameterError: If the text has neither form.
    """
    least = 0 if flag("server", server) else 1
    if (udp := _UDP.fullmatch(text)) and least <= int(udp[2]) <= 65535:
        return Url("udp", udp[1], int(udp[2]))
    if (serial := _SERIAL.fullmatch(text)) and int(serial[2] or BAUD) > 0:
        return Url("serial", serial[1], int(serial[2] or BAUD))
    raise ParameterError(
        f"address must be udp://HOST:PORT with a port of {least} to 65535, "
        f"or serial:///PATH?baud=RATE (on Windows serial://COM3?baud=RATE), not {text!r}"
    )


Address: TypeAlias = tuple[str, int]
"""Address of a server's peer.

Host and port, or path and 0 of a serial line.
"""

_LARGEST = 2048  # of a datagram: a frame has at most 300 bytes
_BACKLOG = 4096 * 1280  # frames in the receive buffer, and Linux's size of one
# no listener, no host, no room: the same as an unplugged cable;
# an answer to a forged sender, port 0 or everyone, is not let out; and Windows refuses to cut a datagram short
_SILENCE = {errno.ECONNREFUSED, errno.ECONNRESET, errno.EHOSTUNREACH, errno.ENETUNREACH, errno.ENETDOWN}
_SILENCE |= {errno.ENOBUFS, errno.EAGAIN, errno.EINVAL, errno.EACCES, errno.EPERM, errno.EMSGSIZE}


class LinkError(MaglevError):
    """Link cannot be opened, or its line has failed."""


class Link(Protocol):
    """One end of a connection between two."""

    def send(self, data: bytes) -> None:
        """Send one frame; drop it if it cannot leave now.

        Raises:
            LinkError: If the link has failed.
        """

    def receive(self, timeout: float) -> bytes | None:
        """Return the oldest received frame, or None.

        It waits up to `timeout` [s]; 0 returns at once.

        Raises:
            LinkError: If the link has failed.
        """

    def now(self) -> int:
        """Return the link's monotonic clock [ns]."""

    def close(self) -> None:
        """Close the link; idempotent."""


class Server(Protocol):
    """Interface of the end that waits for hosts."""

    @property
    def address(self) -> Address:
        """Address for hosts."""

    def receive(self, timeout: float) -> tuple[bytes, Address] | None:
        """Return the oldest frame and its sender, or None.

        It waits up to `timeout` [s]; 0 returns at once.
        """

    def send(self, data: bytes, address: Address) -> None:
        """Send one frame; drop it if it cannot leave now."""

    def close(self) -> None:
        """Close the server; idempotent."""


class _Udp:
    """Non-blocking IPv4 UDP socket.

    Args:
        host: Name or address.
        port: Port, at least `least`.
        way: Method for that address: "connect" or "bind".
        failing: Error message of a failure.
    """

    def __init__(self, host: str, port: int, least: int, way: str, failing: str) -> None:
        if not least <= port <= 65535:
            raise ParameterError(f"port must be {least} to 65535, not {port!r}")
        address = (resolve(host), port)
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.setblocking(False)
        with suppress(OSError):  # a system may grant less (net.core.rmem_max)
            self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, _BACKLOG)
        try:
            getattr(self._socket, way)(address)
        except OSError as error:
            self._socket.close()
            raise LinkError(f"{failing} udp://{host}:{port}: {error.strerror}") from None

    def fileno(self) -> int:
        """Return the descriptor for `select`."""
        return self._socket.fileno()

    def close(self) -> None:
        """Close the socket; idempotent."""
        self._socket.close()


class UdpLink(_Udp):
    """Link over UDP, IPv4.

    An end without listener gives silence, not an error.

    Args:
        host: Name or address of the other end.
        port: Port of the other end, 1 to 65535.

    Raises:
        ParameterError: If the host has no address, or the port is invalid.
        LinkError: If the host cannot be reached.
    """

    def __init__(self, host: str, port: int) -> None:
        super().__init__(host, port, 1, "connect", "no way to")
        self._send, self._receive = self._socket.send, self._socket.recv

    def send(self, data: bytes) -> None:
        """See `Link.send`."""
        try:
            self._send(data)
        except ConnectionRefusedError:  # of an earlier frame: this one has not been sent yet
            try:
                self._send(data)
            except OSError as error:
                _complain("send", error)
        except OSError as error:
            _complain("send", error)

    def receive(self, timeout: float) -> bytes | None:
        """See `Link.receive`."""
        if timeout > 0.0 and not readable(self._socket, timeout):
            return None
        try:
            return self._receive(_LARGEST)
        except BlockingIOError:
            if timeout <= 0.0:
                return None
        except OSError as error:
            _complain("receive", error)
        # that was word of a frame sent earlier; a caller that got None at once, and asked again, would spin
        return self.receive(timeout)

    now = staticmethod(time.monotonic_ns)


class UdpServer(_Udp):
    """UDP server socket, IPv4, open to any sender.

    `check_host` tells if it may be opened at a host.

    Args:
        host: Name or address of this machine; 0.0.0.0 for all addresses.
        port: Port of the server, 1 to 65535; 0 for any free one.

    Attributes:
        address: Address of the server.

    Raises:
        ParameterError: If the host has no address, or the port is invalid.
        LinkError: If it cannot listen there.
    """

    def __init__(self, host: str, port: int) -> None:
        super().__init__(host, port, 0, "bind", "cannot listen at")
        self.address: Address = self._socket.getsockname()

    def receive(self, timeout: float) -> tuple[bytes, Address] | None:
        """Return the oldest frame and its sender, or None.

        It waits up to `timeout` [s]; 0 returns at once.
        """
        if timeout > 0.0 and not readable(self._socket, timeout):
            return None
        try:
            return self._socket.recvfrom(_LARGEST)
        except OSError as error:
            _complain("receive", error)
            return None

    def send(self, data: bytes, address: Address) -> None:
        """Send one frame; drop it if it cannot leave now."""
        try:
            self._socket.sendto(data, address)
        except OSError as error:
            _complain("send", error)


def open_link(url: str | Link, key: bytes | None = None) -> Link:
    """Return a link to the device at an address.

    Args:
        url: See `parse_url`; a link is returned as it is.
        key: Authentication key of the frames; needed for any machine but this.

    Raises:
        ParameterError: If the address is invalid, or is another machine's and there is no key.
        LinkError: If it cannot be opened.
        MissingPackageError: If a serial line needs pyserial, which is not installed.

    Example:
        >>> from maglev_mj import open_link
        >>> link = open_link("udp://127.0.0.1:5678")
        >>> link.receive(timeout=0.0) is None  # nothing has come
        True
        >>> link.close()
    """
    if not isinstance(url, str):
        if not hasattr(url, "receive"):
            raise ParameterError(f"link must be an address, or a link that open_link returns, not {one_line(url)}")
        return url
    scheme, place, number = parse_url(url)
    if scheme == "udp":
        # the checked address is opened: a name may have another address the next time
        return UdpLink(check_host(place, key), number)
    return SerialLink(place, number)


def readable(descriptor: int | socket.socket, timeout: float) -> bool:
    """Return True if a descriptor is readable within `timeout` [s].

    0 or less returns at once.

    Raises:
        LinkError: If the link has failed.
    """
    try:
        # select, not poll or a timeout of the socket: those wait whole milliseconds
        return bool(select([descriptor], (), (), timeout if timeout > 0.0 else 0.0)[0])
    except (OSError, ValueError) as error:  # a descriptor that is closed is a ValueError
        raise LinkError(f"the line is gone: {error}") from None


def _complain(what: str, error: OSError) -> None:
    """Raise LinkError unless the error means silence."""
    if error.errno not in _SILENCE:
        raise LinkError(f"cannot {what}: {error.strerror or error}") from None


LONGEST = 4096
"""Largest number of bytes of a frame."""

_FLOOD = 1e-3  # longest reading of invalid data beyond the caller's timeout [s]
_CODES = [bytes([length + 1]) for length in range(255)]
_SLICE = 1e-3  # longest wait of one read [s]: set once, as drivers take a new one for a new setting of the line
_ROOM = 0.0 if os.name == "nt" else 1e-4  # wait for room to send [s]; elsewhere pyserial, told 0, waits without end


def cobs_encode(data: bytes) -> bytes:
    """Return COBS-encoded data, without a zero byte.

    It is longer by 1 and by at most one more for every 254 bytes.
    """
    pieces: list[bytes] = []
    blocks = data.split(b"\0")
    for left, block in enumerate(blocks, 1 - len(blocks)):
        while len(block) > 253 + (left == 0):  # the last has no zero after it
            pieces += (b"\xff", block[:254])
            block = block[254:]
        pieces += (_CODES[len(block)], block)
    return b"".join(pieces)


def cobs_decode(data: bytes) -> bytes | None:
    """Return COBS-decoded data; None for an invalid encoding."""
    end = len(data)
    if not end or b"\0" in data:
        return None
    pieces = []
    start = 0
    while start < end:
        code = data[start]
        stop = start + code
        if stop > end:
            return None
        pieces.append(data[start + 1 : stop])
        if code < 255 and stop < end:
            pieces.append(b"\0")
        start = stop
    return b"".join(pieces)


class Deframer:
    """Splitter of a byte stream into frames.

    It resynchronizes after garbage.

    Attributes:
        frames: Received frames, oldest first; to be taken from the left.
        dropped: Number of invalid pieces.
    """

    def __init__(self) -> None:
        self.frames: deque[bytes] = deque()
        self.dropped = 0
        self._rest = b""
        self._lost = False

    def feed(self, data: bytes) -> None:
        """Add the next bytes."""
        *pieces, self._rest = (self._rest + data).split(b"\0")
        for piece in pieces:
            frame = None if self._lost or len(piece) > LONGEST else cobs_decode(piece)
            if frame is not None:
                self.frames.append(frame)
            elif piece or self._lost:
                self.dropped += 1
            self._lost = False
        if len(self._rest) > LONGEST:
            self._rest, self._lost = b"", True


class _Line(ABC):
    """Frames over a stream of bytes.

    Args:
        name: Path of the line, for messages.
    """

    def __init__(self, name: str) -> None:
        self._name, self._deframer = name, Deframer()

    @abstractmethod
    def _read(self, timeout: float) -> bytes:
        """Return the bytes that have come, none after `timeout` [s]."""

    @abstractmethod
    def _put(self, data: bytes) -> None:
        """Send bytes, or what of them there is room for."""

    def _write(self, data: bytes) -> None:
        """Send one frame; drop it if the buffer is full.

        Raises:
            LinkError: If the link has failed.
        """
        try:
            # the zero before it keeps noise, or a frame cut short for lack of room, from spoiling this one
            self._put(b"\0" + cobs_encode(data) + b"\0")
        except OSError as error:
            raise self._gone(error) from None

    def _next(self, timeout: float) -> bytes | None:
        """See `Link.receive`."""
        frames = self._deframer.frames
        end = time.monotonic() + timeout
        while not frames:
            left = end - time.monotonic()
            try:
                data = b"" if left < -_FLOOD else self._read(max(left, 0.0))
            except OSError as error:
                raise self._gone(error) from None
            if not data and left <= 0.0:
                return None
            self._deframer.feed(data)
        return frames.popleft()

    def _gone(self, error: OSError) -> LinkError:
        return LinkError(f"{self._name} is gone: {error.strerror or error}")


class SerialLink(_Line):
    """Link over a serial line, opened exclusively.

    Args:
        path: Path of the line, such as /dev/ttyUSB0 or COM3.
        baud: Rate [1/s], above 0.

    Raises:
        MissingPackageError: If pyserial is not installed.
        ParameterError: If the line does not have that rate.
        LinkError: If it cannot be opened.
    """

    def __init__(self, path: str, baud: int) -> None:
        require(("serial",), "serial", "a serial line needs pyserial")
        from serial import Serial, SerialTimeoutException

        try:
            self._port = Serial(path, baud, timeout=_SLICE, write_timeout=_ROOM, exclusive=True)
        except ValueError:
            raise ParameterError(f"baud must be a rate that {path} has, not {baud!r}") from None
        except OSError as error:
            raise LinkError(f"cannot open serial://{path}: {error.strerror or error}") from None
        # without it some USB adapters hold bytes back for 16 ms; others, and a pty, do not know it
        with suppress(OSError, ValueError, AttributeError, NotImplementedError):
            self._port.set_low_latency_mode(True)
        self._full, self._open = SerialTimeoutException, True
        super().__init__(path)

    send, receive = _Line._write, _Line._next

    now = staticmethod(time.monotonic_ns)

    def _read(self, timeout: float) -> bytes:
        waiting = self._opened().in_waiting
        data: bytes = self._port.read(waiting or 1) if waiting or timeout > 0.0 else b""
        return data

    def _put(self, data: bytes) -> None:
        with suppress(self._full):  # no room: lost, as on any link
            self._opened().write(data)

    def _opened(self) -> Any:
        if not self._open:  # its descriptor may be another file's by now
            raise OSError("it is closed")
        return self._port

    def close(self) -> None:
        """Close the line; idempotent."""
        self._open = False
        with suppress(OSError):  # an adapter that was pulled out
            self._port.close()


class PtyServer(_Line):
    """Device's end of a simulated serial line, a pseudo-terminal.

    Any program may open the other end.

    Attributes:
        path: Path of the other end, for a `SerialLink`.
        address: Address of its only peer.

    Raises:
        LinkError: If the system has no pseudo-terminals.
    """

    def __init__(self) -> None:
        try:
            import tty

            master, self._slave = os.openpty()
        except (ImportError, AttributeError, OSError) as error:
            raise LinkError(f"no pseudo-terminal: {error}") from None
        tty.setraw(self._slave)  # kept open, or the line would be gone whenever the peer closes
        os.set_blocking(master, False)
        self.path = os.ttyname(self._slave)
        self.address: Address = (self.path, 0)
        self._descriptor, self._open = master, True
        super().__init__(self.path)

    def receive(self, timeout: float) -> tuple[bytes, Address] | None:
        """Return the oldest frame and its sender, or None.

        It waits up to `timeout` [s]; 0 returns at once.
        """
        data = self._next(timeout)
        return None if data is None else (data, self.address)

    def send(self, data: bytes, address: Address) -> None:
        """Send one frame; drop it if the buffer is full."""
        self._write(data)

    def _read(self, timeout: float) -> bytes:
        try:
            return os.read(self._descriptor, LONGEST) if readable(self._descriptor, timeout) else b""
        except BlockingIOError:
            return b""

    def _put(self, data: bytes) -> None:
        with suppress(BlockingIOError):  # no room: lost, as on any link
            os.write(self._descriptor, data)

    def close(self) -> None:
        """Close both ends; idempotent."""
        if self._open:
            self._open = False
            os.close(self._descriptor)
            os.close(self._slave)
            self._descriptor = -1
