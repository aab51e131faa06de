"""Parts of files unpacked within bounds: what a file says of its size may be a lie."""

from __future__ import annotations

import zlib
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from mcap.records import Chunk

__all__ = ["LARGEST_PART", "Allowance", "UnpackingError", "unpacked"]

LARGEST_PART = 64 << 20
"""Bytes that a compressed part of a file, a chunk or an array, may unpack to."""

_TIMES = 1000
_KEPT_TIMES = 100
_KEPT = 1 << 20


class UnpackingError(ValueError):
    """A part of a file is larger than it may be, or is not what it says."""


class Allowance:
    """What a file may unpack to in all: by far more than a recording does, and too little to fill a memory.

    Args:
        size: Of the file [bytes].
    """

    def __init__(self, size: int) -> None:
        self._left, self._kept = LARGEST_PART + _TIMES * size, _KEPT + _KEPT_TIMES * size

    def part(self, size: int) -> None:
        """Count a part, before it is unpacked.

        Raises:
            UnpackingError: If it is too large [bytes], or too much with those before.
        """
        if size > LARGEST_PART:
            raise UnpackingError(f"a part of it must unpack to at most {LARGEST_PART} bytes, not {size}")
        self._left -= size
        if self._left < 0:
            raise UnpackingError(f"it must unpack to at most {_TIMES} times its size")

    def text(self, size: int) -> None:
        """Count a text that is kept; as objects it takes many times its size [bytes].

        Raises:
            UnpackingError: If it is too much with those before.
        """
        self._kept -= size
        if self._kept < 0:
            raise UnpackingError(f"its texts must be at most {_KEPT_TIMES} times its size")


def unpacked(chunk: Chunk) -> bytes:
    """Return what is in a chunk, whose size was counted.

    Raises:
        UnpackingError: If it is more or less than the chunk says, or packed in a way that is not known.
        Exception: Of the program that unpacks it, if it is damaged.
    """
    size = chunk.uncompressed_size
    if chunk.compression == "zstd":
        import zstandard

        data = zstandard.ZstdDecompressor(max_window_size=LARGEST_PART).stream_reader(chunk.data).read(size + 1)
    elif chunk.compression == "lz4":
        from lz4.frame import LZ4FrameDecompressor  # type: ignore[import-untyped]

        data = LZ4FrameDecompressor().decompress(chunk.data, max_length=size + 1)
    elif chunk.compression == "":
        data = chunk.data
    else:
        raise UnpackingError(f"a chunk must be packed by zstd or lz4, not {chunk.compression[:20]!r}")
    if len(data) != size:
        raise UnpackingError(f"a chunk must unpack to {size} bytes, as it says")
    if chunk.uncompressed_crc and zlib.crc32(data) != chunk.uncompressed_crc:
        raise UnpackingError("a chunk must have the checksum that it says")
    return data
