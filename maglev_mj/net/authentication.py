"""Message authentication by a shared key."""

from __future__ import annotations

import hashlib

from maglev_mj.errors import ParameterError

LEAST_KEY, MOST_KEY = 16, 32
"""Smallest and largest length of a key [bytes]."""

TAG = 16
"""Length of a tag [bytes]."""


class Authenticator:
    """Authenticator of messages by keyed BLAKE2s.

    Args:
        key: Key shared by both ends.

    Raises:
        ParameterError: If it is too short or too long.
    """

    def __init__(self, key: bytes) -> None:
        if not LEAST_KEY <= len(key) <= MOST_KEY:
            raise ParameterError(f"key must have {LEAST_KEY} to {MOST_KEY} bytes, not {len(key)}")
        self._key = key

    def tag(self, data: bytes) -> bytes:
        """Return the tag of a message."""
        return hashlib.blake2s(data, digest_size=TAG, key=self._key).digest()
