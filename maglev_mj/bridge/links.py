"""Links to a device: UDP and serial."""

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
from maglev_mj.keywords import checked
from maglev_mj.parameters import flag
from maglev_mj.session.access import check_host, resolve

BAUD = 921600
"""Default baud rate; at 200 Hz, STATE and CMD together use 3/5 of it."""

_UDP = re.compile(r"udp://([\w.-]+):(\d{1,5})", re.ASCII)
_SERIAL = re.compile(r"serial://(/[^?#]+|COM\d{1,3})(?:\?baud=(\d{1,8})(&dtr=1)?)?", re.ASCII)


class Url(NamedTuple):
    """Parsed address of a link: "udp", host and port; or "serial", path, baud rate, and if DTR and RTS follow it."""

    scheme: str
    host: str
    number: int
    dtr: bool = False


def parse_url(text: str, *, server: bool = False) -> Url:
    """Parse udp://HOST:PORT or serial:///PATH?baud=RATE (on Windows serial://COM3?baud=RATE), optionally with &dtr=1.

    Args:
        text: Address.
        server: Allow port 0, any free port.

    Raises:
        ParameterError: If the address is invalid.
    """
    least = 0 if flag("server", server) else 1
    if (udp := _UDP.fullmatch(text)) and least <= int(udp[2]) <= 65535:
        return Url("udp", udp[1], int(udp[2]))
    if (serial := _SERIAL.fullmatch(text)) and int(serial[2] or BAUD) > 0:
        return Url("serial", serial[1], int(serial[2] or BAUD), serial[3] is not None)
    port = "serial:///PATH?baud=RATE[&dtr=1] (on Windows serial://COM3?baud=RATE)"
    raise ParameterError(f"address must be udp://HOST:PORT with a port from {least} to 65535, or {port}; got {text!r}")


Address: TypeAlias = tuple[str, int]
"""Address of a server's peer: host and port, or the path of a serial port and 0."""

_LARGEST = 2048  # receive size [bytes]; a frame has at most 300
_BACKLOG = 4096 * 1280  # receive buffer: frames, and Linux's bytes per frame
# treated as an unplugged cable: no listener, no host, full buffer;
# a reply to a forged sender (port 0, broadcast); a truncated datagram on Windows
_SILENCE = {errno.ECONNREFUSED, errno.ECONNRESET, errno.EHOSTUNREACH, errno.ENETUNREACH, errno.ENETDOWN}
_SILENCE |= {errno.ENOBUFS, errno.EAGAIN, errno.EINVAL, errno.EACCES, errno.EPERM, errno.EMSGSIZE}


class LinkError(MaglevError):
    """Link cannot be opened, or has failed."""


class Link(Protocol):
    """Interface of a link between host and device."""

    def send(self, data: bytes) -> None:
        """Send one frame; drop it if it cannot be sent now.

        Raises:
            LinkError: If the link has failed.
        """

    def receive(self, timeout: float) -> bytes | None:
        """Return the oldest received frame, or None after `timeout` [s]; 0 does not wait.

        Raises:
            LinkError: If the link has failed.
        """

    def now(self) -> int:
        """Return the link's monotonic clock [ns]."""

    def close(self) -> None:
        """Close the link; idempotent."""


class Server(Protocol):
    """Interface of the device's end, which accepts frames from any host."""

    @property
    def address(self) -> Address:
        """Address for hosts."""

    def receive(self, timeout: float) -> tuple[bytes, Address] | None:
        """Return the oldest frame and its sender, or None after `timeout` [s]; 0 does not wait."""

    def send(self, data: bytes, address: Address) -> None:
        """Send one frame; drop it if it cannot be sent now."""

    def close(self) -> None:
        """Close the server; idempotent."""


class _Udp:
    """Non-blocking IPv4 UDP socket.

    Args:
        host: Name or address.
        port: Port, from `least`.
        least: Smallest port.
        method: "connect" or "bind".
        failure: Start of the error message.
    """

    def __init__(self, host: str, port: int, least: int, method: str, failure: str) -> None:
        if not least <= port <= 65535:
            raise ParameterError(f"port must be {least} to 65535 (got {port!r})")
        address = (resolve(host), port)
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.setblocking(False)
        with suppress(OSError):  # the system may grant less (net.core.rmem_max)
            self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, _BACKLOG)
        try:
            getattr(self._socket, method)(address)
        except OSError as error:
            self._socket.close()
            raise LinkError(f"{failure} udp://{host}:{port}: {error.strerror}") from None

    def close(self) -> None:
        """Close the socket; idempotent."""
        self._socket.close()


class UdpLink(_Udp):
    """Link over UDP (IPv4); a peer that does not listen is silent, not an error.

    Args:
        host: Name or address of the other end.
        port: Port of the other end, 1 to 65535.

    Raises:
        ParameterError: If the host name cannot be resolved, or the port is invalid.
        LinkError: If the host cannot be reached.
    """

    def __init__(self, host: str, port: int) -> None:
        super().__init__(host, port, 1, "connect", "cannot reach")
        self._send, self._receive = self._socket.send, self._socket.recv

    def send(self, data: bytes) -> None:
        """See `Link.send`."""
        try:
            self._send(data)
        except ConnectionRefusedError:  # reported for an earlier frame; this one is not sent yet
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
        # the error was for an earlier frame: keep waiting, so that a polling caller does not spin
        return self.receive(timeout)

    now = staticmethod(time.monotonic_ns)


class UdpServer(_Udp):
    """UDP server socket (IPv4) for any sender; see `check_host` for the permitted hosts.

    Args:
        host: Name or address of this machine; 0.0.0.0 for all interfaces.
        port: Port, 1 to 65535; 0 for any free port.

    Attributes:
        address: Address of the server.

    Raises:
        ParameterError: If the host name cannot be resolved, or the port is invalid.
        LinkError: If the socket cannot be bound.
    """

    def __init__(self, host: str, port: int) -> None:
        super().__init__(host, port, 0, "bind", "cannot listen at")
        self.address: Address = self._socket.getsockname()

    def receive(self, timeout: float) -> tuple[bytes, Address] | None:
        """Return the oldest frame and its sender, or None after `timeout` [s]; 0 does not wait."""
        if timeout > 0.0 and not readable(self._socket, timeout):
            return None
        try:
            return self._socket.recvfrom(_LARGEST)
        except OSError as error:
            _complain("receive", error)
            return None

    def send(self, data: bytes, address: Address) -> None:
        """Send one frame; drop it if it cannot be sent now."""
        try:
            self._socket.sendto(data, address)
        except OSError as error:
            _complain("send", error)


@checked(own="url")
def open_link(url: str | Link, key: bytes | None = None) -> Link:
    """Open a link to the device at an address.

    Args:
        url: See `parse_url`; a link is returned unchanged.
        key: Authentication key of the frames; required for any other machine.

    Raises:
        ParameterError: If the address is invalid, or another machine's without a key.
        LinkError: If it cannot be opened.
        MissingPackageError: If pyserial, needed for a serial link, is not installed.

    Example:
        >>> from maglev_mj import open_link
        >>> link = open_link("udp://127.0.0.1:5678")
        >>> link.receive(timeout=0.0) is None  # no frame yet
        True
        >>> link.close()
    """
    if not isinstance(url, str):
        if not hasattr(url, "receive"):
            raise ParameterError(f"link must be an address or the result of open_link (got {one_line(url)})")
        return url
    scheme, host, number, dtr = parse_url(url)
    if scheme == "udp":
        # open the checked address: the name may resolve differently next time
        return UdpLink(check_host(host, key), number)
    return SerialLink(host, number, dtr=dtr)


def readable(descriptor: int | socket.socket, timeout: float) -> bool:
    """Return True if a descriptor becomes readable within `timeout` [s]; 0 or less does not wait.

    Raises:
        LinkError: If the link has failed.
    """
    try:
        # select: poll and socket timeouts have a resolution of 1 ms
        return bool(select([descriptor], (), (), timeout if timeout > 0.0 else 0.0)[0])
    except (OSError, ValueError) as error:  # ValueError: closed descriptor
        raise LinkError(f"link lost: {error}") from None


def _complain(what: str, error: OSError) -> None:
    """Raise LinkError unless the error counts as silence."""
    if error.errno not in _SILENCE:
        raise LinkError(f"cannot {what}: {error.strerror or error}") from None


LONGEST = 4096
"""Largest frame [bytes]."""

_FLOOD = 1e-3  # longest time spent on invalid data after the caller's timeout [s]
_CODES = [bytes([length + 1]) for length in range(255)]
_SLICE = 1e-3  # timeout of one read [s]; constant, because changing it reconfigures the port
_RAISED = os.name != "nt"  # the system raises DTR and RTS of an opened port: to lower them would be an edge
_ROOM = 0.0 if os.name == "nt" else 1e-4  # write timeout [s]; except on Windows, 0 makes pyserial block indefinitely


def cobs_encode(data: bytes) -> bytes:
    """Return COBS-encoded data: no zero bytes, longer by 1 plus at most 1 per 254 bytes."""
    pieces: list[bytes] = []
    blocks = data.split(b"\0")
    for offset, block in enumerate(blocks, 1 - len(blocks)):
        while len(block) > 253 + (offset == 0):  # no zero follows the last block
            pieces += (b"\xff", block[:254])
            block = block[254:]
        pieces += (_CODES[len(block)], block)
    return b"".join(pieces)


def cobs_decode(data: bytes) -> bytes | None:
    """Return COBS-decoded data, or None if the encoding is invalid."""
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
    """Splitter of a byte stream into frames; resynchronises after garbage.

    Attributes:
        frames: Received frames, oldest first.
        dropped: Number of invalid frames.
    """

    def __init__(self) -> None:
        self.frames: deque[bytes] = deque()
        self.dropped = 0
        self._tail = b""
        self._lost = False

    def feed(self, data: bytes) -> None:
        """Process the next bytes."""
        *pieces, self._tail = (self._tail + data).split(b"\0")
        for piece in pieces:
            frame = None if self._lost or len(piece) > LONGEST else cobs_decode(piece)
            if frame is not None:
                self.frames.append(frame)
            elif piece or self._lost:
                self.dropped += 1
            self._lost = False
        if len(self._tail) > LONGEST:
            self._tail, self._lost = b"", True


class _Line(ABC):
    """Frames over a byte stream.

    Args:
        name: Path of the port, for messages.
    """

    def __init__(self, name: str) -> None:
        self._name, self._deframer = name, Deframer()

    @abstractmethod
    def _read(self, timeout: float) -> bytes:
        """Return the received bytes; none after `timeout` [s]."""

    @abstractmethod
    def _put(self, data: bytes) -> None:
        """Send as many bytes as the buffer takes."""

    def _write(self, data: bytes) -> None:
        """Send one frame; drop it if the buffer is full.

        Raises:
            LinkError: If the link has failed.
        """
        try:
            # the leading zero separates this frame from noise or a truncated one
            self._put(b"\0" + cobs_encode(data) + b"\0")
        except OSError as error:
            raise self._failure(error) from None

    def _next(self, timeout: float) -> bytes | None:
        """See `Link.receive`."""
        frames = self._deframer.frames
        end = time.monotonic() + timeout
        while not frames:
            remaining = end - time.monotonic()
            try:
                data = b"" if remaining < -_FLOOD else self._read(max(remaining, 0.0))
            except OSError as error:
                raise self._failure(error) from None
            if not data and remaining <= 0.0:
                return None
            self._deframer.feed(data)
        return frames.popleft()

    def _failure(self, error: OSError) -> LinkError:
        return LinkError(f"{self._name} lost: {_cause(error)}")


def _cause(error: OSError) -> str:
    """Return the cause in the system's words; pyserial's own errors repeat each other, or have no number."""
    if error.errno in (errno.EAGAIN, errno.EBUSY):
        return "in use by another program"
    return os.strerror(error.errno) if error.errno else "unplugged, or opened by another program"


def _hang_up(path: str, lower: bool) -> None:
    """Set if the system lowers DTR and RTS of a port that is closed; before it is opened, as this resets odd rates."""
    try:
        import fcntl
        import termios
    except ImportError:  # Windows
        return
    with suppress(OSError, termios.error):  # opening reports it
        descriptor = os.open(path, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)  # not that of another program
            values = termios.tcgetattr(descriptor)
            values[2] = values[2] | termios.HUPCL if lower else values[2] & ~termios.HUPCL
            termios.tcsetattr(descriptor, termios.TCSANOW, values)
        finally:
            os.close(descriptor)


class SerialLink(_Line):
    """Link over a serial port, opened exclusively.

    Edges of DTR and RTS reset many boards, or start their boot loader. POSIX systems raise both before a program can
    act, so they are raised once and then kept across closing and opening; on Windows they stay low.

    Args:
        path: Path of the port, such as /dev/ttyUSB0 or COM3.
        baud: Baud rate, above 0.
        dtr: True to raise DTR and RTS at opening, and lower them at closing.

    Raises:
        MissingPackageError: If pyserial is not installed.
        ParameterError: If the port does not support that rate.
        LinkError: If it cannot be opened.
    """

    def __init__(self, path: str, baud: int, *, dtr: bool = False) -> None:
        require(("serial",), "serial", "a serial link needs pyserial")
        from serial import Serial, SerialTimeoutException

        try:
            self._port = Serial(None, baud, timeout=_SLICE, write_timeout=_ROOM, exclusive=True)
            self._port.port, self._port.dtr, self._port.rts = path, dtr or _RAISED, dtr or _RAISED
            _hang_up(path, dtr)
            self._port.open()
        except ValueError:
            raise ParameterError(f"baud must be a rate that {path} supports (got {baud!r})") from None
        except OSError as error:
            raise LinkError(f"cannot open serial://{path}: {_cause(error)}") from None
        # some USB adapters otherwise delay bytes by 16 ms; others, and a pty, do not support it
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
        with suppress(self._full):  # buffer full: drop the frame
            self._opened().write(data)

    def _opened(self) -> Any:
        if not self._open:  # the descriptor may already be reused
            raise OSError(errno.EBADF, "closed")
        return self._port

    def close(self) -> None:
        """Close the port; idempotent."""
        self._open = False
        with suppress(OSError):  # unplugged adapter
            self._port.close()


class PtyServer(_Line):
    """Device's end of a simulated serial port (pseudo-terminal); any program may open the other end.

    Attributes:
        path: Path of the other end, for a `SerialLink`.
        address: Address of the only peer.

    Raises:
        LinkError: If the system has no pseudo-terminals.
    """

    def __init__(self) -> None:
        try:
            import tty

            master, self._slave = os.openpty()
        except (ImportError, AttributeError, OSError) as error:
            raise LinkError(f"cannot open a pseudo-terminal: {error}") from None
        tty.setraw(self._slave)  # keep it open, or the port would close with the peer
        os.set_blocking(master, False)
        self.path = os.ttyname(self._slave)
        self.address: Address = (self.path, 0)
        self._descriptor, self._open = master, True
        super().__init__(self.path)

    def receive(self, timeout: float) -> tuple[bytes, Address] | None:
        """Return the oldest frame and its sender, or None after `timeout` [s]; 0 does not wait."""
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
        with suppress(BlockingIOError):  # buffer full: drop the frame
            os.write(self._descriptor, data)

    def close(self) -> None:
        """Close both ends; idempotent."""
        if self._open:
            self._open = False
            os.close(self._descriptor)
            os.close(self._slave)
            self._descriptor = -1
