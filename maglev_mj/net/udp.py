"""Links that transport frames, and links over UDP.

A link may lose, repeat, reorder and damage frames without notice: the frames are numbered and have a checksum.
"""

from __future__ import annotations

import errno
import socket
import time
from contextlib import suppress
from select import select
from typing import Protocol, TypeAlias

from maglev_mj.errors import MaglevError, ParameterError, one_line
from maglev_mj.net.addresses import check_host, parse_url, resolve

__all__ = ["Address", "Link", "LinkError", "Server", "UdpLink", "UdpServer", "check_host", "open_link", "parse_url"]

Address: TypeAlias = tuple[str, int]
"""Address of a server's peer.

Host and port, or path and 0 of a serial line.
"""

_LARGEST = 2048  # of a datagram: a frame has at most 300 bytes
_BACKLOG = 4096 * 1280  # frames in the receive buffer, and Linux's size of one
# no listener, no host, no room: the same as an unplugged cable;
# and an answer to a forged sender, port 0 or everyone, is not let out
_SILENCE = {errno.ECONNREFUSED, errno.ECONNRESET, errno.EHOSTUNREACH, errno.ENETUNREACH, errno.ENETDOWN}
_SILENCE |= {errno.ENOBUFS, errno.EAGAIN, errno.EINVAL, errno.EACCES, errno.EPERM}


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

    def now(self) -> int:
        """Return this machine's monotonic clock [ns]."""
        return time.monotonic_ns()


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
    from maglev_mj.net.serial import SerialLink

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
