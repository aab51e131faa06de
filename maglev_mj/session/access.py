"""Access control of local servers: hosts, ports, allowed origins."""

from __future__ import annotations

import os
import re
import socket
from collections.abc import Sequence
from dataclasses import dataclass
from ipaddress import IPv4Address

from maglev_mj.errors import MaglevError, ParameterError

LOOPBACK = r"(?:127\.0\.0\.1|localhost|\[::1\])(?::\d{1,5})?"
"""Pattern of the loopback names, with optional port."""


class ListenError(MaglevError):
    """A port cannot be opened: in use, or the address is not local."""


def resolve(host: str) -> str:
    """Return the IPv4 address of a host.

    Raises:
        ParameterError: If it has no IPv4 address.
    """
    try:
        addresses = socket.getaddrinfo(host, 0, socket.AF_INET, socket.SOCK_DGRAM) if host else []
        return str(addresses[0][4][0])
    except (OSError, ValueError, IndexError):  # ValueError: malformed name
        raise ParameterError(f"host must be a name or IPv4 address (got {host!r})") from None


def is_loopback(host: str) -> bool:
    """Return True if a host is a loopback address.

    Raises:
        ParameterError: If the host has no IPv4 address.
    """
    return IPv4Address(resolve(host)).is_loopback


def check_host(host: str, key: bytes | None) -> str:
    """Return the IPv4 address of a permitted host: any with a key, otherwise loopback only.

    Raises:
        ParameterError: If the host is not permitted, or has no IPv4 address.
    """
    address = resolve(host)
    if key is None and not is_loopback(address):
        raise ParameterError(f"host must be a loopback address, such as 127.0.0.1, unless a key is set (got {host!r})")
    return address


def check_port(port: int) -> int:
    """Validate a port and return it.

    Raises:
        ParameterError: If it is not an integer from 0 to 65535.
    """
    if isinstance(port, bool) or not isinstance(port, int) or not 0 <= port <= 65535:
        raise ParameterError(f"port must be a whole number from 0 to 65535 (got {port!r})")
    return port


def listen(port: int, host: str = "127.0.0.1") -> socket.socket:
    """Return a listening TCP socket.

    Args:
        port: Port number; 0 for any free port.
        host: Local host name or IPv4 address.

    Raises:
        ParameterError: If the port is invalid, or the host has no IPv4 address.
        ListenError: If the port is in use, or the address is not local.
    """
    try:
        return socket.create_server((resolve(host), check_port(port)))
    except OSError as error:
        raise ListenError(f"cannot listen on port {port} of {host}: {os.strerror(error.errno or 0)}") from None


_ORIGIN = r"https?://(?:[a-z0-9](?:[a-z0-9.-]*[a-z0-9])?|\[[0-9a-f:]+\])(?::\d{1,5})?|file://|null"


def check_origin(text: str) -> str:
    """Validate an Origin (of a viewer's page) and return it.

    Raises:
        ParameterError: If it is not a valid Origin.
    """
    if not re.fullmatch(_ORIGIN, text, re.IGNORECASE):
        raise ParameterError(
            f"origin must be a URL without a path, such as http://192.168.0.5:8080, file:// or null (got {text!r})"
        )
    return text


@dataclass(frozen=True)
class Access:
    """Access check of a local server by the headers Host and Origin.

    Browsers let any page open a WebSocket to this machine; Origin identifies the page. Host detects DNS rebinding, an
    attacker's name that resolves to this machine.

    Args:
        hosts: Pattern of the permitted Host.
        named: Description of the permitted Host, for messages.
        allowed: Permitted Origins besides that of the page itself, see `check_origin`.
    """

    hosts: str
    named: str
    allowed: Sequence[str] = ()

    def refusal(self, hosts: Sequence[str], origins: Sequence[str]) -> str:
        """Return the reason to refuse a request, or "".

        Args:
            hosts: Host headers of the request.
            origins: Origin headers of the request.
        """
        if len(hosts) != 1 or not re.fullmatch(self.hosts, hosts[0], re.IGNORECASE):
            return f"Host must be {self.named} (got {', '.join(hosts)!r})"
        pattern = "|".join((f"https?://{re.escape(hosts[0])}", *map(re.escape, self.allowed)))
        wrong = [origin for origin in origins if not re.fullmatch(pattern, origin, re.IGNORECASE)]
        return f"Origin must be {', '.join(('the page itself', *self.allowed))} (got {wrong[0]!r})" if wrong else ""


def local_access(host: str, origins: Sequence[str] = ()) -> Access:
    """Return the access check of a server, for its host, and for the loopback names if it is a loopback address.

    Args:
        host: Address or name that the server listens on.
        origins: Permitted Origins besides that of the page itself.
    """
    # listening on all addresses: accept any IP address but no name, which an attacker could own (DNS rebinding)
    pattern = r"(?:\d{1,3}\.){3}\d{1,3}" if host == "0.0.0.0" else re.escape(host)
    hosts = rf"{pattern}(?::\d{{1,5}})?" + (f"|{LOOPBACK}" if is_loopback(host) else "")
    return Access(hosts, host, allowed=origins)
