"""Addresses of links, and checks of permitted hosts."""

from __future__ import annotations

import os
import re
import socket
from ipaddress import IPv4Address
from typing import NamedTuple

from maglev_mj.errors import MaglevError, ParameterError
from maglev_mj.parameters import flag

BAUD = 921600
"""Default baud rate of a serial line.

139 bytes a sample and as many an answer need 3/5 of it at 200 Hz.
"""

LOOPBACK = r"(?:127\.0\.0\.1|localhost|\[::1\])(?::\d{1,5})?"
"""Pattern of this machine's names, with or without port."""

_UDP = re.compile(r"udp://([\w.-]+):(\d{1,5})", re.ASCII)
_SERIAL = re.compile(r"serial://(/[^?#]+)(?:\?baud=(\d{1,8}))?", re.ASCII)


class ListenError(MaglevError):
    """Port cannot be opened: in use, or not this machine's."""


class Url(NamedTuple):
    """Address of a link, parsed.

    Scheme "udp", host and port; or "serial", path of the line and baud rate [1/s].
    """

    scheme: str
    place: str
    number: int


def parse_url(text: str, *, server: bool = False) -> Url:
    """Parse udp://HOST:PORT or serial:///PATH?baud=RATE.

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
        f"address must be udp://HOST:PORT with a port of {least} to 65535, or serial:///PATH?baud=RATE, not {text!r}"
    )


def resolve(host: str) -> str:
    """Return the IPv4 address of a host.

    Raises:
        ParameterError: If it has no address.
    """
    try:
        found = socket.getaddrinfo(host, 0, socket.AF_INET, socket.SOCK_DGRAM) if host else []
        return str(found[0][4][0])
    except (OSError, ValueError, IndexError):  # a name that cannot be one is a ValueError
        raise ParameterError(f"host must be a name or address with IPv4, not {host!r}") from None


def is_loopback(host: str) -> bool:
    """Return True if a host is this machine.

    Raises:
        ParameterError: If the host has no IPv4 address.
    """
    return IPv4Address(resolve(host)).is_loopback


def check_host(host: str, key: bytes | None) -> str:
    """Return the IPv4 address of a permitted host.

    Permitted is this machine, and any with a key.

    Raises:
        ParameterError: If it is another machine and there is no key, or it has no address.
    """
    address = resolve(host)
    if key is None and not is_loopback(address):
        raise ParameterError(f"host must be a loopback address, such as 127.0.0.1, or a key be given, not {host!r}")
    return address


def check_port(port: int) -> int:
    """Return a port after checking it.

    Raises:
        ParameterError: If it is not a whole number of 0 to 65535.
    """
    if isinstance(port, bool) or not isinstance(port, int) or not 0 <= port <= 65535:
        raise ParameterError(f"port must be a whole number of 0 to 65535, not {port!r}")
    return port


def listen(port: int, host: str = "127.0.0.1") -> socket.socket:
    """Return a socket that listens for TCP connections.

    Args:
        port: Port number; 0 for any free one.
        host: Name or IPv4 address of this machine.

    Raises:
        ParameterError: If the port is invalid, or the host has no IPv4 address.
        ListenError: If the port is taken, or the host is not of this machine.
    """
    try:
        return socket.create_server((resolve(host), check_port(port)))
    except OSError as error:
        raise ListenError(f"cannot listen at port {port} of {host}: {os.strerror(error.errno or 0)}") from None
