"""Access to servers of this machine: hosts, ports, and who may use them."""

from __future__ import annotations

import os
import re
import socket
from collections.abc import Sequence
from dataclasses import dataclass
from ipaddress import IPv4Address

from maglev_mj.errors import MaglevError, ParameterError

LOOPBACK = r"(?:127\.0\.0\.1|localhost|\[::1\])(?::\d{1,5})?"
"""Pattern of this machine's names, with or without port."""


class ListenError(MaglevError):
    """Port cannot be opened: in use, or not this machine's."""


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


_ORIGIN = r"https?://(?:[a-z0-9](?:[a-z0-9.-]*[a-z0-9])?|\[[0-9a-f:]+\])(?::\d{1,5})?|file://|null"


def check_origin(text: str) -> str:
    """Return the Origin of a viewer's page after checking it.

    Raises:
        ParameterError: If it is not one.
    """
    if not re.fullmatch(_ORIGIN, text, re.IGNORECASE):
        raise ParameterError(
            f"origin must be as http://192.168.0.5:8080, without a path, file:// or null, not {text!r}"
        )
    return text


@dataclass(frozen=True)
class Access:
    """Permission to use a server of this machine, by what a browser says of itself.

    A browser lets any page open a WebSocket to this machine, and says in Origin whose page it is. A name of an
    attacker's own may lead to this machine, too, which Host tells.

    Args:
        hosts: Pattern of the permitted Host.
        named: What that is, in words.
        allowed: Permitted Origins besides that of the page itself, see `check_origin`.
    """

    hosts: str
    named: str
    allowed: Sequence[str] = ()

    def refusal(self, hosts: Sequence[str], origins: Sequence[str]) -> str:
        """Return the reason to refuse a request, or an empty text.

        Args:
            hosts: Its fields Host.
            origins: Its fields Origin.
        """
        if len(hosts) != 1 or not re.fullmatch(self.hosts, hosts[0], re.IGNORECASE):
            return f"Host must be {self.named}, not {', '.join(hosts)!r}"
        pattern = "|".join((f"https?://{re.escape(hosts[0])}", *map(re.escape, self.allowed)))
        wrong = [origin for origin in origins if not re.fullmatch(pattern, origin, re.IGNORECASE)]
        return f"Origin must be {', '.join(('the page itself', *self.allowed))}, not {wrong[0]!r}" if wrong else ""
