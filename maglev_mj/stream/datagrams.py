"""Datagrams of the pose stream: one JSON object each, with a key and a tag behind it; see docs/stream.md.

Nothing that arrives can raise here: what is no datagram is counted by reason and dropped.
"""

from __future__ import annotations

import hmac
import json
import secrets
from collections import Counter
from collections.abc import Mapping
from typing import Any, TypeAlias, TypeGuard

from maglev_mj.net.authentication import Authenticator

__all__ = ["MOST_ANSWERED", "MOST_ASKED", "MOST_INTEGER", "Datagrams", "Guard", "Message", "is_integer"]

Message: TypeAlias = dict[str, Any]

MOST_ASKED = 1400
"""Bytes that a request may have, its tag included."""

MOST_ANSWERED = 2048
"""Bytes that an answer or a pose may have, its tag included."""

MOST_INTEGER = 2**53 - 1
"""The largest integer that every reader of JSON keeps."""

_SHORT = 17
_MOST_HOSTS = 65536


class Datagrams:
    """Writes and reads datagrams, sealed by a key if there is one.

    Args:
        key: 16 to 32 bytes shared by both ends; None for none.
        most: Longest that is read [bytes].

    Attributes:
        dropped: How many were dropped, by reason: size, tag, json; who reads them adds reasons of its own.

    Raises:
        ParameterError: If the key is too short or too long.
    """

    def __init__(self, key: bytes | None, most: int) -> None:
        self._seal, self._most = None if key is None else Authenticator(key), most
        self.dropped: Counter[str] = Counter()

    @property
    def keyed(self) -> bool:
        """Whether there is a key."""
        return self._seal is not None

    def encode(self, message: Message) -> bytes:
        """Return a datagram; its numbers must be finite."""
        data = json.dumps(message, separators=(",", ":"), allow_nan=False).encode("ascii")
        return data if self._seal is None else data + b"\n" + _digits(self._seal.tag(data))

    def decode(self, data: bytes) -> Message | None:
        """Return the message, or None where there is none that can be trusted; the reason is counted in `dropped`."""
        if len(data) > self._most:
            self.dropped["size"] += 1
            return None
        if self._seal is not None:
            data, _, tag = data.rpartition(b"\n")
            if not hmac.compare_digest(tag, _digits(self._seal.tag(data))):
                self.dropped["tag"] += 1
                return None
        try:
            message = json.loads(data.decode("utf-8"), parse_int=_integer, parse_constant=_no_number)
        except (ValueError, RecursionError):
            message = None
        if not isinstance(message, dict):
            self.dropped["json"] += 1
            return None
        return message


class Guard:
    """Keeps requests that were recorded from being taken again, where there is a key.

    Each request names the session, a number that its host drew, and a sequence number that rises from one request of
    that host to the next. So it is taken once, wherever it comes from.

    Attributes:
        session: Drawn at random when the stream starts.
    """

    def __init__(self) -> None:
        self.session = _drawn()
        self._last: dict[int, int] = {}

    def objection(self, message: Mapping[str, Any]) -> str:
        """Return why a request is not taken, "session" or "replay"; nothing where it is."""
        host, sequence = message.get("host"), message.get("sequence")
        if message.get("session") != self.session or not is_integer(host) or not is_integer(sequence):
            return "session"
        if sequence <= self._last.get(host, -1):
            return "replay"
        if len(self._last) >= _MOST_HOSTS and host not in self._last:
            # no host is forgotten while the session lasts: its requests could be sent again
            self._last.clear()
            self.session = _drawn()
            return "session"
        self._last[host] = sequence
        return ""


def is_integer(value: object) -> TypeGuard[int]:
    """Return whether a value is an integer of 0 to 2**53 - 1."""
    return isinstance(value, int) and not isinstance(value, bool) and 0 <= value <= MOST_INTEGER


def _digits(tag: bytes) -> bytes:
    return tag.hex().encode("ascii")


def _drawn() -> int:
    return 1 + secrets.randbelow(MOST_INTEGER)


def _integer(text: str) -> int | float:
    # a longer one is no integer to most readers, and may be too large for a float to be made of it later
    return int(text) if len(text) < _SHORT else float(text)


def _no_number(text: str) -> float:
    raise ValueError(f"{text} is not JSON")
